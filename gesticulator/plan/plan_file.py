"""Files of gesture plans: reading, writing, JSON Schema.

The classes of `gesticulator.plan.plan` say what a plan holds. msgspec reads values by the types of their fields and
derives the schema from them; what types cannot say is in `gesticulator.plan.checks`.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import re
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, cast

import msgspec

from data_module.errors import InputError, shown
from data_module.files import parse_json, read_text, write_text
from data_module.settings import field_docs
from gesticulator.plan.checks import check_plan
from gesticulator.plan.gestures import GESTURES
from gesticulator.plan.plain import members
from gesticulator.plan.plan import FORMAT, VERSION, GesturePlan, Place, place_of

__all__ = ["parse_plan", "plan_from", "read_plan", "schema", "write_plan_file"]

_MOST_BYTES = 32 << 20
"""Size limit of a plan file, bytes (32 MiB); the plan of an hour has 10 million bytes."""
_ADVICE = "give the file that --plan-out wrote"


# ------------------------------------------------------------------------------------------------------- reading

def read_plan(path: str | os.PathLike[str]) -> GesturePlan:
    """Read a plan from a JSON file; `InputError` with the place in the plan and what is allowed if it is invalid."""
    return parse_plan(read_text(path, _ADVICE, _MOST_BYTES), str(path))


def parse_plan(text: str, source: str = "plan") -> GesturePlan:
    """Parse the JSON of a plan; errors as `read_plan`. source: its name in error messages."""
    return plan_from(parse_json(text, source, _ADVICE), source)


def plan_from(plain: Any, source: str = "plan") -> GesturePlan:
    """The plan of plain values, as JSON gives them; errors as `read_plan`."""
    if not isinstance(plain, dict):
        raise InputError(source, f"is {shown(plain)}", "give an object in braces")
    if plain.get("format") != FORMAT:
        raise InputError(source, f"format is {shown(plain.get('format'))}",
                         f'give a plan that --plan-out wrote ("format": "{FORMAT}")')
    if plain.get("version") != VERSION or isinstance(plain["version"], bool):
        raise InputError(source, f"version is {shown(plain.get('version'))}", f"this version reads {VERSION}")
    _checkmembers(GesturePlan, plain, (), source)
    try:
        plan = msgspec.convert(plain, GesturePlan)
    except msgspec.ValidationError as error:
        wrong, _, place = str(error).partition(" - at `$")
        place = place.rstrip("`").lstrip(".")
        raise InputError(source, f"{place or 'the file'}: {_plain_words(wrong)}", _advice_at(place)) from None
    plan = dataclasses.replace(plan, source=source)
    check_plan(plan)
    return plan


def _plain_words(problem: str) -> str:
    """A message of msgspec in the words of JSON: "expected integer >= 0, not -1"."""
    names = {"int": "integer", "float": "number", "str": "string", "bool": "true or false"}
    text = re.sub(r"`(\w+)`", lambda quoted: names.get(quoted[1], quoted[1]), problem)
    return text[:1].lower() + text[1:]


def _advice_at(place: str) -> str:
    """The words that are allowed at a place such as blocks[3].flag; a reference to the schema for other values."""
    hint: Any = GesturePlan
    for name in re.findall(r"\w+", re.sub(r"\[\d*\.*\]", "", place)):
        kind = next(filter(dataclasses.is_dataclass, _parts(hint)), None)
        hint = typing.get_type_hints(kind).get(name) if kind is not None else None
    words = [word for part in _parts(hint) if typing.get_origin(part) is Literal for word in typing.get_args(part)]
    return f"give one of {', '.join(words)}" if words else "write it as docs/schema/plan.schema.json says"


def _checkmembers(kind: type, value: Any, path: Place, source: str) -> None:
    """`InputError` for a member that no field has: msgspec ignores those of dataclasses, and a misspelt member of an
    edited plan must not be ignored."""
    if not isinstance(value, dict):
        return  # the wrong type is reported when the values are converted
    inner = _inner(kind)
    for name, member in value.items():
        if name not in inner:
            raise InputError(source, f"{place_of((*path, name))} is unknown", f"allowed here: {', '.join(inner)}")
        part = inner[name]
        if part is not None:
            rows = enumerate(member) if isinstance(member, list) else ()
            for at, row in rows:
                _checkmembers(part, row, (*path, name, at), source)
            _checkmembers(part, member, (*path, name), source)


@functools.cache
def _inner(kind: type) -> dict[str, type | None]:
    """Member of the file -> the dataclass of its value or of the entries of its list, None for other values."""
    hints = typing.get_type_hints(kind)
    return {name: next((cast(type, part) for part in _parts(hints[name]) if dataclasses.is_dataclass(part)), None)
            for name in members(kind)}


def _parts(hint: Any) -> Iterator[Any]:
    """A type and those that it is composed of."""
    yield hint
    for part in typing.get_args(hint):
        yield from _parts(part)


# ------------------------------------------------------------------------------------------------------- writing

def write_plan_file(path: str | os.PathLike[str], plan: GesturePlan) -> Path:
    """Write a plan atomically. Returns the path."""
    target = Path(path)
    write_text(target, plan.to_json())
    return target


# -------------------------------------------------------------------------------------------------------- schema

def schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a plan; descriptions are the docstrings below the fields.

    Names of gestures are examples, as a cue may name a lexeme, too.
    """
    whole = msgspec.json.schema(GesturePlan)
    definitions = whole["$defs"]
    for kind in filter(dataclasses.is_dataclass, _reached(GesturePlan)):
        definition = definitions[kind.__name__]
        about = field_docs(kind)
        definition["description"] = (kind.__doc__ or "").split("\n\n")[0].replace("\n    ", " ")
        definition["additionalProperties"] = False
        definition["properties"] = {name: {"description": about[name], **definition["properties"][name]}
                                    for name in members(kind)}
    definitions["GestureCue"]["properties"]["gesture"]["examples"] = list(GESTURES)
    # Defaults are tuples and dataclasses there; as JSON they are lists and objects.
    plain: dict[str, Any] = json.loads(json.dumps(msgspec.to_builtins(whole)))
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **plain}


def _reached(kind: type) -> list[type]:
    """A dataclass and all that its fields hold."""
    reached = [kind]
    for inner in reached:
        reached += [part for part in dict.fromkeys(_inner(inner).values()) if part is not None and part not in reached]
    return reached
