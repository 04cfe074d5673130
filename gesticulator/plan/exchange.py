"""A plan that goes to and fro between us and a page, in plain values: what did not change is not read or written again.

A page sends the whole plan after each edit, and an hour's has ten thousand blocks. `PlanExchange` remembers the parts
of the last plan that it read and of the last that it wrote. A part is known again by its text, in which 1, 1.0 and true
differ as they do in JSON.
"""

from __future__ import annotations

import json
from typing import Any

from data_module.errors import InputError
from gesticulator.plan.checks import check_plan
from gesticulator.plan.json_lines import LinedJson, with_lines
from gesticulator.plan.plan import Block, GesturePlan
from gesticulator.plan.plan_file import upgraded
from gesticulator.plan.schema import part_names, read_as, read_part, to_plain, written_parts

_BLOCKS = "blocks"


class PlanExchange:
    """Reads and writes the plans of one page; memory is that of two plans. Not for several threads at once."""

    def __init__(self) -> None:
        self._read: dict[str, tuple[str, Any]] = {}  # member -> its text, what it was read as
        self._blocks: dict[str, Block] = {}  # text of a block -> the block
        self._written: dict[int, tuple[Any, str]] = {}  # identity of a part -> the part, its JSON

    def read(self, plain: dict[str, Any], source: str = "plan") -> GesturePlan:
        """The plan of plain values, as `parse_plan` gives it; `InputError` with the line that a value would have in
        the JSON of the plan with an indent of 1. Parts that are equal to those of the last plan are the same objects.
        """
        lined = upgraded(with_lines(plain, source))
        plain = lined.value
        names, needed = part_names(GesturePlan)
        if not set(needed) <= set(plain) <= set(names) or not isinstance(plain[_BLOCKS], list):
            read_as(GesturePlan, lined)  # which says what is wrong
        parts: dict[str, tuple[str, Any]] = {}
        try:
            for name in names:
                if name in plain and name != _BLOCKS:
                    text = repr(plain[name])
                    known = self._read.get(name)
                    same = known is not None and known[0] == text
                    parts[name] = known if known is not None and same else (text, read_part(GesturePlan, name, lined))
            blocks, texts = self._read_blocks(lined)
        except RecursionError:
            raise InputError(source, "is nested too deeply", "write it as the schema says") from None
        plan = GesturePlan(**{name: value for name, (_, value) in parts.items()}, blocks=blocks, source=lined)
        check_plan(plan)
        self._read, self._blocks = parts, dict(zip(texts, blocks, strict=True))
        return plan

    def _read_blocks(self, lined: LinedJson) -> tuple[tuple[Block, ...], list[str]]:
        """The blocks, and the text of each."""
        known, blocks, texts = self._blocks, [], []
        for at, row in enumerate(lined.value[_BLOCKS]):
            text = repr(row)
            texts.append(text)
            blocks.append(known[text] if text in known else read_as(Block, lined, (_BLOCKS, at)))
        return tuple(blocks), texts

    def plain(self, plan: GesturePlan) -> dict[str, Any]:
        """`GesturePlan.to_dict`, in values that belong to the caller alone."""
        known, written, texts = self._written, {}, []
        parts = [(name, value) for name, value in written_parts(plan) if name != _BLOCKS]
        # Blocks are parts of their number: an edit changes one of them.
        for value in (*(value for _, value in parts), *plan.blocks):
            place = id(value)
            again = place in known and not isinstance(value, dict)  # a dict may have changed since
            written[place] = known[place] if again else (value, json.dumps(to_plain(value)))
            texts.append(written[place][1])
        self._written = written
        members = [f'"{name}": {text}' for (name, _), text in zip(parts, texts, strict=False)]
        plain = json.loads("{" + ", ".join([*members, f'"{_BLOCKS}": [' + ", ".join(texts[len(parts):]) + "]"]) + "}")
        return {name: plain[name] for name in part_names(GesturePlan)[0] if name in plain}
