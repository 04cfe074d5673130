"""Run inside Blender: a picture of one frame of a file that was imported at the importer's defaults, and its joints.

    python blender_scene.py FILE.glb|fbx FPS FRAME OUT.png|- OUT.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any


def main(source: str, fps: str, frame: str, picture: str, told: str) -> None:
    """The places that are told are Blender's: metres, Z up; at rest and in the frame."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene: Any = bpy.context.scene
    scene.render.fps = int(fps)
    if source.endswith(".fbx"):
        bpy.ops.import_scene.fbx(filepath=source)
    else:
        bpy.ops.import_scene.gltf(filepath=source)
    armature = next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    for thing in bpy.data.objects:  # what the importer of glTF makes to draw bones with
        thing.hide_render = thing.type == "MESH" and thing.name.startswith("Icosphere")
    first = min(action.frame_range[0] for action in bpy.data.actions)
    scene.frame_set(round(first) + int(frame))
    bones = {bone.name: {"parent": bone.parent.name if bone.parent else "",
                         "rest": list(armature.matrix_world @ bone.bone.head_local),
                         "place": list(armature.matrix_world @ bone.head)} for bone in armature.pose.bones}
    Path(told).write_text(json.dumps(bones))
    if picture != "-":
        render(scene, picture)


def render(scene: Any, picture: str) -> None:
    """By Cycles, which needs no screen and no graphics card."""
    import bpy
    from mathutils import Vector

    bpy.ops.mesh.primitive_plane_add(size=30)
    bpy.context.object.is_shadow_catcher = True  # what lies behind her stays empty
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "AREA"))
    lamp.data.energy, lamp.data.size, lamp.location = 230.0, 2.0, (2.2, -2.6, 3.4)
    lamp.rotation_euler = (Vector((0, 0, 1.0)) - lamp.location).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(lamp)
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.75, 0.78, 0.8, 1.0)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.7
    scene.world = world
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location, camera.data.lens = (1.35, -3.6, 1.55), 53
    camera.rotation_euler = (Vector((0, 0, 0.93)) - camera.location).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.view_settings.view_transform = "Standard"
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 64, True
    scene.cycles.max_bounces = 3
    scene.render.film_transparent = True
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.resolution_x, scene.render.resolution_y = 480, 400
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.filepath = picture
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main(*(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]))
