"""Arms and legs of two bones that bend to reach a place, for all frames at once; poses of the default skeleton."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_module.motion import rotation
from data_module.motion.kinematics import with_ancestors
from data_module.types import Array, Motion, Skeleton

SOFT = 0.05
"""Metres before and after the surface over which a hand is slowed; one at rest on the trunk, at 12 mm, moves by 7."""
LEAST = 1e-6
"""Metres below which a hand is not moved."""
POLE_OF_ELBOW = np.array([0.0, -1.0, -0.5])
"""Direction to which the elbow of a straight arm bends."""
MARGIN = 0.03
"""Metres from the trunk beyond which a hand is not corrected, for an adult."""
OURS = (0.145, 0.115)
"""Half the width and half the depth of the default character's trunk, metres: a slim adult."""
FINGERTIPS = ("HandThumb3", "HandIndex3", "HandMiddle3", "HandRing3", "HandPinky3")
"""Joints of a hand that are kept out of thighs with its wrist and knuckles."""
_STRETCHED = 0.9995
"""Largest share of a limb's length used: a fully stretched knee jumps."""


@dataclass(frozen=True)
class Pose:
    """The joints of the default skeleton: joint -> [T, 3, 3] world rotations and [T, 3] positions, metres."""

    turns: Mapping[str, Array]
    places: Mapping[str, Array]

    def at(self, frames: NDArray[np.bool_] | NDArray[np.intp]) -> Pose:
        """The pose at some of its frames."""
        return Pose({joint: turn[frames] for joint, turn in self.turns.items()},
                    {joint: place[frames] for joint, place in self.places.items()})


def pose_of(motion: Motion, names: Sequence[str] | None = None) -> Pose:
    """World rotations and positions of a motion's joints; of these and those above them, if names are given."""
    return posed(motion.skeleton, motion.rotations, names, motion.root_positions)


def posed(skeleton: Skeleton, rotations: Array, names: Sequence[str] | None = None, root: Array | None = None) -> Pose:
    """As `pose_of` for local rotations [T, J, 4]; root: [T, 3] its places, by default the origin."""
    # Fewer joints cost less: a stream asks for a dozen of 54 in every block.
    joints: Sequence[int] = range(len(skeleton))
    if names is not None:
        joints = with_ancestors(skeleton.parents, tuple(map(skeleton.index, names)))
    local = rotation.to_matrix(rotations[:, joints])
    turns, places = {}, {}
    for place, joint in enumerate(joints):
        name, parent = skeleton.names[joint], skeleton.parents[joint]
        if parent < 0:
            turns[name], places[name] = local[:, place], np.zeros((len(rotations), 3)) if root is None else root
        else:
            above = skeleton.names[parent]
            turns[name] = turns[above] @ local[:, place]
            places[name] = places[above] + turns[above] @ skeleton.offsets[joint]
    return Pose(turns, places)


@dataclass(frozen=True)
class TrunkAxes:
    """The line from hips to neck over T frames: axes [T, 3, 3], rows left, up and ahead; length [T], metres."""

    axes: Array
    length: Array

    def local(self, points: Array) -> Array:
        """[3, T] metres left, up and ahead of the hips of points [T, 3] relative to the hips."""
        return np.einsum("tij,tj->it", self.axes, points)


def trunk_axes(neck: Array, chest: Array) -> TrunkAxes:
    """neck: [T, 3] relative to the hips; chest: [T, 3, 3] the character's axes there (columns left, up, ahead)."""
    far = np.maximum(length(neck), 1e-9)
    up = neck / far
    # Gram-Schmidt: up is kept exactly, left as far as it is level.
    left = chest[..., 0] - dot(chest[..., 0], up) * up
    left = left / np.maximum(length(left), 1e-9)
    return TrunkAxes(np.stack([left, up, rotation.cross(left, up)], axis=-2), far[..., 0])


CAP, RECEDES = 0.20, 0.5
"""Metres above the neck and below the hips over which the surface of a trunk recedes, and by how many."""


def receding(along: Array, low: Array | float, high: Array, size: Array | float = 1.0) -> Array:
    """Metres by which the surface of a trunk that reaches from `low` to `high` recedes at metres `along` it. size:
    relative to the default character's."""
    return np.asarray(size * RECEDES * (np.maximum(np.maximum(low - along, along - high), 0.0) / (CAP * size)) ** 2)


class Limbs(Protocol):
    """A body that computes the positions of its nodes."""

    def place(self, turns: Mapping[int, Array], node: int) -> Array:
        """[T, 3] position of a node relative to the hips, metres; turns: node -> [T, 3, 3] its axes to ours."""


def bend(turns: dict[int, Array], body: Limbs, chain: tuple[int, int, int], goal: Array, pole: Array,
         where: NDArray[np.bool_] | None = None) -> None:
    """Rotate the first two nodes of a chain so that the third reaches `goal` [T, 3].

    The middle joint stays in the plane in which it bends; that of a straight limb bends towards `pole` [3]. Positions
    are relative to the hips; the third node keeps its world rotation if it is in `turns`. where: [T] the frames to
    change; default all.
    """
    top, middle, _ = chain
    socket, hinge, tip = (body.place(turns, node) for node in chain)
    upper, lower = hinge - socket, tip - hinge
    for node, before, after in zip((top, middle), (upper, lower), bent(upper, lower, goal - socket, pole), strict=True):
        turned = swing(before, after) @ turns[node]
        turns[node] = turned if where is None else np.where(where[:, None, None], turned, turns[node])


def bent(upper: Array, lower: Array, way: Array, pole: Array) -> tuple[Array, Array]:
    """The two bones [T, 3] of a limb that reaches `way` [T, 3] from its first joint; see `bend`."""
    first, second, far = length(upper), length(lower), length(way)
    along = way / np.maximum(far, 1e-9)
    # A place out of reach is approached as far as the bones allow.
    far = np.clip(far, np.abs(first - second) / _STRETCHED + 1e-9, _STRETCHED * (first + second))
    # Law of cosines: the middle joint's distance along the direction to the goal, and beside it.
    share = (first ** 2 + far ** 2 - second ** 2) / (2.0 * far)
    beside = np.sqrt(np.maximum(first ** 2 - share ** 2, 0.0))
    out = upper - dot(upper, along) * along
    # A straight limb has no plane of its own to bend in.
    straight = length(out) < 1e-4 * first
    out = np.where(straight, pole - (along @ pole)[:, None] * along, out)
    new_upper = share * along + beside * (out / np.maximum(length(out), 1e-9))
    return new_upper, far * along - new_upper


def swivelled(upper: Array, lower: Array, shift: Array) -> Array:
    """[T, 3] the first bone of a limb of two bones [T, 3] whose middle joint moves by about `shift` [T, 3], as far as
    the places of its ends let it.

    One that is opposite to where it should go could leave to either side. It is moved the less, the nearer it is to
    there: at an angle a from that direction, by cos(a / 2) of the shift, so that no small difference grows to a jump.
    """
    way = upper + lower
    along = way / np.maximum(length(way), 1e-9)
    centre = dot(upper, along) * along
    beside = upper - centre
    size = length(beside)
    # The middle joint moves on a circle about the line between the others.
    shift = shift - dot(shift, along) * along
    cosine = dot(shift, beside) / np.maximum(length(shift) * size, 1e-9)
    moved = beside + shift * np.sqrt(np.maximum(1.0 + cosine, 0.0) / 2.0)
    far = length(moved)
    return centre + np.where(far > 1e-6, moved / np.maximum(far, 1e-9) * size, beside)


def dot(a: Array, b: Array) -> Array:
    """[..., 1] inner products of vectors [..., 3]; the sum of the products takes three times as long for few of them.
    """
    return np.asarray(np.vecdot(a, b))[..., None]


def lengths(vectors: Array) -> Array:
    """[...] lengths of vectors [..., 3]; `numpy.linalg.norm` takes twice as long for few of them."""
    return np.asarray(np.sqrt(np.vecdot(vectors, vectors)))


def length(vectors: Array) -> Array:
    """[..., 1] lengths of vectors [..., 3]."""
    return lengths(vectors)[..., None]


def swing(a: Array, b: Array) -> Array:
    """[T, 3, 3] the shortest rotations from directions a [T, 3] to b."""
    return rotation.to_matrix(rotation.between(a, b))


class BelowShoulder:
    """The default skeleton as `Limbs`, under a shoulder that stays where it is; its nodes are its joints."""

    def __init__(self, skeleton: Skeleton, shoulder: int, place: Array) -> None:
        self.skeleton = skeleton
        self._shoulder = {shoulder: place}

    def place(self, turns: Mapping[int, Array], node: int) -> Array:
        """[T, 3] position of a joint relative to the hips, metres; turns: joint -> [T, 3, 3] its world rotation."""
        if node in self._shoulder:
            return self._shoulder[node]
        above = self.skeleton.parents[node]
        return self.place(turns, above) + turns[above] @ self.skeleton.offsets[node]


def write_turns(rotations: Array, skeleton: Skeleton, turns: Mapping[int, Array], joints: Sequence[int],
                at: NDArray[np.int64]) -> None:
    """Write world rotations of some joints, each above the next, into `rotations` [T, J, 4] at the frames `at`."""
    above = np.array([turns[skeleton.parents[joint]] for joint in joints])
    local = np.swapaxes(above, -1, -2) @ np.array([turns[joint] for joint in joints])
    new = rotation.from_matrix(local)
    where = at, np.array(joints)[:, None]
    old = rotations[where]
    # Of the two quaternions of a rotation the one on the side of the frame as it was, so that none turns round.
    rotations[where] = np.where(dot(new, old) < 0.0, -new, new)


def combined(moves: Array) -> Array:
    """[..., T, 3] the displacement of a hand, of those of its P points: larger ones count more, none takes over."""
    # Weights that vanish with their displacement: a point that just touches changes nothing.
    weights = dot(moves, moves)
    return np.asarray((weights * moves).sum(axis=-3) / np.maximum(weights.sum(axis=-3), 1e-12))


def soft(depth: Array, over: Array | float = SOFT) -> Array:
    """max(depth, 0) without a kink, metres. over: metres on both sides in which it is rounded."""
    eased = np.minimum(np.maximum(depth + over, 0.0), 2.0 * over)
    return np.where(depth > over, depth, eased * eased / (4.0 * over))
