"""`.npz`: SMPL-X poses at 30 frames per second, the format of the BEAT2 leaderboard."""

import io
from pathlib import Path

import numpy as np

from data_module.files import write_bytes
from data_module.motion.kinematics import resample
from data_module.motion.smplx import smplx_arrays
from gesticulator.export.writers import Scene

FPS = 30.0
"""Frames per second of BEAT2; the scene is resampled."""


def write_smplx(path: Path, scene: Scene) -> Path:
    """Write the motion as an SMPL-X file (`data_module.motion.smplx.smplx_arrays`), atomically."""
    # In memory first: the file appears whole or not at all.
    out = io.BytesIO()
    np.savez(out, **smplx_arrays(resample(scene.standing, FPS)))  # type: ignore[arg-type, unused-ignore]
    write_bytes(path, out.getvalue())
    return path
