"""`.fbx`: the GLB, converted by Blender in a process of its own."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.files import write_bytes
from data_module.motion.kinematics import resample
from gesticulator.export.blender import run_in_blender
from gesticulator.export.glb import write_glb

if TYPE_CHECKING:
    from gesticulator.performance import Performance

SCRIPT = Path(__file__).with_name("fbx_child.py")


def write_fbx(path: Path, performance: Performance) -> Path:
    """Write the motion as binary FBX, whole or not at all. Returns `path`.

    Blender keeps whole frames per second alone: another rate is brought to the nearest. `InputError` where there is no
    Blender, or it fails.
    """
    rate = max(1, round(performance.fps))
    if performance.fps != rate:
        performance = replace(performance, motion=resample(performance.motion, float(rate)))
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "motion.glb", Path(folder) / "motion.fbx"
        write_glb(source, performance)
        run_in_blender(path, SCRIPT, str(source), str(target), str(rate))
        write_bytes(path, target.read_bytes())
    return path
