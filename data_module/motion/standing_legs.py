"""Legs for a standing speaker: planted feet under moving hips.

For balance the hips move opposite to the chest, and no higher than both legs reach. A leg has two bones: the law of
cosines gives the bend of the knee from the positions of hip and ankle, and the knee points in the direction of the
toes.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.skeletons import HIP_HEIGHT, LEG_JOINTS, WHOLE_BODY
from data_module.types import Array, Motion, Skeleton

# Metres that the hips move per metre of the chest, in the opposite direction.
_BALANCE = 0.25
# Smoothing of this motion, seconds: the weight moves slower than the chest.
_SLOW = 0.35
# Height of the ankle of a flat foot, metres.
_ANKLE = 0.08
# Position of the left ankle relative to the floor under the hips, metres.
_FEET = np.array([0.105, _ANKLE, -0.010])
# Outward turn of each foot, radians.
_TOES_OUT = np.radians(9.0)
# Largest extension of a leg as a share of its length: a locked knee jumps.
_STRETCHED = 0.997
# Seconds before and after in which the hips are lowered for a leg that would not reach, and the smoothing of that.
_DIP, _DIP_WIDTH = 0.6, 0.2
_SIDES = (("Left", 1.0), ("Right", -1.0))


def with_standing_legs(motion: Motion) -> Motion:
    """The motion with planted feet: the path of the hips and all joints of the legs are synthesised, the rest stays.
    motion: on `WHOLE_BODY`; the rotations of the hips are used, their path and the legs are not. Y = 0 is the floor,
    the mean position of the hips is over the origin, and the feet point in the mean direction of the hips."""
    motion = skeletons.resized(motion, WHOLE_BODY)
    hips = motion.rotations[:, 0]
    yaws = rotation.yaw_of(hips)
    # The mean of quaternions on one half sphere, since q and -q are one rotation.
    heading = rotation.normalise(np.where(yaws @ yaws[0] < 0.0, -1.0, 1.0) @ yaws)
    root = np.zeros((len(motion), 3))
    root[:, [0, 2]] = _travel(motion)
    ankles = {side: rotation.rotate(heading, _FEET * [sign, 1.0, 1.0]) for side, sign in _SIDES}
    sockets = {side: rotation.rotate(hips, WHOLE_BODY.offsets[WHOLE_BODY.index(side + "UpLeg")]) for side, _ in _SIDES}
    # The lower of both limits: neither foot may leave its place.
    reach = np.min([_reach(root + sockets[side], ankles[side]) - sockets[side][:, 1] for side, _ in _SIDES], axis=0)
    root[:, 1] = _under(np.minimum(reach, HIP_HEIGHT), motion.fps)
    rotations = motion.rotations.copy()
    for side, sign in _SIDES:
        half = sign * _TOES_OUT / 2.0
        toes = rotation.multiply(heading, np.array([np.cos(half), 0.0, np.sin(half), 0.0]))
        thigh, shin = bent_leg(ankles[side] - root - sockets[side], rotation.rotate(toes, np.array([0.0, 0.0, 1.0])),
                               leg_lengths(WHOLE_BODY, side))
        foot = np.broadcast_to(toes, thigh.shape)
        local = (rotation.multiply(rotation.conjugate(hips), thigh), rotation.multiply(rotation.conjugate(thigh), shin),
               rotation.multiply(rotation.conjugate(shin), foot), np.tile([1.0, 0.0, 0.0, 0.0], (len(motion), 1)))
        for part, turns in zip(("UpLeg", "Leg", "Foot", "ToeBase"), local, strict=True):
            rotations[:, WHOLE_BODY.index(side + part)] = rotation.continuous(turns[:, None])[:, 0]
    every = {*motion.filled, *LEG_JOINTS}
    return replace(motion, rotations=rotations, root_positions=root,
                   absent=tuple(name for name in motion.absent if name not in LEG_JOINTS),
                   filled=tuple(name for name in WHOLE_BODY.names if name in every))


def _travel(motion: Motion) -> Array:
    """[T, 2] displacement of the hips along X and Z from their mean position, metres."""
    body = skeletons.upper_body(motion)
    chest = kinematics.joint_positions(body.skeleton, body.rotations)[:, body.skeleton.index("Spine3")][:, [0, 2]]
    slow = gaussian_filter1d(chest, _SLOW * motion.fps, axis=0, mode="nearest")
    return -_BALANCE * (slow - slow.mean(axis=0))


def leg_lengths(skeleton: Skeleton, side: str) -> tuple[float, float]:
    thigh, shin = (float(np.linalg.norm(skeleton.offsets[skeleton.index(side + part)])) for part in ("Leg", "Foot"))
    return thigh, shin


def _reach(socket: Array, ankle: Array) -> Array:
    """[T] greatest height over the floor, metres, of a socket [T, 3] from which the leg reaches the ankle."""
    level = np.sum((socket - ankle)[:, [0, 2]] ** 2, axis=-1)
    return ankle[1] + np.sqrt(np.maximum((_STRETCHED * sum(leg_lengths(WHOLE_BODY, "Left"))) ** 2 - level, 0.0))


def _under(limit: Array, fps: float) -> Array:
    """[T] a smooth curve nowhere above `limit`: a windowed mean of minima over at least that window."""
    half = max(1, round(_DIP * fps))
    least = minimum_filter1d(limit, 2 * half + 1, mode="nearest")
    return gaussian_filter1d(least, _DIP_WIDTH * fps, mode="nearest", radius=half)


def bent_leg(way: Array, toes: Array, lengths: tuple[float | Array, float | Array]) -> tuple[Array, Array]:
    """World rotations [..., 4] of thigh and shin, for bones that hang at rest (-Y): inverse kinematics of two bones.

    By the law of cosines the knee lies (a^2 + d^2 - b^2) / 2d along the line of length d from hip to ankle, offset in
    the direction of the toes. way: [..., 3] from the hip socket to the ankle; toes: [3] or [..., 3] the direction of
    the knee, not parallel to the way; lengths: a and b, metres of thigh and shin, each one number or [..., 1]. A way
    longer than both bones stretches the leg.
    """
    thigh, shin = lengths
    length = np.clip(np.linalg.norm(way, axis=-1, keepdims=True), np.abs(thigh - shin) + 1e-6, thigh + shin - 1e-6)
    along = way / np.linalg.norm(way, axis=-1, keepdims=True)
    ahead = toes - np.sum(along * toes, axis=-1, keepdims=True) * along
    ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
    share = (thigh ** 2 + length ** 2 - shin ** 2) / (2.0 * length)
    knee = share * along + np.sqrt(np.maximum(thigh ** 2 - share ** 2, 0.0)) * ahead
    # Thigh and shin bend about one axis, so the knee does not twist.
    hinge = np.cross(ahead, along)
    return _hung(knee, hinge), _hung(length * along - knee, hinge)


def _hung(bone: Array, hinge: Array) -> Array:
    """[..., 4] the rotations of a bone that hangs at rest (-Y) with knee axis X, from its direction and that axis."""
    up = -bone / np.linalg.norm(bone, axis=-1, keepdims=True)
    frames = np.stack([hinge, up, np.cross(hinge, up)], axis=-1)
    return rotation.from_matrix(frames)
