"""Validates values against a JSON Schema, for the part of draft 2020-12 that the protocol uses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from data_module.errors import InputError, shown

_TYPES: dict[str, tuple[type, ...]] = {"object": (dict,), "array": (list,), "string": (str,), "boolean": (bool,),
                                       "integer": (int,), "number": (int, float)}
KNOWN = {"type", "const", "enum", "minimum", "maximum", "maxLength", "minItems", "maxItems", "items", "properties",
         "required", "additionalProperties", "$ref", "description", "default"}
"""Supported keywords, and annotations without effect; a test checks that the schema uses no others."""


def check(value: Any, schema: Mapping[str, Any], root: Mapping[str, Any], place: str = "message") -> None:
    """`InputError` with the place and the rule if a value is invalid. root: the whole schema, for "$ref"; place: the
    name of the value in messages."""
    if "$ref" in schema:
        schema = root["$defs"][schema["$ref"].removeprefix("#/$defs/")]
    _check_kind(value, schema, place)
    if isinstance(value, str):
        if len(value) > schema.get("maxLength", math.inf):
            raise InputError(place, "is too long", f"{schema['maxLength']} characters at most")
    elif isinstance(value, dict):
        _check_object(value, schema, root, place)
    elif isinstance(value, list):
        _check_array(value, schema, root, place)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        _check_number(value, schema, place)


def _check_kind(value: Any, schema: Mapping[str, Any], place: str) -> None:
    if "type" in schema:
        kind = schema["type"]
        fits = isinstance(value, _TYPES[kind]) and (kind == "boolean" or not isinstance(value, bool))
        # JSON Schema counts a float without a fraction as an integer.
        if not (fits or (kind == "integer" and isinstance(value, float) and value.is_integer())):
            raise InputError(place, f"is {shown(value)}", f"give {'an' if kind[0] in 'aio' else 'a'} {kind}")
    allowed = [schema["const"]] if "const" in schema else schema.get("enum")
    if allowed is not None and not any(value == one and isinstance(value, bool) == isinstance(one, bool)
                                       for one in allowed):
        raise InputError(place, f"is {shown(value)}", "give " + " or ".join(map(str, allowed)))


def _check_number(value: float, schema: Mapping[str, Any], place: str) -> None:
    low, high = schema.get("minimum", -math.inf), schema.get("maximum", math.inf)
    if not low <= value <= high:  # also NaN
        raise InputError(place, f"is {shown(value)}", f"give {low:g} to {high:g}")


def _check_object(value: dict[str, Any], schema: Mapping[str, Any], root: Mapping[str, Any], place: str) -> None:
    properties = schema.get("properties", {})
    for name in schema.get("required", ()):
        if name not in value:
            raise InputError(place, f"lacks {name}", "see the published schema")
    for name, member in value.items():
        if name in properties:
            check(member, properties[name], root, f"{place}.{name}")
        elif schema.get("additionalProperties", True) is False:
            raise InputError(place, f"has {shown(name)}, which is unknown", "it has " + ", ".join(properties))


def _check_array(value: list[Any], schema: Mapping[str, Any], root: Mapping[str, Any], place: str) -> None:
    if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf):
        raise InputError(place, f"has {len(value)} entries", f"{schema.get('minItems', 0)} to "
                         f"{schema.get('maxItems', 'any number')}")
    for number, item in enumerate(value if "items" in schema else ()):
        check(item, schema["items"], root, f"{place}[{number}]")
