"""The roll of a hand, shared out to the twist bones of its forearm.

Where a palm turns over, the skin of a living forearm turns with it, more and more towards the wrist. A forearm of one
bone cannot: all of the roll is at the wrist, which looks like a wrung cloth. Rigs have bones along the forearm for
that, and here they get their share: let A be the forearm's rotation, H the hand's, and phi the part of A^-1 H, against
the pose that the mesh was bound in, that turns about the forearm. A twist bone at the share s of the way from the elbow
to the wrist turns by s phi about it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.types import Array
from gesticulator.characters.bvh_rig import turns_of
from gesticulator.characters.frames import Body
from gesticulator.characters.mapping import SIDES, ancestors
from gesticulator.characters.names import words
from gesticulator.characters.shape import bind_matrices

NAMED = {"twist", "roll"}
"""Words in the names of such bones."""
_ENDS = (0.1, 0.95)
"""Shares of the way from elbow to wrist within which a bone's place tells its share of the roll."""
_FARTHEST = 2.6
"""Radians (149 degrees) beyond which no wrist is rolled, and the way back is as near as the way there."""
_ASIDE = 0.1
"""A bone between elbow and wrist that lies off the line by more of the forearm's length is none to turn about it."""


@dataclass(frozen=True)
class TwistBone:
    """A node that turns about the forearm by `share` of the hand's roll; base: [3, 3] its axes to the forearm's."""

    node: int
    share: float
    base: Array


@dataclass(frozen=True)
class Forearm:
    """Nodes of a forearm and its hand. axis: [3] from elbow to wrist, in the forearm's axes; base: [3, 3] the hand's
    axes to the forearm's, in the pose that the mesh was bound in."""

    node: int
    hand: int
    axis: Array
    base: Array
    bones: tuple[TwistBone, ...]


def forearms(body: Body) -> list[Forearm]:
    """The forearms that have twist bones, by name, or because they lie between elbow and wrist."""
    character, joints = body.character, body.mapping.joints
    bind = bind_matrices(character)
    turns, places = turns_of(bind), bind[:, :3, 3]
    out = []
    for side in SIDES:
        node, hand = joints[side + "ForeArm"], joints[side + "Hand"]
        way = turns[node].T @ (places[hand] - places[node])
        length = float(np.linalg.norm(way))
        line = ancestors(character.parents, hand)
        line = line[:line.index(node)]
        found = []
        for one in range(len(character)):
            above = ancestors(character.parents, one)
            if node not in above or one == hand or hand in above or one in joints.values():
                continue
            own = turns[node].T @ (places[one] - places[node])
            place = float(own @ way) / length ** 2
            aside = float(np.linalg.norm(own - place * way)) / length
            if (one in line or NAMED & set(words(character.names[one]))) and aside < _ASIDE:
                found.append((place, one))
        found.sort()
        bones = tuple(TwistBone(
            one, place if _ENDS[0] < place < _ENDS[1] else (rank + 1) / (len(found) + 1), turns[node].T @ turns[one])
            for rank, (place, one) in enumerate(found))
        if bones:
            out.append(Forearm(node, hand, way / length, turns[node].T @ turns[hand], bones))
    return out


def roll(turns: dict[int, Array], forearm: Forearm) -> Array:
    """[T] radians by which the hand is rolled about its forearm, against the bind pose; each frame by itself.

    Half a turn to either side is the same: towards it the roll that is told fades, so that nothing jumps there.
    """
    apart = np.swapaxes(turns[forearm.node], -1, -2) @ turns[forearm.hand] @ forearm.base.T
    q = Rotation.from_matrix(apart).as_quat(scalar_first=True)
    angle = 2.0 * np.arctan2(q[:, 1:] @ forearm.axis, q[:, 0])
    angle = np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
    left = np.clip((np.pi - np.abs(angle)) / (np.pi - _FARTHEST), 0.0, 1.0)
    return np.where(np.abs(angle) > _FARTHEST, np.sign(angle) * left * _FARTHEST, angle)


def share_roll(turns: dict[int, Array], body: Body) -> None:
    """Add the twist bones' world rotations to `turns` (node -> [T, 3, 3]); what the hands do stays as it is."""
    for forearm in forearms(body):
        angle = roll(turns, forearm)
        for bone in forearm.bones:
            turn = Rotation.from_rotvec(bone.share * angle[:, None] * forearm.axis).as_matrix()
            turns[bone.node] = turns[forearm.node] @ turn @ bone.base
