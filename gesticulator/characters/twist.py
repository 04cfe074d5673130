"""Distributes the roll of a hand to the twist bones of its forearm.

When a palm turns over, the skin of a real forearm turns with it, increasingly towards the wrist. A forearm of one bone
concentrates all roll at the wrist, which looks like a wrung cloth. Twist bones along the forearm take their share: let
A be the forearm's rotation, H the hand's, and phi the part of A^-1 H, relative to the bind pose, that turns about the
forearm. A twist bone at share s of the distance from elbow to wrist turns by s phi about the forearm.
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
"""Words in the names of twist bones."""
_ENDS = (0.1, 0.95)
"""Range of positions from elbow to wrist within which a bone's position is its share of the roll."""
_FARTHEST = 2.6
"""Radians (149 degrees) beyond which the roll fades to zero: no wrist rolls farther, and its sign becomes ambiguous."""
_ASIDE = 0.1
"""Largest distance of a twist bone from the line between elbow and wrist, as a share of the forearm's length."""


@dataclass(frozen=True)
class TwistBone:
    """A node that takes `share` of the hand's roll about the forearm; base: [3, 3] its axes to the forearm's."""

    node: int
    share: float
    base: Array


@dataclass(frozen=True)
class Forearm:
    """Nodes of a forearm and its hand. axis: [3] from elbow to wrist, in the forearm's axes; base: [3, 3] the hand's
    axes to the forearm's, in the bind pose of the mesh."""

    node: int
    hand: int
    axis: Array
    base: Array
    bones: tuple[TwistBone, ...]


def forearms(body: Body) -> list[Forearm]:
    """The forearms with twist bones, identified by name or by lying between elbow and wrist."""
    character, joints = body.character, body.mapping.joints
    bind = bind_matrices(character)
    turns, places = turns_of(bind), bind[:, :3, 3]
    out = []
    for side in SIDES:
        node, hand = joints[side + "ForeArm"], joints[side + "Hand"]
        way = turns[node].T @ (places[hand] - places[node])
        length = float(np.linalg.norm(way))
        # The nodes strictly between forearm and hand.
        line = ancestors(character.parents, hand)
        line = line[:line.index(node)]
        twists = []
        for candidate in range(len(character)):
            above = ancestors(character.parents, candidate)
            if node not in above or candidate == hand or hand in above or candidate in joints.values():
                continue
            offset = turns[node].T @ (places[candidate] - places[node])
            place = float(offset @ way) / length ** 2
            aside = float(np.linalg.norm(offset - place * way)) / length
            if (candidate in line or NAMED & set(words(character.names[candidate]))) and aside < _ASIDE:
                twists.append((place, candidate))
        twists.sort()
        bones = tuple(TwistBone(
            candidate, place if _ENDS[0] < place < _ENDS[1] else (rank + 1) / (len(twists) + 1),
            turns[node].T @ turns[candidate]) for rank, (place, candidate) in enumerate(twists))
        if bones:
            out.append(Forearm(node, hand, way / length, turns[node].T @ turns[hand], bones))
    return out


def roll(turns: dict[int, Array], forearm: Forearm) -> Array:
    """[T] roll of the hand about its forearm relative to the bind pose, radians; each frame independently.

    Half a turn to either side is the same pose: the roll fades towards it, so that it is continuous there.
    """
    apart = np.swapaxes(turns[forearm.node], -1, -2) @ turns[forearm.hand] @ forearm.base.T
    q = Rotation.from_matrix(apart).as_quat(scalar_first=True)
    # The twist of a swing-twist decomposition: the part of the quaternion along the axis.
    angle = 2.0 * np.arctan2(q[:, 1:] @ forearm.axis, q[:, 0])
    angle = np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
    left = np.clip((np.pi - np.abs(angle)) / (np.pi - _FARTHEST), 0.0, 1.0)
    return np.where(np.abs(angle) > _FARTHEST, np.sign(angle) * left * _FARTHEST, angle)


def share_roll(turns: dict[int, Array], body: Body) -> None:
    """Add the twist bones' world rotations to `turns` (node -> [T, 3, 3]); the hands are unchanged."""
    for forearm in forearms(body):
        angle = roll(turns, forearm)
        for bone in forearm.bones:
            turn = Rotation.from_rotvec(bone.share * angle[:, None] * forearm.axis).as_matrix()
            turns[bone.node] = turns[forearm.node] @ turn @ bone.base
