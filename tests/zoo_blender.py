"""Run inside Blender: rigs of its add-on Rigify with a body of capsules, as GLB or FBX.

    python zoo_blender.py KIND META|DEF|ALL OUT.glb|OUT.fbx

KIND is a metarig of Rigify: human, basic_human, wolf, horse, cat, bird, ... META exports the metarig itself, DEF the
deforming bones of the generated rig, ALL the generated rig with its controls. It imports nothing from this project.
"""

from __future__ import annotations

import sys
from typing import Any


def main(kind: str, part: str, target: str) -> None:
    """Make the rig, give it a body, and write it."""
    import bpy  # type: ignore[import-not-found, unused-ignore]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module="rigify")
    getattr(bpy.ops.object, f"armature_{kind}_metarig_add")()
    rig = bpy.context.object
    if part != "META":
        bpy.ops.pose.rigify_generate()
        rig = bpy.context.object if bpy.context.object is not rig else next(
            thing for thing in bpy.data.objects if thing.type == "ARMATURE" and thing is not rig)
    names = [bone.name for bone in rig.data.bones if part == "META" or bone.name.startswith("DEF-")]
    body = _body(bpy, rig, names)
    for thing in bpy.data.objects:
        thing.select_set(thing in (rig, body))
    bpy.context.view_layer.objects.active = rig
    if target.endswith(".fbx"):
        bpy.ops.export_scene.fbx(filepath=target, use_selection=True, add_leaf_bones=False, bake_anim=False,
                                 use_armature_deform_only=part == "DEF")
    else:
        bpy.ops.export_scene.gltf(filepath=target, use_selection=True, export_animations=False,
                                  export_def_bones=part == "DEF")


def _body(bpy: Any, rig: Any, names: list[str]) -> Any:
    """A mesh of an octahedron around each bone, which alone moves it."""
    from mathutils import Vector  # type: ignore[import-not-found, unused-ignore]

    points: list[Any] = []
    faces: list[list[int]] = []
    groups: dict[str, list[int]] = {}
    for name in names:
        bone = rig.data.bones[name]
        start, end = bone.head_local, bone.tail_local
        way = end - start
        x = way.orthogonal().normalized() * max(0.12 * way.length, 0.004)
        y = way.normalized().cross(x)
        first, middle = len(points), start + 0.3 * way
        points += [start, end, middle + x, middle + y, middle - x, middle - y]
        for one, other in ((2, 3), (3, 4), (4, 5), (5, 2)):
            faces += [[first, first + other, first + one], [first + 1, first + one, first + other]]
        groups[name] = list(range(first, first + 6))
    mesh = bpy.data.meshes.new("Body")
    mesh.from_pydata([Vector(point) for point in points], [], faces)
    body = bpy.data.objects.new("Body", mesh)
    bpy.context.collection.objects.link(body)
    for name, rows in groups.items():
        body.vertex_groups.new(name=name).add(rows, 1.0, "REPLACE")
    body.parent = rig
    body.modifiers.new("Armature", "ARMATURE").object = rig
    return body


if __name__ == "__main__":
    main(*(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]))
