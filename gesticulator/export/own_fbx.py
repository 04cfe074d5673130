"""Animates a character's own FBX file through Blender, which keeps mesh, skin and materials."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from data_module.files import write_bytes
from data_module.motion import rotation
from gesticulator.characters.blender import run_in_blender
from gesticulator.characters.rig import CharacterMotion
from gesticulator.export.clip import ClipLayout
from gesticulator.export.scene import Scene

SCRIPT = Path(__file__).with_name("fbx_child.py")


def own_character(scene: Scene) -> CharacterMotion | None:
    """The scene's character if it came from FBX."""
    character = scene.character
    return character if character is not None and character.character.kind == "fbx" else None


def write_animated(path: Path, moved: CharacterMotion, clip: ClipLayout) -> Path:
    """Write the character's file with our animation as `.glb` or `.fbx`, atomically. Returns `path`.

    Animations in the file are omitted. `InputError` without Blender or if it fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        target, motion = Path(folder) / f"out{path.suffix.lower()}", Path(folder) / "motion.npz"
        np.savez(motion, **pose(moved))
        run_in_blender(path, SCRIPT, str(moved.character.path.resolve()), str(target), repr(moved.fps), str(motion))
        write_bytes(path, target.read_bytes())
    return path


def pose(moved: CharacterMotion) -> dict[str, Any]:
    """Bone poses as Blender defines them: relative to rest, in the bone's axes.

    names: [n] bones; turns: [T, n, 4] w first; hips: [1] the translated bone; shifts: [T, 3], empty for none.
    """
    character = moved.character
    nodes = [node for node in moved.moved if node]  # node 0 is the armature's object
    back = rotation.conjugate(character.rotations[nodes])
    shifts = np.zeros((0, 3))
    if moved.translations is not None:
        away = moved.translations - character.translations[moved.hips]
        shifts = rotation.rotate(rotation.conjugate(character.rotations[moved.hips]), away)
    return {"names": np.array([character.names[node] for node in nodes]),
            "turns": rotation.multiply(back, moved.rotations[:, nodes]),
            "hips": np.array([character.names[moved.hips]]), "shifts": shifts}
