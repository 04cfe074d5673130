"""A store: synchronised motion, speech and words, not yet cut into blocks.

A store is a folder. `store.json` lists its content, `recordings/NAME.flac` is the sound and `recordings/NAME.npz` the
motion on the character (with fingers and legs) at the original frame rate, and the words.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from data_module.arrays import as_floats, read_npz
from data_module.errors import InputError, shown
from data_module.files import file_hash, read_json, write_bytes, write_text
from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTERS, JOINTS, resized
from data_module.speech.audio import load_speech, write_flac
from data_module.types import Motion, Speech, Word

__all__ = ["SPLITS", "Recording", "RecordingInfo", "Store", "StoreWriter"]

FORMAT = 3
Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = get_args(Split)
_LISTING, _FOLDER = "store.json", "recordings"
_LARGEST_LISTING = 1 << 28
"""Bytes (256 MiB) of a listing: half a kilobyte a recording, so half a million recordings."""


@dataclass(frozen=True)
class RecordingInfo:
    """The entry of a recording in the list of a store.

    speaker: the performer; voice: the person who speaks; language: ISO 639-1; absent: joints that the source lacks;
    filled: joints with synthetic motion (`Motion.filled`); group: recordings of one group share their sound or their
    text, so a confidence interval counts them once; part: of a corpus with parts; sources: the original recordings.
    """

    name: str
    split: Split
    speaker: str
    voice: str
    language: str
    seconds: float = 0.0
    frames: int = 0
    fps: float = 0.0
    absent: tuple[str, ...] = ()
    group: str = ""
    part: str = ""
    sources: tuple[str, ...] = ()
    filled: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.split not in SPLITS:
            raise InputError(self.name, f"has the split '{self.split}'", f"use one of {', '.join(SPLITS)}")
        if not all(0 <= number < np.inf for number in (self.seconds, self.frames, self.fps)):
            raise ValueError("a length that is not a number")
        # Unprintable are control characters and invalid bytes.
        if not self.name or any(mark in self.name for mark in "/\\:") or self.name.startswith(".") \
                or not self.name.isprintable():
            raise InputError(ascii(self.name), "cannot name a recording", "use letters, digits, '_' and '-'")


@dataclass(frozen=True)
class Recording:
    """Speech (with its words, where known) and motion that start together and last equally long. stands: the
    performer does not walk, so that a store may fix the feet to the floor."""

    info: RecordingInfo
    speech: Speech
    motion: Motion
    stands: bool = False


@dataclass(frozen=True)
class _Listing:
    """The entries of `store.json`."""

    corpus: str
    settings: dict[str, Any]
    seed: int
    licence: str
    fingerprint: str
    recordings: tuple[RecordingInfo, ...]


class Store:
    """A finished store, opened for reading."""

    def __init__(self, path: Path, listing: Mapping[str, Any]) -> None:
        checked = msgspec.convert(listing, _Listing)
        self.path = path
        self.corpus, self.settings, self.seed = checked.corpus, checked.settings, checked.seed
        self.licence, self.fingerprint, self.recordings = checked.licence, checked.fingerprint, checked.recordings
        self._hashes = {entry["name"]: (str(entry["sha256"]["flac"]), str(entry["sha256"]["npz"]))
                        for entry in listing["recordings"]}
        if len(self._hashes) != len(self.recordings):
            raise ValueError("two recordings share a name")

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Store:
        """Open the store at `path`; `InputError` if it is missing, not a store, or of another format."""
        folder = Path(path)
        listing = folder / _LISTING
        if not listing.is_file():
            raise InputError(folder, "is not a store (no store.json)" if folder.exists() else "does not exist",
                             "give a folder made by gesticulator build")
        try:
            content = read_json(listing, "build it again", _LARGEST_LISTING)
            if content["format"] != FORMAT:
                raise InputError(folder, f"is a store of format {shown(content['format'])}, and this version reads "
                                 f"format {FORMAT}", "build it again")
            store = cls(folder, content)
            fingerprint = _fingerprint(content["recordings"])
        except (AttributeError, TypeError, KeyError, ValueError):
            raise InputError(listing, "is not the listing of a store, or has invalid entries",
                             "build it again") from None
        # The fingerprint covers the entries, so that a changed split or speaker is noticed, too.
        if fingerprint != store.fingerprint:
            raise InputError(listing, "does not match its own fingerprint", "it was edited: build it again")
        # Files are looked for now and hashed when a recording is read: hashing hours of sound takes minutes.
        for info in store.recordings:
            for file in _files(folder, info.name):
                if not file.is_file():
                    raise InputError(file, "is missing from its store", "build it again")
        return store

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(info.name for info in self.recordings)

    def of_split(self, split: Split) -> tuple[RecordingInfo, ...]:
        return tuple(info for info in self.recordings if info.split == split)

    def load(self, name: str, joints: int = len(JOINTS)) -> Recording:
        """Read one recording: its motion on the character at the corpus's own rate. joints: in which of its sizes
        (`skeletons.CHARACTERS`); those that the store lacks are at rest and `absent`."""
        info = next((info for info in self.recordings if info.name == name), None)
        if info is None:
            raise InputError(name, f"is not in the store {self.path}", f"it holds {len(self.recordings)} recordings")
        sound, arrays = _files(self.path, name)
        for file, wanted in zip((sound, arrays), self._hashes[name], strict=True):
            if file_hash(file) != wanted:
                raise InputError(file, "was changed since its store was built", "build it again")
        recording = _read(info, sound, arrays)
        return replace(recording, motion=resized(recording.motion, CHARACTERS[joints]))


class StoreWriter:
    """Writes a store into a folder, recording by recording, in any order and from several processes at once."""

    def __init__(self, path: str | os.PathLike[str], corpus: str, settings: Mapping[str, Any], seed: int,
                 licence: str) -> None:
        self.path = Path(path)
        self._head = {"format": FORMAT, "corpus": corpus, "settings": settings, "seed": seed, "licence": licence}
        (self.path / _FOLDER).mkdir(parents=True)

    def add(self, recording: Recording, character: Motion | None = None) -> Path:
        """Write one recording with its motion, or `character` in its place, on the character in any of its sizes; its
        sound file. The motion must last as long as the speech, to a frame."""
        recording = recording if character is None else replace(recording, motion=character)
        motion, info = recording.motion, recording.info
        if not any(motion.skeleton.same_joints(character) for character in CHARACTERS.values()):
            raise ValueError(f"{info.name}: a store keeps motion on the character")
        if abs(motion.duration - recording.speech.duration) > 1.0 / motion.fps:
            raise ValueError(f"{info.name}: {motion.duration:.3f} s of motion for "
                             f"{recording.speech.duration:.3f} s of speech")
        sound, arrays = _files(self.path, info.name)
        write_flac(sound, recording.speech)
        write_bytes(arrays, _pack(_arrays(recording)))
        entry = asdict(info) | {"seconds": round(recording.speech.duration, 6), "frames": len(motion),
                                "fps": motion.fps, "absent": list(motion.absent), "filled": list(motion.filled),
                                "sources": list(info.sources),
                                "sha256": {"flac": file_hash(sound), "npz": file_hash(arrays)}}
        write_text(self._entry(info.name), json.dumps(entry))
        return sound

    def finish(self, names: Sequence[str]) -> Store:
        """Write the list of the recordings in the order of `names`, which must all exist."""
        entries = [read_json(self._entry(name), "build it again") for name in names]
        # So that equal stores have equal files.
        for name in names:
            self._entry(name).unlink()
        listing = self._head | {"fingerprint": _fingerprint(entries), "recordings": entries}
        write_text(self.path / _LISTING, json.dumps(listing, indent=1))
        return Store.open(self.path)

    def _entry(self, name: str) -> Path:
        return self.path / _FOLDER / f"{name}.json"


def _files(folder: Path, name: str) -> tuple[Path, Path]:
    return folder / _FOLDER / f"{name}.flac", folder / _FOLDER / f"{name}.npz"


def _fingerprint(entries: Sequence[Mapping[str, Any]]) -> str:
    return hashlib.sha256(json.dumps(list(entries), sort_keys=True).encode()).hexdigest()


_WORDS = ("text", "start", "end")


def _arrays(recording: Recording) -> dict[str, NDArray[Any]]:
    motion, speech = recording.motion, recording.speech
    arrays: dict[str, NDArray[Any]] = {
        # Single precision halves the file; its error of 1e-7 rad is far below that of any capture.
        "rotations": motion.rotations.astype(np.float32),
        "root_positions": motion.root_positions.astype(np.float32),
        "fps": np.array(motion.fps), "joints": np.array(motion.skeleton.names),
        "absent": np.array(motion.absent, dtype=str), "filled": np.array(motion.filled, dtype=str),
    }
    if speech.words is not None:
        arrays |= {f"word_{name}": np.array([getattr(word, name) for word in speech.words]) for name in _WORDS}
    return arrays


def _read(info: RecordingInfo, sound: Path, file: Path) -> Recording:
    arrays = read_npz(file, advice="build the store again")
    try:
        # The number of joints tells the character, whose names must then agree.
        skeleton = CHARACTERS[len(arrays["joints"])]
        if arrays["joints"].tolist() != list(skeleton.names):
            raise ValueError("other joints")
        motion = Motion(skeleton, rotation.normalise(as_floats(arrays["rotations"])),
                        as_floats(arrays["root_positions"]), float(arrays["fps"].item()),
                        *(tuple(map(str, arrays[which].tolist())) for which in ("absent", "filled")))
        columns = [arrays[f"word_{name}"].tolist() for name in _WORDS if "word_text" in arrays]
        words = tuple(Word(str(text), float(start), float(end)) for text, start, end in zip(*columns, strict=True))
    except (ValueError, KeyError, TypeError, IndexError):
        raise InputError(file, "is not a recording of a store", "build the store again") from None
    # The limit of an hour is for the input of users; recordings in a store were accepted when it was built.
    speech = load_speech(sound)
    return Recording(info, Speech(speech.samples, speech.sample_rate, words if columns else None,
                                  info.speaker), motion)


def _pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """An .npz whose bytes depend on its arrays only (no time stamps), without pickle."""
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w") as archive:
        for name, array in arrays.items():
            column = io.BytesIO()
            np.lib.format.write_array(column, np.asarray(array), allow_pickle=False)
            # A ZipInfo without a date is of 1980: the archive has the same bytes whenever it is written.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), column.getvalue())
    return memory.getvalue()
