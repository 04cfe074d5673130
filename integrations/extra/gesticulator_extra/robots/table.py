"""`.g1.csv`: joint angles of a Unitree G1 in MuJoCo's convention, one row per frame."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np

from data_module.files import write_text
from gesticulator.export.writers import Scene
from gesticulator_extra.robots.angles import to_robot
from gesticulator_extra.robots.g1 import NAMES

COLUMNS = ("time", "base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz", *NAMES)
"""time: seconds. base: position of the pelvis, metres (X ahead, Y left, Z up, floor at 0), and its rotation, a unit
quaternion. Then the 29 joints, radians. All but the first are `qpos` of the model in MuJoCo, in its order."""


class RobotWarning(UserWarning):
    """A motion that the robot can only approximate."""


def write_g1(path: Path, scene: Scene) -> Path:
    """Write the motion for a G1, atomically; a `RobotWarning` describes clipped motion. Returns `path`."""
    moved = to_robot(scene.motion)
    rows = np.concatenate([np.arange(len(moved))[:, None] / moved.fps, moved.places, moved.turns, moved.angles], axis=1)
    out = io.StringIO()
    out.write(",".join(COLUMNS) + "\n")
    np.savetxt(out, np.round(rows, 7) + 0.0, fmt="%.7f", delimiter=",")
    write_text(path, out.getvalue())
    note = moved.note()
    if note is not None:
        warnings.warn(RobotWarning(f"{path.name}: {note}"), stacklevel=1)
    return path
