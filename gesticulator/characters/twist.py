"""Distributes the roll of a hand to the twist bones of its forearm.

When a palm turns over, the skin of a real forearm turns with it, increasingly towards the wrist. A forearm of one bone
concentrates all roll at the wrist, which looks like a wrung cloth. Twist bones along the forearm take their share: let
A be the forearm's rotation, H the hand's, and phi the part of A^-1 H, relative to the bind pose, that turns about the
forearm. A twist bone at share s of the distance from elbow to wrist turns by s phi about the forearm.
"""

import numpy as np

from data_module.motion import rotation
from data_module.types import Array
from gesticulator.characters.frames import Body
from gesticulator.characters.mapping import SIDES, ancestors
from gesticulator.characters.names import words
from gesticulator.characters.shape import bind_matrices, bind_turns

_ENDS = (0.1, 0.95)
"""Range of positions from elbow to wrist within which a bone's position is its share of the roll."""
_FARTHEST = 2.6
"""Radians (149 degrees) beyond which the roll fades to zero: no wrist rolls farther, and its sign becomes ambiguous."""
_ASIDE = 0.1
"""Largest distance of a twist bone from the line between elbow and wrist, as a share of the forearm's length."""


def share_roll(turns: dict[int, Array], body: Body) -> None:
    """Add the twist bones' world rotations to `turns` (node -> [T, 3, 3]); the hands are unchanged."""
    bound, places = bind_turns(body.character), bind_matrices(body.character)[:, :3, 3]
    for side in SIDES:
        forearm, hand = body.mapping.joints[side + "ForeArm"], body.mapping.joints[side + "Hand"]
        # Places from elbow to wrist in the axes of the forearm, in the bind pose of the mesh.
        offsets = (places - places[forearm]) @ bound[forearm]
        bones = _twist_bones(body, forearm, hand, offsets)
        if not bones:
            continue
        axis = offsets[hand] / float(np.linalg.norm(offsets[hand]))
        apart = np.swapaxes(turns[forearm], -1, -2) @ turns[hand] @ (bound[forearm].T @ bound[hand]).T
        angle = _roll(apart, axis)
        for node, share in bones:
            turn = rotation.to_matrix(rotation.from_exponential_map(share * angle[:, None] * axis))
            turns[node] = turns[forearm] @ turn @ (bound[forearm].T @ bound[node])


def _twist_bones(body: Body, forearm: int, hand: int, offsets: Array) -> list[tuple[int, float]]:
    """The nodes that take a share of the hand's roll, and their shares: identified by name or by lying between elbow
    and wrist. offsets: [N, 3] from the elbow, in the forearm's axes."""
    character, way = body.character, offsets[hand]
    length, line = float(np.linalg.norm(way)), ancestors(character.parents, hand)
    along = offsets @ way / length ** 2
    aside = np.linalg.norm(offsets - along[:, None] * way, axis=1) / length
    under = character.under([forearm], body.mapping.joints.values()) & (aside < _ASIDE)
    twists = sorted((float(along[node]), int(node)) for node in np.flatnonzero(under) if node != forearm
                    and (node in line or {"twist", "roll"} & set(words(character.names[node]))))
    # Several bones at one end are taken to be evenly along the forearm.
    return [(node, place if _ENDS[0] < place < _ENDS[1] else (rank + 1) / (len(twists) + 1))
            for rank, (place, node) in enumerate(twists)]


def _roll(apart: Array, axis: Array) -> Array:
    """[T] the part of rotations [T, 3, 3] that turns about an axis [3], radians; each frame independently.

    Half a turn to either side is the same pose: the roll fades towards it, so that it is continuous there.
    """
    q = rotation.from_matrix(apart)
    # The twist of a swing-twist decomposition: the part of the quaternion along the axis.
    angle = 2.0 * np.arctan2(q[:, 1:] @ axis, q[:, 0])
    angle = np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
    left = np.clip((np.pi - np.abs(angle)) / (np.pi - _FARTHEST), 0.0, 1.0)
    return np.where(np.abs(angle) > _FARTHEST, np.sign(angle) * left * _FARTHEST, angle)
