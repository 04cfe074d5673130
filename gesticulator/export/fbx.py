"""`.fbx`: the GLB converted by Blender; or a character's FBX file animated by it, with its mesh, skin and materials."""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.files import write_bytes
from data_module.motion import rotation
from data_module.types import Array
from gesticulator.characters.blender import run_in_blender
from gesticulator.characters.rig import CharacterMotion
from gesticulator.export.glb import write_glb
from gesticulator.export.gltf import ROTATION, WEIGHTS, FrameTrack, GltfDocument, open_gltf
from gesticulator.export.writers import Scene

if TYPE_CHECKING:
    from gesticulator.face.motion import FaceMotion

SCRIPT = Path(__file__).with_name("fbx_child.py")
_STILL = 1e-5
"""A shape key whose value never differs by more from that at rest needs no keys."""


def write_fbx(path: Path, scene: Scene) -> Path:
    """Write the motion as binary FBX, atomically. Returns `path`. `InputError` without Blender or if it fails.

    Of a character from FBX the animations in the file are omitted; with a face, the animation moves the shape keys,
    eyes and jaw that it has for one, too.
    """
    moved, clip = scene.character, scene.clip
    with tempfile.TemporaryDirectory() as folder:
        resting, motion, target = (Path(folder) / name for name in ("motion.glb", "motion.npz", "motion.fbx"))
        if moved is None or moved.character.kind != "fbx":
            # All frames: the keys are reduced once, by Blender's exporter, within the same bound.
            write_glb(resting, replace(scene, layout=replace(clip, keys=0.0)))
            run_in_blender(path, SCRIPT, str(resting), str(target), repr(scene.fps), repr(clip.keys), clip.name)
        else:
            source, poses = str(moved.character.path.resolve()), pose(moved)
            if scene.face is not None:
                run_in_blender(path, SCRIPT, source, str(resting))
                poses = _with_face(poses, resting, moved, scene.face)
            np.savez(motion, **poses)
            run_in_blender(path, SCRIPT, source, str(target), repr(moved.fps), repr(clip.keys), clip.name, str(motion))
        write_bytes(path, target.read_bytes())
    return path


def _face_tracks(file: Path, gltf: GltfDocument, moved: CharacterMotion, face: FaceMotion
                 ) -> list[FrameTrack]:
    """Tracks of the face in a GLB that Blender wrote of the character, as `gesticulator.export.face` makes them."""
    from gesticulator.characters.gltf_rig import read_gltf_character
    from gesticulator.export.face import FaceWarning, tracks_of

    if not gltf.document.get("skins"):
        warnings.warn(FaceWarning(f"{moved.character.path.name}: has no mesh on its bones, so it shows no face"),
                      stacklevel=4)
        return []
    character = read_gltf_character(file)
    bones = {name: node for node, name in enumerate(character.names) if character.skinned[node]}
    left, right = (bones[moved.character.names[moved.joints[joint]]] for joint in ("LeftArm", "RightArm"))
    return tracks_of(gltf, character, (left, right), face, moved.character.path.name)


def _with_face(poses: dict[str, Any], file: Path, moved: CharacterMotion, face: FaceMotion) -> dict[str, Any]:
    """Bone poses as of `pose` with those of the eyes and the jaw, and the values of shape keys.

    shape_meshes, shape_keys: [k] names of a mesh object and of a shape key of it; shape_values: [T, k].
    """
    gltf = open_gltf(file)
    nodes, names, turns = gltf.document["nodes"], poses["names"].tolist(), [poses["turns"]]
    shapes: list[tuple[str, str, Array]] = []
    for node, path, values in _face_tracks(file, gltf, moved, face):
        entry = nodes[node]
        assert isinstance(values, np.ndarray)
        if path == WEIGHTS:
            mesh = gltf.document["meshes"][entry["mesh"]]
            keys = mesh["extras"]["targetNames"]
            stills = mesh.get("weights", [0.0] * len(keys))
            shapes += [(entry["name"], key, column) for key, column, still in zip(
                keys, values.reshape(-1, len(keys)).T, stills, strict=True) if np.abs(column - still).max() > _STILL]
        elif path == ROTATION and entry["name"] in moved.character.names and entry["name"] not in names:
            # glTF's quaternions are w last, ours w first.
            rest = np.array(entry.get("rotation", [0.0, 0.0, 0.0, 1.0]))[[3, 0, 1, 2]]
            names.append(entry["name"])
            turns.append(rotation.multiply(rotation.conjugate(rest), values[:, [3, 0, 1, 2]].astype(float))[:, None])
    return poses | {"names": np.array(names), "turns": np.concatenate(turns, axis=1),
                    "shape_meshes": np.array([mesh for mesh, _, _ in shapes], dtype=str),
                    "shape_keys": np.array([key for _, key, _ in shapes], dtype=str),
                    "shape_values": np.array([column for _, _, column in shapes]).reshape(len(shapes), len(face)).T}


def pose(moved: CharacterMotion) -> dict[str, Any]:
    """Bone poses as Blender defines them: relative to rest, in the bone's axes.

    names: [n] bones; turns: [T, n, 4] w first; hips: [1] the translated bone; shifts: [T, 3], empty for none.
    """
    character = moved.character
    nodes = [node for node in moved.moved if node]  # node 0 is the armature's object
    # Blender's pose is relative to rest: q_pose = q_rest^-1 q_local.
    back = rotation.conjugate(character.rotations[nodes])
    shifts = np.zeros((0, 3))
    if moved.translations is not None:
        away = moved.translations - character.translations[moved.hips]
        shifts = rotation.rotate(rotation.conjugate(character.rotations[moved.hips]), away)
    return {"names": np.array([character.names[node] for node in nodes]),
            "turns": rotation.multiply(back, moved.rotations[:, nodes]),
            "hips": np.array([character.names[moved.hips]]), "shifts": shifts}
