"""`.fbx`: the GLB converted by Blender; or a character's FBX file with the animation added."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from data_module.files import write_bytes
from gesticulator.characters.blender import run_in_blender
from gesticulator.export.glb import write_glb
from gesticulator.export.own_fbx import SCRIPT, own_character, write_animated
from gesticulator.export.writers import Scene


def write_fbx(path: Path, scene: Scene) -> Path:
    """Write the motion as binary FBX, atomically. Returns `path`. `InputError` without Blender or if it fails."""
    character = own_character(scene)
    if character is not None:
        return write_animated(path, character, scene.clip, scene.face)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "motion.glb", Path(folder) / "motion.fbx"
        # All frames: the keys are reduced once, by Blender's exporter, within the same bound.
        write_glb(source, replace(scene, layout=replace(scene.clip, keys=0.0)))
        run_in_blender(path, SCRIPT, str(source), str(target), repr(scene.fps), repr(scene.clip.keys), scene.clip.name)
        write_bytes(path, target.read_bytes())
    return path
