"""`.glb`: the skeleton with a plain figure and one animation, or the user's character with the animation added."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.files import write_bytes
from gesticulator.characters.rig import CharacterMotion
from gesticulator.export.gltf import VERTICES, GltfDocument, Numbers, node_tree, open_gltf, transform
from gesticulator.export.nodes import NodeMotion
from gesticulator.export.own_fbx import write_animated
from gesticulator.export.scene import Scene
from gesticulator.export.stick_figure import figure

if TYPE_CHECKING:
    from data_module.face import FaceMotion

ANIMATION = "gesture"
"""Name of the added animation."""
_COLOUR = [0.24, 0.45, 0.47, 1.0]
"""Colour of the figure: linear red, green, blue, opacity."""


def write_glb(path: Path, scene: Scene) -> Path:
    """Write the motion as GLB, atomically. Returns `path`. An FBX character needs Blender."""
    character = scene.character
    if character is not None and character.character.kind == "fbx":
        return write_animated(path, character)
    is_glb = character is not None and character.character.kind == "glb"
    write_bytes(path, character_glb(character, scene.face) if character is not None and is_glb else
                skeleton_glb(scene.nodes))
    return path


def character_glb(moved: CharacterMotion, face: FaceMotion | None = None) -> bytes:
    """The character's file with one animation added: the bytes of a GLB file. With a face, the animation moves what the
    character has for one (`gesticulator.characters.face_rig`), too; if it has no mouth, a warning says so.

    Nothing else changes, except that animated nodes with a matrix get a translation, a rotation and a scale instead.
    Buffers and images in separate files are embedded.
    """
    character = moved.character
    gltf = open_gltf(character.path)
    for node in moved.moved:
        entry = gltf.document["nodes"][character.node_ids[node]]
        if entry.pop("matrix", None) is not None:
            entry |= transform(character.translations[node], character.rotations[node], character.scales[node])
    shifts = {} if moved.translations is None else {moved.hips: moved.translations}
    motion = NodeMotion(character.names, character.parents, character.translations, character.rotations,
                        character.scales, moved.rotations, shifts, {}, moved.fps)
    more: list[tuple[int, str, Numbers]] = []
    if face is not None:
        from gesticulator.export.face import character_tracks

        more = character_tracks(gltf, moved, face)
    gltf.animate(ANIMATION, motion, {node: character.node_ids[node] for node in sorted({*moved.moved, *shifts})}, more)
    return gltf.to_bytes()


def skeleton_glb(motion: NodeMotion) -> bytes:
    """An animated skeleton with a figure of spindles: the bytes of a GLB file."""
    gltf = skeleton_document(motion)
    gltf.animate(ANIMATION, motion, {node: node for node in range(len(motion.names))})
    return gltf.to_bytes()


def skeleton_document(motion: NodeMotion) -> GltfDocument:
    """A skeleton at rest with a figure of spindles."""
    from gesticulator.version import __version__

    gltf = GltfDocument({
        "asset": {"version": "2.0", "generator": f"gesticulator {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [node for node, parent in enumerate(motion.parents) if parent < 0]}],
        "nodes": node_tree(motion),
    })
    _dress(gltf, motion)
    return gltf


def _dress(gltf: GltfDocument, motion: NodeMotion) -> None:
    """Attach the figure to the joints as a skin, which tools import as an armature."""
    body, bind = figure(motion), motion.rest_matrices()
    inverse = np.linalg.inv(bind)
    inverse[:, 3] = [0, 0, 0, 1]  # exactly, as the format requires
    joints = np.zeros((len(body.joints), 4), "<u2")
    joints[:, 0] = body.joints
    weights = np.zeros((len(body.joints), 4), "<f4")
    weights[:, 0] = 1.0
    document: dict[str, Any] = gltf.document
    document["skins"] = [{"name": "skeleton", "joints": list(range(len(motion.names))), "skeleton": 0,
                          "inverseBindMatrices": gltf.accessor(inverse.astype("<f4"))}]
    attributes = {
        "POSITION": gltf.accessor(body.positions.astype("<f4"), VERTICES, bounds=True),
        "NORMAL": gltf.accessor(body.normals.astype("<f4"), VERTICES),
        "JOINTS_0": gltf.accessor(joints, VERTICES),
        "WEIGHTS_0": gltf.accessor(weights, VERTICES),
    }
    document["meshes"] = [{"name": "figure", "primitives": [{"attributes": attributes, "material": 0}]}]
    document["materials"] = [{"name": "figure", "pbrMetallicRoughness": {
        "baseColorFactor": _COLOUR, "metallicFactor": 0.0, "roughnessFactor": 0.8}}]
    # Beside the skeleton, not in it: the position of a skinned mesh is defined by its joints alone.
    document["scenes"][0]["nodes"].append(len(document["nodes"]))
    document["nodes"].append({"name": "figure", "mesh": 0, "skin": 0})
