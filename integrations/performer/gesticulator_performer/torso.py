"""Where joints of the character are in the facing frame, and how deep arms are inside the trunk."""

from __future__ import annotations

import numpy as np

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array

FPS = 60.0
"""Frames per second of the performer's motion: twice that of the clips, so that a beat can be moved by half a frame."""
TORSO_RADIUS, ELBOW_RADIUS = 0.115, 0.13
"""Radius of the capsule from hips to chest that a hand (half the depth of an adult's chest) or an elbow may not enter,
metres."""


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
