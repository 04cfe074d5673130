"""`.vrma`: a motion for any VRM character (VRMC_vrm_animation 1.0), a GLB without a mesh.

It animates the bones of the VRM humanoid, with a T-pose at rest, and the position of the hips, which players scale by
the height of the character's hips. Our four spine joints become `spine` and `chest`: `upperChest` is not used, since a
character may lack it, and rotations of a missing bone would be lost with everything attached to it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data_module.files import write_bytes
from data_module.motion.kinematics import copied_rotations
from data_module.motion.skeletons import LEG_JOINTS, WHOLE_BODY
from data_module.types import Array, Motion
from gesticulator.characters.joints import VRM_BONES
from gesticulator.export.clip import ClipLayout
from gesticulator.export.gltf import FrameTrack, GltfDocument, node_tree
from gesticulator.export.nodes import NodeMotion, of_motion
from gesticulator.export.writers import Scene

if TYPE_CHECKING:
    from gesticulator.face.motion import FaceMotion

EXTENSION = "VRMC_vrm_animation"
# Bone of the humanoid -> parent bone, our joints whose world rotations it takes, and the joint where it begins.
_TRUNK: dict[str, tuple[str | None, tuple[str, ...], str]] = {
    "hips": (None, ("Hips",), "Hips"),
    "spine": ("hips", ("Spine", "Spine1"), "Spine"),
    "chest": ("spine", ("Spine3",), "Spine2"),
    "neck": ("chest", ("Neck",), "Neck"),
    "head": ("neck", ("Head",), "Head"),
}


def _bones() -> dict[str, tuple[str | None, tuple[str, ...], str]]:
    table = dict(_TRUNK)
    for joint, bone in VRM_BONES.items():
        if bone not in table:
            above = WHOLE_BODY.names[WHOLE_BODY.parents[WHOLE_BODY.index(joint)]]
            table[bone] = VRM_BONES.get(above, "chest"), (joint,), joint
    return table


BONES = _bones()
"""Bone of the VRM humanoid -> parent bone, our joints whose world rotations it takes, and the joint where it begins."""


def write_vrma(path: Path, scene: Scene) -> Path:
    """Write the motion as a VRM animation, atomically. Returns `path`."""
    write_bytes(path, vrm_animation(scene.standing, scene.clip, scene.face))
    return path


def vrm_animation(motion: Motion, clip: ClipLayout, face: FaceMotion | None = None) -> bytes:
    """The bytes of a .vrma file for a motion of our skeleton in any of its sizes. Joints that the motion lacks are
    omitted, so that a character keeps its rest pose or another animation there. With a face, there are tracks for the
    expressions and the gaze."""
    from gesticulator.cli import __version__

    nodes = humanoid(motion)
    gltf = GltfDocument({
        "asset": {"version": "2.0", "generator": f"gesticulator {__version__}"},
        "extensionsUsed": [EXTENSION],
        "extensions": {EXTENSION: {"specVersion": "1.0", "humanoid": {
            "humanBones": {bone: {"node": node} for node, bone in enumerate(nodes.names)}}}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": node_tree(nodes),
    })
    more: list[FrameTrack] = []
    if face is not None:
        from gesticulator.export.face import vrma_tracks

        more = vrma_tracks(gltf, gltf.document["extensions"][EXTENSION], face)
    # Errors of hips and legs add up at the feet, so their keys are held tighter.
    steady = frozenset(node for node, bone in enumerate(nodes.names) if BONES[bone][2] in ("Hips", *LEG_JOINTS))
    gltf.animate(clip, nodes, {node: node for node in range(len(nodes.names)) if not (clip.bare and node in steady)},
                 steady, more)
    return gltf.to_bytes()


def humanoid(motion: Motion) -> NodeMotion:
    """The motion on the bones of the VRM humanoid, with the names of the extension."""
    # A bone needs all of its joints; the others would take a pose that was never generated.
    there = set(motion.skeleton.names) - set(motion.absent)
    bones = {bone: row for bone, row in BONES.items() if set(row[1]) <= there}
    local = copied_rotations(motion, {bone: row[1] for bone, row in bones.items()},
                             {bone: row[0] for bone, row in bones.items()})
    nodes = of_motion(motion)
    rest = nodes.rest_matrices()[:, :3, 3]
    # VRM wants identity rotations at rest, so bones differ from their parents by offsets alone.
    names = tuple(bones)
    parents = tuple(-1 if above is None else names.index(above) for above, _, _ in bones.values())
    places: Array = np.array([rest[motion.skeleton.index(joint)] for _, _, joint in bones.values()])
    offsets = np.array([place - (places[parent] if parent >= 0 else 0.0)
                        for place, parent in zip(places, parents, strict=True)])
    identity = np.zeros((len(names), 4))
    identity[:, 0] = 1.0
    return NodeMotion(names, parents, offsets, identity, np.stack([local[name] for name in names], axis=1),
                      nodes.shifts, {}, nodes.fps)
