"""Motion mirrored: left and right exchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_module.types import Motion

SIDES = ("Left", "Right")


def exchanged_joints(names: tuple[str, ...]) -> NDArray[np.int64]:
    """[J] for each joint the one on the other side."""
    other = {"Left": "Right", "Right": "Left"}
    theirs = [next((other[side] + name[len(side):] for side in SIDES if name.startswith(side)), name) for name in names]
    return np.array([names.index(name) for name in theirs])


def mirrored_motion(motion: Motion) -> Motion:
    """The motion with left and right exchanged, exactly: the mirror image of the mirror image is the motion."""
    swapped = exchanged_joints(motion.skeleton.names)
    return replace(motion, rotations=motion.rotations[:, swapped] * np.array([1.0, 1.0, -1.0, -1.0]),
                   root_positions=motion.root_positions * np.array([-1.0, 1.0, 1.0]))
