"""Keeps the hands of the default character out of its trunk and thighs and away from its face, its elbows off its back.

The models draw poses, not contacts: at one block's end a hand is on one side of the chest, at the next on the other,
and between them it would pass through, or end behind the back. An arm whose wrist or knuckles are too far back is bent
until they are on the surface.

A hand is always moved ahead, never around: with p its place across the body, the front of trunk and face is a height
field z(p) of limited slope, which falls behind the body on the hand's side only. The correction max(z(p) - z, 0) then
changes at most `STEEPEST` times as fast as the hand moves, so that a hand that would shoot through the body passes in
front of it without a jump; the direction out of a closed shape would turn round at its middle. With d the depth and
e = `SOFT`, a hand is moved by 0 for d < -e, (d + e)^2 / 4e for -e < d < e, and d beyond, which leaves no kink in its
path. An elbow that the trunk would hide swings outward about the line from shoulder to wrist, by the same rule and a
plane behind the trunk that recedes beside it; the hand stays. A hand at its shoulder, where the models fold an elbow
further than a person can, stays where only the slope of the field would move it: there a centimetre of the hand is ten
of the elbow, which would turn round within a frame. It turns about its wrist if its knuckles are in the trunk.
Everything depends on the pose alone; a pose that needs no correction stays the same bit for bit. The thighs of a body
that sits (`gesticulator.contacts.lap`) are a third surface, from which hands are lifted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTERS, SIDES
from data_module.types import Array, Motion, Skeleton
from gesticulator.contacts import limbs
from gesticulator.contacts.limbs import length

if TYPE_CHECKING:
    from gesticulator.contacts.lap import Thigh

STEEPEST = 1.2
"""Largest slope of the front of the trunk: with 3, a hand that shot past the hip was thrown ahead at 4.7 m/s."""
_EDGE = STEEPEST * limbs.OURS[0] ** 2 / math.hypot(limbs.OURS[1], STEEPEST * limbs.OURS[0])
"""Metres across at which the ellipse of the trunk is as steep."""
OTHER_SIDE = (0.115, 0.07, 0.35)
"""Where the front leaves the trunk on the side of the other hand: metres across, metres ahead, and slope from there on.
A hand there is beside the other arm, not behind the back."""
HEM, HIPS, HIPS_UNDER = 0.08, 0.17, 0.12
"""Metres below the hips down to which a shirt hangs; share by which the hips under it are wider than the trunk; metres
above the hips from which it widens."""
BACK, BACK_ENDS, BACK_FALLS, ELBOW_SOFT = 0.07, 0.16, 0.8, 0.06
"""The plane behind which the trunk hides an elbow: metres behind its middle, up to which metres across, its slope from
there on, and metres over which an elbow is slowed. In two takes of people who talk no
elbow is ever there; in the clips of gestures that the corpus is made of, up to a tenth of the time."""
OUTWARD = (0.95, 0.3)
"""Direction in which an elbow leaves it, outward and ahead: more to the front, it would flip round a raised hand."""
FOLDED, BESIDE = (0.13, 0.20), (0.12, 0.17)
"""Metres from a wrist to its shoulder, and across the trunk: a hand that is nearer than the first pair and farther
across than the second is at its shoulder beside the trunk, and stays. Elbows that are bent by 152 and 136 degrees bring
it there; people bend theirs by up to 150."""
TIP_SOFT, FARTHEST_TIP = 0.01, 0.8
"""Metres over which a hand is turned that stays at its shoulder with its knuckles in the trunk; radians at most."""
HEAD_MIDDLE = np.array([0.0, 0.085, 0.025])
"""Middle of the face relative to the joint of the head, metres: the joint is at the top of the neck."""
HEAD_RADIUS = 0.13
"""Metres from there within which a hand hides the face: the face is 0.09 deep, and a hand 0.04."""
_HAND = "Hand", "HandMiddle1"
"""The points of a hand that are kept out: wrist and knuckles."""
_SEATED = tuple(side + part for side in SIDES for part in ("UpLeg", "Leg", *limbs.FINGERTIPS))
"""Further joints of a body that sits."""
_JOINTS = ("Neck", "Spine3", "Head", *(side + part for side in SIDES for part in ("Arm", "ForeArm", *_HAND)))
_SIGNS = np.array([1.0, -1.0])[:, None, None]
"""Of the sides, for their points over time."""
Sign = float | Array
_STEPS, _STEPS_SEATED = 4, 8
"""Iterations: the points of a hand share a correction, and each corrects the one before."""
_SWINGS = 7
"""Iterations of an elbow that swings outward."""


def cleared(motion: Motion, sits: bool = False) -> Motion:
    """A motion on the default skeleton with the hands outside trunk and face. sits: and above its thighs, those of a
    body that sits; the motion may still lack them."""
    free = _cleared(motion.skeleton, motion.rotations, sits)
    # Most motions are clear, and are returned as they came.
    return motion if free is motion.rotations else replace(motion, rotations=free)


def _cleared(skeleton: Skeleton, rotations: Array, sits: bool) -> Array:
    """Local rotations [T, J, 4] with the hands outside, or these themselves if they are; see `cleared`."""
    names = _joints_of(skeleton.names, sits)
    pose, free = limbs.posed(skeleton, rotations, names), rotations
    body = _Body.of(pose, sits)
    parts = (*_HAND, *limbs.FINGERTIPS)
    points = [[pose.places[side + part] for part in parts if side + part in names] for side in SIDES]
    push = body.push(np.array(points), _SIGNS)
    # Both sides at once: this runs for every block of a stream, and few large arrays are faster.
    hidden = body.hidden(np.array([pose.places[side + "ForeArm"] for side in SIDES]), _SIGNS[..., 0])
    moved = (length(push) > limbs.LEAST) | (length(hidden) > limbs.LEAST)
    for side, sign, frames in zip(SIDES, (1.0, -1.0), moved[..., 0], strict=True):
        if frames.any():
            free = rotations.copy() if free is rotations else free
            posed, at = (pose.at(frames), body.at(frames)), np.flatnonzero(frames)
            _bend_arm(free, skeleton, posed, (side, sign), at)
    return free


@lru_cache(maxsize=16)
def _joints_of(names: tuple[str, ...], sits: bool) -> list[str]:
    """The joints that matter, of those that a body has."""
    return [name for name in (*_JOINTS, *(_SEATED if sits else ())) if name in names]


def _bend_arm(rotations: Array, skeleton: Skeleton, posed: tuple[limbs.Pose, _Body], side: tuple[str, float],
              at: NDArray[np.int64]) -> None:
    """Bend an arm in `rotations` [T, J, 4] at the frames `at`, where it is in the body; posed: the pose and the body in
    these frames."""
    (name, sign), (pose, body), places = side, posed, posed[0].places
    shoulder, wrist = places[name + "Arm"], places[name + "Hand"]
    bones = upper, lower = places[name + "ForeArm"] - shoulder, wrist - places[name + "ForeArm"]
    # The hand does not turn with the arm.
    palm = np.array([places[name + part] - wrist for part in (*_HAND, *limbs.FINGERTIPS) if name + part in places])
    share = 1.0 - body.at_shoulder(wrist, shoulder, sign)
    for _ in range(_STEPS_SEATED if body.thighs else _STEPS):
        push = body.push(shoulder + upper + lower + palm, sign) * share
        inside = length(push) > limbs.LEAST
        if not inside.any():
            break
        # The elbow stays in the plane of its arm, so that a push of the hand does not swing it.
        reaching = limbs.bent(upper, lower, upper + lower + push, limbs.POLE_OF_ELBOW)
        upper, lower = np.where(inside, reaching[0], upper), np.where(inside, reaching[1], lower)
    for _ in range(_SWINGS):
        hidden = body.hidden(shoulder + upper, sign)
        behind = length(hidden) > limbs.LEAST
        if not behind.any():
            break
        # A frame does not depend on which others are cleared with it.
        swung = limbs.swivelled(upper, lower, hidden)
        upper, lower = np.where(behind, swung, upper), np.where(behind, upper + lower - swung, lower)
    turns = {skeleton.index(joint): turn for joint, turn in pose.turns.items()}
    chain = [skeleton.index(name + part) for part in ("Arm", "ForeArm", "Hand")]
    for node, before, after in zip(chain, bones, (upper, lower), strict=False):
        turns[node] = limbs.swing(before, after) @ turns[node]
    if len(palm) > 1:
        turns[chain[2]] = _tipped(turns[chain[2]], (shoulder + upper + lower, palm[1]), body, sign)
    limbs.write_turns(rotations, skeleton, turns, chain, at)


def _tipped(turn: Array, hand: tuple[Array, Array], body: _Body, sign: float) -> Array:
    """The turn [T, 3, 3] of a hand, about its wrist where its knuckles are still in the trunk: of a hand that stays at
    its shoulder. hand: [T, 3] the wrist, and the knuckles from there; sign: 1 for the left hand, -1 for the right."""
    wrist, palm = hand
    push = body.out_of_trunk(wrist + palm, sign, TIP_SOFT)
    at = length(push)[:, 0] > limbs.LEAST
    if not at.any():
        return turn
    before, after = palm[at], (palm + push)[at]
    before, after = before / length(before), after / np.maximum(length(after), 1e-9)
    axis = rotation.cross(before, after)
    sine = length(axis)
    # The arctangent is exact for small angles, where an arccosine loses half of its digits.
    angle = np.minimum(np.arctan2(sine, limbs.dot(before, after)), FARTHEST_TIP)
    tipped = rotation.from_exponential_map(axis / np.maximum(sine, 1e-9) * angle)
    turn = turn.copy()
    turn[at] = rotation.to_matrix(tipped) @ turn[at]
    return turn


def cleared_poses(poses: Array, sits: bool = False) -> Array:
    """Poses [K, 3 J] as exponential maps with the hands outside trunk and face; sits: see `cleared`."""
    rotations = rotation.from_exponential_map(poses.reshape(len(poses), -1, 3))
    free = _cleared(CHARACTERS[rotations.shape[1]], rotations, sits)
    if free is rotations:
        return poses
    moved = (free != rotations).any(axis=-1)
    # Of the exponential maps of a rotation, the one nearest to the given pose: models differentiate them over time.
    out = poses.reshape(*moved.shape, 3).copy()
    out[moved] = rotation.unroll(np.stack([out[moved], rotation.to_exponential_map(free[moved])]))[1]
    return np.asarray(out.reshape(poses.shape))


@dataclass(frozen=True)
class _Body:
    """Trunk and head over T frames, relative to the hips: axes and length of the trunk (`limbs.TrunkAxes`), axes
    [T, 3, 3] of the head, [T, 3] the middle of the face, and the thighs, if it sits."""

    axes: Array
    length: Array
    head: Array
    face: Array
    thighs: tuple[Thigh, ...]

    @classmethod
    def of(cls, pose: limbs.Pose, sits: bool) -> _Body:
        trunk, head = limbs.trunk_axes(pose.places["Neck"], pose.turns["Spine3"]), pose.turns["Head"]
        body = cls(trunk.axes, trunk.length, head, pose.places["Head"] + head @ HEAD_MIDDLE, ())
        if not sits:
            return body
        from gesticulator.contacts.lap import thighs_of

        return replace(body, thighs=thighs_of(pose))

    def at(self, frames: NDArray[np.bool_]) -> _Body:
        """The body in some of its frames."""
        return _Body(self.axes[frames], self.length[frames], self.head[frames], self.face[frames],
                     tuple(replace(thigh, hip=thigh.hip[frames], knee=thigh.knee[frames]) for thigh in self.thighs))

    def push(self, points: Array, sign: Sign) -> Array:
        """[..., T, 3] the displacement of a hand whose P points [..., P, T, 3] are in the body, fingertips only in the
        thighs; sign: 1 for the left hand, -1 for the right, or an array of them."""
        hand = points[..., :len(_HAND), :, :]
        moves = [self.out_of_trunk(hand, sign, limbs.SOFT), self._off_face(hand)]
        return limbs.combined(np.concatenate([*moves, *(thigh.push(points) for thigh in self.thighs)], axis=-3))

    def hidden(self, elbow: Array, sign: Sign) -> Array:
        """[..., T, 3] the displacement of an elbow [..., T, 3] behind the trunk; sign: see `push`."""
        across, along, ahead = self._from_hips(elbow)
        # Behind the plane only: an elbow beside or ahead of the trunk is in view.
        depth = limbs.soft(back_at(across * sign, along, self.length) - ahead, ELBOW_SOFT)[..., None]
        out = OUTWARD[0] * self.axes[:, 0]
        return depth * (np.asarray(sign)[..., None] * out + OUTWARD[1] * self.axes[:, 2])

    def at_shoulder(self, hand: Array, shoulder: Array, sign: float) -> Array:
        """[T, 1] how much a hand [T, 3] is at its shoulder [T, 3] and beside the trunk, 0 to 1."""
        across = sign * limbs.dot(self.axes[:, 0], hand)
        return np.asarray((1.0 - _ramp(length(hand - shoulder), FOLDED)) * _ramp(across, BESIDE))

    def out_of_trunk(self, point: Array, sign: Sign, over: float) -> Array:
        """[..., T, 3] the displacement of a point of a hand in the trunk; over: metres in which it is rounded."""
        across, along, ahead = self._from_hips(point)
        return self.axes[:, 2] * limbs.soft(shirt_at(across * sign, along, self.length) - ahead, over)[..., None]

    def _from_hips(self, point: Array) -> tuple[Array, Array, Array]:
        """[..., T] metres across, along and ahead of a point [..., T, 3]."""
        local = np.matmul(self.axes, point[..., None])
        return local[..., 0, 0], local[..., 1, 0], local[..., 2, 0]

    def _off_face(self, point: Array) -> Array:
        local = np.matmul((point - self.face)[..., None, :], self.head)
        x, y, z = local[..., 0, 0], local[..., 0, 1], local[..., 0, 2]
        return self.head[..., 2] * limbs.soft(face_front(np.sqrt(x * x + y * y)) - z)[..., None]


def trunk_front(across: Array) -> Array:
    """Metres by which the front of the trunk is ahead of its middle, at metres across it (the hand's side: > 0)."""
    width, depth = limbs.OURS
    # The ellipse up to where its slope is the steepest, then its tangent.
    ellipse = depth * np.sqrt(1.0 - np.minimum(np.maximum(across / width, -1.0), _EDGE / width) ** 2)
    # Beyond the edge the slope stays, so that a hanging hand beside the hip is not thrown ahead.
    own = ellipse - STEEPEST * np.maximum(across - _EDGE, 0.0)
    begins, height, slope = OTHER_SIDE
    return np.asarray(np.where(across > -begins, own, np.maximum(ellipse, height + slope * (across + begins))))


def front_at(across: Array, along: Array, length: Array) -> Array:
    """`trunk_front` at metres across the trunk and `along` it; it recedes beyond the ends of its `length`."""
    return np.asarray(trunk_front(across) - limbs.receding(along, 0.0, length))


def shirt_at(across: Array, along: Array, length: Array) -> Array:
    """As `front_at`, over hips that are wider than the trunk."""
    wide = 1.0 + HIPS * (1.0 - _ramp(along, (0.0, HIPS_UNDER)))
    # Down to the hem the shirt is as wide as at the hips; it begins to recede there.
    hem = np.maximum(along, np.minimum(along + HEM, 0.0))
    return np.asarray(wide * trunk_front(across / wide) - limbs.receding(hem, 0.0, length))


def back_at(across: Array, along: Array, length: Array) -> Array:
    """Metres by which the plane that hides an elbow is ahead of the middle of the trunk; see `front_at`."""
    return np.asarray(-BACK - BACK_FALLS * np.maximum(across - BACK_ENDS, 0.0) - limbs.receding(along, 0.0, length))


def face_front(radius: Array) -> Array:
    """Metres by which the space of the face is ahead of its middle, at metres beside it: a paraboloid, then a cone."""
    inside = np.minimum(radius, HEAD_RADIUS)
    return np.asarray(HEAD_RADIUS - inside ** 2 / HEAD_RADIUS - 2.0 * (radius - inside))


def _ramp(values: Array, ends: tuple[float, float]) -> Array:
    """0 below the first of two ends, 1 above the second, without a kink."""
    share = np.minimum(np.maximum((values - ends[0]) / (ends[1] - ends[0]), 0.0), 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))
