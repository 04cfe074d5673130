"""Takes of named gestures that were drawn from scripts, as strokes of the performer.

A folder holds `takes.csv` and the clips beside it (BVH in metres, joints of the character). Unlike a stroke that was
captured, a take keeps its size and its tempo, and its phases are marked rather than measured. A performer takes them
for the gestures of which there are few captured strokes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from data_module.errors import InputError
from data_module.motion.bvh import read_bvh
from gesticulator_performer.clips import complete_rows
from gesticulator_performer.lending import lent
from gesticulator_performer.strokes import (
    PerformerBody,
    Stroke,
    held_out_keys,
    logs_against,
    mirror,
    standing_body,
)
from gesticulator_performer.types import SCRIPTED

ENOUGH = 3
"""Captured strokes of a label, mirror images apart, from which on its scripted takes are not played."""
TAKES = "takes.csv"
COLUMNS = ("file", "label", "size", "hand", "licence", "start", "stroke", "apex", "hold_end", "end")
"""file: a BVH file in the folder, metres, joints of the character; label: of the gesture ("thumbs_up"); size: of
`SIZES`; hand: "left", "right", "both" or "none"; the rest: seconds in the clip at which preparation and stroke begin,
the stroke ends, and hold and retraction end."""
SIZES: Mapping[str, float] = {"small": 0.65, "medium": 1.0, "large": 1.4}
"""The sizes of takes, as factors on the medium one."""
_ADVICE = "name a folder that does not exist, and the build draws takes into it"
_BODY = "script"
# Lent takes in memory, about 70 kB each.
_REMEMBERED = 300


@dataclass(frozen=True)
class Repertoire:
    """The takes of a folder. outlines: strokes without their motion, each with its mirror image; licences: of the
    takes, in order."""

    folder: Path
    outlines: tuple[Stroke, ...]
    licences: tuple[str, ...]
    _bodies: dict[str, PerformerBody] = field(default_factory=dict, repr=False)
    _played: dict[tuple[str, str], Stroke] = field(default_factory=dict, repr=False)

    @property
    def labels(self) -> frozenset[str]:
        """The labels of the takes and of their mirror images."""
        return frozenset(outline.meaning for outline in self.outlines)

    def usable(self, strokes: Sequence[Stroke], split: str) -> tuple[Stroke, ...]:
        """The outlines of the labels of which a performer has fewer than `ENOUGH` captured strokes (given)."""
        captured = Counter(label for label, _ in {(stroke.meaning, stroke.base) for stroke in strokes})
        return tuple(outline for outline in self.outlines if captured[outline.meaning] < ENOUGH
                     and (split == "test" or not outline.held_out))

    def played(self, outline: Stroke, body: PerformerBody) -> Stroke:
        """The stroke of an outline with its motion, on the body of a performer. InputError for a broken clip."""
        key = outline.clip, body.name
        if key not in self._played:
            while len(self._played) >= _REMEMBERED:
                del self._played[next(iter(self._played))]
            self._played[key] = self._lent(outline, body)
        return self._played[key]

    def _lent(self, outline: Stroke, body: PerformerBody) -> Stroke:
        file = self.folder / f"{outline.base.removeprefix(SCRIPTED)}.bvh"
        motion = read_bvh(file, unit=1.0)
        if _BODY not in self._bodies:
            self._bodies[_BODY] = standing_body(_BODY, [motion])
        figure = self._bodies[_BODY]
        arms = np.stack([logs_against(figure.rest, motion.rotations, joints) for joints in figure.arms])
        trunk = logs_against(figure.rest, motion.rotations, figure.trunk)
        stroke = replace(outline, clip=outline.base, fps=motion.fps, arms=arms, trunk=trunk)
        if outline.clip != outline.base:
            stroke = replace(mirror(stroke), lexeme=outline.lexeme, hand=outline.hand, meaning=outline.meaning)
        return lent(stroke, figure, body, trunk=True)


def read_repertoire(folder: str | Path) -> Repertoire:
    """The takes of a folder; the clips are read when they are played. InputError for a missing folder."""
    folder = Path(folder)
    if not (folder / TAKES).is_file():
        raise InputError(folder, f"holds no {TAKES}", _ADVICE)
    rows = complete_rows(folder / TAKES, frozenset(COLUMNS))
    outlines = [_outline(row) for row in rows]
    held_out = held_out_keys((_BODY, outline.base) for outline in outlines)
    free = {outline.meaning for outline in outlines if (_BODY, outline.base) not in held_out}
    whole: list[Stroke] = []
    for outline in outlines:
        kept = (_BODY, outline.base) in held_out and outline.meaning in free
        other = mirror(replace(outline, held_out=kept))
        whole += [replace(outline, held_out=kept), replace(other, lexeme=other.meaning)]
    return Repertoire(folder, tuple(whole), tuple(dict.fromkeys(row["licence"] for row in rows)))


def _outline(row: Mapping[str, str]) -> Stroke:
    """A row of the table as a stroke without motion."""
    start, apex, hold_end, end = (float(row[phase]) for phase in ("start", "apex", "hold_end", "end"))
    base = SCRIPTED + row["file"].removesuffix(".bvh")
    none = np.zeros((2, 0, 0, 3)), np.zeros((0, 0, 3))
    return Stroke(base, base, _BODY, row["label"], row["hand"], 0.0, *none, start, apex, hold_end, end, steady=True,
                  meaning=row["label"], faithful=True, size=SIZES[row["size"]])
