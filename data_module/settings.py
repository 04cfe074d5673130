"""Trees of settings: frozen dataclasses with ranges, and their safe reading and changing from outside.

The type of a field contains its range, `width: Width = 64`, and `check` validates every value, so that an invalid
setting is refused by its name when it is read, and not by a layer of a network half an hour later.
"""

from __future__ import annotations

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
_LONGEST = 2**16
"""Most values in one setting: the number of lexemes in the largest lexicon."""
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


def limits_of(hint: Any) -> SettingRange | SettingChoice | None:
    marks = getattr(hint, "__metadata__", ())
    return next((mark for mark in marks if isinstance(mark, SettingRange | SettingChoice)), None)


def check(settings: Any, path: str = "") -> None:
    """InputError for the first setting that is of another type than its field, or outside its range. settings: a
    dataclass; path: its own place in the tree, such as "generator"."""
    hints = _hints(cast(Any, type(settings)))
    for field in dataclasses.fields(settings):
        value, hint = getattr(settings, field.name), hints[field.name]
        place = f"{path}.{field.name}" if path else field.name
        if dataclasses.is_dataclass(value):
            check(value, place)
            continue
        _check_type(value, hint, place)
        limits = limits_of(hint)
        if limits is not None:
            for number in value if isinstance(value, tuple) else (value,):
                if number not in limits:
                    raise InputError(place, f"is {value!r}", f"give {limits}")


def _check_type(value: Any, hint: Any, place: str) -> None:
    plain = typing.get_args(hint)[0] if hasattr(hint, "__metadata__") else hint
    kind = typing.get_origin(plain) or plain
    fits = _is(value, kind)
    if fits and kind is tuple:
        inner = typing.get_args(plain)
        fits = len(value) <= _LONGEST and all(_is(item, inner[0]) for item in value)
        fits = fits and (inner[-1] is Ellipsis or len(value) == len(inner))
    if not fits:
        raise InputError(place, f"is {_shown(value)}", f"give a value of the kind {getattr(kind, '__name__', kind)}")


def _is(value: Any, kind: Any) -> bool:
    # To Python a bool is an int, but `true` for a width is an error.
    if isinstance(value, bool) or kind is bool:
        return isinstance(value, bool) and kind is bool
    return isinstance(value, (int, float) if kind is float else kind)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


def to_dict(settings: Any) -> dict[str, Any]:
    """A tree of settings as plain values, without empty open groups (fields that are dicts)."""
    return dataclasses.asdict(settings, dict_factory=lambda pairs: {
        name: value for name, value in pairs if value != {}})


def from_dict(cls: type[T], data: Mapping[str, Any]) -> T:
    """The inverse of `to_dict`, without `check`; InputError names an unknown or missing setting."""
    if not dataclasses.is_dataclass(cls):
        raise TypeError(f"{cls} is not a dataclass")
    hints: dict[str, Any] = _hints(cast(Any, cls))
    unknown = sorted(set(map(str, data)) - {field.name for field in dataclasses.fields(cls)})
    if unknown:
        raise InputError("settings", f"unknown: {', '.join(unknown)[:200]}", "use a matching version of gesticulator")
    values: dict[str, Any] = {}
    for name, value in data.items():
        if dataclasses.is_dataclass(hints[name]):
            if not isinstance(value, Mapping):
                raise InputError("settings", f"{name} is {_shown(value)}, and a group of settings is wanted",
                                 "use a matching version of gesticulator")
            value = from_dict(cast(type, hints[name]), value)
        elif isinstance(value, list):
            # JSON has no tuples; settings have no lists.
            value = tuple(value)
        values[name] = value
    try:
        return cls(**values)
    except TypeError as error:
        raise InputError("settings", str(error), "use a matching version of gesticulator") from None
    except (ValueError, OverflowError) as error:
        raise InputError("settings", str(error), "change them") from None


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
        _put(tree, config, path.split("."), value, setting)
    # All at once, because shares that must sum to 1 cannot be changed one by one.
    return from_dict(type(config), tree) if settings else config


def _put(tree: dict[str, Any], node: Any, path: list[str], value: Any, setting: str) -> None:
    # The known names of this group are the help that a misspelt path needs.
    names = {f.name for f in dataclasses.fields(node)}
    if path[0] not in names:
        raise InputError(setting, f"there is no setting '{path[0]}'", f"known here: {', '.join(sorted(names))}")
    old = getattr(node, path[0])
    if isinstance(old, Mapping):  # an open group, which the settings check when they are made
        _put_open(tree.setdefault(path[0], {}), path[1:], value, setting)
        return
    if len(path) > 1:
        if not dataclasses.is_dataclass(old):
            raise InputError(setting, f"'{path[0]}' holds no further settings", "shorten the path")
        _put(tree[path[0]], old, path[1:], value, setting)
        return
    if isinstance(old, tuple) and isinstance(value, list):
        value = tuple(value)
    # `=1` for a float setting is meant as 1.0.
    if isinstance(old, float) and isinstance(value, int) and not isinstance(value, bool):
        try:
            value = float(value)
        except OverflowError:
            value = math.inf
    # Exactly the type: True would pass for 1, and 1 for True.
    if dataclasses.is_dataclass(old) or type(old) is not type(value):
        raise InputError(setting, f"expects a value like {old!r}", "write path=value")
    tree[path[0]] = value


def whole_number(text: str, most: int) -> int | None:
    """The number from 0 to `most` in a text of ASCII digits; None for anything else, of any length."""
    if not (text.isascii() and text.isdigit()) or len(text) > len(str(most)):
        return None
    number = int(text)
    return number if number <= most else None


def _put_open(tree: dict[str, Any], path: list[str], value: Any, setting: str) -> None:
    """Put a value into an open group: group.NAME={...}, or group.NAME.setting=value."""
    if not path or (len(path) == 1 and not isinstance(value, dict)):
        raise InputError(setting, "names no setting of this group", "write group.name={} or group.name.setting=value")
    for name in path[:-1]:
        tree = tree.setdefault(name, {})
        if not isinstance(tree, dict):
            raise InputError(setting, f"'{name}' holds no further settings", "shorten the path")
    tree[path[-1]] = value


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
