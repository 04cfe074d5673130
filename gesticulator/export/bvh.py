"""BVH of a performance: the format that every animation tool opens."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from data_module.motion import bvh
from data_module.motion.skeletons import standing

if TYPE_CHECKING:
    from gesticulator.performance import Performance


def write_bvh_file(path: Path, performance: Performance) -> Path:
    """Write the motion, standing on the floor, at its own frame rate. Returns `path`."""
    bvh.write_bvh(path, standing(performance.motion))
    return path
