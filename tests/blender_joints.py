"""Run inside Blender: import a file as a user would, and write where the joints are in every frame, as JSON.

    python blender_joints.py FILE FRAMES_PER_SECOND OUT.json [importer settings as JSON]
"""

import json
import os
import sys
from pathlib import Path


def main(source: str, fps: str, target: str, settings: str = "{}") -> None:
    """Places are in Blender's metres, Z up."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = round(float(fps))
    {".bvh": bpy.ops.import_anim.bvh, ".glb": bpy.ops.import_scene.gltf, ".fbx": bpy.ops.import_scene.fbx,
     ".usda": bpy.ops.wm.usd_import, ".usdc": bpy.ops.wm.usd_import}[Path(source).suffix](
        filepath=source, **json.loads(settings))
    armature = next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    first, last = (round(end) for end in armature.animation_data.action.frame_range)
    frames = []
    for frame in range(first, last + 1):
        scene.frame_set(frame)
        frames.append({bone.name: list(armature.matrix_world @ bone.head) for bone in armature.pose.bones})
    meshes = {thing.name: len(thing.data.vertices) for thing in bpy.data.objects if thing.type == "MESH"}
    told = {"frames": frames, "scale": list(armature.matrix_world.to_scale()), "meshes": meshes,
            "height": max((armature.matrix_world @ bone.head_local).z for bone in armature.data.bones)}
    Path(target).write_text(json.dumps(told))


if __name__ == "__main__":
    main(*(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]))
    os._exit(0)  # Blender as a Python module may crash while it is torn down
