"""Files of gesture plans: reading, upgrades from earlier versions, writing, JSON Schema.

Plans of all earlier versions can be read: each entry of `UPGRADES` converts the plain object of one version to the
next. Version 2 added units, meanings, pins, curves and alignment, all of which are optional.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_module.errors import shown
from data_module.files import read_text, write_text
from gesticulator.plan.checks import check_plan
from gesticulator.plan.gestures import GESTURES
from gesticulator.plan.json_lines import LinedJson, parse
from gesticulator.plan.plan import FORMAT, VERSION, GesturePlan
from gesticulator.plan.schema import read_as, schema_of

__all__ = ["parse_plan", "read_plan", "schema", "write_plan_file"]

_MOST_BYTES = 32 << 20
"""Size limit of a plan file, bytes (32 MiB); the plan of an hour has 10 million bytes."""
Plain = dict[str, Any]


def _to_version_2(plan: Plain) -> Plain:
    return {**plan, "version": 2}


UPGRADES: Mapping[int, Callable[[Plain], Plain]] = {1: _to_version_2}
"""Version -> conversion to the next version."""


def upgraded(lined: LinedJson) -> LinedJson:
    """The plan's object in this version, with the lines of the file; `InputError` for another format or version."""
    plan = lined.value
    if not isinstance(plan, dict):
        return lined  # `read_as` reports this error
    if plan.get("format") != FORMAT:
        raise lined.error(("format",), f"is {shown(plan.get('format'))}",
                          f'give a plan that --plan-out wrote ("format": "{FORMAT}")')
    version = plan.get("version")
    number = isinstance(version, int | float) and not isinstance(version, bool)
    if not number or (version != VERSION and version not in UPGRADES):
        raise lined.error(("version",), f"is {shown(version)}",
                          f"this version reads {', '.join(map(str, UPGRADES))} and {VERSION}")
    while plan["version"] != VERSION:
        plan = UPGRADES[plan["version"]](plan)
    return replace(lined, value=plan)


def read_plan(path: str | os.PathLike[str]) -> GesturePlan:
    """Read a plan from a JSON file; `InputError` with the line and the allowed values if it is invalid."""
    return parse_plan(read_text(path, "give the file that --plan-out wrote", _MOST_BYTES), str(path))


def parse_plan(text: str, source: str = "plan") -> GesturePlan:
    """Parse the JSON of a plan; errors as `read_plan`. source: its name in error messages."""
    lined = upgraded(parse(text, source))
    plan = replace(read_as(GesturePlan, lined), source=lined)
    check_plan(plan)
    return plan


def write_plan_file(path: str | os.PathLike[str], plan: GesturePlan) -> Path:
    """Write a plan atomically. Returns the path."""
    target = Path(path)
    write_text(target, plan.to_json())
    return target


def schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a plan. Names of gestures are examples, as a cue may name a lexeme, too."""
    whole = schema_of(GesturePlan)
    whole["$defs"]["GestureCue"]["properties"]["gesture"]["examples"] = list(GESTURES)
    return whole
