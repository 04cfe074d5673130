"""`.glb`: the skeleton as nodes with a plain figure on it, and one animation; or the user's own character, animated."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.files import write_bytes
from gesticulator.export.gltf import VERTICES, GltfDocument, node_tree, open_gltf, transform
from gesticulator.export.nodes import NodeMotion
from gesticulator.export.own_fbx import own_character, write_animated
from gesticulator.export.stick_figure import figure

if TYPE_CHECKING:
    from gesticulator.characters.rig import CharacterMotion
    from gesticulator.export.scene import Scene

ANIMATION = "gesture"
"""Name of the one animation that is added."""
_COLOUR = [0.24, 0.45, 0.47, 1.0]
"""Of the figure: linear red, green, blue, opacity."""


def write_glb(path: Path, scene: Scene) -> Path:
    """Write the motion as GLB, whole or not at all. Returns `path`. A character that came as FBX needs Blender."""
    from_fbx = own_character(scene)
    if from_fbx is not None:
        return write_animated(path, from_fbx)
    character = scene.character
    own = character is not None and character.character.kind == "glb"
    write_bytes(path, character_glb(character) if character is not None and own
                else skeleton_glb(scene.nodes))
    return path


def character_glb(moved: CharacterMotion) -> bytes:
    """The character's own file with one animation more: the bytes of a GLB file.

    Nothing else in it changes, apart from nodes that are moved and have a matrix, which becomes a translation, a
    rotation and a scale. Buffers and pictures that lie beside a .gltf are put inside.
    """
    character = moved.character
    gltf = open_gltf(character.path)
    for node in moved.moved:
        own = gltf.document["nodes"][character.node_ids[node]]
        if own.pop("matrix", None) is not None:
            own |= transform(character.translations[node], character.rotations[node], character.scales[node])
    shifts = {} if moved.translations is None else {moved.hips: moved.translations}
    motion = NodeMotion(character.names, character.parents, character.translations, character.rotations,
                        character.scales, moved.rotations, shifts, {}, moved.fps)
    gltf.animate(ANIMATION, motion, {node: character.node_ids[node] for node in sorted({*moved.moved, *shifts})})
    return gltf.to_bytes()


def skeleton_glb(motion: NodeMotion) -> bytes:
    """A skeleton with a figure of spindles on it, that moves: the bytes of a GLB file."""
    gltf = skeleton_document(motion)
    gltf.animate(ANIMATION, motion, {node: node for node in range(len(motion.names))})
    return gltf.to_bytes()


def skeleton_document(motion: NodeMotion) -> GltfDocument:
    """A skeleton at rest with a figure of spindles on it."""
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
    """Hang the figure on the joints, as a skin: what tools take for an armature."""
    body, bind = figure(motion), motion.rest_matrices()
    inverse = np.linalg.inv(bind)
    inverse[:, 3] = [0, 0, 0, 1]  # to the last bit, as the format asks for
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
    # Beside the skeleton, not in it: where a skinned mesh stands is told by its joints alone.
    document["scenes"][0]["nodes"].append(len(document["nodes"]))
    document["nodes"].append({"name": "figure", "mesh": 0, "skin": 0})
