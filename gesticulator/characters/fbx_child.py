"""Run inside Blender: write the largest armature of an FBX file, and a sample of its meshes, as JSON.

    python fbx_child.py IN.fbx OUT.json

The script imports nothing from this package: Blender has its own Python.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

MOST_TRIANGLES = 6000
"""Most triangles written, evenly over each mesh."""


def export_armature(source: str, target: str) -> None:
    """Import the file into an empty scene and write its armature object and bones, parents first, and the meshes that
    the bones move: {"bones": [...], "points": [[x, y, z]], "joints": [[4 bones]], "weights", "triangles"}."""
    import bpy  # type: ignore[import-not-found, unused-ignore]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.fbx(filepath=source, use_anim=False)
    armatures: list[Any] = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    nodes: list[dict[str, Any]] = []
    if armatures:
        armature = max(armatures, key=lambda thing: len(thing.data.bones))
        nodes.append({"name": armature.name, "parent": -1, "matrix": _rows(armature.matrix_world), "length": 0.0})
        at = {}
        # Depth first with a stack: `reversed` keeps the file's order of siblings.
        todo: list[tuple[Any, int]] = [(bone, 0) for bone in reversed(armature.data.bones) if bone.parent is None]
        while todo:
            bone, parent = todo.pop()
            above = bone.parent.matrix_local.inverted() if bone.parent is not None else None
            local = bone.matrix_local if above is None else above @ bone.matrix_local
            at[bone.name] = len(nodes)
            nodes.append({"name": bone.name, "parent": parent, "matrix": _rows(local), "length": bone.length})
            todo += [(child, at[bone.name]) for child in reversed(bone.children)]
    skin: dict[str, list[Any]] = {"points": [], "joints": [], "weights": [], "triangles": []}
    if armatures:
        meshes = [thing for thing in bpy.data.objects if thing.type == "MESH" and any(
            modifier.type == "ARMATURE" and modifier.object == armature for modifier in thing.modifiers)]
        step = max(1, sum(len(thing.data.polygons) for thing in meshes) // MOST_TRIANGLES)
        for thing in meshes:
            _add_mesh(thing, at, step, skin)
    Path(target).write_text(json.dumps({"bones": nodes, **skin}), encoding="utf-8")


def _add_mesh(thing: Any, at: dict[str, int], step: int, skin: dict[str, list[Any]]) -> None:
    """Add every `step`-th polygon of a mesh, in the world of the rest pose, with its four largest weights."""
    bones = {group.index: at[group.name] for group in thing.vertex_groups if group.name in at}
    place: dict[int, int] = {}
    for polygon in list(thing.data.polygons)[::step]:
        rows = list(polygon.vertices)[:3]
        for vertex in rows:
            if vertex in place:
                continue
            influences = sorted(((entry.weight, bones[entry.group]) for entry in thing.data.vertices[vertex].groups
                            if entry.group in bones and entry.weight > 0.0), reverse=True)[:4]
            whole = sum(weight for weight, _ in influences)
            place[vertex] = len(skin["points"])
            skin["points"].append([float(value) for value in thing.matrix_world @ thing.data.vertices[vertex].co])
            skin["joints"].append([bone for _, bone in influences] + [0] * (4 - len(influences)))
            skin["weights"].append([weight / whole for weight, _ in influences] + [0.0] * (4 - len(influences))
                                   if whole else [1.0, 0.0, 0.0, 0.0])
        skin["triangles"].append([place[vertex] for vertex in rows])


def _rows(matrix: Any) -> list[float]:
    return [float(value) for row in matrix for value in row]


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    export_armature(*given)
