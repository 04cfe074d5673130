"""Animates a character's own FBX file through Blender, which keeps mesh, skin and materials."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from data_module.files import write_bytes
from data_module.motion import rotation
from gesticulator.characters.blender import job_in_blender
from gesticulator.characters.rig import CharacterMotion
from gesticulator.export.clip import STEADY, ClipLayout
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
        source = str(moved.character.path.resolve())
        if target.suffix == ".glb":
            job_in_blender(path, SCRIPT, source, str(target))
            write_bytes(path, _animated_glb(target, moved, clip))
            return path
        np.savez(motion, **pose(moved))
        job_in_blender(path, SCRIPT, source, str(target), repr(moved.fps), repr(clip.keys), clip.name, str(motion))
        write_bytes(path, target.read_bytes())
    return path


def _animated_glb(file: Path, moved: CharacterMotion, clip: ClipLayout) -> bytes:
    """A GLB that Blender wrote of the character at rest, with the animation added: its bones have the axes of
    Blender's, so that poses relative to rest are the same."""
    from gesticulator.export.gltf import open_gltf
    from gesticulator.export.nodes import NodeMotion

    gltf, poses = open_gltf(file), pose(moved)
    nodes = gltf.document["nodes"]
    bones = {nodes[node]["name"]: node for skin in gltf.document.get("skins", []) for node in skin["joints"]}
    names = [name for name in poses["names"].tolist() if name in bones]
    rows = [poses["names"].tolist().index(name) for name in names]
    rest = np.array([nodes[bones[name]].get("rotation", [0.0, 0.0, 0.0, 1.0]) for name in names])[:, [3, 0, 1, 2]]
    places = np.array([nodes[bones[name]].get("translation", [0.0, 0.0, 0.0]) for name in names])
    hips, shifts = poses["hips"].tolist()[0], {}
    if len(poses["shifts"]) and hips in names:
        at = names.index(hips)
        shifts[at] = places[at] + rotation.rotate(rest[at], poses["shifts"])
    turns = rotation.continuous(rotation.normalise(rotation.multiply(rest, poses["turns"][:, rows])))
    motion = NodeMotion(tuple(names), (-1,) * len(names), places, rest, np.ones_like(places), turns, shifts, {},
                        moved.fps)
    steady = frozenset(names.index(moved.character.names[node]) for joint, node in moved.joints.items()
                       if joint in STEADY and moved.character.names[node] in names)
    gltf.animate(clip, motion, {row: bones[name] for row, name in enumerate(names)}, steady)
    return gltf.to_bytes()


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
