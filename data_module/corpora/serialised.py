"""Values as `pyarrow.serialize` wrote them (to version 10), read with a pyarrow of today.

That function is gone, and what undid it would unpickle whatever a file told it to. What it wrote is plain Arrow: a
few counts, a record batch with one dense union (lists are lists, dictionaries lists of key and value), then the arrays
as Arrow tensors, which the batch names by number. Only that is read here. A value of a type that had to be pickled
comes out as the bytes that it is, never as an object.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError

_HEADER, _ALIGNMENT = 16, 64
"""Bytes: the counts with their padding, and what each tensor begins at a multiple of."""


def available() -> bool:
    """Whether pyarrow is installed."""
    import importlib.util

    return importlib.util.find_spec("pyarrow") is not None


def deserialise(data: bytes | memoryview, *, arrays: bool = True, source: object = "value") -> Any:
    """One value: dict, list (tuples too), str, bytes, int, float, bool, None and numpy arrays, nested.

    arrays: False leaves the arrays unread and puts None in their place, to look at the rest in no time.
    InputError naming `source` when it is something else, or cut short.
    """
    import pyarrow

    broken = InputError(source, "is not what pyarrow.serialize wrote, or is cut short", "fetch it again")
    reader = pyarrow.BufferReader(pyarrow.py_buffer(data))
    try:
        count = _array_count(np.frombuffer(reader.read(_HEADER), dtype="<i4"))
        if count is None:
            raise broken
        stream = pyarrow.ipc.open_stream(reader)
        batch = stream.read_next_batch()
        batch.validate(full=True)
        # To the end of the stream, behind which the arrays stand.
        for _ in stream:
            raise broken
        found: list[NDArray[Any] | None] = [_tensor(reader) for _ in range(count)] if arrays else [None] * count
        if batch.num_columns != 1 or batch.num_rows != 1:
            raise broken
        value = _column(batch.column(0), found)[0]
    except (pyarrow.ArrowException, OSError, IndexError, ValueError, TypeError, StopIteration) as error:
        raise InputError(source, f"is not what pyarrow.serialize wrote, or is cut short ({error})",
                         "fetch it again") from None
    return value


def _array_count(header: NDArray[np.int32]) -> int | None:
    """How many arrays follow; None when there is something else than arrays.

    To version 0.14 the counts are of tensors, arrays and buffers; from 0.15 on sparse tensors stand second.
    """
    if len(header) != 4 or (header < 0).any():
        return None
    tensors, second, third, fourth = header.tolist()
    if tensors or fourth or (second and third):
        return None
    return second or third


def _tensor(reader: Any) -> NDArray[Any]:
    import pyarrow

    reader.seek(-(-reader.tell() // _ALIGNMENT) * _ALIGNMENT)
    array: NDArray[Any] = pyarrow.ipc.read_tensor(reader).to_numpy()
    return array


def _column(column: Any, arrays: list[NDArray[Any] | None]) -> list[Any]:
    """An Arrow column as a list of plain values."""
    import pyarrow

    kind = column.type
    if len(column) == 0:
        return []  # an empty union has no buffers, and pyarrow crashes when asked for what is in them
    if pyarrow.types.is_union(kind):
        place = {code: _column(column.field(index), arrays) for index, code in enumerate(kind.type_codes)}
        return [place[code][offset] for code, offset in
                zip(column.type_codes.to_pylist(), column.offsets.to_pylist(), strict=True)]
    if pyarrow.types.is_list(kind):
        edges = column.offsets.to_pylist()
        spans = list(zip(edges[:-1], edges[1:], strict=True))
        if pyarrow.types.is_struct(kind.value_type):
            keys, values = (_column(column.values.field(index), arrays) for index in (0, 1))
            return [dict(zip(keys[a:b], values[a:b], strict=True)) for a, b in spans]
        values = _column(column.values, arrays)
        return [values[a:b] for a, b in spans]
    if pyarrow.types.is_int32(kind):
        return [arrays[number] for number in column.to_pylist()]
    plain: list[Any] = column.to_pylist()
    return plain
