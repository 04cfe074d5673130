"""A body that sits: an arm that swings through its thighs, and how far hands are out of them."""

from __future__ import annotations

import numpy as np

from data_module.motion import rotation
from data_module.motion.skeletons import FINGERED, SIDES
from data_module.types import Array, Motion
from gesticulator.contacts.surfaces import FINGERTIPS, OUR_RADII

FPS = 60.0
PARTS = ("Hand", "HandMiddle1", *FINGERTIPS)
WAY = 0.3 - 0.9 * np.cos(2.0 * np.pi * np.arange(120) / 120)
"""Radians by which an arm swings ahead and back in two seconds."""


def swung(ahead: Array, across: float = -1.75, elbow: float = 0.1) -> Motion:
    """A left arm that hangs over the thigh and is swung ahead by `ahead` [T], radians; on the fingered skeleton."""
    turns = np.zeros((len(ahead), len(FINGERED), 4))
    turns[..., 0] = 1.0
    down = rotation.from_exponential_map(np.tile([0.0, 0.0, across], (len(ahead), 1)))
    swing = rotation.from_exponential_map(ahead[:, None] * [-1.0, 0.0, 0.0])
    turns[:, FINGERED.index("LeftArm")] = rotation.multiply(swing, down)
    turns[:, FINGERED.index("LeftForeArm")] = rotation.from_exponential_map(np.tile([0.0, -elbow, 0.0],
                                                                                    (len(ahead), 1)))
    turns[:, FINGERED.index("RightArm")] = rotation.from_exponential_map(np.tile([0.0, 0.0, 0.6], (len(ahead), 1)))
    return Motion(FINGERED, turns, np.zeros((len(ahead), 3)), FPS)


def out_of_thighs(places: Array, at: dict[str, int], radii: tuple[float, float] = OUR_RADII) -> Array:
    """[T] metres from tapering round thighs to the nearest joint of a hand: the distance from the line of the bone."""
    gaps = []
    for side in SIDES:
        hip, knee = places[:, at[side + "UpLeg"]], places[:, at[side + "Leg"]]
        bone = knee - hip
        for joint in [other + part for other in SIDES for part in PARTS if other + part in at]:
            way = places[:, at[joint]] - hip
            share = np.clip(np.sum(way * bone, axis=1) / np.sum(bone ** 2, axis=1), 0.0, 1.0)
            gaps.append(np.linalg.norm(way - share[:, None] * bone, axis=1) - np.interp(share, [0.0, 1.0], radii))
    return np.min(gaps, axis=0)
