"""Files of gesture plans: reading, writing, JSON Schema.

The classes of `gesticulator.plan.plan` say what a plan holds. msgspec reads values by the types of their fields and
derives the schema from them; what types cannot say is in `gesticulator.plan.checks`.
"""

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import msgspec

from data_module.errors import InputError, shown
from data_module.files import parse_json, read_text, write_text
from data_module.settings import field_docs
from gesticulator.plan import plan as nouns
from gesticulator.plan.checks import check_plan
from gesticulator.plan.gestures import GESTURES
from gesticulator.plan.plan import FORMAT, VERSION, GesturePlan, Place, members, place_of

__all__ = ["parse_plan", "plan_from", "read_plan", "schema", "write_plan_file"]

_MOST_BYTES = 32 << 20
"""Size limit of a plan file, bytes (32 MiB); the plan of an hour has 10 million bytes."""
_ADVICE = "give the file that --plan-out wrote"


def read_plan(path: str | os.PathLike[str]) -> GesturePlan:
    """Read a plan from a JSON file; `InputError` with the place in the plan if it is invalid."""
    return parse_plan(read_text(path, _ADVICE, _MOST_BYTES), str(path))


def parse_plan(text: str, source: str = "plan") -> GesturePlan:
    """Parse the JSON of a plan; errors as `read_plan`. source: its name in error messages."""
    return plan_from(parse_json(text, source, _ADVICE), source)


def plan_from(plain: Any, source: str = "plan") -> GesturePlan:
    """The plan of plain values, as JSON gives them; errors as `read_plan`."""
    if not isinstance(plain, dict):
        raise InputError(source, f"is {shown(plain)}", "give an object in braces")
    # Before anything else: a file of another kind would be refused for its first unknown member.
    if plain.get("format") != FORMAT:
        raise InputError(source, f"format is {shown(plain.get('format'))}",
                         f'give a plan that --plan-out wrote ("format": "{FORMAT}")')
    # True equals 1 in Python.
    if plain.get("version") != VERSION or isinstance(plain["version"], bool):
        raise InputError(source, f"version is {shown(plain.get('version'))}", f"this version reads {VERSION}")
    try:
        plan = msgspec.convert(plain, GesturePlan)
    except msgspec.ValidationError as error:
        # msgspec puts the place last: "Expected `int` >= 0 - at `$.seed`".
        wrong, _, place = str(error).partition(" - at `$")
        raise InputError(source, f"{place.strip('.`') or 'the file'}: {wrong}",
                         "gesticulator plan schema prints what is allowed") from None
    plan = dataclasses.replace(plan, source=source)
    _check_members(plain, plan, (), source)
    check_plan(plan)
    return plan


def _check_members(plain: Any, record: Any, path: Place, source: str) -> None:
    # A member that no field has, such as a misspelt one, must not be ignored as msgspec does with dataclasses.
    if isinstance(plain, list):
        for at, (row, entry) in enumerate(zip(plain, record, strict=True)):
            _check_members(row, entry, (*path, at), source)
    elif dataclasses.is_dataclass(record):
        allowed = members(record.__class__)
        for name, value in plain.items():
            if name not in allowed:
                raise InputError(source, f"{place_of((*path, name))} is unknown", f"allowed here: {', '.join(allowed)}")
            _check_members(value, getattr(record, name), (*path, name), source)


def write_plan_file(path: str | os.PathLike[str], plan: GesturePlan) -> Path:
    """Write a plan atomically. Returns the path."""
    target = Path(path)
    write_text(target, plan.to_json())
    return target


def schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a plan; descriptions are the docstrings below the fields. Names of gestures
    are examples, as a cue may name a lexeme, too."""
    whole = msgspec.json.schema(GesturePlan)
    for name, definition in whole["$defs"].items():
        kind = getattr(nouns, name)
        about = field_docs(kind)
        definition["description"] = kind.__doc__.split("\n\n")[0].replace("\n    ", " ")
        definition["additionalProperties"] = False
        definition["properties"] = {member: {"description": about[member], **definition["properties"][member]}
                                    for member in members(kind)}
    whole["$defs"]["GestureCue"]["properties"]["gesture"]["examples"] = list(GESTURES)
    # Defaults are tuples and dataclasses there; as JSON they are lists and objects.
    plain: dict[str, Any] = json.loads(json.dumps(msgspec.to_builtins(whole)))
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **plain}
