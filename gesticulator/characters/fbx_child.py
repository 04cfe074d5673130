"""Run inside Blender: write the largest armature of an FBX file as JSON.

    python fbx_child.py IN.fbx OUT.json

It imports nothing from this package: Blender has its own Python.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any


def export_armature(source: str, target: str) -> None:
    """Import the file into an empty scene and write its armature object and bones, parents first."""
    import bpy  # type: ignore[import-not-found, unused-ignore]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.fbx(filepath=source, use_anim=False)
    armatures: list[Any] = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    nodes: list[dict[str, Any]] = []
    if armatures:
        armature = max(armatures, key=lambda thing: len(thing.data.bones))
        nodes.append({"name": armature.name, "parent": -1, "matrix": _rows(armature.matrix_world), "length": 0.0})
        at = {}
        todo: list[tuple[Any, int]] = [(bone, 0) for bone in reversed(armature.data.bones) if bone.parent is None]
        while todo:
            bone, parent = todo.pop()
            above = bone.parent.matrix_local.inverted() if bone.parent is not None else None
            local = bone.matrix_local if above is None else above @ bone.matrix_local
            at[bone.name] = len(nodes)
            nodes.append({"name": bone.name, "parent": parent, "matrix": _rows(local), "length": bone.length})
            todo += [(child, at[bone.name]) for child in reversed(bone.children)]
    Path(target).write_text(json.dumps(nodes), encoding="utf-8")


def _rows(matrix: Any) -> list[float]:
    return [float(value) for row in matrix for value in row]


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    export_armature(given[0], given[1])
