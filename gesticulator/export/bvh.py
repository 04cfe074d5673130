"""BVH of a performance: the format that every animation tool opens."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from data_module.motion import bvh
from data_module.motion.skeletons import HIP_HEIGHT
from data_module.types import Motion
from gesticulator.performance import Performance


def standing(motion: Motion) -> Motion:
    """The motion lifted (or lowered) so that the root's median height is `HIP_HEIGHT`; doing it twice changes nothing.

    Models work with the root at the origin; a viewer's floor is at zero.
    """
    lift = np.array([0.0, HIP_HEIGHT - float(np.median(motion.root_positions[:, 1])), 0.0])
    return replace(motion, root_positions=motion.root_positions + lift)


def write_bvh_file(path: Path, performance: Performance) -> Path:
    """Write the motion, standing on the floor, at its own frame rate. Returns `path`."""
    bvh.write_bvh(path, standing(performance.motion))
    return path
