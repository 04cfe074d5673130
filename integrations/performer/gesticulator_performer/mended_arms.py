"""Arms of CMU's takes, turned back to where people hold them.

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
from data_module.types import Array
from gesticulator_performer.joints import FPS, TORSO_RADIUS, capsule_depth, facing_positions
from gesticulator_performer.tables import table

SIDES = ("Left", "Right")
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
