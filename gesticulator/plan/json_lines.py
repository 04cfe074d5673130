"""JSON with the line of every value, so that a mistake in a file that somebody edits can be pointed at."""

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
"""The way to a value: names of members and places in lists."""

_SPACE = re.compile(r"[ \t\r\n]*")
_NUMBER = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d+)?")
_WORDS = {"true": True, "false": False, "null": None}
_DEEPEST = 64
"""Lists within lists: a plan has five."""
_MOST_VALUES = 1 << 20
"""Values of a file (1,048,576), each of which keeps its line: a plan of an hour has a quarter of it."""
_HALF = re.compile("[\ud800-\udfff]")
"""Half of a surrogate pair, which no file can hold."""


@dataclass(frozen=True)
class LinedJson:
    """A value that was read. source: the file's name, for messages; lines: the line, from 1, of each value in it."""

    source: str
    value: Any
    lines: Mapping[Path, int]

    def error(self, path: Path, wrong: str, advice: str) -> InputError:
        """An error that names the file, the line of the value (or of what should hold it) and its place."""
        line = next((self.lines[path[:end]] for end in range(len(path), -1, -1) if path[:end] in self.lines), 1)
        return InputError(f"{self.source}, line {line}", f"{place_of(path)} {wrong}", advice)


def with_lines(value: Any, source: str) -> LinedJson:
    """A value that is already parsed, as `parse` gives it; the lines are those of its text with an indent of 1.

    They are worked out when the first error asks for one.
    """
    return LinedJson(source, value, _LinesOnDemand(value, source))


def half_character(text: str) -> bool:
    """Whether a text holds half of a surrogate pair, which no file can hold."""
    return not text.isascii() and _HALF.search(text) is not None


class _LinesOnDemand(Mapping[Path, int]):
    """The lines of a value that was parsed before."""

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
    """`InputError` for a number that is not finite, or lists and objects nested more than 64 deep, within a value."""
    parts: list[tuple[Any, int]] = [(value, len(path))]
    while parts:
        part, depth = parts.pop()
        if depth > _DEEPEST:
            raise source.error(path, "is nested too deeply", "write it as the schema says")
        if isinstance(part, float) and not math.isfinite(part):
            raise source.error(path, f"holds {part}", "give finite numbers")
        if isinstance(part, str) and half_character(part):
            raise source.error(path, f"holds half a character in {shown(part)}", "write whole ones")
        if isinstance(part, dict | list):
            parts += [(one, depth + 1) for one in (part.values() if isinstance(part, dict) else part)]


def place_of(path: Path) -> str:
    """Such as blocks[3].lexeme; "the file" for the whole."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).lstrip(".")
    return shown(text, 80) or "the file"


def parse(text: str, source: str) -> LinedJson:
    """A text of JSON (RFC 8259); `InputError` with the line where it is none, or names a member twice."""
    reader = _Reader(text, source)
    value = reader.value(reader.skip(0), ())
    if reader.at < len(text):
        raise reader.error(reader.at, "holds something after its end", "take it away")
    return LinedJson(source, value, reader.lines)


class _Reader:
    """One pass over a text; `at` is where the next token begins."""

    def __init__(self, text: str, source: str) -> None:
        self.text, self.source = text, source
        self.at = 0
        self.lines: dict[Path, int] = {}
        self._line, self._seen = 1, 0

    def error(self, at: int, wrong: str, advice: str) -> InputError:
        return InputError(f"{self.source}, line {self.text.count(chr(10), 0, at) + 1}", wrong, advice)

    def skip(self, at: int) -> int:
        found = _SPACE.match(self.text, at)
        self.at = found.end() if found else at
        return self.at

    def _line_of(self, at: int) -> int:
        self._line += self.text.count("\n", self._seen, at)
        self._seen = at
        return self._line

    def value(self, at: int, path: Path) -> Any:
        """The value that begins at a place; `at` is then behind it and the space that follows."""
        self.lines[path] = self._line_of(at)
        if len(self.lines) > _MOST_VALUES:
            raise self.error(at, f"has more than {_MOST_VALUES:,} values", "cut the recording in parts")
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
        found = _NUMBER.match(self.text, at)
        if not found:
            raise self.error(at, "holds something that is no JSON" if start else "ends too early",
                             "check quotes, commas and brackets")
        self.skip(found.end())
        try:
            return json.loads(found.group())
        except ValueError:
            raise self.error(at, "holds a number of too many digits", "write fewer") from None

    def _string(self, at: int) -> str:
        try:
            text, end = scanstring(self.text, at + 1)
        except json.JSONDecodeError as error:
            raise self.error(error.pos, f"holds a text that is none ({error.msg})", "check its quotes") from None
        if half_character(text):
            raise self.error(at, f"holds half a character in {shown(text)}", "write whole ones")
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
        """Whether a member follows the `count` that were read; steps over the comma or the closing bracket."""
        found = self.text[self.at:self.at + 1]
        if found == closing:
            self.skip(self.at + 1)
            return False
        if count:
            if found != ",":
                raise self.error(self.at, "ends too early" if not found else f"lacks a comma or a {closing}",
                                 "check commas and brackets")
            self.skip(self.at + 1)
            if self.text[self.at:self.at + 1] == closing:
                raise self.error(self.at, "has a comma before the closing bracket", "take the comma away")
        return True


def in_lines(value: Any, depth: int = 0) -> str:
    """JSON text with the members of the first two levels on lines of their own; deeper values stay on one line."""
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if depth > 2 or len(flat) < 100 or not isinstance(value, dict | list) or not value:
        return flat
    if depth == 2 and isinstance(value, dict):
        return flat
    inner = " " * (depth + 1)
    if isinstance(value, dict):
        rows = [f"{json.dumps(key, ensure_ascii=False)}: {in_lines(one, depth + 1)}" for key, one in value.items()]
        return "{\n" + ",\n".join(inner + row for row in rows) + "\n" + " " * depth + "}"
    if not isinstance(value[0], dict):
        return flat
    return "[\n" + ",\n".join(inner + in_lines(one, depth + 1) for one in value) + "\n" + " " * depth + "]"
