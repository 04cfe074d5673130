"""Takes of named gestures: drawn from scripts into a folder, and read from it as strokes of the performer.

Every gesture of the repertoire that does not offend is drawn in three sizes, several times each. No two takes are the
same, since place, direction, size and timing vary with the seed. The performer adds the mirror images. The folder holds
`takes.csv` and the clips beside it (BVH in metres, joints of the character). Unlike a stroke that was captured, a take
keeps its size and its tempo, and its phases are marked rather than measured. A performer takes them for the gestures of
which there are few captured strokes.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_module.files import lock, new_folder, write_text
from data_module.motion import rotation
from data_module.motion.bvh import write_bvh
from data_module.motion.skeletons import FINGERED
from data_module.types import Motion
from gesticulator.directing.named_gestures import GestureDraw, drawn_gesture, laid_over
from gesticulator.plan.gestures import REPERTOIRE, NamedGesture
from gesticulator.plan.plan import GestureCue
from gesticulator_performer import strokes as performed
from gesticulator_performer.strokes import SCRIPT_BODY, SCRIPTED, Repertoire, Stroke, mirror
from gesticulator_performer.tables import complete_rows

TAKES = "takes.csv"
COLUMNS = ("file", "label", "size", "hand", "licence", "start", "stroke", "apex", "hold_end", "end")
"""file: a BVH file in the folder, metres, joints of the character; label: of the gesture ("thumbs_up"); size: of
`SIZES`; hand: "left", "right", "both" or "none"; the rest: seconds in the clip at which preparation and stroke begin,
the stroke ends, and hold and retraction end."""
SIZES: Mapping[str, float] = {"small": 0.65, "medium": 1.0, "large": 1.4}
"""The sizes of takes, as factors on the medium one."""
LICENCE = "GPL-3.0-or-later (scripts of gesticulator)"
"""The licence of the takes, as a corpus records it."""
CORE_VARIATIONS, VARIATIONS = 4, 2
"""Takes of a core gesture and of another one, in each size."""
_FPS = 30.0
# Seconds before and after the gesture, in which the arms hang.
_AROUND = 0.2
# Height of the hips, metres, so that a viewer shows the figure above the floor.
_HIPS = 1.0
# Radians from a level arm to a hanging one.
_ARMS_DOWN = 1.3


def read_repertoire(folder: str | Path) -> Repertoire:
    """The takes of a folder; the clips are read when they are played. InputError for a missing folder."""
    folder = Path(folder)
    rows = complete_rows(folder / TAKES, frozenset(COLUMNS))
    outlines = [_outline(row) for row in rows]
    held_out = performed.held_out_keys((SCRIPT_BODY, outline.base) for outline in outlines)
    free = {outline.meaning for outline in outlines if (SCRIPT_BODY, outline.base) not in held_out}
    whole: list[Stroke] = []
    for outline in outlines:
        kept = (SCRIPT_BODY, outline.base) in held_out and outline.meaning in free
        other = mirror(replace(outline, held_out=kept))
        whole += [replace(outline, held_out=kept), replace(other, lexeme=other.meaning)]
    return Repertoire(folder, tuple(whole), tuple(dict.fromkeys(row["licence"] for row in rows)))


def _outline(row: Mapping[str, str]) -> Stroke:
    """A row of the table as a stroke without motion."""
    start, apex, hold_end, end = (float(row[phase]) for phase in ("start", "apex", "hold_end", "end"))
    base = SCRIPTED + row["file"].removesuffix(".bvh")
    none = np.zeros((2, 0, 0, 3)), np.zeros((0, 0, 3))
    return Stroke(base, base, SCRIPT_BODY, row["label"], row["hand"], 0.0, *none, start, apex, hold_end, end,
                  steady=True, meaning=row["label"], faithful=True, size=SIZES[row["size"]])


def write_takes(out: Path, seed: int = 1, names: Collection[str] = REPERTOIRE) -> int:
    """Write OUT/LABEL_SIZE_NUMBER.bvh (metres) and OUT/takes.csv, whole or not at all; the number of takes. The same
    seed gives the same bytes. names: of the gestures; those that offend are left out. InputError if OUT exists and is
    not empty."""
    with lock(out, "a drawing of takes", beside=True), new_folder(out) as partial:
        rows = [row for gesture in REPERTOIRE.values() if gesture.name in names and not gesture.offensive
                for row in _drawn(gesture, partial, seed)]
        table = io.StringIO()
        writer = csv.DictWriter(table, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(partial / TAKES, table.getvalue())
    return len(rows)


def _drawn(gesture: NamedGesture, folder: Path, seed: int) -> Iterator[dict[str, object]]:
    """Write the takes of a gesture; their rows of the table."""
    label = gesture.name.replace(" ", "_")
    for size, intensity in SIZES.items():
        for number in range(CORE_VARIATIONS if gesture.core else VARIATIONS):
            # The time of the cue varies the draw; it tells the takes of a gesture apart.
            cue, at = GestureCue(gesture.name, time=0.0, intensity=intensity), float(number + 1)
            draw = drawn_gesture(cue, at, seed)
            motion, begin = _take(cue, at, draw, seed)
            name = f"{label}_{size}_{number + 1}.bvh"
            write_bvh(folder / name, motion, 1.0)
            yield {"file": name, "label": label, "size": size, "hand": _hand(draw), "licence": LICENCE,
                   **_marks(draw, at - begin)}


def _take(cue: GestureCue, at: float, draw: GestureDraw, seed: int) -> tuple[Motion, float]:
    """The motion of a draw, from arms that hang and back, and the second at which it begins."""
    begin = at - draw.phases.before - _AROUND
    frames = round((draw.phases.before + draw.phases.after + 2.0 * _AROUND) * _FPS) + 1
    times = begin + np.arange(frames) / _FPS
    hanging = np.zeros((frames, len(FINGERED), 3))
    hanging[:, FINGERED.index("LeftArm"), 2], hanging[:, FINGERED.index("RightArm"), 2] = -_ARMS_DOWN, _ARMS_DOWN
    poses = laid_over(hanging.reshape(frames, -1), times, [(cue, at)], seed)
    turns = rotation.from_exponential_map(poses.reshape(frames, -1, 3))
    root = np.repeat([[0.0, _HIPS, 0.0]], frames, axis=0)
    return Motion(FINGERED, turns, root, _FPS), begin


def _hand(draw: GestureDraw) -> str:
    """Which hands act: "left", "right", "both" or, if head and trunk alone move, "none"."""
    script = draw.script
    if script.main is None:
        return "none"
    return "both" if script.other is not None else script.side.lower()


def _marks(draw: GestureDraw, apex: float) -> dict[str, float]:
    """Seconds in the clip: where the preparation begins, where the stroke begins, its apex, and the ends of hold and
    retraction."""
    phases = draw.phases
    marks = {"start": apex - phases.before, "stroke": apex - phases.stroke, "apex": apex,
             "hold_end": apex + phases.hold, "end": apex + phases.after}
    return {name: round(seconds, 4) for name, seconds in marks.items()}
