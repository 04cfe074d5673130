"""A stroke on another person's body.

Skeletons of different makers differ in the pose that identity rotations mean: some hold the arms level, some half down.
A bone of the borrower is turned so that it points where the lender's does. With B the rotation of the bind pose of a
joint from borrower to lender and p its parent, the local rotation q becomes B_p^-1 q B.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_module.motion import rotation
from data_module.types import Array, Skeleton
from gesticulator_performer.strokes import SIDES, PerformerBody, Stroke

_NONE = np.array([1.0, 0.0, 0.0, 0.0])


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
