"""Trees of settings: frozen dataclasses with ranges, and their safe reading and changing from outside.

The type of a field contains its range, `width: Width = 64`, and `check` validates every value, so that an invalid
setting is refused by its name when it is read, and not by a layer of a network half an hour later.
"""

import ast
import dataclasses
import functools
import hashlib
import inspect
import itertools
import json
import math
import textwrap
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar, cast

import msgspec

from data_module.errors import InputError
from data_module.files import parse_json

T = TypeVar("T")


@dataclass(frozen=True)
class SettingRange:
    """The numbers from `least` to `most`; `least` itself is left out where `above` is set."""

    least: float
    most: float = math.inf
    above: bool = False

    def __contains__(self, value: float) -> bool:
        return math.isfinite(value) and (value > self.least if self.above else value >= self.least) \
            and value <= self.most

    def __str__(self) -> str:
        least, most = (f"{int(end):,}" if float(end).is_integer() else f"{end:g}" for end in (self.least, self.most))
        if self.most < math.inf:
            return f"{'more than ' if self.above else ''}{least} to {most}"
        return f"a number above {least}" if self.above else f"{least} or more"


@dataclass(frozen=True)
class SettingChoice:
    """One of some words, or of some numbers."""

    words: tuple[str | int, ...]

    def __contains__(self, value: str | int) -> bool:
        return value in self.words

    def __str__(self) -> str:
        return f"one of {', '.join(map(str, self.words))}"


_MOST_STEPS = 10**9
"""Most steps: more than a decade of training."""
_WIDEST = 2**16
"""Largest width: a square layer has 17 GB of weights."""

Steps = Annotated[int, SettingRange(0, _MOST_STEPS)]
Count = Annotated[int, SettingRange(1, _MOST_STEPS)]
Natural = Annotated[int, SettingRange(0, _MOST_STEPS)]
Width = Annotated[int, SettingRange(1, _WIDEST)]
WidthOrNone = Annotated[int, SettingRange(0, _WIDEST)]
"""0 for no layer."""
Depth = Annotated[int, SettingRange(1, 64)]
"""Number of layers."""
Widths = Annotated[tuple[int, ...], SettingRange(1, _WIDEST)]
Share = Annotated[float, SettingRange(0.0, 1.0)]
Positive = Annotated[float, SettingRange(0.0, above=True)]
NotNegative = Annotated[float, SettingRange(0.0)]


@functools.cache
def _hints(cls: Any) -> dict[str, Any]:
    return typing.get_type_hints(cls, include_extras=True)


def check(settings: Any, path: str = "") -> None:
    """InputError for the first setting outside its range. settings: a dataclass; path: its own place in the tree, such
    as "generator"."""
    hints = _hints(cast(Any, type(settings)))
    for field in dataclasses.fields(settings):
        value, place = getattr(settings, field.name), f"{path}.{field.name}" if path else field.name
        if dataclasses.is_dataclass(value):
            check(value, place)
            continue
        for limits in getattr(hints[field.name], "__metadata__", ()):
            if not all(number in limits for number in (value if isinstance(value, tuple) else (value,))):
                raise InputError(place, f"is {value!r}", f"give {limits}")


def to_dict(settings: Any) -> dict[str, Any]:
    """A tree of settings as plain values, without empty open groups (fields that are dicts)."""
    return dataclasses.asdict(settings, dict_factory=lambda pairs: {
        name: value for name, value in pairs if value != {}})


def from_dict(cls: type[T], data: Mapping[str, Any]) -> T:
    """The inverse of `to_dict`, without `check`; InputError names an unknown or missing setting, or one of another
    type."""
    _check_names(cls, data, "")
    try:
        return msgspec.convert(data, cls)
    except (msgspec.ValidationError, UnicodeEncodeError) as error:
        wrong, _, place = str(error).partition(" - at `$.")
        raise InputError(place.rstrip("`") or "settings", f"cannot be used ({wrong[:200]})",
                         "change it, or use a matching version of gesticulator") from None


def _check_names(cls: Any, data: Mapping[str, Any], path: str) -> None:
    hints = _hints(cls)
    for name, value in data.items():
        if name not in hints:
            raise InputError(f"{path}{name}"[:100], "is not a setting", f"known here: {', '.join(sorted(hints))}")
        if dataclasses.is_dataclass(hints[name]) and isinstance(value, Mapping):
            _check_names(hints[name], value, f"{path}{name}.")


def with_settings(config: T, settings: Sequence[str]) -> T:
    """A copy with `path=value` settings applied, such as `generator.lstm_width=320` or `rhythm.beats.d_max=1.0`. Values
    are JSON; InputError names a path that does not exist or a value that cannot be."""
    # Changed as a tree and made again, so that every group checks itself.
    tree = to_dict(config)
    for setting in settings:
        path, mark, text = setting.partition("=")
        if not mark:
            raise InputError(setting, "is not a setting", "write path=value, for example generator.lstm_width=320")
        try:
            value = parse_json(text, setting, "write path=value")
        except InputError:
            value = text
        *groups, name = path.split(".")
        group: Any = tree
        for part in groups:
            group = group.setdefault(part, {})
            if not isinstance(group, dict):
                raise InputError(setting, f"'{part}' holds no further settings", "shorten the path")
        group[name] = value
    try:
        # All at once, because shares that must sum to 1 cannot be changed one by one.
        return from_dict(type(config), tree) if settings else config
    except InputError as error:
        typed = next((setting for setting in settings if setting.startswith(error.subject)), error.subject)
        raise InputError(typed, error.wrong, error.advice) from None


def whole_number(text: str, most: int) -> int | None:
    """The number from 0 to `most` in a text of ASCII digits; None for anything else, of any length."""
    if not (text.isascii() and text.isdigit()) or len(text) > len(str(most)):
        return None
    number = int(text)
    return number if number <= most else None


def digest(*parts: Any) -> str:
    """A short hash of plain values and settings, such as the key of a cached stage."""
    # Sorted, so that the order of fields in a class does not change the keys of finished work.
    text = json.dumps(parts, sort_keys=True, default=to_dict)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def field_docs(kind: type) -> dict[str, str]:
    """Field of a dataclass -> the docstring below it, on one line."""
    body = cast(ast.ClassDef, ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]).body
    return {above.target.id: " ".join(below.value.value.split()) for above, below in itertools.pairwise(body)
            if isinstance(above, ast.AnnAssign) and isinstance(above.target, ast.Name)
            and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
            and isinstance(below.value.value, str)}
