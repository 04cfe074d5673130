"""A stroke on another person's body, and strokes of a person who is no performer, lent to every performer.

Skeletons of different makers differ in the pose that identity rotations mean: some hold the arms level, some half down.
A bone of the borrower is turned so that it points where the lender's does. With B the rotation of the bind pose of a
joint from borrower to lender and p its parent, the local rotation q becomes B_p^-1 q B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.types import Array, Skeleton
from gesticulator_performer.strokes import SIDES, PerformerBody, Stroke, StrokeSet, held_out_keys, speaker_strokes
from gesticulator_performer.tables import read_clips, table

_NONE = np.array([1.0, 0.0, 0.0, 0.0])
LENDER = "pn"
_LEXEMES = table("clips.toml")["borrowed"]


def lent(stroke: Stroke, lender: PerformerBody, borrower: PerformerBody, head: bool = False, trunk: bool = False
         ) -> Stroke:
    """The stroke of a lender for a borrower: the arms' joints of the same name point where the lender's do. Joints that
    the lender lacks and the trunk stay at rest; with `head` the neck and the head move as the lender's, with `trunk`
    the spine, too."""
    arms = np.stack([_arm(stroke.arms[side], side, lender, borrower) for side in (0, 1)])
    turns = np.zeros((stroke.trunk.shape[0], len(borrower.trunk), 3))
    theirs = [lender.skeleton.names[j] for j in lender.trunk]
    for place, joint in enumerate(borrower.trunk):
        name = borrower.skeleton.names[joint]
        if name in theirs and (trunk or (head and name.startswith(("Neck", "Head")))):
            turns[:, place] = stroke.trunk[:, theirs.index(name)]
    return replace(stroke, speaker=borrower.name, arms=arms, trunk=turns, _splines={})


def _arm(logs: Array, side: int, lender: PerformerBody, borrower: PerformerBody) -> Array:
    """Log rotations [T, A, 3] against the borrower's rest from the lender's [T, B, 3] against theirs."""
    theirs = [lender.skeleton.names[j] for j in lender.arms[side]]
    joints = [j for j in borrower.arms[side] if borrower.skeleton.names[j] in theirs]
    of = [theirs.index(borrower.skeleton.names[j]) for j in joints]
    binds = bind_differences(lender.skeleton, borrower.skeleton, SIDES[side])
    own = np.stack([binds.get(j, _NONE) for j in joints])
    parents = np.stack([binds.get(borrower.skeleton.parents[j], _NONE) for j in joints])
    before = rotation.multiply(rotation.conjugate(borrower.rest[joints]), rotation.conjugate(parents))
    before = rotation.multiply(before, lender.rest[[lender.arms[side][k] for k in of]])
    local = rotation.multiply(rotation.multiply(before[None], rotation.from_exponential_map(logs[:, of])), own[None])
    out = np.zeros((len(logs), len(borrower.arms[side]), 3))
    out[:, [borrower.arms[side].index(j) for j in joints]] = rotation.unroll(rotation.to_exponential_map(local))
    return out


def bind_differences(lender: Skeleton, borrower: Skeleton, side: str) -> dict[int, Array]:
    """Joint of the borrower -> quaternion that turns its bone in the bind pose to the lender's, for one arm. The hand's
    holds for its fingers; a clavicle and joints without the needed children have none."""
    there = {side + name for name in ("Arm", "ForeArm", "Hand", "HandMiddle1", "HandIndex1")}
    there &= set(lender.names) & set(borrower.names)
    out: dict[int, Array] = {}
    for name, end in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("Hand", "HandMiddle1")):
        if side + end in there:
            ours, theirs = (skeleton.offsets[skeleton.index(side + end)] for skeleton in (borrower, lender))
            out[borrower.index(side + name)] = rotation.between(ours, theirs)
    if {f"{side}HandMiddle1", f"{side}HandIndex1"} <= there:
        out |= dict.fromkeys([j for j, name in enumerate(borrower.names) if name.startswith(f"{side}Hand")],
                             _hand(lender, borrower, side, out[borrower.index(f"{side}Hand")]))
    return out


def _hand(lender: Skeleton, borrower: Skeleton, side: str, turn: Array) -> Array:
    """`turn` of the middle finger, and then about it, so that the index fingers are on the same side of it."""
    axis = lender.offsets[lender.index(f"{side}HandMiddle1")]
    axis = axis / np.linalg.norm(axis)
    ours = rotation.rotate(turn, borrower.offsets[borrower.index(f"{side}HandIndex1")])
    theirs = lender.offsets[lender.index(f"{side}HandIndex1")]
    across = [vector - float(vector @ axis) * axis for vector in (ours, theirs)]
    return rotation.multiply(rotation.between(*across), turn)


def lexemes_of_clip(stem: str) -> tuple[str, ...]:
    """Lexemes of a clip by its file's stem ("pn_bigger_intense2"); () for one that is no stroke ("pn_idle")."""
    return tuple(_LEXEMES.get(stem.removeprefix(LENDER + "_").rstrip("0123456789").removesuffix("_intense"), ()))


def load_borrowed(folder: str | Path) -> tuple[PerformerBody, tuple[Stroke, ...]]:
    rows = [row for row in read_clips(folder, {"file", "person", "emphasis"}) if row["person"] == LENDER]
    chosen = [{"file": row["file"], "speaker": LENDER, "posture": "", "hand": "", "emphasis": row["emphasis"] or "1.0",
               "lexeme": lexemes_of_clip(Path(row["file"]).stem)[0]}
              for row in rows if lexemes_of_clip(Path(row["file"]).stem)]
    if not chosen:
        raise InputError(Path(folder) / "manifest.csv", f"names no stroke of {LENDER}",
                         "take the manifest that came with the clips")
    figure, strokes = speaker_strokes(Path(folder), LENDER, chosen)
    held_out = held_out_keys((LENDER, stroke.base) for stroke in strokes)
    return figure, tuple(replace(stroke, held_out=(LENDER, stroke.base) in held_out) for stroke in strokes)


def with_borrowed(strokes: StrokeSet, lender: PerformerBody, borrowed: Sequence[Stroke]) -> StrokeSet:
    """Add a lender's strokes for every performer, as `lent`. A lexeme takes the first of its names that the
    performer knows."""
    out = list(strokes.strokes)
    for performer in strokes.performers:
        known = {stroke.lexeme for stroke in strokes.of(performer, "test")}
        for stroke in borrowed:
            # A mirror image has its own lexeme already ("YouLeft" becomes "YouRight").
            wanted = [stroke.lexeme, *lexemes_of_clip(stroke.base)[1:]]
            usual = "BeatMid" if "BeatMid" in known else stroke.lexeme
            lexeme = next((name for name in wanted if name in known), usual)
            out.append(replace(lent(stroke, lender, strokes.figures[performer]), lexeme=lexeme))
    return StrokeSet(tuple(out), strokes.figures)
