"""A corpus on disk: its arrays, written once per recording, and its statistics."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import write_bytes
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Statistics, three_blocks
from gesticulator.training.stages.caches import read_arrays
from gesticulator.training.stages.measured import measured
from gesticulator.training.stages.rows import RowsWriter, StoredRows, stretches

MEASURED = 16_384
"""Blocks (80 minutes) used for statistics, predictors and k-means of a corpus on disk: the standard error of a mean is
then below a hundredth of a deviation."""
CHECKED = 4_096
"""Blocks of the validation split used for figures of the lexicon."""
_SMALL = "small.npz"
"""File of small arrays (one number or pose per block or recording); written last, it marks the corpus complete."""


@dataclass(frozen=True)
class CachedBlocks:
    """Recordings with cached blocks and, if a front end is available, features: files [R] and features [R] of arrays;
    speaker_of: [R]; splits: [R]; names: [R]; words: the file of all word vectors by recording."""

    files: Sequence[Path]
    features: Sequence[Path] | None
    speaker_of: NDArray[np.int64]
    splits: Sequence[str]
    names: Sequence[str]
    words: Path | None = None

    def counts(self) -> NDArray[np.int64]:
        """[R] number of blocks of each recording."""
        return np.array([len(read_arrays(file, only=("silent",))["silent"]) for file in self.files], dtype=np.int64)

    def features_of(self, recording: int, frames: int, count: int) -> dict[str, NDArray[Any]]:
        """Features of a recording; one column of zeros without a front end."""
        if self.features is None:
            return {"low": np.zeros((count, 3 * frames, 1), np.float16)}
        return read_arrays(self.features[recording])


def bytes_of(blocks: CachedBlocks, counts: NDArray[np.int64], frames: int) -> int:
    """Size of the corpus in memory, bytes."""
    arrays = read_arrays(blocks.files[0], leave_out=("sound",))
    # 12 bytes a frame: the row numbers of words, three int32 for each frame of a block.
    row = sum(arrays[key][0].nbytes for key in ("motion", "control") if len(arrays[key])) + 12 * frames
    features = blocks.features_of(0, frames, len(arrays["silent"]))
    row += sum(level[0].nbytes for level in features.values() if len(level))
    return int(counts.sum()) * row + (blocks.words.stat().st_size if blocks.words is not None else 0)


def measured_of(config: Config, speakers: tuple[str, ...], blocks: CachedBlocks, counts: NDArray[np.int64]
                ) -> Statistics:
    """`measured` on about MEASURED blocks of the training split, recording by recording."""
    train = [r for r, split in enumerate(blocks.splits) if split == "train"]
    taken = stretches(counts[train], blocks.speaker_of[train], MEASURED)
    loaded: list[dict[str, NDArray[Any]]] = []
    encoded: list[dict[str, NDArray[Any]]] = []
    owners: list[int] = []
    for recording, parts in zip(train, taken, strict=True):
        if not parts:
            continue
        arrays = read_arrays(blocks.files[recording], only=("motion", "silent", "mask", "control"))
        features = blocks.features_of(recording, arrays["motion"].shape[1], len(arrays["silent"]))
        for part in parts:
            # Copies: a view would keep the whole recording in memory.
            loaded.append({"mask": arrays["mask"], **{key: arrays[key][part].copy()
                                                   for key in ("motion", "silent", "control")}})
            encoded.append({key: level[part].copy() for key, level in features.items()})
            owners.append(int(blocks.speaker_of[recording]))
    return measured(config, speakers, np.array(owners), ["train"] * len(loaded), loaded, encoded)


def written(folder: Path, blocks: CachedBlocks, counts: NDArray[np.int64], statistics: Statistics) -> dict[str, Any]:
    """The per-block fields of a corpus, written to `folder` if missing, and the small ones (silent, durations, first,
    mask, has_text) in memory."""
    if not (folder / _SMALL).exists():
        folder.mkdir(parents=True, exist_ok=True)
        _write(folder, blocks, counts, statistics)
    with np.load(folder / _SMALL, allow_pickle=False) as small:
        fields: dict[str, Any] = {key: small[key] for key in small.files}
    try:
        for name in ("motion", "low", "high", "control", "word_at", "words"):
            if (folder / f"{name}.npy").exists():
                fields[name] = StoredRows(folder / f"{name}.npy")
        if len(fields["motion"]) != counts.sum():
            raise ValueError("other rows")
    except (OSError, ValueError, KeyError):
        raise InputError(folder, "is damaged", "delete it and start again") from None
    fields.setdefault("high", fields["low"])
    return fields


def _write(folder: Path, blocks: CachedBlocks, counts: NDArray[np.int64], statistics: Statistics) -> None:
    total, writers = int(counts.sum()), dict[str, RowsWriter]()
    small: dict[str, list[Any]] = {"silent": [], "durations": [], "first": [], "mask": [], "has_text": []}
    vectors: Mapping[str, NDArray[Any]] = {} if blocks.words is None else np.load(blocks.words, allow_pickle=False)

    def add(name: str, rows: NDArray[Any], dtype: Any, count: int = total) -> None:
        if name not in writers:
            writers[name] = RowsWriter(folder / f"{name}.npy", (count, *rows.shape[1:]), dtype)
        writers[name].add(rows)

    spoken, begin = _spoken(blocks, vectors), 1
    for recording, name in enumerate(blocks.names):
        arrays = read_arrays(blocks.files[recording], leave_out=("sound",))
        speaker, size = int(blocks.speaker_of[recording]), len(arrays["silent"])
        frames = arrays["motion"].shape[1]
        features = blocks.features_of(recording, frames, size)
        add("motion", statistics.normalise(arrays["motion"], speaker), np.float32)
        add("low", statistics.low.apply(features["low"].astype(np.float32)), np.float16)
        if "high" in features:
            add("high", statistics.high.apply(features["high"].astype(np.float32)), np.float16)
        add("control", arrays["control"], np.float32)
        if spoken:
            has = name in spoken
            at = np.zeros((size, 3 * frames), np.int32)
            if has:
                table = np.asarray(vectors[name])
                if begin == 1:  # the empty word
                    add("words", np.eye(1, table.shape[1] + 1, table.shape[1]), np.float16, 1 + sum(spoken.values()))
                add("words", np.pad(table, ((0, 0), (0, 1))), np.float16)
                at = three_blocks(np.where(arrays["word_at"] >= 0, arrays["word_at"] + begin, 0).astype(np.int32),
                                  np.zeros(()))
                begin += len(table)
            add("word_at", at, np.int32)
        for key, value in (("silent", arrays["silent"]), ("durations", np.diff(arrays["edges"])),
                           ("mask", arrays["mask"]),
                           ("first", statistics.normalise(arrays["first"], speaker)), ("has_text", name in spoken)):
            small[key].append(value)
    for writer in writers.values():
        writer.close()
    stream = io.BytesIO()
    np.savez(stream, silent=np.concatenate(small["silent"]), durations=np.concatenate(small["durations"]),
             first=np.stack(small["first"]).astype(np.float32), mask=np.stack(small["mask"]).astype(np.float32),
             has_text=np.array(small["has_text"], dtype=bool))
    write_bytes(folder / _SMALL, stream.getvalue())


def _spoken(blocks: CachedBlocks, vectors: Mapping[str, NDArray[Any]]) -> dict[str, int]:
    """Recording -> number of words, for recordings with words."""
    return {name: len(vectors[name]) for name, file in zip(blocks.names, blocks.files, strict=True)
            if name in vectors and "word_at" in read_arrays(file, only=("word_at",))}
