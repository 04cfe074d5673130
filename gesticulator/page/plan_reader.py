"""Reads the plans that a page sends whole after each edit: a part that was not changed is not read again.

The plan of ten minutes has 1,800 blocks, which take a second to read. A part is recognised by its `repr`, which
distinguishes 1, 1.0 and true as JSON does.
"""

from __future__ import annotations

from typing import Any

from data_module.errors import InputError
from gesticulator.plan.checks import check_plan
from gesticulator.plan.json_lines import with_lines
from gesticulator.plan.plan import Block, GesturePlan
from gesticulator.plan.plan_file import upgraded
from gesticulator.plan.schema import part_names, read_as, read_part

_BLOCKS = "blocks"


class PlanReader:
    """Remembers the parts of the last plan that it read. Not thread-safe."""

    def __init__(self) -> None:
        self._parts: dict[tuple[str, str], Any] = {}  # (member, its text) -> its value in the plan
        self._blocks: dict[str, Block] = {}  # text of a block -> the block

    def read(self, plain: dict[str, Any], source: str = "plan") -> GesturePlan:
        """The plan of plain values, as from `parse_plan`. `InputError` with the line that the value has in the plan's
        JSON with an indent of 1."""
        lined = upgraded(with_lines(plain, source))
        plain = lined.value
        names, needed = part_names(GesturePlan)
        if not set(needed) <= set(plain) <= set(names) or not isinstance(plain[_BLOCKS], list):
            read_as(GesturePlan, lined)  # raises the error
        parts: dict[tuple[str, str], Any] = {}
        blocks: dict[str, Block] = {}
        try:
            for name in (name for name in names if name in plain and name != _BLOCKS):
                key = name, repr(plain[name])
                parts[key] = self._parts[key] if key in self._parts else read_part(GesturePlan, name, lined)
            texts = [repr(row) for row in plain[_BLOCKS]]
            for at, text in enumerate(texts):
                known = blocks.get(text) or self._blocks.get(text)
                blocks[text] = read_as(Block, lined, (_BLOCKS, at)) if known is None else known
        except RecursionError:
            raise InputError(source, "is nested too deeply", "write it as the schema says") from None
        plan = GesturePlan(**{name: value for (name, _), value in parts.items()},
                           blocks=tuple([blocks[text] for text in texts]), source=lined)
        check_plan(plan)
        self._parts, self._blocks = parts, blocks
        return plan
