"""Plans of earlier versions, brought to the version that is read: a plan that was saved once can always be opened.

Each entry of `UPGRADES` takes the plain object of one version to the next. Version 2 added the sections of
`gesticulator.plan.sections`, all of which may be left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from data_module.errors import shown
from gesticulator.plan.json_lines import LinedJson

FORMAT, VERSION = "gesticulator-plan", 2
Plain = dict[str, Any]


def _to_version_2(plan: Plain) -> Plain:
    return {**plan, "version": 2}


UPGRADES: Mapping[int, Callable[[Plain], Plain]] = {1: _to_version_2}
"""Version -> what makes the next version of it."""


def upgraded(lined: LinedJson) -> LinedJson:
    """The plan's object in this version; lines are those of the file. `InputError` for another format or version."""
    plan = lined.value
    if not isinstance(plan, dict):
        return lined  # which is told where it is read
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
