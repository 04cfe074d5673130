"""Keeps the hands of the default character above its thighs while it sits.

The models know no legs: a hand that hangs or sweeps low would pass through the thighs. A hand is lifted by bending its
arm until wrist and knuckles are on the thighs, is turned about its wrist as far as its fingertips are lower, and is
lifted by what still lacks. As with the trunk, a hand is slowed before it touches, and everything depends on the pose
alone.

Seen from a thigh, its surface is a height field: above the line from hip to knee, with s along it and w across, the
tangents of its slice of the radius r(s) at angles a (0 to the left and pi / 2 up) leave

    H(s, w) = min over a of (r(s) - w cos a) / sin a,   40 to 140 degrees,

the upper side of the slice, which falls beside it and beyond its ends with a slope of at most 1.2. A hand is moved
along the upward normal of the thigh alone: a direction out of a closed shape would turn round at its middle, and a hand
that passes through a thigh would jump. Its displacement changes at most 1.2 times as fast as the hand moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_module.motion.skeletons import SIDES, WHOLE_BODY
from data_module.types import Array, Motion
from gesticulator.contacts.limbs import (
    LEAST,
    POLE_OF_ELBOW,
    BelowShoulder,
    Pose,
    bend,
    combined,
    pose_of,
    soft,
    swivel,
    write_turns,
)

RADII = (0.076, 0.056)
"""Metres around the line from hip to knee of the default character, at its ends: as pages draw them."""
FINGERTIPS = ("HandThumb3", "HandIndex3", "HandMiddle3", "HandRing3", "HandPinky3")
"""Joints of a hand that are kept out of thighs with its wrist and knuckles."""
_LEVEL = 0.7
"""Cosine between thighs and straight down below which a body sits: 45 degrees."""
_TANGENTS = np.radians(np.arange(40.0, 150.0, 10.0))
"""Directions of tangents, of which the flattest has a slope of 1.2."""
_STEEPEST, _ROUND = 1.2, 0.05
"""Slope beyond the ends of a thigh, and metres over which it begins."""
SEAT_SPREAD = 7.0
"""Degrees by which a seated thigh points outward."""
WRIST, KNUCKLES, TIP = 0.024, 0.018, 0.009
"""Metres from the joints of a hand to its underside: half the thickness of wrist, palm and fingers."""
SOFT, TIP_SOFT = 0.03, 0.015
"""Metres above and below the thighs over which a hand is slowed, and turned."""
FARTHEST_TIP = 0.5
"""Radians by which a hand is turned at most."""
_PALM = np.array([[0.086, 0.004, 0.003], [0.17, -0.02, 0.0]])
"""Knuckles and fingertips of a left hand without fingers, metres from its wrist in a T-pose."""
_LAST_BONE = 0.022
"""Metres from the last joint of a finger to its tip."""
NATURAL, STRAIGHT = np.array([0.5, -0.5, -0.7]), 0.003
"""Direction in which the left elbow goes as far as its arm is bent more; metres beside the line from shoulder to wrist
at which an elbow is taken to be at least."""
_LIFTS = 3
"""Iterations: the thighs are of another height where the hand is moved to."""


@dataclass(frozen=True)
class Thigh:
    """A thigh over T frames: hip, knee [T, 3] or [1, 3] metres from the middle of the hips."""

    hip: Array
    knee: Array

    def depth(self, points: Array) -> tuple[Array, Array]:
        """[T] metres by which points [T, 3] are under the surface, negative above it, and [T, 3] the way up."""
        bone = self.knee - self.hip
        length = np.linalg.norm(bone, axis=-1)
        along = bone / np.maximum(length, 1e-9)[..., None]
        # Level and not the bone's own left: a thigh that rolls keeps its upper side up.
        left = np.cross([0.0, 1.0, 0.0], along)
        left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
        up = np.cross(along, left)
        across, height, far = (np.sum((points - self.hip) * axis, axis=-1) for axis in (left, up, along))
        radius = np.interp(far / np.maximum(length, 1e-9), [0.0, 1.0], RADII)
        # The height field of the module: the lowest of the tangents over this place across.
        tangents = [(radius - across * np.cos(angle)) / np.sin(angle) for angle in _TANGENTS]
        # Beyond hip and knee it falls, rounded so that a hand gliding off has no kink in its path.
        beyond = np.maximum(np.maximum(-far, far - length), 0.0)
        top = np.min(tangents, axis=0) - _STEEPEST * (np.hypot(beyond, _ROUND) - _ROUND)
        return top - height, np.broadcast_to(up, points.shape)


def kept_off_thighs(motion: Motion) -> Motion:
    """A motion on the default skeleton, seated or about to be, with its hands above its thighs."""
    pose = pose_of(replace(motion, root_positions=np.zeros((len(motion), 3))))
    thighs, rotations = _thighs(pose), None
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        hand = _Hand(pose, side, sign)
        points = hand.points(pose.places[side + "Hand"], pose.turns[side + "Hand"])
        lacks, slowed = (_push(thighs, some, hand.margins, over)
                         for some, over in ((points, TIP_SOFT), (points[:2], SOFT)))
        # The wide margin slows the whole hand; the narrow one is for fingertips, which may lie on the thigh.
        at = np.flatnonzero((np.linalg.norm(lacks, axis=-1) > LEAST) | (np.linalg.norm(slowed, axis=-1) > LEAST))
        if len(at):
            rotations = motion.rotations.copy() if rotations is None else rotations
            _lift(rotations, motion, pose, side, sign, at)
    return motion if rotations is None else replace(motion, rotations=rotations)


def is_seated(motion: Motion) -> bool:
    """True if a motion on the default skeleton has legs, and they sit."""
    if "LeftUpLeg" not in motion.skeleton.names or not len(motion):
        return False
    first = replace(motion, rotations=motion.rotations[:1], root_positions=np.zeros((1, 3)))
    ways = np.concatenate([knee - hip for hip, knee in zip(*_ends(pose_of(first)), strict=True)])
    return bool((-ways[:, 1] < _LEVEL * np.linalg.norm(ways, axis=-1)).all())


def _lift(rotations: Array, motion: Motion, pose: Pose, side: str, sign: float, at: NDArray[np.intp]) -> None:
    """Bend an arm in `rotations` [T, J, 4] at the frames `at`, where its hand is in the thighs."""
    skeleton = motion.skeleton
    pose = pose.at(at)
    turns = {skeleton.index(joint): turn for joint, turn in pose.turns.items()}
    shoulder, elbow, wrist = (skeleton.index(side + part) for part in ("Arm", "ForeArm", "Hand"))
    limbs = BelowShoulder(skeleton, shoulder, pose.places[side + "Arm"])
    thighs, hand = _thighs(pose), _Hand(pose, side, sign)

    def lift(count: int, over: float) -> None:
        place = limbs.place(turns, wrist)
        push = _push(thighs, hand.points(place, turns[wrist])[:count], hand.margins, over)
        chain, moved = (shoulder, elbow, wrist), np.linalg.norm(push, axis=-1) > LEAST
        # An arm that bends more points its elbow somewhere: out, down and back, as people who sit do.
        before = _beside(limbs, turns, chain)
        bend(turns, limbs, chain, place + push, POLE_OF_ELBOW, moved)
        after = _beside(limbs, turns, chain)
        more = np.where(moved[:, None], np.maximum(after - before, 0.0) * after / np.maximum(before, STRAIGHT), 0.0)
        swivel(turns, limbs, chain, more * (NATURAL * [sign, 1.0, 1.0]))

    for _ in range(_LIFTS):
        lift(2, SOFT)
    # Fingers first lie down along the thigh; what is still inside afterwards lifts the hand again.
    place = limbs.place(turns, wrist)
    turns[wrist] = _tipped(hand.points(place, turns[wrist]), hand.margins, thighs) @ turns[wrist]
    for _ in range(_LIFTS):
        lift(len(hand.margins), TIP_SOFT)
    write_turns(rotations, skeleton, turns, (shoulder, elbow, wrist), at)


def _beside(limbs: BelowShoulder, turns: dict[int, Array], chain: tuple[int, int, int]) -> Array:
    """[T, 1] metres of an elbow from the line from shoulder to wrist."""
    shoulder, elbow, wrist = (limbs.place(turns, joint) for joint in chain)
    way = wrist - shoulder
    way = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)
    return np.asarray(np.linalg.norm(np.cross(elbow - shoulder, way), axis=-1, keepdims=True))


def _tipped(points: Sequence[Array], margins: Sequence[float], thighs: Sequence[Thigh]) -> Array:
    """[T, 3, 3] the turn of a hand about its wrist that lifts its fingertips. points: [T, 3], the wrist first."""
    turn, weights = np.zeros_like(points[0]), np.full((len(points[0]), 1), 1e-12)
    for point, margin in zip(points[1:], margins[1:], strict=True):
        arm, push = point - points[0], _push(thighs, [point], [margin], TIP_SOFT)
        weight = np.sum(push ** 2, axis=-1, keepdims=True)
        turn = turn + weight * np.cross(arm, push) / np.sum(arm ** 2, axis=-1, keepdims=True)
        weights = weights + weight
    turn = turn / weights
    # tanh bounds the turn without a kink.
    angle = np.maximum(np.linalg.norm(turn, axis=-1, keepdims=True), 1e-9)
    return np.asarray(Rotation.from_rotvec(turn / angle * FARTHEST_TIP * np.tanh(angle / FARTHEST_TIP)).as_matrix())


class _Hand:
    """A hand over T frames: its wrist, knuckles and fingertips."""

    def __init__(self, pose: Pose, side: str, sign: float) -> None:
        wrist, turned = pose.places[side + "Hand"], pose.turns[side + "Hand"]
        if side + "HandMiddle1" in pose.places:
            tips = [pose.places[side + tip] + sign * _LAST_BONE * pose.turns[side + tip][..., 0] for tip in FINGERTIPS
                    if side + tip in pose.places]
            # In the axes of the hand, since lifting changes where it is but not the pose of its fingers.
            self._local = [np.einsum("tji,tj->ti", turned, place - wrist)
                           for place in (pose.places[side + "HandMiddle1"], *tips)]
        else:
            self._local = [np.tile(place * [sign, 1.0, 1.0], (len(wrist), 1)) for place in _PALM]
        self.margins = (WRIST, KNUCKLES, *(TIP for _ in self._local[1:]))

    def points(self, wrist: Array, turned: Array) -> list[Array]:
        """[T, 3] each, of a hand whose wrist is at [T, 3] with the turn [T, 3, 3]."""
        return [wrist, *(wrist + np.einsum("tij,tj->ti", turned, place) for place in self._local)]


def _thighs(pose: Pose) -> tuple[Thigh, ...]:
    """Those of a pose that sits or is about to, relative to the hips."""
    if "LeftUpLeg" in pose.places:
        return tuple(map(Thigh, *_ends(pose)))
    # The upper body keeps its pose when it is seated, and the hips are turned under it.
    hips, knees, spine = _seat()
    shift = pose.turns["Hips"] @ spine - spine
    return tuple(Thigh(hip + shift, knee + shift) for hip, knee in zip(hips, knees, strict=True))


def _push(thighs: Sequence[Thigh], points: Sequence[Array], margins: Sequence[float], over: float) -> Array:
    """[T, 3] the displacement of a hand with points [T, 3] that belong above the thighs by the margins; over: metres in
    which it is rounded."""
    moves = []
    for point, margin in zip(points, margins, strict=False):
        for thigh in thighs:
            depth, up = thigh.depth(point)
            moves.append(soft(depth + margin, over)[:, None] * up)
    return combined(np.array(moves))


def _ends(pose: Pose) -> tuple[list[Array], list[Array]]:
    """Left and right hip, and left and right knee, [T, 3] metres from the middle of the hips."""
    hips = pose.places["Hips"]
    upper, lower = ([pose.places[side + part] - hips for side in SIDES] for part in ("UpLeg", "Leg"))
    return upper, lower


@cache
def _seat() -> tuple[list[Array], list[Array], Array]:
    """`_ends` of the default character on its seat, [1, 3], and the place of its spine [3] from the hips."""
    offsets = {name: WHOLE_BODY.offsets[WHOLE_BODY.index(name)]
               for name in ("Spine", *(side + part for side in SIDES for part in ("UpLeg", "Leg")))}
    hips = [offsets[side + "UpLeg"][None] for side in SIDES]
    # The seat is that of `gesticulator.body.legs.seated`.
    level = Rotation.from_euler("x", -90.0, degrees=True)
    knees = [hip + (Rotation.from_euler("y", out, degrees=True) * level).apply(offsets[side + "Leg"])
             for side, hip, out in zip(SIDES, hips, (SEAT_SPREAD, -SEAT_SPREAD), strict=True)]
    return hips, knees, offsets["Spine"]
