"""The corpus: blocks of motion, audio and words of a whole store, as arrays in memory."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.motion.movement import Pasts, joined, pasts_of
from data_module.store import Store
from data_module.types import Array
from generator.flow import circumstances
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Sizes, Statistics, three_blocks
from gesticulator.training.stages.base import Node, Run
from gesticulator.training.stages.caches import cached_blocks
from gesticulator.training.stages.measured import measured

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder


@dataclass(frozen=True)
class Corpus:
    """All blocks of a store, concatenated. N blocks, R recordings, W words, F style features.

    motion: [N, K, D_m] normalised; pasts: [N] what each block is predicted from; low, high: [N, 3K, d] normalised audio
    windows in half precision (the same array if the front end has one level); silent: [N]; durations: [N] seconds;
    recording: [N] index; first: [R, D_m] normalised pose at time 0; mask: [R, D_m] dimensions present in the source;
    control: [N, K, F] style features in their units; has_text: [R]; word_at: [N, 3K] rows of `words` [W + 1, d_t + 1]
    (None without a word encoder); files: cached blocks of each recording.
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
    rows, words, files = cached_blocks(store, config, folder, encoder, workers=workers, progress=progress)
    splits = tuple(info.split for info in store.recordings)
    known = [(row, speaker) for row, speaker, split in zip(rows, speaker_of, splits, strict=True) if split == "train"]
    statistics = measured(config, speakers, np.array([speaker for _, speaker in known]), [row for row, _ in known])
    motion, first = [], []
    pasts: list[Pasts] = []
    levels: dict[str, list[NDArray[np.float16]]] = {"low": [], "high": []}
    for row, speaker in zip(rows, speaker_of.tolist(), strict=True):
        motion.append(statistics.normalise(row["motion"], speaker).astype(np.float32))
        first.append(statistics.normalise(row["first"], speaker).astype(np.float32))
        pasts.append(pasts_of(*map(torch.as_tensor, (motion[-1], np.diff(row["edges"]), first[-1]))))
        for level, values in levels.items():
            if level in row:
                values.append(getattr(statistics, level).apply(row[level].astype(np.float32)).astype(np.float16))
    low = torch.as_tensor(np.concatenate(levels["low"]))
    has_text = np.array([name in words and "word_at" in row for name, row in zip(store.names, rows, strict=True)])
    table, word_at = _words(rows, words, store.names) if words else (None, None)
    return Corpus(
        names=store.names, splits=splits, speaker_of=speaker_of, motion=torch.as_tensor(np.concatenate(motion)),
        pasts=joined(pasts),
        # The same tensor, so that one level takes its memory once and `is` tells the cases apart.
        low=low, high=torch.as_tensor(np.concatenate(levels["high"])) if levels["high"] else low,
        silent=np.concatenate([row["silent"] for row in rows]),
        durations=np.concatenate([np.diff(row["edges"]) for row in rows]),
        recording=np.repeat(np.arange(len(rows)), [len(row["silent"]) for row in rows]),
        first=torch.as_tensor(np.stack(first)), mask=torch.as_tensor(np.stack([row["mask"] for row in rows])).float(),
        control=np.concatenate([row["control"] for row in rows]), statistics=statistics, has_text=has_text,
        word_at=word_at, words=table, files=files)


def _words(rows: Sequence[dict[str, NDArray[Any]]], words: Mapping[str, NDArray[np.float16]], names: Sequence[str]
           ) -> tuple[Tensor, Tensor]:
    """The table [W + 1, d_t + 1] of the words of all recordings, and [N, 3K] the row of each frame of the blocks."""
    width = len(next(iter(words.values()))[0])
    # Row 0 of the table is the empty word, zeros with the flag 1.
    table, at = [np.eye(1, width + 1, width, dtype=np.float16)], []
    begin = 1
    for row, name in zip(rows, names, strict=True):
        frames = np.zeros((len(row["silent"]), 3 * row["motion"].shape[1]), np.int32)
        if name in words and "word_at" in row:
            frames = three_blocks(np.where(row["word_at"] >= 0, row["word_at"] + begin, 0), np.zeros(()))
            table.append(np.pad(words[name], ((0, 0), (0, 1))))
            begin += len(words[name])
        at.append(frames.astype(np.int32))
    return torch.as_tensor(np.concatenate(table)), torch.as_tensor(np.concatenate(at))


def sizes(config: Config, corpus: Corpus, **more: Any) -> Sizes:
    """The model dimensions of a corpus; more: fields of `Sizes` not known from the corpus."""
    return Sizes(config, corpus.motion.shape[-1], corpus.low.shape[-1], corpus.high.shape[-1],
                 corpus.high is not corpus.low, len(corpus.statistics.speakers), corpus.text_width,
                 corpus.statistics.present, **more)


def _blocks(run: Run) -> Corpus:
    corpus = prepare(run.store, run.config, run.work, workers=run.workers, progress=run.progress)
    if run.config.text.encoder and corpus.words is None:
        raise InputError(run.store.path, "has no recording with words",
                         "set text.encoder= (empty) to train without text")
    return corpus


BLOCKS: Node[Corpus] = Node("blocks", settings=("rhythm",), make=_blocks)
"""The corpus without trained audio features: motion, stretched audio and words (and mel features, which need no
training). The settings of the motion representation belong to the lexicon, its first user."""
