"""Audio for pre-training the speech encoder: crops of any sound files (RG 4.1.3)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.parallel import own_rows
from data_module.speech.audio import SAMPLE_RATE, load_speech, resample
from data_module.store import Store

SUFFIXES = (".flac", ".wav", ".ogg", ".mp3")


def sound_files(folder: Path) -> list[Path]:
    """All sound files in a folder and below, sorted; InputError if there are none."""
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "name a folder of sound files")
    files = sorted(file for file in folder.rglob("*") if file.suffix.lower() in SUFFIXES and file.is_file())
    if not files:
        raise InputError(folder, "holds no sound file", f"put {', '.join(SUFFIXES)} files there")
    return files


def folder_digest(folder: Path) -> str:
    """A hash of the names and contents of a folder's sound files."""
    digest = hashlib.sha256()
    for file in sound_files(folder):
        digest.update(file.relative_to(folder).as_posix().encode() + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class Crops:
    """Concatenated audio, and the possible starts of crops within each recording.

    samples: [T] half precision. first: [R] start of each recording; room: [R] number of possible starts in it.
    """

    samples: NDArray[np.float16]
    first: NDArray[np.int64]
    room: NDArray[np.int64]
    length: int

    @classmethod
    def of_store(cls, store: Store, names: Sequence[str], folders: Sequence[Path], length: int) -> Crops:
        """Crops of `length` samples from recordings of a store and from folders of audio."""
        files = [file for folder in folders for file in sound_files(folder)]
        parts = []
        for sound in [store.load(name).speech for name in names] + [load_speech(file) for file in files]:
            samples = resample(sound, SAMPLE_RATE).samples
            parts.append(np.pad(samples, (0, max(0, length - len(samples)))).astype(np.float16))
        sizes = np.array([len(part) for part in parts])
        return cls(np.concatenate(parts), np.cumsum(sizes) - sizes, sizes - length + 1, length)

    def sample(self, rng: np.random.Generator, count: int) -> NDArray[np.float32]:
        """[count, length] crops, every start equally likely; only this process's rows."""
        ends = np.cumsum(self.room)
        place = rng.integers(ends[-1], size=count)[own_rows(count)]
        recording = np.searchsorted(ends, place, side="right")
        starts = self.first[recording] + place - (ends - self.room)[recording]
        return np.stack([self.samples[start:start + self.length] for start in starts]).astype(np.float32)
