"""`.glb`: the skeleton with a plain figure and one animation, or the user's character with the animation added.

The figure is a visible body for a bare skeleton: one spindle of eight triangles per bone, in the world of the rest pose
(metres), each rigidly attached to its joint.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from data_module.files import write_bytes
from data_module.types import Array
from gesticulator.characters.rig import CharacterMotion
from gesticulator.export.clip import ClipLayout
from gesticulator.export.gltf import VERTICES, FrameTrack, GltfDocument, node_tree, open_gltf
from gesticulator.export.key_reduction import STEADY
from gesticulator.export.nodes import NodeMotion
from gesticulator.export.writers import Scene

if TYPE_CHECKING:
    from gesticulator.face.motion import FaceMotion

_COLOUR = [0.24, 0.45, 0.47, 1.0]
"""Colour of the figure: linear red, green, blue, opacity."""


def write_glb(path: Path, scene: Scene) -> Path:
    """Write the document of a scene as GLB, atomically. Returns `path`."""
    write_bytes(path, document_of(scene).to_bytes())
    return path


def document_of(scene: Scene) -> GltfDocument:
    """The motion as the last animation of a document, named after the clip.

    A character's file keeps everything; with a face, the animation moves what it has for one (`gesticulator.face.rig`),
    too, and a warning says so if it has no mouth. Other scenes are a skeleton with a figure of spindles.
    """
    character = scene.character
    if character is not None and character.character.kind == "glb":
        gltf = open_gltf(character.character.path)
        _add_character_clip(gltf, character, scene.clip, scene.face)
    else:
        if scene.face is not None:
            from gesticulator.export.face import FaceWarning

            warnings.warn(FaceWarning("a skeleton without a mesh shows no face; give a --character that has one"),
                          stacklevel=2)
        motion = scene.nodes
        gltf = skeleton_document(motion)
        steady = frozenset(node for node, name in enumerate(motion.names) if name in STEADY)
        gltf.animate(scene.clip, motion, {node: node for node in range(len(motion.names))
                                          if not (scene.clip.bare and node in steady)}, steady)
    return gltf


def _add_character_clip(gltf: GltfDocument, moved: CharacterMotion, clip: ClipLayout, face: FaceMotion | None) -> None:
    """Add the motion to the document of its character. Buffers and images in separate files have been embedded."""
    character = moved.character
    for node in moved.moved:
        gltf.split_matrix(character, node)
    if not gltf.document.get("skins"):  # the sign by which players take nodes for bones
        inside = character.under([moved.hips])
        gltf.document["skins"] = [{"joints": [character.node_ids[node] for node in np.flatnonzero(inside)]}]
    shifts = {} if moved.translations is None else {moved.hips: moved.translations}
    motion = NodeMotion(character.names, character.parents, character.translations, character.rotations,
                        moved.rotations, shifts, {}, moved.fps)
    more: list[FrameTrack] = []
    if face is not None:
        from gesticulator.export.face import tracks_of

        arms = moved.joints["LeftArm"], moved.joints["RightArm"]
        more = tracks_of(gltf, character, arms, face, character.path.name)
    gltf.animate(clip, motion, {node: character.node_ids[node] for node in sorted({*moved.moved, *shifts})},
                 frozenset(node for joint, node in moved.joints.items() if joint in STEADY), more)


def skeleton_document(motion: NodeMotion) -> GltfDocument:
    """A skeleton at rest with a figure of spindles."""
    from gesticulator.cli import __version__

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
    # Rigid skinning: each vertex follows one joint with weight 1.
    positions, normals, owners = figure(motion)
    inverse = np.linalg.inv(motion.rest_matrices())
    inverse[:, 3] = [0, 0, 0, 1]  # exactly, as the format requires
    joints = np.zeros((len(owners), 4), "<u2")
    joints[:, 0] = owners
    weights = np.zeros((len(owners), 4), "<f4")
    weights[:, 0] = 1.0
    document: dict[str, Any] = gltf.document
    document["skins"] = [{"name": "skeleton", "joints": list(range(len(motion.names))), "skeleton": 0,
                          "inverseBindMatrices": gltf.accessor(inverse.astype("<f4"))}]
    attributes = {
        "POSITION": gltf.accessor(positions.astype("<f4"), VERTICES, bounds=True),
        "NORMAL": gltf.accessor(normals.astype("<f4"), VERTICES),
        "JOINTS_0": gltf.accessor(joints, VERTICES),
        "WEIGHTS_0": gltf.accessor(weights, VERTICES),
    }
    document["meshes"] = [{"name": "figure", "primitives": [{"attributes": attributes, "material": 0}]}]
    document["materials"] = [{"name": "figure", "pbrMetallicRoughness": {
        "baseColorFactor": _COLOUR, "metallicFactor": 0.0, "roughnessFactor": 0.8}}]
    # Beside the skeleton, not in it: the position of a skinned mesh is defined by its joints alone.
    document["scenes"][0]["nodes"].append(len(document["nodes"]))
    document["nodes"].append({"name": "figure", "mesh": 0, "skin": 0})


_WIDEST = 0.14
"""Half width of a spindle as a share of its length."""
_MOST_HALF_WIDTH = 0.035
"""Largest half width, metres."""
_LEAST_BONE = 1e-4
"""Shorter bones are omitted, metres."""
_WIDEST_AT = 0.18
"""Position of the widest point along the bone."""
_SPINDLE_FACES = np.array([(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 1, 4), (5, 1, 2), (5, 2, 3), (5, 3, 4), (5, 4, 1)])


def figure(motion: NodeMotion) -> tuple[Array, Array, NDArray[np.int64]]:
    """The mesh of all bones of a skeleton at rest: positions and normals [V, 3] of V vertices, each in one triangle
    (flat shading), and the joint of each [V]; V = 0 if no bone has a length."""
    world = motion.rest_matrices()
    bones = [(parent, world[node, :3, 3]) for node, parent in enumerate(motion.parents) if parent >= 0]
    # Nodes without a child end in a tip (a fingertip, the crown of the head).
    bones += [(node, world[node, :3, :3] @ tip + world[node, :3, 3]) for node, tip in motion.tips.items()]
    corners, joints = [], []
    for joint, end in bones:
        start = world[joint, :3, 3]
        if np.linalg.norm(end - start) > _LEAST_BONE:
            corners.append(_spindle(start, end)[_SPINDLE_FACES])
            joints.append(joint)
    triangles = np.concatenate(corners) if corners else np.zeros((0, 3, 3))
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return (triangles.reshape(-1, 3), np.repeat(normals, 3, axis=0),
            np.repeat(np.array(joints, np.int64), 3 * len(_SPINDLE_FACES)))


def _spindle(start: Array, end: Array) -> Array:
    """[6, 3] the first point, four around the widest place, and the last."""
    way = end - start
    length = float(np.linalg.norm(way))
    along = way / length
    # The axis least parallel to the bone gives the best conditioned cross product.
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    up = np.cross(along, across)
    belly = start + way * _WIDEST_AT
    around = min(_WIDEST * length, _MOST_HALF_WIDTH) * np.array([across, up, -across, -up])
    return np.concatenate([start[None], belly + around, end[None]])
