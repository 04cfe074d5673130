"""JSON with the line of every value, so that error messages can name the line of a mistake in an edited file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from json.decoder import scanstring  # type: ignore[attr-defined] # not in the stubs
from typing import Any

from data_module.errors import InputError, shown

Path = tuple[str | int, ...]
"""The path to a value: names of members and indices in lists."""

_SPACE = re.compile(r"[ \t\r\n]*")
_NUMBER = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d+)?")
_WORDS = {"true": True, "false": False, "null": None}
_DEEPEST = 64
"""Limit of nested lists and objects; a plan has five levels."""
_MOST_VALUES = 1 << 20
"""Limit of values in a file (1,048,576), since the line of each is stored; a plan of an hour has a quarter of it."""
_HALF = re.compile("[\ud800-\udfff]")
"""Half of a surrogate pair, which UTF-8 cannot encode."""


@dataclass(frozen=True)
class LinedJson:
    """A parsed value. source: the file's name, for messages; lines: path -> line, from 1, of each value in it."""

    source: str
    value: Any
    lines: Mapping[Path, int]

    def error(self, path: Path, wrong: str, advice: str) -> InputError:
        """An error that names the file, the line of the value (or of the object that lacks it) and its path."""
        line = next((self.lines[path[:end]] for end in range(len(path), -1, -1) if path[:end] in self.lines), 1)
        return InputError(f"{self.source}, line {line}", f"{place_of(path)} {wrong}", advice)


def with_lines(value: Any, source: str) -> LinedJson:
    """A value that is parsed already, with the lines of its JSON with an indent of 1, computed at the first error."""
    return LinedJson(source, value, _LinesOnDemand(value, source))


def _half_character(text: str) -> bool:
    return not text.isascii() and _HALF.search(text) is not None


def check_text(text: str, source: LinedJson, path: Path) -> None:
    """`InputError` for a text with half of a surrogate pair."""
    if _half_character(text):
        raise source.error(path, f"holds half a character in {shown(text)}", "write whole characters")


class _LinesOnDemand(Mapping[Path, int]):
    """The lines of a value that was parsed without them."""

    def __init__(self, value: Any, source: str) -> None:
        self._value, self._source = value, source

    @cached_property
    def _lines(self) -> Mapping[Path, int]:
        try:
            text = json.dumps(self._value, indent=1)
        except RecursionError:
            raise InputError(self._source, "is nested too deeply", "write it as the schema says") from None
        return parse(text, self._source).lines

    def __getitem__(self, path: Path) -> int:
        return self._lines[path]

    def __iter__(self) -> Iterator[Path]:
        return iter(self._lines)

    def __len__(self) -> int:
        return len(self._lines)


def check_plain(value: Any, source: LinedJson, path: Path) -> None:
    """`InputError` for numbers that are not finite, invalid texts, and more than 64 levels of nesting in a value."""
    parts: list[tuple[Any, int]] = [(value, len(path))]
    while parts:
        part, depth = parts.pop()
        if depth > _DEEPEST:
            raise source.error(path, "is nested too deeply", "write it as the schema says")
        if isinstance(part, float) and not math.isfinite(part):
            raise source.error(path, f"holds {part}", "give finite numbers")
        if isinstance(part, str):
            check_text(part, source, path)
        if isinstance(part, dict | list):
            parts += [(inner, depth + 1) for inner in (part.values() if isinstance(part, dict) else part)]


def place_of(path: Path) -> str:
    """A path as text, such as blocks[3].lexeme; "the file" for the root."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).lstrip(".")
    return shown(text, 80) or "the file"


def parse(text: str, source: str) -> LinedJson:
    """Parse JSON (RFC 8259); `InputError` with the line if it is invalid or has a member twice."""
    reader = _Reader(text, source)
    value = reader.value(reader.skip(0), ())
    if reader.at < len(text):
        raise reader.error(reader.at, "continues after its end", "remove the rest")
    return LinedJson(source, value, reader.lines)


class _Reader:
    """A parser in one pass over a text; `at` is the position of the next token."""

    def __init__(self, text: str, source: str) -> None:
        self.text, self.source = text, source
        self.at = 0
        self.lines: dict[Path, int] = {}
        self._line, self._seen = 1, 0

    def error(self, at: int, wrong: str, advice: str) -> InputError:
        return InputError(f"{self.source}, line {self.text.count(chr(10), 0, at) + 1}", wrong, advice)

    def skip(self, at: int) -> int:
        space = _SPACE.match(self.text, at)
        self.at = space.end() if space else at
        return self.at

    def _line_of(self, at: int) -> int:
        self._line += self.text.count("\n", self._seen, at)
        self._seen = at
        return self._line

    def value(self, at: int, path: Path) -> Any:
        """Parse the value at a position; afterwards `at` is behind it and the white space that follows."""
        self.lines[path] = self._line_of(at)
        if len(self.lines) > _MOST_VALUES:
            raise self.error(at, f"has more than {_MOST_VALUES:,} values", "split the recording")
        if len(path) > _DEEPEST:
            raise self.error(at, "is nested too deeply", "write it as the schema says")
        start = self.text[at:at + 1]
        if start == "{":
            return self._object(at, path)
        if start == "[":
            return self._array(at, path)
        if start == '"':
            return self._string(at)
        for word, meaning in _WORDS.items():
            if self.text.startswith(word, at):
                self.skip(at + len(word))
                return meaning
        number = _NUMBER.match(self.text, at)
        if not number:
            raise self.error(at, "is not JSON" if start else "ends too early", "check quotes, commas and brackets")
        self.skip(number.end())
        try:
            return json.loads(number.group())
        except ValueError:
            raise self.error(at, "holds a number of too many digits", "write fewer digits") from None

    def _string(self, at: int) -> str:
        try:
            text, end = scanstring(self.text, at + 1)
        except json.JSONDecodeError as error:
            raise self.error(error.pos, f"holds an invalid text ({error.msg})", "check its quotes") from None
        if _half_character(text):
            raise self.error(at, f"holds half a character in {shown(text)}", "write whole characters")
        self.skip(end)
        return text

    def _object(self, at: int, path: Path) -> dict[str, Any]:
        out: dict[str, Any] = {}
        self.skip(at + 1)
        while self._more(len(out), "}"):
            if self.text[self.at:self.at + 1] != '"':
                raise self.error(self.at, "lacks a name in quotes", "write \"name\": value")
            name_at = self.at
            name = self._string(self.at)
            if name in out:
                raise self.error(name_at, f"names {shown(name)} twice", "keep one")
            if self.text[self.at:self.at + 1] != ":":
                raise self.error(self.at, f"lacks the colon after \"{shown(name)}\"", "write \"name\": value")
            out[name] = self.value(self.skip(self.at + 1), (*path, name))
        return out

    def _array(self, at: int, path: Path) -> list[Any]:
        out: list[Any] = []
        self.skip(at + 1)
        while self._more(len(out), "]"):
            out.append(self.value(self.at, (*path, len(out))))
        return out

    def _more(self, count: int, closing: str) -> bool:
        """Whether a member follows the first `count` ones; steps over the comma or the closing bracket."""
        character = self.text[self.at:self.at + 1]
        if character == closing:
            self.skip(self.at + 1)
            return False
        if count:
            if character != ",":
                raise self.error(self.at, "ends too early" if not character else f"lacks a comma or a {closing}",
                                 "check commas and brackets")
            self.skip(self.at + 1)
            if self.text[self.at:self.at + 1] == closing:
                raise self.error(self.at, "has a comma before the closing bracket", "remove the comma")
        return True


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
