"""Arrays from .npy and .npz files of any origin, checked before memory is taken.

numpy trusts the header: a file of a hundred bytes that claims 45 GB makes it allocate them. Here the shape is first
compared with the size of the file, only numbers, booleans and text are read, and nothing is unpickled.
"""

import io
import math
import os
import struct
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import opened

LARGEST = 1 << 30
"""Bytes (1 GiB) of all arrays of a file together: two hours of SMPL-X at 120 frames a second in double precision."""

# Largest header, bytes: that of a plain array has 128.
_HEADER = 1 << 14
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# Exceptions of zipfile, zlib and the parser of literals for broken files.
_BROKEN = (ValueError, SyntaxError, TypeError, KeyError, EOFError, OverflowError, RecursionError, MemoryError,
           NotImplementedError, RuntimeError, UnicodeError, struct.error, tokenize.TokenError, zlib.error,
           zipfile.BadZipFile, zipfile.LargeZipFile)


def read_npy(path: str | os.PathLike[str], advice: str = "save it again") -> NDArray[Any]:
    """The array of an .npy file, read-only. InputError, with `advice`, for a missing or invalid file, objects or
    records, a truncated file, or more than `LARGEST` bytes."""
    with opened(path) as stream:
        try:
            array = _array(stream, os.fstat(stream.fileno()).st_size)
        except _BROKEN as error:
            raise InputError(path, f"is not an .npy of plain numbers ({_reason(error)})", advice) from None
    return array


def read_npz(path: str | os.PathLike[str], names: Collection[str] | None = None,
             advice: str = "save it again") -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file by name, read-only: those of `names` that exist, or all. InputError, with `advice`,
    for a missing, invalid or encrypted file, a compression other than deflate, objects or records, or more than
    `LARGEST` bytes in the requested arrays."""
    with opened(path) as stream:
        try:
            return _members(stream, names)
        except (*_BROKEN, OSError) as error:  # OSError: a place in the file before its beginning
            raise InputError(path, f"is not an .npz of plain arrays ({_reason(error)})", advice) from None


def as_floats(array: NDArray[Any]) -> NDArray[np.float64]:
    """The numbers of a file in double precision; NaN stays NaN, without a warning on the terminal."""
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
            if member.compress_type not in _METHODS:
                raise ValueError(f"{name[:40]} is compressed by method {member.compress_type}")
            total += member.file_size
            if total > LARGEST:
                raise ValueError(f"it claims more than {LARGEST >> 30} GiB")
            with archive.open(member) as content:
                arrays[name] = _array(content, member.file_size)
                if not _is_text(arrays[name]):
                    raise ValueError(f"{name[:40]} holds characters that Unicode does not have")
                if content.read(1):  # the end of a member is where zipfile compares its checksum
                    raise ValueError(f"{name[:40]} goes on behind its array")
    return arrays


def _is_text(array: NDArray[Any]) -> bool:
    """Whether every character of a text array is valid Unicode (True for other arrays). Python raises SystemError for
    invalid ones when the text is taken out of the array."""
    if array.dtype.kind != "U" or array.size == 0 or array.dtype.itemsize == 0:
        return True
    codes = np.ascontiguousarray(array).reshape(-1).view(np.dtype(np.uint32).newbyteorder(array.dtype.byteorder))
    return int(codes.max()) <= sys.maxunicode


def _array(stream: IO[bytes], size: int) -> NDArray[Any]:
    """The array in the `size` bytes of a stream. ValueError for an invalid one, or for a shape of another size."""
    # From its first bytes alone: numpy reads a header of any length before it checks it.
    head = io.BytesIO(stream.read(_HEADER))
    version = np.lib.format.read_magic(head)
    parse = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, kind = parse(head)
    if kind.kind not in "biufSU" or any(not 0 <= length <= LARGEST for length in shape):
        raise ValueError(f"it holds {str(kind)[:40]} shaped {str(shape)[:40]}, not plain numbers")
    count, behind = math.prod(shape), head.tell()
    if count * kind.itemsize != size - behind:
        raise ValueError(f"its header claims {count * kind.itemsize} bytes, and {size - behind} follow")
    if size > LARGEST:
        raise ValueError(f"it claims more than {LARGEST >> 30} GiB")
    stream.seek(behind)
    data = stream.read(count * kind.itemsize)
    # frombuffer refuses items of no bytes.
    if not kind.itemsize:  # text of no length
        return np.zeros(shape, kind)
    return np.frombuffer(data, kind).reshape(shape, order="F" if fortran else "C")


def _reason(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:120]
