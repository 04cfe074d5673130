"""Arrays from .npy and .npz files of any origin, checked before memory is taken.

numpy's own reader believes the header: a file of a hundred bytes that claims 45 GB makes it ask for them. Here the
shape is compared with the bytes that are there first, only plain numbers, truth values and text are read, and nothing
is unpickled.
"""

from __future__ import annotations

import ast
import math
import os
import re
import struct
import sys
import zipfile
import zlib
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError

LARGEST = 1 << 30
"""Bytes (1 GiB) of all arrays of a file together: two hours of SMPL-X at 120 frames a second in double precision."""

_MAGIC = b"\x93NUMPY"
_HEADER = 1 << 14
"""Bytes of a header that is read: a plain array's has 128."""
_KINDS = re.compile(r"[<>|=]?[biufSU]\d{1,6}|[<>|=]?\?")
"""Truth values, whole numbers, real numbers and text of fixed length; no objects, no records, no times."""
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DEFLATED_MOST = 1040
"""Times that deflate can shrink (1032 by its format): a member that claims more lies about its size."""
_BROKEN = (ValueError, SyntaxError, TypeError, KeyError, EOFError, OverflowError, RecursionError, MemoryError,
           NotImplementedError, RuntimeError, UnicodeError, struct.error, zlib.error, zipfile.BadZipFile,
           zipfile.LargeZipFile)
"""What zipfile, zlib and the parser of literals raise on broken files."""


def read_npy(path: str | os.PathLike[str], advice: str = "save it again") -> NDArray[Any]:
    """The array of an .npy file, not writable.

    InputError, with `advice`, for a file that is absent, no .npy, of objects or records, cut short, or larger than
    `LARGEST`.
    """
    with _opened(path) as stream:
        try:
            array = _array(stream, os.fstat(stream.fileno()).st_size)
        except _BROKEN as error:
            raise InputError(path, f"is not an .npy of plain numbers ({_reason(error)})", advice) from None
    return array


def read_npz(path: str | os.PathLike[str], names: Collection[str] | None = None,
             advice: str = "save it again") -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file by name, not writable: those of `names` that are there, or all.

    InputError, with `advice`, for a file that is absent, no .npz, broken, encrypted, compressed by another method than
    deflate, with objects or records, or with more than `LARGEST` bytes in what is asked for.
    """
    with _opened(path) as stream:
        try:
            return _members(stream, names)
        except (*_BROKEN, OSError) as error:  # OSError: a place in the file before its beginning
            raise InputError(path, f"is not an .npz of plain arrays ({_reason(error)})", advice) from None


def read_numbers(path: str | os.PathLike[str], names: Sequence[str], advice: str = "save it again"
                 ) -> list[NDArray[np.float64]]:
    """The arrays `names` of an .npz file in double precision.

    InputError as of `read_npz`, and for one that is not there, holds no real numbers, or any that are not finite.
    """
    held = read_npz(path, names, advice)
    if lacking := [name for name in names if name not in held]:
        raise InputError(path, f"lacks {', '.join(lacking)}", advice)
    numbers = []
    for name in names:
        if held[name].dtype.kind not in "fiu" or not np.isfinite(values := as_floats(held[name])).all():
            raise InputError(path, f"holds something other than finite numbers in {name}", advice)
        numbers.append(values)
    return numbers


def as_floats(array: NDArray[Any]) -> NDArray[np.float64]:
    """The numbers of a file in double precision; what is none stays none, without a warning on the terminal."""
    with np.errstate(invalid="ignore", over="ignore"):  # a damaged float may be a NaN that signals when it is copied
        return array.astype(np.float64)


def _members(stream: IO[bytes], names: Collection[str] | None) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    total = 0
    with zipfile.ZipFile(stream) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if names is not None and name not in names:
                continue
            if name in arrays:
                raise ValueError(f"{name[:40]} is in it twice")
            if member.compress_type not in _METHODS:
                raise ValueError(f"{name[:40]} is compressed by method {member.compress_type}")
            total += member.file_size
            if total > LARGEST:
                raise ValueError(f"it claims more than {LARGEST >> 30} GiB")
            if member.file_size > _DEFLATED_MOST * (member.compress_size + 1):
                raise ValueError(f"{name[:40]} claims {member.file_size} bytes in {member.compress_size}")
            with archive.open(member) as content:
                arrays[name] = _array(content, member.file_size)
                if not _is_text(arrays[name]):
                    raise ValueError(f"{name[:40]} holds characters that Unicode does not have")
                if content.read(1):  # the end of a member is where zipfile compares its checksum
                    raise ValueError(f"{name[:40]} goes on behind its array")
    return arrays


def _is_text(array: NDArray[Any]) -> bool:
    """Whether every character of an array of text is one; those of other arrays are not looked at. Python refuses the
    others with a SystemError when the text is taken out of the array."""
    if array.dtype.kind != "U" or array.size == 0 or array.dtype.itemsize == 0:
        return True
    codes = np.ascontiguousarray(array).reshape(-1).view(np.dtype(np.uint32).newbyteorder(array.dtype.byteorder))
    return int(codes.max()) <= sys.maxunicode


def _opened(path: str | os.PathLike[str]) -> IO[bytes]:
    name = Path(path)
    try:
        if not name.is_file():
            wrong = "is a folder" if name.is_dir() else "is no regular file" if name.exists() else "does not exist"
            raise InputError(path, wrong, "check the path")
        return name.open("rb")
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read ({getattr(error, 'strerror', None) or error})",
                         "check the path and its rights") from None


def _array(stream: IO[bytes], size: int) -> NDArray[Any]:
    """The array in the `size` bytes of a stream. ValueError when it is none, or when its shape does not fit them."""
    shape, fortran, kind, behind = _header(stream)
    count = math.prod(shape)
    if count * kind.itemsize != size - behind:
        raise ValueError(f"its header claims {count * kind.itemsize} bytes, and {max(size - behind, 0)} follow")
    if count * kind.itemsize > LARGEST:
        raise ValueError(f"it claims more than {LARGEST >> 30} GiB")
    data = stream.read(count * kind.itemsize)
    if len(data) != count * kind.itemsize:
        raise ValueError(f"it is cut short: {len(data)} of {count * kind.itemsize} bytes")
    if not kind.itemsize:  # text of no length
        return np.zeros(shape, kind)
    return np.frombuffer(data, kind).reshape(shape, order="F" if fortran else "C")


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """(shape, whether columns come first, type, bytes read) from the head of an .npy."""
    start = stream.read(8)
    if start[:6] != _MAGIC or len(start) < 8:
        raise ValueError("it has no header of numpy's")
    width = 2 if start[6] == 1 else 4
    length = int.from_bytes(stream.read(width), "little")
    if length > _HEADER:
        raise ValueError(f"its header of {length} bytes is too long")
    told = ast.literal_eval(stream.read(length).decode("utf-8" if start[6] > 2 else "latin-1").strip())
    if not isinstance(told, dict) or not {"descr", "fortran_order", "shape"} <= set(told):
        raise ValueError("its header is broken")
    shape, kind = told["shape"], told["descr"]
    if not isinstance(shape, tuple) or len(shape) > 32 \
            or not all(isinstance(length, int) and 0 <= length <= LARGEST for length in shape):
        raise ValueError("its shape is none")
    if not isinstance(kind, str) or not _KINDS.fullmatch(kind):
        raise ValueError(f"it holds {str(kind)[:40]}, no plain numbers")
    return shape, bool(told["fortran_order"]), np.dtype(kind), 8 + width + length


def _reason(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:120]
