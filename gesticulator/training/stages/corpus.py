"""The corpus: blocks of motion, audio and words of a whole store, cached under the hash of their inputs."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.motion.movement import Pasts, joined, pasts_of
from data_module.store import Store
from data_module.types import Array
from generator.flow import circumstances
from gesticulator.bundle.config import Config, digest
from gesticulator.bundle.features import Normaliser, Sizes, Statistics, three_blocks, word_table
from gesticulator.training.stages.base import Node, Run
from gesticulator.training.stages.caches import cut, encode_all, read_arrays, read_words, word_file
from gesticulator.training.stages.measured import measured
from gesticulator.training.stages.rows import PastRows, StoredRows, evenly
from gesticulator.training.stages.stored import CHECKED, MEASURED, CachedBlocks, bytes_of, measured_of, written

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder


@dataclass(frozen=True)
class Corpus:
    """All blocks of a store, concatenated. N blocks, R recordings, W words, F style features.

    motion: [N, K, D_m] normalised; low, high: [N, 3K, d] normalised audio windows in half precision (the same array if
    the front end has one level); silent: [N]; durations: [N] seconds; recording: [N] index; first: [R, D_m] normalised
    pose at time 0; mask: [R, D_m] dimensions present in the source; control: [N, K, F] style features in their units;
    has_text: [R]; word_at: [N, 3K] rows of `words` [W + 1, d_t + 1] (None without a word encoder); files: cached blocks
    of each recording.

    If a corpus does not fit into memory, motion, low, high, control, word_at and words are `StoredRows`, whose rows are
    read when indexed.
    """

    names: tuple[str, ...]
    splits: tuple[str, ...]
    speaker_of: NDArray[np.int64]
    motion: Tensor
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

    @property
    def stored(self) -> bool:
        """Whether it stays on disk."""
        return isinstance(cast(Any, self.motion), StoredRows)

    def some(self, split: str) -> NDArray[np.int64]:
        """Block numbers of a split for statistics or fitting: all, or evenly sampled ones if the corpus stays on
        disk."""
        every = self.select(split)
        return evenly(every, MEASURED if split == "train" else CHECKED) if self.stored else every

    def text(self, blocks: NDArray[np.int64] | Tensor) -> Tensor:
        """[..., 3K, d_t + 1] word vectors around blocks [...]."""
        if self.word_at is None or self.words is None:
            raise ValueError("this corpus was prepared without text")
        return self.words[self.word_at[torch.as_tensor(blocks)].long()].float()

    @functools.cached_property
    def pasts(self) -> Pasts:
        """[N, 3, D_m] the past from which each block is predicted; read when indexed if the corpus stays on disk."""
        rows_of = cast(Any, self.motion)
        if isinstance(rows_of, StoredRows):
            begins = np.diff(self.recording, prepend=-1) > 0
            before = np.where(begins, self.durations, np.roll(self.durations, 1))
            ratio = torch.as_tensor(self.durations / before).to(rows_of.dtype)
            return cast(Pasts, PastRows(rows_of, begins, self.first, self.recording, ratio))
        rows = [torch.as_tensor(self.blocks_of(recording)) for recording in range(len(self.names))]
        return joined(pasts_of(self.motion[blocks], torch.as_tensor(self.durations)[blocks], first)
                      for blocks, first in zip(rows, self.first, strict=True))

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

    def sound(self, recording: int) -> NDArray[np.float16] | StoredRows:
        """[N, L] the stretched audio of a recording's blocks; read when indexed if the corpus stays on disk."""
        if self.stored:
            return StoredRows(self.files[recording], "sound")
        with np.load(self.files[recording], allow_pickle=False) as arrays:
            return np.asarray(arrays["sound"])


def prepare(store: Store, config: Config, folder: Path, encoder: SpeechEncoder | None = None, *, workers: int = 1,
            progress: bool = True, memory: float | None = None) -> Corpus:
    """Cut, encode and normalise a store; results cached in `folder` under the same settings are reused.

    encoder: the trained speech encoder, for the front end "vqwav2vec"; without it audio is omitted (one column of
    zeros), which suffices for the lexicon. memory: bytes; a larger corpus stays on disk.
    """
    infos = store.recordings
    speakers = tuple(sorted({info.speaker for info in infos if info.split == "train"}))
    if not speakers:
        raise InputError(store.path, "has no recordings in its training split", "build the store again")
    # Speakers that occur in no training recording use the statistics of the first.
    speaker_of = np.array([speakers.index(info.speaker) if info.speaker in speakers else 0 for info in infos])
    files = cut(store, config, folder, workers=workers, progress=progress)
    without_audio = encoder is None and config.front_end.name == "vqwav2vec"
    feature_files = None if without_audio else encode_all(files, config, encoder, workers=workers, progress=progress)
    if memory is not None:
        blocks = CachedBlocks(files, feature_files, speaker_of, [info.split for info in infos], store.names,
                              word_file(store, config, folder, progress=progress))
        # Decided from counts and one file, before anything large is read.
        counts = blocks.counts()
        if bytes_of(blocks, counts, config.rhythm.frames) > memory:
            return _on_disk(config, folder, speakers, blocks, counts)
    loaded = [read_arrays(file, leave_out=("sound",)) for file in files]
    encoded: list[dict[str, NDArray[Any]]]
    if feature_files is None:
        encoded = [{"low": np.zeros((len(arrays["silent"]), 3 * config.rhythm.frames, 1), np.float16)}
                   for arrays in loaded]
    else:
        encoded = [read_arrays(file) for file in feature_files]
    statistics = measured(config, speakers, speaker_of, [info.split for info in infos], loaded, encoded)
    motion = [statistics.normalise(arrays["motion"], speaker)
              for arrays, speaker in zip(loaded, speaker_of, strict=True)]
    first = [statistics.normalise(arrays["first"], speaker) for arrays, speaker in zip(loaded, speaker_of, strict=True)]
    low = _normalised(statistics.low, [arrays["low"] for arrays in encoded])
    # The same tensor, so that one level takes its memory once and `is` tells the cases apart.
    high = low if "high" not in encoded[0] else _normalised(statistics.high, [arrays["high"] for arrays in encoded])
    word_at, words, has_text = _text(infos, loaded, read_words(store, config, folder, progress=progress))
    return Corpus(
        names=tuple(info.name for info in infos), splits=tuple(info.split for info in infos), speaker_of=speaker_of,
        motion=torch.as_tensor(np.concatenate(motion).astype(np.float32)), low=low, high=high,
        silent=np.concatenate([arrays["silent"] for arrays in loaded]),
        durations=np.concatenate([np.diff(arrays["edges"]) for arrays in loaded]),
        recording=np.repeat(np.arange(len(infos)), [len(arrays["silent"]) for arrays in loaded]),
        first=torch.as_tensor(np.stack(first).astype(np.float32)),
        mask=torch.as_tensor(np.stack([arrays["mask"] for arrays in loaded]).astype(np.float32)),
        control=np.concatenate([arrays["control"] for arrays in loaded]), statistics=statistics, has_text=has_text,
        word_at=word_at, words=words, files=files)


def _on_disk(config: Config, folder: Path, speakers: tuple[str, ...], blocks: CachedBlocks,
             counts: NDArray[np.int64]) -> Corpus:
    # The names of the cache folders are hashes of their own inputs.
    key = digest(blocks.files[0].parent.name, blocks.features[0].parent.name if blocks.features else "",
                 blocks.words.name if blocks.words else "", config.motion, MEASURED)
    statistics = measured_of(config, speakers, blocks, counts)
    fields = written(folder / f"corpus-{key}", blocks, counts, statistics)
    return Corpus(
        names=tuple(blocks.names), splits=tuple(blocks.splits), speaker_of=blocks.speaker_of,
        recording=np.repeat(np.arange(len(counts)), counts), statistics=statistics, files=tuple(blocks.files),
        **{**fields, "first": torch.as_tensor(fields["first"]), "mask": torch.as_tensor(fields["mask"])})


def _normalised(normaliser: Normaliser, parts: list[NDArray[Any]]) -> Tensor:
    return torch.as_tensor(np.concatenate([normaliser.apply(part.astype(np.float32)).astype(np.float16)
                                           for part in parts]))


def _text(infos: Iterable[Any], loaded: list[dict[str, NDArray[Any]]], vectors: dict[str, NDArray[np.float16]]
          ) -> tuple[Tensor | None, Tensor | None, NDArray[np.bool_]]:
    """[N, 3K] rows, the table [W + 1, d_t + 1], and which recordings have words [R]."""
    has = np.array([info.name in vectors and "word_at" in arrays for info, arrays in zip(infos, loaded, strict=True)])
    if not has.any():
        return None, None, has
    # Row 0 of the table is the empty word, so the first word of all is row 1.
    rows, tables, begin = [], [], 1
    for info, arrays in zip(infos, loaded, strict=True):
        frames = arrays.get("word_at")
        if frames is None or info.name not in vectors:
            rows.append(np.zeros((len(arrays["silent"]), 3 * arrays["motion"].shape[1]), np.int32))
            continue
        rows.append(three_blocks(np.where(frames >= 0, frames + begin, 0).astype(np.int32), np.zeros(())))
        tables.append(vectors[info.name])
        begin += len(vectors[info.name])
    table = np.concatenate(tables)
    return (torch.as_tensor(np.concatenate(rows)),
            torch.as_tensor(word_table(table, table.shape[1]).astype(np.float16)), has)


def sizes(config: Config, corpus: Corpus, **more: Any) -> Sizes:
    """The model dimensions of a corpus; more: fields of `Sizes` not known from the corpus."""
    return Sizes(config, corpus.motion.shape[-1], corpus.low.shape[-1], corpus.high.shape[-1],
                 corpus.high is not corpus.low, len(corpus.statistics.speakers), corpus.text_width,
                 corpus.statistics.present, **more)


def _blocks(run: Run) -> Corpus:
    corpus = prepare(run.store, run.config, run.work, workers=run.workers, progress=run.progress, memory=run.memory)
    if run.config.text.encoder and corpus.words is None:
        raise InputError(run.store.path, "has no recording with words",
                         "set text.encoder= (empty) to train without text")
    return corpus


BLOCKS: Node[Corpus] = Node("blocks", settings=("rhythm",), make=_blocks)
"""The corpus without trained audio features: motion, stretched audio and words (and mel features, which need no
training). The settings of the motion representation belong to the lexicon, its first user."""
