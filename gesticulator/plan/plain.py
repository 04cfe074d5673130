"""Plain values of a plan, and their text: JSON with one line for each block, word and lexeme."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Mapping
from typing import Any, cast


@functools.cache
def members(kind: type) -> tuple[str, ...]:
    """The fields of a dataclass that are members of the file; a field that is not compared says where it came from."""
    return tuple(field.name for field in dataclasses.fields(cast(Any, kind)) if field.compare)


def to_plain(record: Any) -> Any:
    """Plain values for JSON, without optional members that are null or empty by default and unchanged."""
    if isinstance(record, tuple | list):
        return [to_plain(entry) for entry in record]
    if not dataclasses.is_dataclass(record):
        return dict(record) if isinstance(record, Mapping) else record
    kind: type = type(record)
    values = {name: getattr(record, name) for name in members(kind)}
    omitted = _omitted_if_empty(kind)
    return {name: to_plain(value) for name, value in values.items() if not (name in omitted and value in (None, ()))}


@functools.cache
def _omitted_if_empty(kind: type) -> frozenset[str]:
    return frozenset(field.name for field in dataclasses.fields(cast(Any, kind)) if field.default in (None, ()))


def in_lines(value: Any, depth: int = 0) -> str:
    """JSON text with one line for each member of the first two levels; deeper values stay on one line."""
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if depth > 2 or len(flat) < 100 or not isinstance(value, dict | list) or not value:
        return flat
    if depth == 2 and isinstance(value, dict):
        return flat
    indent = " " * (depth + 1)
    if isinstance(value, dict):
        rows = [f"{json.dumps(key, ensure_ascii=False)}: {in_lines(inner, depth + 1)}" for key, inner in value.items()]
        return "{\n" + ",\n".join(indent + row for row in rows) + "\n" + " " * depth + "}"
    if not isinstance(value[0], dict):
        return flat
    return "[\n" + ",\n".join(indent + in_lines(inner, depth + 1) for inner in value) + "\n" + " " * depth + "]"
