"""Joints of the character: where they are, how deep arms are in the trunk, and what was not recorded or is rigid.

The rhythm of the shoulder: the clavicle rises with the arm and goes forward with its reach.

Of the elevation of an arm over 30 degrees the shoulder girdle does a third (scapulohumeral rhythm, Inman 1944); it
rises a little with every hand that is raised, and goes forward with one that reaches. Of elevation e, and of height y
and reach z of the hand from the shoulder, in metres,

    lift = (e - 30) / 3 over 30 degrees + 18 (y + 0.5),    protraction = 15 (z - 0.1)    degrees,

which is what SmartBody's `brad` and Rocketbox's man show (0.37 of the elevation, 19 to 36 degrees a metre; 11 to 25
forward). The upper arm keeps its direction, so the hand goes along by what the shoulder goes, under 7 cm.

Wrists for takes whose wrists were not recorded: loose hands on moving forearms.

A relaxed hand lags: it bends against the way it is moved, and when the forearm brakes it swings on. With n the normal
of the palm and t the direction of the thumb, v the velocity of the wrist and a its acceleration (low-passed),

    flexion   = p - D v.n - G a.n,    deviation = D' v.t,

where the posture p is a little flexion of a hanging hand and an extension of a raised one whose palm is down. Both are
limited softly to what a wrist can do without effort. The accelerations of a stroke (5 m/s^2) bend it by 20 degrees.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, Skeleton

FPS = 60.0
"""Frames per second of the performer's motion: twice that of the clips, so that a beat can be moved by half a frame."""
TORSO_RADIUS, ELBOW_RADIUS = 0.115, 0.13
"""Radius of the capsule from hips to chest that a hand (half the depth of an adult's chest) or an elbow may not enter,
metres."""
# Elevation from which the shoulder takes part, degrees; its share; degrees over which that sets in.
_SETTING, _THIRD, _ROUND = 30.0, 1.0 / 3.0, 6.0
# Degrees for a metre of the hand's height; height of a hanging hand under the shoulder, metres.
_RISE, _HANGS = 18.0, -0.5
# Degrees for a metre of reach; reach of a hanging hand, metres.
_FORWARD, _NEAR = 15.0, 0.1
# Soft limits of lift and protraction, degrees.
_MOST = (22.0, 12.0)
# Standard deviation of the low pass, seconds.
_SMOOTH_SHOULDER = 0.05
# Degrees of flexion of a hanging hand, and of a raised one with the palm down.
_HANGING, _RAISED = 8.0, -10.0
# Degrees of flexion for 1 m/s along the normal of the palm and for 1 m/s^2; of deviation for 1 m/s along the thumb.
_DRAG, _SWING, _ASIDE = 20.0, 4.0, 10.0
# Soft limits, degrees.
_BENT, _EXTENDED, _DEVIATED = 45.0, 50.0, 18.0
# Height over the hips of a hand that is half raised, and the scale of the transition, metres.
_HALF_RAISED, _LIFT_WIDTH = 0.1, 0.07
# Standard deviation of the low pass of velocity and acceleration, seconds.
_SMOOTH_HAND = 0.07


def facing_positions(rotations: Array) -> Array:
    """Joint positions [T, 16, 3] in metres from the hips, in the facing frame, of rotations [T, 16 or more, 4]."""
    faced = rotations[:, :len(CHARACTER)].copy()
    faced[:, 0] = rotation.remove_yaw(faced[:, 0])
    return kinematics.joint_positions(CHARACTER, faced)


def torso_depth(places: Array) -> Array:
    """[T] depth of the deepest wrist or elbow inside the torso (a capsule from hips to chest), metres, 0 outside."""
    chest = places[:, CHARACTER.index("Spine3")]
    hips = np.zeros_like(chest)
    return np.maximum.reduce([
        capsule_depth(places[:, CHARACTER.index(side + name)], hips, chest, radius)
        for name, radius in (("Hand", TORSO_RADIUS), ("ForeArm", ELBOW_RADIUS)) for side in ("Left", "Right")])


def capsule_depth(point: Array, low: Array, high: Array, radius: float) -> Array:
    """[T] depth in metres of points [T, 3] inside a capsule between two points [T, 3], 0 outside."""
    axis = high - low
    share = np.clip(np.sum((point - low) * axis, axis=-1) / np.sum(axis * axis, axis=-1), 0.0, 1.0)
    return np.maximum(0.0, radius - np.linalg.norm(point - low - share[:, None] * axis, axis=-1))


def with_rhythm(skeleton: Skeleton, rotations: Array, fps: float, share: float = 1.0) -> Array:
    """Local rotations [T, J, 4] with the clavicles turned by `share` of the rhythm."""
    out = rotations.copy()
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        collar, arm = skeleton.index(side + "Shoulder"), skeleton.index(side + "Arm")
        lift, forward = (share * np.radians(gaussian_filter1d(angle, _SMOOTH_SHOULDER * fps, mode="nearest"))
                         for angle in rhythm(skeleton, rotations, side))
        zero = np.zeros_like(lift)
        turn = rotation.from_exponential_map(np.stack([zero, -sign * forward, sign * lift], axis=-1))
        raised = rotation.multiply(turn, rotations[:, collar])
        kept = rotation.multiply(rotations[:, collar], rotations[:, arm])
        out[:, collar], out[:, arm] = raised, rotation.multiply(rotation.conjugate(raised), kept)
    return out


def rhythm(skeleton: Skeleton, rotations: Array, side: str) -> tuple[Array, Array]:
    """Lift and protraction [T] of a clavicle in degrees, as seen from the chest."""
    turned = rotations[:, skeleton.index(side + "Shoulder")]
    bones = []
    for joint, tip in (("Arm", "ForeArm"), ("ForeArm", "Hand")):
        turned = rotation.multiply(turned, rotations[:, skeleton.index(side + joint)])
        bones.append(rotation.rotate(turned, skeleton.offsets[skeleton.index(side + tip)]))
    down = -bones[0][:, 1] / np.linalg.norm(bones[0], axis=-1)
    elevation = np.degrees(np.arccos(np.clip(down, -1.0, 1.0)))
    hand = bones[0] + bones[1]
    over = _ROUND * np.logaddexp(0.0, (elevation - _SETTING) / _ROUND)
    lift = _THIRD * over + _RISE * (hand[:, 1] - _HANGS)
    forward = _FORWARD * (hand[:, 2] - _NEAR)
    return _MOST[0] * np.tanh(lift / _MOST[0]), _MOST[1] * np.tanh(forward / _MOST[1])


def with_loose_wrists(rotations: Array) -> Array:
    """Local rotations [T, J, 4] (60 fps) with bent wrists, in the place of stiff ones."""
    out = rotations.copy()
    places = facing_positions(rotations)
    faced = rotations[:, :len(CHARACTER)].copy()
    faced[:, 0] = rotation.remove_yaw(faced[:, 0])
    world = kinematics.global_rotations(CHARACTER, faced)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        hand = CHARACTER.index(side + "Hand")
        flexion, deviation = bends(places[:, hand], world[:, hand])
        turn = np.stack([0.0 * flexion, sign * deviation, -sign * flexion], axis=-1)
        out[:, hand] = rotation.multiply(rotations[:, hand], rotation.from_exponential_map(np.radians(turn)))
    return out


def bends(wrist: Array, hand: Array) -> tuple[Array, Array]:
    """Flexion and deviation (towards the little finger) [T] in degrees, from places [T, 3] of the wrist and world
    rotations [T, 4] of a stiff hand."""
    smooth = gaussian_filter1d(wrist, _SMOOTH_HAND * FPS, axis=0, mode="nearest")
    velocity = np.gradient(smooth, 1.0 / FPS, axis=0) if len(wrist) > 1 else np.zeros_like(wrist)
    acceleration = np.gradient(velocity, 1.0 / FPS, axis=0) if len(wrist) > 1 else velocity
    palm, thumb = (rotation.rotate(hand, np.array(axis)) for axis in ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)))
    lifted = 1.0 / (1.0 + np.exp(-(smooth[:, 1] - _HALF_RAISED) / _LIFT_WIDTH))
    down = np.clip(-palm[:, 1], 0.0, 1.0)
    posture = gaussian_filter1d(_HANGING * (1.0 - lifted) + _RAISED * lifted * down, _SMOOTH_HAND * FPS, mode="nearest")
    flexion = posture - _DRAG * (velocity * palm).sum(axis=1) - _SWING * (acceleration * palm).sum(axis=1)
    flexion = np.where(flexion > 0.0, _BENT * np.tanh(flexion / _BENT), _EXTENDED * np.tanh(flexion / _EXTENDED))
    aside = _ASIDE * (velocity * thumb).sum(axis=1)
    return flexion, _DEVIATED * np.tanh(aside / _DEVIATED)
