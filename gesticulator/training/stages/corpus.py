"""The corpus: blocks of motion, audio and words of a whole store, as arrays on disk under the hash of their inputs."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.files import new_folder
from data_module.motion.movement import Pasts, pasts_of
from data_module.store import Store
from data_module.types import Array
from generator.flow import circumstances
from gesticulator.bundle.config import Config, digest
from gesticulator.bundle.features import Sizes, Statistics, three_blocks
from gesticulator.training.stages.base import Node, Run
from gesticulator.training.stages.caches import CachedBlocks, cached_blocks, whole, word_file
from gesticulator.training.stages.measured import measured

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder

MEASURED = 2**16
"""Most blocks (about 7 hours) used for statistics, predictors and k-means, to bound their memory."""
_STRETCH = 64
"""Blocks of a stretch, where statistics leave some out: half a minute, so that silences stay whole."""


@dataclass(frozen=True)
class Corpus:
    """All blocks of a store, concatenated. N blocks, R recordings, W words, F style features.

    motion: [N, K, D_m] normalised; pasts: [N] what each block is predicted from; low, high: [N, 3K, d] normalised audio
    windows in half precision (the same array if the front end has one level); silent: [N]; durations: [N] seconds;
    recording: [N] index; first: [R, D_m] normalised pose at time 0; mask: [R, D_m] dimensions present in the source;
    control: [N, K, F] style features in their units; has_text: [R]; word_at: [N, 3K] rows of `words` [W + 1, d_t + 1]
    (None without a word encoder); files: cached blocks of each recording.

    All arrays of rows are mapped from files, so a corpus may be larger than the memory.
    """

    names: tuple[str, ...]
    splits: tuple[str, ...]
    speaker_of: NDArray[np.int64]
    motion: Tensor
    pasts: Pasts
    low: Tensor
    high: Tensor
    silent: NDArray[np.bool_]
    durations: Array
    recording: NDArray[np.int64]
    first: Tensor
    mask: Tensor
    control: NDArray[np.float32]
    statistics: Statistics
    has_text: NDArray[np.bool_]
    word_at: Tensor | None = None
    words: Tensor | None = None
    files: tuple[Path, ...] = ()

    def blocks_of(self, recording: int) -> NDArray[np.int64]:
        """Block numbers of a recording, in order."""
        # Block numbers of a recording are contiguous, and `recording` is sorted.
        first, last = np.searchsorted(self.recording, (recording, recording + 1))
        return np.arange(first, last)

    def recordings(self, split: str, with_text: bool = False) -> list[int]:
        """Recording numbers of a split; with_text: only those with words."""
        return [index for index, name in enumerate(self.splits)
                if name == split and (self.has_text[index] or not with_text)]

    def select(self, split: str) -> NDArray[np.int64]:
        """Block numbers of a split."""
        return np.flatnonzero(np.isin(self.recording, self.recordings(split)))

    def some(self, split: str) -> NDArray[np.int64]:
        """Block numbers of a split for statistics or fitting: all, or evenly sampled ones of a very large corpus."""
        return evenly(self.select(split), MEASURED)

    def text(self, blocks: NDArray[np.int64] | Tensor) -> Tensor:
        """[..., 3K, d_t + 1] word vectors around blocks [...]."""
        if self.word_at is None or self.words is None:
            raise ValueError("this corpus was prepared without text")
        return self.words[self.word_at[torch.as_tensor(blocks)].long()].float()

    @functools.cached_property
    def circumstances(self) -> Tensor:
        """[N, 8] each block's context in speech (`generator.flow.circumstances`)."""
        rows = [torch.as_tensor(self.blocks_of(recording)) for recording in range(len(self.names))]
        return torch.cat([circumstances(torch.as_tensor(self.durations)[blocks], torch.as_tensor(self.silent)[blocks])
                          for blocks in rows])

    def before(self, blocks: NDArray[np.int64]) -> tuple[Tensor, Tensor]:
        """For blocks [n], the block before as performed [n, K, D_m] (the recording's first pose, held, before its first
        block), and the durations of the block before and the block itself in seconds [n, 2]."""
        earlier = np.maximum(blocks - 1, 0)
        begins = (blocks == 0) | (self.recording[earlier] != self.recording[blocks])
        held = self.first[torch.as_tensor(self.recording[blocks])][:, None].expand(-1, self.motion.shape[1], -1)
        motion = torch.where(torch.as_tensor(begins)[:, None, None], held, self.motion[torch.as_tensor(earlier)])
        seconds = np.stack([self.durations[np.where(begins, blocks, earlier)], self.durations[blocks]], axis=-1)
        return motion, torch.as_tensor(seconds, dtype=torch.float32)

    @property
    def text_width(self) -> int:
        """d_t + 1, 0 without text."""
        return 0 if self.words is None else self.words.shape[-1]


def prepare(store: Store, config: Config, folder: Path, encoder: SpeechEncoder | None = None, *, workers: int = 1,
            progress: bool = True) -> Corpus:
    """Cut, encode and normalise a store; results cached in `folder` under the same settings are reused.

    encoder: the trained speech encoder, for the front end "vqwav2vec"; without it audio is omitted (one column of
    zeros), which suffices for the lexicon.
    """
    speakers = tuple(sorted({info.speaker for info in store.of_split("train")}))
    if not speakers:
        raise InputError(store.path, "has no recordings in its training split", "build the store again")
    # Speakers that occur in no training recording use the statistics of the first.
    speaker_of = np.array([speakers.index(info.speaker) if info.speaker in speakers else 0
                           for info in store.recordings])
    cached = cached_blocks(store, config, folder, encoder, workers=workers, progress=progress)
    counts = np.array([len(cached.arrays(r, only=("silent",))["silent"]) for r in range(len(speaker_of))])
    splits = tuple(info.split for info in store.recordings)
    statistics = _measured(config, speakers, cached, np.flatnonzero(np.array(splits) == "train"), speaker_of, counts)
    rows = folder / f"corpus-{digest(cached.name, config.motion, MEASURED)}"
    if not rows.exists():
        with new_folder(rows) as unfinished:
            _write(unfinished, cached, counts, speaker_of, statistics)
    try:
        # Copy on write: torch wants arrays that may be written to, and the files stay as they are.
        fields: dict[str, Any] = {file.stem: np.asarray(np.load(file, mmap_mode="c")) for file in rows.glob("*.npy")}
        if len(fields["motion"]) != counts.sum():
            raise ValueError("other rows")
    except (OSError, ValueError, KeyError):
        raise InputError(rows, "is damaged", "delete it and start again") from None
    tensors: dict[str, Any] = {name: torch.as_tensor(fields.pop(name)) for name in (
        "motion", "frames", "ratio", "low", "high", "first", "mask", "word_at", "words") if name in fields}
    # The same tensor, so that one level takes its memory once and `is` tells the cases apart.
    tensors.setdefault("high", tensors["low"])
    pasts = Pasts(tensors.pop("frames"), tensors.pop("ratio"))
    return Corpus(names=store.names, splits=splits, speaker_of=speaker_of, statistics=statistics, files=cached.files,
                  recording=np.repeat(np.arange(len(counts)), counts), pasts=pasts, **tensors, **fields)


def evenly(numbers: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """About `most` of these numbers [n], evenly sampled: every second one, every third, ..."""
    return numbers[::max(1, -(-len(numbers) // most))]


def stretches(counts: Sequence[int] | NDArray[np.int64], most: int) -> list[list[slice]]:
    """Stretches of recordings with `counts` blocks, about `most` blocks in all: every recording completely if there are
    no more, else every second, third, ... stretch of `_STRETCH` blocks."""
    every = max(1, -(-int(sum(counts)) // most))
    if every == 1:
        return [[slice(0, size)] for size in counts]
    number, out = 0, []
    for size in counts:
        begins = range(0, size, _STRETCH)
        out.append([slice(at, min(at + _STRETCH, size)) for k, at in enumerate(begins) if (number + k) % every == 0])
        number += len(begins)
    return out


def _measured(config: Config, speakers: tuple[str, ...], cached: CachedBlocks, train: NDArray[np.int64],
              speaker_of: NDArray[np.int64], counts: NDArray[np.int64]) -> Statistics:
    """The statistics of about MEASURED blocks of the training split, read recording by recording."""
    loaded, encoded, owners = [], [], []
    for recording, parts in zip(train, stretches(counts[train], MEASURED), strict=True):
        arrays = cached.arrays(recording, only=("motion", "silent", "mask", "control"))
        features = cached.features_of(recording)
        for part in parts:
            # Copies: a view would keep the whole recording in memory.
            loaded.append({"mask": arrays["mask"], **{key: arrays[key][part].copy()
                                                      for key in ("motion", "silent", "control")}})
            encoded.append({key: level[part].copy() for key, level in features.items()})
            owners.append(int(speaker_of[recording]))
    return measured(config, speakers, np.array(owners), loaded, encoded)


def _write(folder: Path, cached: CachedBlocks, counts: NDArray[np.int64], speaker_of: NDArray[np.int64],
           statistics: Statistics) -> None:
    """Write the fields of a corpus as one file each, recording by recording."""
    written: dict[str, NDArray[Any]] = {}

    def put(name: str, length: int, at: int, rows: NDArray[Any], kind: type) -> None:
        if name not in written:
            written[name] = np.lib.format.open_memmap(folder / f"{name}.npy", "w+", kind, (length, *rows.shape[1:]))
        written[name][at:at + len(rows)] = rows

    total, begin, at = int(counts.sum()), 1, 0
    for recording, size in enumerate(counts.tolist()):
        arrays, speaker = cached.arrays(recording), int(speaker_of[recording])
        motion = statistics.normalise(arrays["motion"], speaker).astype(np.float32)
        first = statistics.normalise(arrays["first"], speaker).astype(np.float32)
        durations = np.diff(arrays["edges"])
        pasts = pasts_of(torch.as_tensor(motion), torch.as_tensor(durations), torch.as_tensor(first))
        rows: dict[str, tuple[NDArray[Any], type]] = {
            "motion": (motion, np.float32), "frames": (pasts.frames.numpy(), np.float32),
            "ratio": (pasts.ratio.numpy(), np.float32), "silent": (arrays["silent"], np.bool_),
            "durations": (durations, np.float64), "control": (arrays["control"], np.float32)}
        for level, values in cached.features_of(recording).items():
            rows[level] = getattr(statistics, level).apply(values.astype(np.float32)), np.float16
        vectors = cached.words.get(cached.names[recording]) if "word_at" in arrays else None
        if cached.words:
            # Row 0 of the table is the empty word, zeros with the flag 1, so the first word of all is row 1.
            frames = np.zeros((size, 3 * motion.shape[1]), np.int32)
            if vectors is not None:
                words = 1 + sum(map(len, cached.words.values()))
                put("words", words, 0, np.eye(1, vectors.shape[1] + 1, vectors.shape[1]), np.float16)
                put("words", words, begin, np.pad(vectors, ((0, 0), (0, 1))), np.float16)
                frames = three_blocks(np.where(arrays["word_at"] >= 0, arrays["word_at"] + begin, 0), np.zeros(()))
                begin += len(vectors)
            rows["word_at"] = frames, np.int32
        for name, (values, kind) in rows.items():
            put(name, total, at, values, kind)
        for name, value, kind in (("first", first, np.float32), ("mask", arrays["mask"], np.float32),
                                  ("has_text", np.array(vectors is not None), np.bool_)):
            put(name, len(counts), recording, value[None], kind)
        at += size
    for array in written.values():
        array.flush()  # type: ignore[attr-defined]


def sizes(config: Config, corpus: Corpus, **more: Any) -> Sizes:
    """The model dimensions of a corpus; more: fields of `Sizes` not known from the corpus."""
    return Sizes(config, corpus.motion.shape[-1], corpus.low.shape[-1], corpus.high.shape[-1],
                 corpus.high is not corpus.low, len(corpus.statistics.speakers), corpus.text_width,
                 corpus.statistics.present, **more)


def _blocks(run: Run) -> Corpus:
    # Before any block is cut, which takes minutes: the words need none.
    words = word_file(run.store, run.config, run.work, progress=run.progress)
    if words is not None and not whole(words):
        raise InputError(run.store.path, "has no recording with words",
                         "train without them by --set text.encoder= (nothing after the sign)")
    return prepare(run.store, run.config, run.work, workers=run.workers, progress=run.progress)


BLOCKS: Node[Corpus] = Node("blocks", settings=("rhythm",), make=_blocks)
"""The corpus without trained audio features: motion, stretched audio and words (and mel features, which need no
training). The settings of the motion representation belong to the lexicon, its first user."""
