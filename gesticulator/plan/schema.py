"""From dataclasses to JSON and back, and to a JSON Schema: one description, in the types of the fields.

A field's type carries its range (`data_module.settings`); a field with a default may be left out.
"""

from __future__ import annotations

import ast
import copy
import dataclasses
import functools
import inspect
import itertools
import math
import textwrap
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from data_module.errors import shown
from data_module.settings import PRIVATE_MARK, SettingChoice, SettingRange, limits_of
from gesticulator.plan.json_lines import LinedJson, Path, check_plain, half_character

T = TypeVar("T")

_PLAIN: dict[Any, tuple[str, str]] = {bool: ("boolean", "true or false"), int: ("integer", "a whole number"),
                                      float: ("number", "a number"), str: ("string", "a text in quotes")}
_MOST_WHOLE = 2**64
"""Whole numbers in JSON may be written as 3.0 or 1e300: from here on they are none of ours."""


@functools.cache
def _hints(cls: Any) -> dict[str, Any]:
    return typing.get_type_hints(cls, include_extras=True)


def _fields(cls: Any) -> list[dataclasses.Field[Any]]:
    """Those that stand in the file."""
    return [field for field in dataclasses.fields(cls) if not field.metadata.get(PRIVATE_MARK)]


def _required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _split(hint: Any) -> tuple[Any, bool, SettingRange | SettingChoice | None]:
    """The plain type of a field, whether null may stand there, and its range."""
    limits = limits_of(hint)
    plain = typing.get_args(hint)[0] if limits is not None else hint
    if typing.get_origin(plain) in (typing.Union, types.UnionType):
        inner = [one for one in typing.get_args(plain) if one is not type(None)]
        own, _, within = _split(inner[0])
        return own, True, limits or within
    return plain, False, limits


# ------------------------------------------------------------------------------------------------------- reading

def read_as(cls: type[T], source: LinedJson, path: Path = ()) -> T:
    """The dataclass of what was read; `InputError` with the line for the first member that is unknown, lacking, of
    another kind or out of its range."""
    value = _find(source.value, path)
    return cast(T, _record(cls, value, source, path))


def read_part(cls: Any, name: str, source: LinedJson) -> Any:
    """The member `name` of a dataclass whose object is the whole of what was read; errors as `read_as`."""
    return _read(_hints(cls)[name], source.value[name], source, (name,))


def _find(value: Any, path: Path) -> Any:
    for part in path:
        value = value[part]
    return value


def _record(cls: Any, value: Any, source: LinedJson, path: Path) -> Any:
    if not isinstance(value, dict):
        raise source.error(path, f"is {shown(value)}", "give an object in braces")
    fields, hints = _fields(cls), _hints(cls)
    names = [field.name for field in fields]
    for name in value:
        if name not in names:
            raise source.error((*path, name), "is unknown", f"known here: {', '.join(names)}")
    given: dict[str, Any] = {}
    for field in fields:
        if field.name in value:
            given[field.name] = _read(hints[field.name], value[field.name], source, (*path, field.name))
        elif _required(field):
            raise source.error(path, f"lacks {field.name}", f"needed here: "
                               f"{', '.join(one.name for one in fields if _required(one))}")
    return cls(**given)


def _read(hint: Any, value: Any, source: LinedJson, path: Path) -> Any:
    plain, nullable, limits = _split(hint)
    if value is None and nullable:
        return None
    if dataclasses.is_dataclass(plain):
        return _record(plain, value, source, path)
    origin = typing.get_origin(plain)
    if origin is tuple:
        return _list(plain, limits, value, source, path)
    if origin is not None or plain is dict:
        if not isinstance(value, dict):
            raise source.error(path, f"is {shown(value)}", "give an object in braces")
        check_plain(value, source, path)
        return copy.deepcopy(value)  # a plan must not change with the object that it was read from
    return _plain(plain, nullable, limits, value, source, path)


def _list(plain: Any, limits: Any, value: Any, source: LinedJson, path: Path) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise source.error(path, f"is {shown(value)}", "give a list in brackets")
    inner = typing.get_args(plain)
    if inner[-1] is not Ellipsis and len(value) != len(inner):
        raise source.error(path, f"has {len(value)} entries", f"give {len(inner)}")
    kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else list(inner)
    out = []
    for at, (kind, one) in enumerate(zip(kinds, value, strict=True)):
        read = _read(kind, one, source, (*path, at))
        if limits is not None and read not in limits:
            raise source.error((*path, at), f"is {shown(one)}", f"give {limits}")
        out.append(read)
    return tuple(out)


def _plain(kind: Any, nullable: bool, limits: Any, value: Any, source: LinedJson, path: Path) -> Any:
    wanted = f"{limits}" if limits is not None else _PLAIN[kind][1]
    advice = f"give {wanted}{' or null' if nullable else ''}"
    fits = isinstance(value, bool) == (kind is bool) and isinstance(value, (int, float) if kind in (int, float)
                                                                     else kind)
    if fits and kind is int and isinstance(value, float):
        fits = value.is_integer() and abs(value) < _MOST_WHOLE
        value = int(value) if fits else value
    if fits and kind is float and isinstance(value, int):
        fits = abs(value) < _MOST_WHOLE
        value = float(value) if fits else value
    if fits and isinstance(value, float):
        fits = math.isfinite(value)
    if not fits or (limits is not None and value not in limits):
        raise source.error(path, f"is {shown(value)}", advice)
    if kind is str and half_character(value):
        raise source.error(path, f"holds half a character in {shown(value)}", "write whole ones")
    return value


@functools.cache
def part_names(cls: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The members of a dataclass that stand in the file, and those of them that must."""
    return tuple(field.name for field in _fields(cls)), tuple(one.name for one in _fields(cls) if _required(one))


# ------------------------------------------------------------------------------------------------------- writing

def to_plain(record: Any) -> Any:
    """The inverse of `read_as`: plain values for JSON. Fields that are left at their default of None, or of an empty
    list, stay out."""
    if isinstance(record, tuple | list):
        return [to_plain(one) for one in record]
    if not dataclasses.is_dataclass(record):
        return dict(record) if isinstance(record, Mapping) else record
    return {name: to_plain(value) for name, value in written_parts(record)}


def written_parts(record: Any) -> list[tuple[str, Any]]:
    """The members of a dataclass that are written, in order, with their values."""
    cls: Any = type(record)
    left_out, values = _left_out(cls), vars(record)
    return [(name, values[name]) for name in part_names(cls)[0]
            if not (name in left_out and values[name] in (None, ()))]


@functools.cache
def _left_out(cls: Any) -> frozenset[str]:
    """Members that are not written where they are empty."""
    return frozenset(field.name for field in _fields(cls) if not _required(field) and field.default in (None, ()))


# -------------------------------------------------------------------------------------------------------- schema

def schema_of(cls: Any) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a dataclass; what its fields are is read from the docstrings below them."""
    definitions: dict[str, Any] = {}
    whole = _object_schema(cls, definitions)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **whole, "$defs": definitions}


def _object_schema(cls: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    hints, abouts = _hints(cls), _field_docs(cls)
    properties = {field.name: {"description": abouts[field.name], **_type_schema(hints[field.name], definitions)}
                  for field in _fields(cls)}
    return {"title": cls.__name__, "description": (cls.__doc__ or "").split("\n\n")[0].replace("\n    ", " "),
            "type": "object", "properties": properties, "additionalProperties": False,
            "required": [field.name for field in _fields(cls) if _required(field)]}


def _field_docs(cls: type) -> dict[str, str]:
    """Field -> the docstring below it."""
    body = cast(ast.ClassDef, ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0]).body
    return {above.target.id: " ".join(below.value.value.split()) for above, below in itertools.pairwise(body)
            if isinstance(above, ast.AnnAssign) and isinstance(above.target, ast.Name)
            and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
            and isinstance(below.value.value, str)}


def _type_schema(hint: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    plain, nullable, limits = _split(hint)
    if nullable:
        own = _type_schema(typing.Annotated[plain, limits] if limits is not None else plain, definitions)
        return {"anyOf": [own, {"type": "null"}]}
    if dataclasses.is_dataclass(plain):
        name = cast(type, plain).__name__
        if name not in definitions:
            definitions[name] = {}
            definitions[name] = _object_schema(plain, definitions)
        return {"$ref": f"#/$defs/{name}"}
    origin = typing.get_origin(plain)
    if origin is tuple:
        inner = typing.get_args(plain)
        if inner[-1] is Ellipsis:
            return {"type": "array", "items": {**_type_schema(inner[0], definitions), **_limited(limits)}}
        return {"type": "array", "prefixItems": [{**_type_schema(one, definitions), **_limited(limits)}
                                                 for one in inner], "minItems": len(inner), "maxItems": len(inner)}
    if origin is not None or plain is dict:
        return {"type": "object"}
    return {"type": _PLAIN[plain][0], **_limited(limits)}


def _limited(limits: SettingRange | SettingChoice | None) -> dict[str, Any]:
    if limits is None:
        return {}
    if isinstance(limits, SettingChoice):
        return {"enum": list(limits.words)}
    out: dict[str, Any] = {"exclusiveMinimum" if limits.above else "minimum": limits.least}
    if math.isfinite(limits.most):
        out["maximum"] = limits.most
    return out
