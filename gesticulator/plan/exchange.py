"""Fast exchange of plans with a page: parts that did not change since the last edit are not read or written again.

A page sends the whole plan after each edit, and the plan of an hour has ten thousand blocks. `PlanExchange` remembers
the parts of the last plan that it read and of the last one that it wrote. It recognises a part by its `repr`, which
distinguishes 1, 1.0 and true as JSON does.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from data_module.errors import InputError
from gesticulator.plan.checks import check_plan
from gesticulator.plan.json_lines import LinedJson, with_lines
from gesticulator.plan.plan import Block, GesturePlan
from gesticulator.plan.plan_file import upgraded
from gesticulator.plan.schema import part_names, read_as, read_part, to_plain, written_parts

_BLOCKS = "blocks"


class PlanExchange:
    """Reads and writes the plans of one page. Memory is that of two plans. Not thread-safe."""

    def __init__(self, frozen: bool = False) -> None:
        """frozen: the values that are read are never modified, so that the same object is the same block."""
        self._frozen = frozen
        self._rows: dict[int, tuple[Any, str, Block]] = {}  # id of a block's values -> them, their text, the block
        self._read: dict[str, tuple[str, Any]] = {}  # member -> (its text, its value in the plan)
        self._blocks: dict[str, Block] = {}  # text of a block -> the block
        self._written: dict[int, tuple[Any, str]] = {}  # id of a part -> (the part, its JSON)

    def read(self, plain: dict[str, Any], source: str = "plan") -> GesturePlan:
        """The plan of plain values, as from `parse_plan`. Parts that are equal to those of the last plan are the same
        objects. `InputError` with the line that the value has in the plan's JSON with an indent of 1."""
        lined = upgraded(with_lines(plain, source))
        plain = lined.value
        names, needed = part_names(GesturePlan)
        if not set(needed) <= set(plain) <= set(names) or not isinstance(plain[_BLOCKS], list):
            read_as(GesturePlan, lined)  # raises the error
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
        known, rows = self._blocks, dict[int, tuple[Any, str, Block]]()
        found: list[tuple[Any, str, Block]] = []
        for at, row in enumerate(lined.value[_BLOCKS]):
            entry = self._rows.get(id(row))
            if entry is None:
                text = repr(row)
                entry = row, text, known[text] if text in known else read_as(Block, lined, (_BLOCKS, at))
            found.append(entry)
            rows[id(row)] = entry
        if self._frozen:
            self._rows = rows
        return tuple([block for _, _, block in found]), [text for _, text, _ in found]

    def know(self, plain: Mapping[str, Any], plan: GesturePlan) -> None:
        """Take note of the plain values of a plan, so that its blocks need not be read; only where values are
        `frozen`."""
        for row, block in zip(plain[_BLOCKS], plan.blocks, strict=True):
            if id(row) not in self._rows:
                self._rows[id(row)] = row, repr(row), block

    def plain(self, plan: GesturePlan) -> dict[str, Any]:
        """`GesturePlan.to_dict`, in new objects that the caller may modify."""
        known, written, texts = self._written, {}, []
        parts = [(name, value) for name, value in written_parts(plan) if name != _BLOCKS]
        # Each block is a part of its own, since an edit changes only a few of them.
        for value in (*(value for _, value in parts), *plan.blocks):
            key = id(value)
            unchanged = key in known and not isinstance(value, dict)  # a dict may have been modified
            written[key] = known[key] if unchanged else (value, json.dumps(to_plain(value)))
            texts.append(written[key][1])
        self._written = written
        members = [f'"{name}": {text}' for (name, _), text in zip(parts, texts, strict=False)]
        plain = json.loads("{" + ", ".join([*members, f'"{_BLOCKS}": [' + ", ".join(texts[len(parts):]) + "]"]) + "}")
        return {name: plain[name] for name in part_names(GesturePlan)[0] if name in plain}
