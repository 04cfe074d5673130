"""The JSON reader (RFC 8259), with limits on memory, time and depth.

Python's parser accepts NaN and Infinity, turns 1e999 into infinity, raises RecursionError for deep nesting and
ValueError for integers of thousands of digits. Here each of these is an `InputError` that names the file and the line.
"""

from __future__ import annotations

import json
import math
import os
import re
from typing import Any

from data_module.errors import InputError, shown
from data_module.files import LARGEST_TEXT, decoded, read_text

DEEPEST = 100
"""Greatest nesting depth: our files need 8, a glTF document with extensions about 12."""
MOST_DIGITS = 300
"""Most digits of an integer: a float holds 308, so the conversion cannot overflow."""
MOST_VALUES = 1 << 22
"""Most values of a document (4,194,304), about 80 bytes each: a listing of 100,000 recordings has 2 million."""

_SUSPECT = re.compile(rf"(?<!\d)\d{{{MOST_DIGITS}}}|\d[eE]\+?\d{{3}}", re.ASCII)
"""A possibly too large number (or similar text)."""
_HALF = re.compile(r"\\u[dD][89a-fA-F]")
"""An escaped surrogate, half of a pair."""
_STRINGS = re.compile(r'"(?:[^"\\]+|\\.)*"?', re.DOTALL)
"""Strings. The closing quote is optional so that a match that has begun cannot fail: failing on a string that is never
closed takes exponential time, since each way of dividing its characters is tried."""


def read_json(path: str | os.PathLike[str], advice: str, largest: int = LARGEST_TEXT, *, python: bool = False) -> Any:
    """The value in a JSON file. `InputError`, with `advice`, as of `files.read_text` (missing, larger than `largest`
    bytes, not text) and of `parse_json`."""
    return parse_json(read_text(path, advice, largest), path, advice, python=python)


def read_object(path: str | os.PathLike[str], advice: str, largest: int = LARGEST_TEXT, *, python: bool = False
                ) -> dict[str, Any]:
    """The object in a JSON file; `InputError` as of `read_json`, and for any other value."""
    value = read_json(path, advice, largest, python=python)
    if not isinstance(value, dict):
        raise InputError(path, "is not a JSON object in braces", advice)
    return value


def parse_json(data: str | bytes, source: object, advice: str, *, python: bool = False) -> Any:
    """The value of a JSON text; of duplicate keys the last counts.

    source: name in messages. python: accept Python's extensions: NaN, Infinity, and unpaired surrogates (invalid bytes
    in file names). `InputError` for invalid JSON, nesting deeper than `DEEPEST`, more than `MOST_VALUES` values, a
    number that does not fit a float, NaN or Infinity, or an unpaired surrogate.
    """
    text = decoded(data, source, advice) if isinstance(data, bytes) else data
    if text.count(",") + text.count("[") + text.count("{") > MOST_VALUES:
        plain = _STRINGS.sub("", text)
        if plain.count(",") + plain.count("[") + plain.count("{") > MOST_VALUES:
            raise InputError(source, f"holds more than {MOST_VALUES:,} values", advice)
    hooks: dict[str, Any] = {"parse_int": _whole, "parse_float": _float} if _SUSPECT.search(text) else {}
    if not python:
        hooks["parse_constant"] = _constant
    try:
        value = json.loads(text, **hooks)
    except json.JSONDecodeError as error:
        raise InputError(source, f"line {error.lineno}, column {error.colno}: is not valid JSON ({error.msg})",
                         advice) from None
    except RecursionError:
        raise InputError(source, _TOO_DEEP, advice) from None
    except ValueError as error:
        raise InputError(source, f"is not valid JSON ({error})", advice) from None
    _check_depth(value, source, advice)
    if not python and _HALF.search(text):
        _check_characters(value, source, advice)
    return value


_TOO_DEEP = f"is not valid JSON (nested more than {DEEPEST} deep)"


def _whole(digits: str) -> int:
    if len(digits.lstrip("-")) > MOST_DIGITS:
        raise ValueError(f"a number of {len(digits.lstrip('-'))} digits")
    return int(digits)


def _float(digits: str) -> float:
    value = float(digits)
    if math.isinf(value):
        raise ValueError(f"the number {shown(digits, 20)} is too large")
    return value


def _constant(name: str) -> float:
    raise ValueError(f"{name} is not a number")


def _check_depth(value: Any, source: object, advice: str) -> None:
    level = [value] if isinstance(value, list | dict) else []
    for _ in range(DEEPEST):
        if not level:
            return
        level = [inner for outer in level for inner in (outer.values() if isinstance(outer, dict) else outer)
                 if isinstance(inner, list | dict)]
    if level:
        raise InputError(source, _TOO_DEEP, advice)


def _check_characters(value: Any, source: object, advice: str) -> None:
    waiting = [value]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict):
            waiting += [*one, *one.values()]
        elif isinstance(one, list):
            waiting += one
        elif isinstance(one, str) and any("\ud800" <= character <= "\udfff" for character in one):
            raise InputError(source, f"is not valid JSON (half a character in {shown(one)})", advice)
