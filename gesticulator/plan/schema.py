"""Conversion of dataclasses to JSON and back, and their JSON Schema, all derived from the types of the fields.

A field's type carries its range (`data_module.settings`); a field with a default is optional.
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
from gesticulator.plan.json_lines import LinedJson, Path, check_plain, check_text

T = TypeVar("T")

_PLAIN: dict[Any, tuple[str, str]] = {bool: ("boolean", "true or false"), int: ("integer", "a whole number"),
                                      float: ("number", "a number"), str: ("string", "a text in quotes")}
_MOST_WHOLE = 2**64
"""Limit of whole numbers, which JSON may write as 3.0 or 1e300; no field allows larger ones."""


@functools.cache
def _hints(cls: Any) -> dict[str, Any]:
    return typing.get_type_hints(cls, include_extras=True)


def _fields(cls: Any) -> list[dataclasses.Field[Any]]:
    """The fields that are written to the file."""
    return [field for field in dataclasses.fields(cls) if not field.metadata.get(PRIVATE_MARK)]


def _required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _split(hint: Any) -> tuple[Any, bool, SettingRange | SettingChoice | None]:
    """The plain type of a field, whether it can be null, and its range."""
    limits = limits_of(hint)
    plain = typing.get_args(hint)[0] if limits is not None else hint
    if typing.get_origin(plain) in (typing.Union, types.UnionType):
        inner = [part for part in typing.get_args(plain) if part is not type(None)]
        inner_type, _, inner_limits = _split(inner[0])
        return inner_type, True, limits or inner_limits
    return plain, False, limits


# ------------------------------------------------------------------------------------------------------- reading

def read_as(cls: type[T], source: LinedJson, path: Path = ()) -> T:
    """The dataclass of the object at a path; `InputError` with the line of the first member that is unknown, missing,
    of another type or out of range."""
    value = source.value
    for part in path:
        value = value[part]
    return cast(T, _record(cls, value, source, path))


def read_part(cls: Any, name: str, source: LinedJson) -> Any:
    """The member `name` of the dataclass of the whole file; errors as `read_as`."""
    return _read(_hints(cls)[name], source.value[name], source, (name,))


def _record(cls: Any, value: Any, source: LinedJson, path: Path) -> Any:
    if not isinstance(value, dict):
        raise source.error(path, f"is {shown(value)}", "give an object in braces")
    fields, hints = _fields(cls), _hints(cls)
    names = [field.name for field in fields]
    for name in value:
        if name not in names:
            raise source.error((*path, name), "is unknown", f"allowed here: {', '.join(names)}")
    members: dict[str, Any] = {}
    for field in fields:
        if field.name in value:
            members[field.name] = _read(hints[field.name], value[field.name], source, (*path, field.name))
        elif _required(field):
            raise source.error(path, f"lacks {field.name}", f"required here: {', '.join(part_names(cls)[1])}")
    return cls(**members)


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
        return copy.deepcopy(value)  # the plan must not share mutable objects with the caller
    return _plain(plain, nullable, limits, value, source, path)


def _list(plain: Any, limits: Any, value: Any, source: LinedJson, path: Path) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise source.error(path, f"is {shown(value)}", "give a list in brackets")
    inner = typing.get_args(plain)
    if inner[-1] is not Ellipsis and len(value) != len(inner):
        raise source.error(path, f"has {len(value)} entries", f"give {len(inner)}")
    kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else list(inner)
    out = []
    for at, (kind, entry) in enumerate(zip(kinds, value, strict=True)):
        read = _read(kind, entry, source, (*path, at))
        if limits is not None and read not in limits:
            raise source.error((*path, at), f"is {shown(entry)}", f"give {limits}")
        out.append(read)
    return tuple(out)


def _plain(kind: Any, nullable: bool, limits: Any, value: Any, source: LinedJson, path: Path) -> Any:
    allowed = f"{limits}" if limits is not None else _PLAIN[kind][1]
    advice = f"give {allowed}{' or null' if nullable else ''}"
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
    if kind is str:
        check_text(value, source, path)
    return value


@functools.cache
def part_names(cls: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The members of a dataclass in the file, and the required ones of them."""
    return tuple(field.name for field in _fields(cls)), tuple(field.name for field in _fields(cls) if _required(field))


# ------------------------------------------------------------------------------------------------------- writing

def to_plain(record: Any) -> Any:
    """The inverse of `read_as`: plain values for JSON, without optional fields that are None or empty by default and
    unchanged."""
    if isinstance(record, tuple | list):
        return [to_plain(entry) for entry in record]
    if not dataclasses.is_dataclass(record):
        return dict(record) if isinstance(record, Mapping) else record
    return {name: to_plain(value) for name, value in written_parts(record)}


def written_parts(record: Any) -> list[tuple[str, Any]]:
    """The members of a dataclass that are written, in order, with their values."""
    cls: Any = type(record)
    omitted, values = _omitted_if_empty(cls), vars(record)
    return [(name, values[name]) for name in part_names(cls)[0]
            if not (name in omitted and values[name] in (None, ()))]


@functools.cache
def _omitted_if_empty(cls: Any) -> frozenset[str]:
    return frozenset(field.name for field in _fields(cls) if not _required(field) and field.default in (None, ()))


# -------------------------------------------------------------------------------------------------------- schema

def schema_of(cls: Any) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a dataclass; descriptions are the docstrings below its fields."""
    definitions: dict[str, Any] = {}
    root = _object_schema(cls, definitions)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **root, "$defs": definitions}


def _object_schema(cls: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    hints, abouts = _hints(cls), _field_docs(cls)
    properties = {field.name: {"description": abouts[field.name], **_type_schema(hints[field.name], definitions)}
                  for field in _fields(cls)}
    return {"title": cls.__name__, "description": (cls.__doc__ or "").split("\n\n")[0].replace("\n    ", " "),
            "type": "object", "properties": properties, "additionalProperties": False,
            "required": list(part_names(cls)[1])}


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
        not_null = _type_schema(typing.Annotated[plain, limits] if limits is not None else plain, definitions)
        return {"anyOf": [not_null, {"type": "null"}]}
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
        return {"type": "array", "prefixItems": [{**_type_schema(part, definitions), **_limited(limits)}
                                                 for part in inner], "minItems": len(inner), "maxItems": len(inner)}
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
