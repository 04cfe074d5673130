"""Mirrored motion: left and right exchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_module.motion.skeletons import SIDES as SIDES
from data_module.types import Motion


def exchanged_joints(names: tuple[str, ...]) -> NDArray[np.int64]:
    """[J] index of each joint's counterpart on the other side."""
    other = dict(zip(SIDES, reversed(SIDES), strict=True))
    opposite = [next((other[side] + name[len(side):] for side in SIDES if name.startswith(side)), name)
                for name in names]
    return np.array([names.index(name) for name in opposite])


def mirrored_motion(motion: Motion) -> Motion:
    """The motion with left and right exchanged, exactly: mirroring twice gives the motion back."""
    swapped = exchanged_joints(motion.skeleton.names)
    return replace(motion, rotations=motion.rotations[:, swapped] * np.array([1.0, 1.0, -1.0, -1.0]),
                   root_positions=motion.root_positions * np.array([-1.0, 1.0, 1.0]))
