"""Tensors on disk, for training on a corpus larger than memory by reading the rows of each batch."""

from __future__ import annotations

import os
import struct
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.files import rename
from data_module.motion.movement import PAST, Pasts

_TOGETHER = 8192
"""Rows read at a time for a slice, to bound memory."""


class StoredRows:
    """An array [N, ...] in numpy's file format that is indexed like a tensor and returns tensors.

    Requested rows are read in the order of the file, each once, neighbours together; nothing is memory-mapped or cached
    in this process. The operating system caches recently read rows for all processes of the machine.
    """

    def __init__(self, path: Path, member: str | None = None) -> None:
        """member: name of an array in an uncompressed .npz; None: the file is an .npy."""
        self.path = path
        with path.open("rb") as stream:
            if member is not None:
                _to_member(stream, f"{member}.npy")
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            self.shape, _, dtype = read(stream)
            self._offset = stream.tell()
        self._numpy: np.dtype[Any] = dtype
        self._row = dtype.itemsize * int(np.prod(self.shape[1:]))

    @property
    def dtype(self) -> torch.dtype:
        """Type of the returned tensors."""
        return torch.from_numpy(np.zeros(0, self._numpy)).dtype

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, key: Any) -> Tensor:
        rows, *rest = key if isinstance(key, tuple) else (key,)
        if isinstance(rows, slice):
            numbers = np.arange(len(self))[rows]
            parts = [self._read(part)[(slice(None), *rest)]
                     for part in np.array_split(numbers, max(1, -(-len(numbers) // _TOGETHER)))]
            return parts[0] if len(parts) == 1 else torch.cat(parts)
        wanted = np.asarray(rows)
        if wanted.dtype == bool:
            wanted = np.flatnonzero(wanted)
        selected = self._read(wanted.reshape(-1)).reshape(*wanted.shape, *self.shape[1:])
        return selected[(*(slice(None) for _ in wanted.shape), *rest)]

    def _read(self, numbers: NDArray[Any]) -> Tensor:
        """[n, ...] the rows with these numbers [n]. IndexError for numbers out of range."""
        # Each row is read once, in the order of the file: random batches become few long reads.
        places, back = np.unique(np.where(numbers < 0, numbers + len(self), numbers), return_inverse=True)
        if len(places) and not 0 <= places[0] <= places[-1] < len(self):
            raise IndexError(f"rows {places[0]} to {places[-1]} of {len(self)}")
        rows = np.empty((len(places), *self.shape[1:]), self._numpy)
        bytes_of = rows.reshape(-1).view(np.uint8).data if rows.size else memoryview(b"")
        # Starts of runs of neighbouring rows, each of which is one read.
        first = np.flatnonzero(np.diff(places, prepend=-2) != 1)
        with self.path.open("rb", buffering=0) as file:
            for begin, end in zip(first, np.append(first[1:], len(places))[:len(first)], strict=True):
                file.seek(self._offset + int(places[begin]) * self._row)
                left = bytes_of[begin * self._row:end * self._row]
                while left:
                    count = file.readinto(left)
                    if not count:
                        raise InputError(self.path, "ends early", "delete its folder and start again")
                    left = left[count:]
        return torch.from_numpy(rows[back] if len(back) != len(places) or (back[1:] < back[:-1]).any() else rows)


def _to_member(stream: BinaryIO, name: str) -> None:
    """Seek to the data of a member of a zip file. ValueError if it is compressed, KeyError if it is missing."""
    with zipfile.ZipFile(stream) as archive:
        info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{name} is compressed")
    # Bytes 26 to 29 of a zip's local header hold the lengths of the name and the extra field that precede the data.
    stream.seek(info.header_offset + 26)
    names, extra = struct.unpack("<HH", stream.read(4))
    stream.seek(info.header_offset + 30 + names + extra)


class RowsWriter:
    """Writes an array [N, ...] in numpy's file format in parts; `close` renames the file if it is complete."""

    def __init__(self, path: Path, shape: Sequence[int], dtype: Any) -> None:
        self.path, self.shape, self.dtype, self.written = path, tuple(map(int, shape)), np.dtype(dtype), 0
        self._temporary = path.with_name(f"{path.name}.tmp")
        self._stream = self._temporary.open("wb")
        np.lib.format.write_array_header_2_0(self._stream, {
            "descr": np.lib.format.dtype_to_descr(self.dtype), "fortran_order": False, "shape": self.shape})

    def add(self, rows: NDArray[Any]) -> None:
        """The next rows [n, ...]."""
        if rows.shape[1:] != self.shape[1:]:
            raise ValueError(f"rows of shape {rows.shape[1:]} for {self.path.name} of {self.shape[1:]}")
        self._stream.write(np.ascontiguousarray(rows, self.dtype).tobytes())
        self.written += len(rows)

    def close(self) -> None:
        """Sync and name the file; ValueError where rows are missing."""
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        if self.written != self.shape[0]:
            raise ValueError(f"{self.written} rows of {self.shape[0]} for {self.path.name}")
        rename(self._temporary, self.path)


class PastRows:
    """The pasts of stored motion, computed from the block before when indexed.

    motion: [N, K, D_m]; begins: [N] first block of a recording; first: [R, D_m] its pose at time 0; recording: [N];
    ratio: [N] as in `Pasts`.
    """

    def __init__(self, motion: StoredRows, begins: NDArray[np.bool_], first: Tensor, recording: NDArray[np.int64],
                 ratio: Tensor) -> None:
        self.motion, self.begins, self.first, self.recording, self.ratio = motion, begins, first, recording, ratio

    @property
    def frames(self) -> _PastFrames:
        """[N, 3, D_m], read when indexed."""
        return _PastFrames(self)

    def __getitem__(self, rows: Tensor | slice) -> Pasts:
        return Pasts(self.frames[rows], self.ratio[rows])


class _PastFrames:
    def __init__(self, pasts: PastRows) -> None:
        self.pasts = pasts

    def __getitem__(self, rows: Tensor | slice) -> Tensor:
        pasts = self.pasts
        index = np.arange(len(pasts.motion))[rows] if isinstance(rows, slice) else np.asarray(rows)
        before = pasts.motion[np.maximum(index - 1, 0), -PAST:]
        held = pasts.first[torch.as_tensor(pasts.recording[index])].unsqueeze(-2).expand_as(before)
        return torch.where(torch.as_tensor(pasts.begins[index])[..., None, None], held, before)


def evenly(numbers: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """About `most` of these numbers [n], evenly sampled: every second one, every third, ..."""
    return numbers[::max(1, -(-len(numbers) // most))]


def stretches(counts: Iterable[int], speaker_of: Sequence[int] | NDArray[np.int64], most: int, length: int = 64
              ) -> list[list[slice]]:
    """Stretches of recordings with `counts` blocks, about `most` blocks in all: every recording completely if there are
    no more, else every second, third, ... stretch of `length` blocks of each speaker, always including the first."""
    sizes = list(counts)
    every = max(1, -(-sum(sizes) // most))
    if every == 1:
        return [[slice(0, size)] for size in sizes]
    counted: dict[int, int] = {}
    out = []
    for size, speaker in zip(sizes, speaker_of, strict=True):
        begins, number = range(0, size, length), counted.get(int(speaker), 0)
        out.append([slice(at, min(at + length, size)) for k, at in enumerate(begins) if (number + k) % every == 0])
        counted[int(speaker)] = number + len(begins)
    return out
