"""Run inside Blender: an FBX file that stands otherwise than its mesh was bound; how far a mesh is from its bones.

    python blender_stance.py make IN.glb OUT.fbx
    python blender_stance.py measure IN.fbx OUT.fbx RESULT.json

`make` puts the armature into centimetres, the meshes under a turned and scaled node beside it, and turns, moves
and scales every bone of the file's pose. `measure` writes, for OUT.fbx, the volumes of the bones relative to the bind
pose, and the metres between its vertices and those of the mesh in IN.fbx that Blender's bones of OUT.fbx move by hand.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

FRAMES = (0, 4, 8)


def armature_and_meshes() -> tuple[Any, list[Any]]:
    """Of the scene."""
    import bpy

    armature = next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    return armature, sorted((thing for thing in bpy.data.objects if thing.type == "MESH" and thing.vertex_groups),
                            key=lambda thing: thing.name)


def make(source: str, target: str) -> None:
    """See above."""
    import bpy
    from mathutils import Euler, Matrix

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=source)
    armature, meshes = armature_and_meshes()
    for thing in [thing for thing in bpy.data.objects if thing not in (armature, *meshes)]:
        bpy.data.objects.remove(thing)
    armature.animation_data_clear()
    armature.data.transform(Matrix.Scale(100.0, 4))
    armature.scale = [scale / 100.0 for scale in armature.scale]
    aside = bpy.data.objects.new("Geometry", None)
    bpy.context.collection.objects.link(aside)
    aside.location, aside.rotation_euler, aside.scale = (0.3, 0.1, -0.2), (math.pi / 2, 0.0, 0.5), (0.5, 0.5, 0.5)
    bpy.context.view_layer.update()
    for mesh in meshes:
        world = mesh.matrix_world.copy()
        if mesh.parent is armature:
            mesh.data.transform(Matrix.Scale(100.0, 4))
        mesh.parent, mesh.matrix_parent_inverse = aside, aside.matrix_world.inverted()
        mesh.matrix_world = world
    for bone in armature.pose.bones:
        bone.rotation_mode = "QUATERNION"
        bone.rotation_quaternion = Euler((0.15, 0.1, -0.1)).to_quaternion()
        bone.location, bone.scale = (2.0, 0.0, 0.0), (1.1, 1.1, 1.1)
    bpy.context.view_layer.update()
    bpy.ops.export_scene.fbx(filepath=target, add_leaf_bones=False, bake_anim=False)


def opened(source: str) -> tuple[Any, list[Any], dict[str, np.ndarray]]:
    """The armature and meshes of a file, and the bind pose of its bones in the world."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = 25
    bpy.ops.import_scene.fbx(filepath=source)
    armature, meshes = armature_and_meshes()
    return armature, meshes, {bone.name: np.array(armature.matrix_world @ bone.matrix_local)
                              for bone in armature.data.bones}


def corners(mesh: Any) -> np.ndarray:
    """[V, 4] the vertices of a mesh as it is posed, in the world."""
    import bpy

    posed = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    flat = np.ones((len(posed.data.vertices), 4))
    flat[:, :3] = [vertex.co for vertex in posed.data.vertices]
    return flat @ np.array(posed.matrix_world).T


def measure(source: str, result: str, target: str) -> None:
    """See above."""
    import bpy

    armature, meshes, bound = opened(result)
    turned: dict[int, dict[str, np.ndarray]] = {}
    seen: dict[int, dict[str, np.ndarray]] = {}
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        turned[frame] = {bone.name: np.array(armature.matrix_world @ bone.matrix) for bone in armature.pose.bones}
        seen[frame] = {mesh.name: corners(mesh) for mesh in meshes}
    volumes = [float(np.linalg.det(turned[frame][name][:3, :3]) / np.linalg.det(bound[name][:3, :3]))
               for frame in FRAMES for name in bound]
    armature, meshes, bound = opened(source)
    for bone in armature.pose.bones:
        bone.matrix_basis.identity()
    bpy.context.view_layer.update()
    off = 0.0
    for mesh in meshes:
        names, rest = {group.index: group.name for group in mesh.vertex_groups}, corners(mesh)
        for frame in FRAMES:
            moved = {name: turned[frame][name] @ np.linalg.inv(bound[name]) for name in bound}
            for vertex in mesh.data.vertices:
                shares = [(entry.weight, moved[names[entry.group]]) for entry in vertex.groups if entry.weight > 0.0]
                whole = sum(weight for weight, _ in shares)
                place = sum(weight / whole * (matrix @ rest[vertex.index]) for weight, matrix in shares)
                off = max(off, float(np.linalg.norm((place - seen[frame][mesh.name][vertex.index])[:3])))
    Path(target).write_text(json.dumps({"volumes": [min(volumes), max(volumes)], "off": off, "meshes": len(meshes)}))


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    {"make": make, "measure": measure}[given[0]](*given[1:])
