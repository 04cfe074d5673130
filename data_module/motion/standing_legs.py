"""Legs for a speaker who stands in one place: feet that stay where they are under hips that move.

The hips go the other way than the chest, as they do in everybody who keeps her balance, and no higher than both legs
reach. A leg is two bones: where the hip and the ankle are, the law of cosines tells how far the knee is bent, and the
knee points to where the toes do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d
from scipy.spatial.transform import Rotation

from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.skeletons import HIP_HEIGHT, LEG_JOINTS, WHOLE_BODY
from data_module.types import Array, Motion, Skeleton

_BALANCE = 0.25
"""Metres that the hips go back for each metre that the chest comes forward or goes to a side."""
_SLOW = 0.35
"""Seconds that this is smoothed over: the weight moves slower than the chest."""
_ANKLE = 0.08
"""Metres from the floor to the ankle of a foot that stands flat."""
_FEET = np.array([0.105, _ANKLE, -0.010])
"""Metres from the floor under the hips to the left ankle."""
_TOES_OUT = np.radians(9.0)
"""How far each foot is turned outwards."""
_STRETCHED = 0.997
"""Share of a leg's length beyond which it is not stretched: a knee that locks jumps."""
_DIP, _DIP_WIDTH = 0.6, 0.2
"""Seconds ahead and behind in which the hips come down for a leg that would not reach, and the smoothing of that."""
_SIDES = (("Left", 1.0), ("Right", -1.0))


def with_standing_legs(motion: Motion) -> Motion:
    """The motion with planted feet: hips' travel and all joints of the legs are made up, the other joints stay.

    motion: on `WHOLE_BODY`; its hips' rotations are kept, their path is not. Y = 0 is the floor, the hips' mean place
    is over the origin, and the feet point to where the hips do on average. What the legs were does not count.
    """
    motion = skeletons.resized(motion, WHOLE_BODY)
    heading = _mean_yaw(motion.rotations[:, 0])
    hips = motion.rotations[:, 0]
    root = np.zeros((len(motion), 3))
    root[:, [0, 2]] = _travel(motion)
    ankles = {side: rotation.rotate(heading, _FEET * [sign, 1.0, 1.0]) for side, sign in _SIDES}
    sockets = {side: rotation.rotate(hips, WHOLE_BODY.offsets[WHOLE_BODY.index(side + "UpLeg")]) for side, _ in _SIDES}
    reach = np.min([_reach(root + sockets[side], ankles[side]) - sockets[side][:, 1] for side, _ in _SIDES], axis=0)
    root[:, 1] = _under(np.minimum(reach, HIP_HEIGHT), motion.fps)
    rotations = motion.rotations.copy()
    for side, sign in _SIDES:
        toes = rotation.multiply(heading, _about_up(sign * _TOES_OUT))
        thigh, shin = bent_leg(ankles[side] - root - sockets[side], rotation.rotate(toes, np.array([0.0, 0.0, 1.0])),
                               leg_lengths(WHOLE_BODY, side))
        foot = np.broadcast_to(toes, thigh.shape)
        own = (rotation.multiply(rotation.conjugate(hips), thigh), rotation.multiply(rotation.conjugate(thigh), shin),
               rotation.multiply(rotation.conjugate(shin), foot), np.tile([1.0, 0.0, 0.0, 0.0], (len(motion), 1)))
        for part, turns in zip(("UpLeg", "Leg", "Foot", "ToeBase"), own, strict=True):
            rotations[:, WHOLE_BODY.index(side + part)] = rotation.continuous(turns[:, None])[:, 0]
    every = {*motion.filled, *LEG_JOINTS}
    return replace(motion, rotations=rotations, root_positions=root,
                   absent=tuple(name for name in motion.absent if name not in LEG_JOINTS),
                   filled=tuple(name for name in WHOLE_BODY.names if name in every))


def _mean_yaw(hips: Array) -> Array:
    """[4] the turn about the vertical that is nearest to all of the hips' [T, 4]."""
    yaws = rotation.yaw_of(hips)
    return rotation.normalise(np.where(yaws @ yaws[0] < 0.0, -1.0, 1.0) @ yaws)


def _about_up(angle: float) -> Array:
    return np.array([np.cos(angle / 2.0), 0.0, np.sin(angle / 2.0), 0.0])


def _travel(motion: Motion) -> Array:
    """[T, 2] metres along X and Z that the hips are off their mean place."""
    body = skeletons.upper_body(motion)
    chest = kinematics.joint_positions(body.skeleton, body.rotations)[:, body.skeleton.index("Spine3")][:, [0, 2]]
    slow = gaussian_filter1d(chest, _SLOW * motion.fps, axis=0, mode="nearest")
    return -_BALANCE * (slow - slow.mean(axis=0))


def leg_lengths(skeleton: Skeleton, side: str) -> tuple[float, float]:
    """Metres of thigh and shin of a skeleton with our names, of its "Left" or "Right"."""
    thigh, shin = (float(np.linalg.norm(skeleton.offsets[skeleton.index(side + part)])) for part in ("Leg", "Foot"))
    return thigh, shin


def _reach(socket: Array, ankle: Array) -> Array:
    """[T] metres over the floor at which the socket may be, for the leg to reach the ankle; its own height apart."""
    level = np.sum((socket - ankle)[:, [0, 2]] ** 2, axis=-1)
    return ankle[1] + np.sqrt(np.maximum((_STRETCHED * sum(leg_lengths(WHOLE_BODY, "Left"))) ** 2 - level, 0.0))


def _under(limit: Array, fps: float) -> Array:
    """[T] smooth and nowhere above `limit`: a mean, over a window, of minima over at least that window."""
    half = max(1, round(_DIP * fps))
    least = minimum_filter1d(limit, 2 * half + 1, mode="nearest")
    return gaussian_filter1d(least, _DIP_WIDTH * fps, mode="nearest", radius=half)


def bent_leg(way: Array, toes: Array, lengths: tuple[float, float]) -> tuple[Array, Array]:
    """World rotations [T, 4] of thigh and shin, for bones that hang at rest (-Y): inverse kinematics of two bones.

    By the law of cosines the knee lies (a^2 + d^2 - b^2) / 2d along the way d from hip to ankle, and beside it to where
    the toes point. way: [T, 3] from the hip's socket to the ankle; toes: [3] or [T, 3] the direction of the knee, not
    along the way; lengths: a and b, metres of thigh and shin. A way that is longer than both stretches the leg and
    stops short.
    """
    thigh, shin = lengths
    length = np.clip(np.linalg.norm(way, axis=-1, keepdims=True), abs(thigh - shin) + 1e-6, thigh + shin - 1e-6)
    along = way / np.linalg.norm(way, axis=-1, keepdims=True)
    ahead = toes - np.sum(along * toes, axis=-1, keepdims=True) * along
    ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
    share = (thigh ** 2 + length ** 2 - shin ** 2) / (2.0 * length)
    knee = share * along + np.sqrt(np.maximum(thigh ** 2 - share ** 2, 0.0)) * ahead
    hinge = np.cross(ahead, along)
    return _hung(knee, hinge), _hung(length * along - knee, hinge)


def _hung(bone: Array, hinge: Array) -> Array:
    """[T, 4] the rotations of a bone that hangs at rest (-Y) beside a knee whose axis is X, from both as they are."""
    up = -bone / np.linalg.norm(bone, axis=-1, keepdims=True)
    frames = np.stack([hinge, up, np.cross(hinge, up)], axis=-1)
    return Rotation.from_matrix(frames).as_quat(scalar_first=True)
