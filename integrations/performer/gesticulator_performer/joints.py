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

Arms of CMU's takes, turned back to where people hold them.

CMU's clips reached us through a library that copied rotations onto one skeleton whose elbows bend about another axis:
seen from the upper arm the plane of the elbow is tilted outward by 33 degrees, in the clips of Rocketbox and SmartBody
by -31 to 2. So their forearms point outward, in rest by 34 degrees more than the others' and in gestures by 21.

An elbow whose plane is turned by a constant angle a about the upper arm has the rotations

    q' = t q t^-1,    t = exp(a x / 2),    x along the bone,

which leaves the bend, the upper arm, and the roll of the hand about the forearm as they are. `SUBJECTS` has the angle
by subject and side. Upper arms hang as the others' do, within 2 degrees: they are not swung.

`narrowed` is for the takes of all sources: a soft limit of arms that open wider than those of a standing speaker.
`freed` turns a hand out of the trunk. Joints are those of the character; the right arm is treated as the left one's
mirror image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, Skeleton
from gesticulator_performer.tables import table

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
_FLEXED, _EXTENDED, _DEVIATED = 45.0, 50.0, 18.0
# Height over the hips of a hand that is half raised, and the scale of the transition, metres.
_HALF_RAISED, _LIFT_WIDTH = 0.1, 0.07
# Standard deviation of the low pass of velocity and acceleration, seconds.
_SMOOTH_HAND = 0.07
SIDES = ("Left", "Right")
MIRROR = np.array([1.0, -1.0, -1.0])
"""A reflection in x = 0 keeps the x of a log rotation and negates y and z."""
# Sign of x away from the body.
_OUT = {"Left": 1.0, "Right": -1.0}
SUBJECTS: dict[str, dict[str, float]] = table("clips.toml")["takes"]["elbows"]
"""Subject of CMU -> side -> degrees by which the plane of the elbow is turned inward."""
# Degrees up to which the upper arm may be lifted sideways, and the forearm be turned outward about it, as they were
# recorded; and degrees that they never reach.
_LIFT, _OUTWARD = (9.0, 35.0), (-2.0, 27.0)
# Where the limit of the outward turn begins to count, or ends: degrees of the elbow's bend, of the upper arm sideways,
# and outward.
_BENT, _LIFTED, _BACK = (15.0, 40.0), (30.0, 60.0), (110.0, 160.0)
# Standard deviation of the low pass of the limits' turns, seconds.
_SMOOTH = 0.06
# Degrees that the bend of an elbow is clipped to where the lever of the hand about the upper arm is taken.
_LEVER = (38.0, 142.0)
# Most rounds in which hands are turned out of the trunk, the factor on the turn, and seconds by which it begins before
# and ends after the touch.
_TRIES, _AMPLE, _WIDE = 6, 1.3, 0.2
FOREARM, THICK = 0.25, 0.08
"""Metres, of the character."""


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
    flexion = np.where(flexion > 0.0, _FLEXED * np.tanh(flexion / _FLEXED), _EXTENDED * np.tanh(flexion / _EXTENDED))
    aside = _ASIDE * (velocity * thumb).sum(axis=1)
    return flexion, _DEVIATED * np.tanh(aside / _DEVIATED)


def subject_of(stem: str) -> str:
    """"cmu_18" of "cmu_18_08"; "" for a take of another source."""
    return "_".join(stem.split("_")[:2]) if stem.startswith("cmu_") else ""


def mended(stem: str, rotations: Array) -> Array:
    """Local rotations [T, J, 4] (60 fps) of a take by its file's stem; those of another source are returned as they
    are."""
    turns = SUBJECTS.get(subject_of(stem))
    return rotations if turns is None else freed(turned(rotations, turns))


def turned(rotations: Array, turns: Mapping[str, float]) -> Array:
    """Local rotations [T, J, 4] with the planes of the elbows turned inward, side -> degrees."""
    out = rotations.copy()
    for side, degrees in turns.items():
        elbow, about = CHARACTER.index(side + "ForeArm"), _about_bone(np.radians(degrees))
        out[:, elbow] = rotation.multiply(rotation.multiply(about, out[:, elbow]), rotation.conjugate(about))
    return out


def narrowed(rotations: Array) -> Array:
    """Local rotations [T, J, 4] of arms that a standing speaker would hold: upper arms are lowered where they are
    lifted sideways, turned inward about their length where the forearm points outward, and hands turned out of the
    trunk. An angle a over f becomes f + (m - f) tanh((a - f) / (m - f)), which is under m. Turned about an arm that is
    lifted sideways, the forearm goes up and down: that is left, as is a straight arm, which has no such angle."""
    out = rotations.copy()
    for side in SIDES:
        arm = _arm(out, side)
        _swing(out, side, _smooth(_excess(arm.lifted, *_LIFT)))
        arm = _arm(out, side)
        _twist(out, side, _smooth(_excess(arm.outward, *_OUTWARD) * arm.defined))
    return freed(out)


def wide(rotations: Array) -> Array:
    """[T] whether a wrist is farther outside its elbow than the forearm is thick."""
    return np.any([_arm(rotations, side).fore[:, 0] * FOREARM > THICK for side in SIDES], axis=0)


def _excess(angle: Array, free: float, most: float) -> Array:
    """What a soft limit takes off angles [T]."""
    over = np.maximum(angle - free, 0.0)
    return over - (most - free) * np.tanh(over / (most - free))


def _smooth(angle: Array) -> Array:
    return gaussian_filter1d(angle, _SMOOTH * FPS, mode="nearest")


def freed(rotations: Array) -> Array:
    """Local rotations [T, J, 4] with upper arms turned outward about their length where the hand is in the trunk."""
    out = rotations
    for _ in range(_TRIES):
        places = facing_positions(out)
        low, high = np.zeros_like(places[:, 0]), places[:, CHARACTER.index("Spine3")]
        turns = {}
        for side in SIDES:
            depth = capsule_depth(places[:, CHARACTER.index(side + "Hand")], low, high, TORSO_RADIUS)
            if depth.max() > 0.0:
                lever = FOREARM * np.sin(np.radians(np.clip(_arm(out, side).bend, *_LEVER)))
                near = maximum_filter1d(np.degrees(_AMPLE * depth / lever), 2 * round(_WIDE * FPS) + 1)
                turns[side] = gaussian_filter1d(near, 0.5 * _WIDE * FPS, mode="nearest")
        if not turns:
            break
        out = out.copy()
        for side, outward in turns.items():
            _twist(out, side, -outward)
    return out


def _twist(rotations: Array, side: str, inward: Array) -> None:
    """Turn an upper arm inward about its length by degrees [T], in place."""
    joint = CHARACTER.index(side + "Arm")
    rotations[:, joint] = rotation.multiply(rotations[:, joint], _about_bone(np.radians(inward)))


def _swing(rotations: Array, side: str, down: Array) -> None:
    """Swing an upper arm down towards the body about the axis ahead of the chest by degrees [T], in place."""
    joint = CHARACTER.index(side + "Arm")
    world = kinematics.global_rotations(CHARACTER, rotations[:, :len(CHARACTER)])
    chest, collar = (world[:, CHARACTER.index(name)] for name in ("Spine3", side + "Shoulder"))
    half = -_OUT[side] * np.radians(down) / 2.0
    about = np.stack([np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)], axis=-1)
    about = rotation.multiply(rotation.multiply(chest, about), rotation.conjugate(chest))
    swung = rotation.multiply(about, world[:, joint])
    rotations[:, joint] = rotation.multiply(rotation.conjugate(collar), swung)


def _about_bone(angle: Array | float) -> Array:
    """[..., 4] rotations about x by angles in radians."""
    half = np.asarray(angle) / 2.0
    return np.stack([np.cos(half), np.sin(half), 0.0 * half, 0.0 * half], axis=-1)


@dataclass(frozen=True)
class _Arm:
    """Directions [T, 3] of the upper arm and the forearm of a side, as seen from the chest: outward, up (vertical),
    ahead."""

    upper: Array
    fore: Array

    @property
    def bend(self) -> Array:
        """[T] degrees."""
        return np.degrees(np.arccos(np.clip((self.upper * self.fore).sum(axis=1), -1.0, 1.0)))

    @property
    def outward(self) -> Array:
        """[T] degrees by which the forearm is turned outward from ahead, about the upper arm."""
        out = _square(np.array([1.0, 0.0, 0.0]), self.upper)
        return np.degrees(np.arctan2((self.fore * out).sum(axis=1),
                                     (self.fore * np.cross(self.upper, out)).sum(axis=1)))

    @property
    def lifted(self) -> Array:
        """[T] degrees by which the upper arm points sideways."""
        return np.degrees(np.arcsin(np.clip(self.upper[:, 0], -1.0, 1.0)))

    @property
    def defined(self) -> Array:
        """[T] from 0 to 1: how far `outward` is what an onlooker sees."""
        return _ramp(self.bend, *_BENT) * (1.0 - _ramp(self.lifted, *_LIFTED)) \
            * (1.0 - _ramp(np.abs(self.outward), *_BACK))


def _square(vector: Array, to: Array) -> Array:
    """[T, 3] the part of a vector that is square to unit vectors [T, 3], of length 1."""
    part = vector - (to @ vector)[:, None] * to
    return part / np.maximum(np.linalg.norm(part, axis=-1, keepdims=True), 1e-9)


def _ramp(values: Array, low: float, high: float) -> Array:
    """Smoothly from 0 at low to 1 at high."""
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def _arm(rotations: Array, side: str) -> _Arm:
    world = kinematics.global_rotations(CHARACTER, rotations[:, :len(CHARACTER)])
    across = rotation.rotate(world[:, CHARACTER.index("Spine3")], np.array([1.0, 0.0, 0.0])) * [1.0, 0.0, 1.0]
    across = across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
    ahead = np.cross(across, np.array([0.0, 1.0, 0.0]))
    along = np.array([_OUT[side], 0.0, 0.0])
    bones = []
    for name in ("Arm", "ForeArm"):
        bone = rotation.rotate(world[:, CHARACTER.index(side + name)], along)
        bones.append(np.stack([_OUT[side] * (bone * across).sum(axis=-1), bone[:, 1], (bone * ahead).sum(axis=-1)],
                              axis=-1))
    return _Arm(bones[0], bones[1])
