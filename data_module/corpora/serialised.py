"""Values as `pyarrow.serialize` wrote them (to version 10), read with a pyarrow of today.

That function was removed, and its inverse unpickled arbitrary objects. Its format is plain Arrow: a few counts, a
record batch with one dense union (lists are lists, dictionaries lists of key and value), then the arrays as Arrow
tensors, which the batch references by number. Only this is read here; a pickled value is returned as bytes, never as an
object.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError

_HEADER, _ALIGNMENT = 16, 64
"""Bytes of the counts with their padding, and the alignment of each tensor in bytes."""


def deserialise(data: bytes | memoryview, *, arrays: bool = True, source: object = "value") -> Any:
    """One value: dict, list (also for tuples), str, bytes, int, float, bool, None and numpy arrays, nested. arrays:
    False for None in place of the arrays, to read the rest quickly. InputError naming `source` for anything else, and
    for truncated data."""
    import pyarrow

    broken = InputError(source, "is not an output of pyarrow.serialize, or is truncated", "fetch it again")
    reader = pyarrow.BufferReader(pyarrow.py_buffer(data))
    try:
        count = _array_count(np.frombuffer(reader.read(_HEADER), dtype="<i4"))
        if count is None:
            raise broken
        stream = pyarrow.ipc.open_stream(reader)
        batch = stream.read_next_batch()
        # Without it a damaged offset would make pyarrow read beyond its buffers.
        batch.validate(full=True)
        # To the end of the stream, behind which the arrays stand.
        for _ in stream:
            raise broken
        tensors: list[NDArray[Any] | None] = [_tensor(reader) for _ in range(count)] if arrays else [None] * count
        if batch.num_columns != 1 or batch.num_rows != 1:
            raise broken
        value = _column(batch.column(0), tensors)[0]
    except (pyarrow.ArrowException, OSError, IndexError, ValueError, TypeError, StopIteration) as error:
        raise InputError(source, f"is not an output of pyarrow.serialize, or is truncated ({error})",
                         "fetch it again") from None
    return value


def _array_count(header: NDArray[np.int32]) -> int | None:
    """The number of arrays; None if there is anything else. Up to version 0.14 the counts are of tensors, arrays and
    buffers; from 0.15 on the second is of sparse tensors."""
    if len(header) != 4 or (header < 0).any():
        return None
    tensors, second, third, fourth = header.tolist()
    # Other kinds (pickled objects, tensors of other libraries) are refused: reading them could run code.
    if tensors or fourth or (second and third):
        return None
    return second or third


def _tensor(reader: Any) -> NDArray[Any]:
    import pyarrow

    # Arrays begin at multiples of the alignment; the double negation rounds up.
    reader.seek(-(-reader.tell() // _ALIGNMENT) * _ALIGNMENT)
    array: NDArray[Any] = pyarrow.ipc.read_tensor(reader).to_numpy()
    return array


def _column(column: Any, arrays: list[NDArray[Any] | None]) -> list[Any]:
    import pyarrow

    kind = column.type
    if len(column) == 0:
        return []  # an empty union has no buffers, and pyarrow crashes when they are accessed
    if pyarrow.types.is_union(kind):
        # A value of any type is a union; each entry says which child column holds it, and at what offset.
        place = {code: _column(column.field(index), arrays) for index, code in enumerate(kind.type_codes)}
        return [place[code][offset] for code, offset in
                zip(column.type_codes.to_pylist(), column.offsets.to_pylist(), strict=True)]
    if pyarrow.types.is_list(kind):
        edges = column.offsets.to_pylist()
        spans = list(zip(edges[:-1], edges[1:], strict=True))
        # A dict is a list of key and value pairs.
        if pyarrow.types.is_struct(kind.value_type):
            keys, values = (_column(column.values.field(index), arrays) for index in (0, 1))
            return [dict(zip(keys[a:b], values[a:b], strict=True)) for a, b in spans]
        values = _column(column.values, arrays)
        return [values[a:b] for a, b in spans]
    # An integer of this width is a reference: the number of an array behind the stream.
    if pyarrow.types.is_int32(kind):
        return [arrays[number] for number in column.to_pylist()]
    plain: list[Any] = column.to_pylist()
    return plain
