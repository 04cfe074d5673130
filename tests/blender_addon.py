"""Run inside Blender: the add-on moves an armature to a recording; where the bones are then is written as JSON.

    python blender_addon.py RIG.glb|rigify SOUND PROGRAM FRAMES_PER_SECOND OUT.json
"""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

ADDON = Path(__file__).resolve().parent.parent / "integrations" / "blender" / "gesticulator_blender.py"


def main(rig: str, sound: str, program: str, fps: str, target: str) -> None:
    """Places are in Blender's metres, Z up."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    import addon_utils  # Blender's own, found once it runs

    scene = bpy.context.scene
    scene.render.fps = int(fps)
    spec = importlib.util.spec_from_file_location("gesticulator_blender", ADDON)
    addon = importlib.util.module_from_spec(spec)
    sys.modules["gesticulator_blender"] = addon
    spec.loader.exec_module(addon)
    addon.register()
    if rig == "rigify":
        if addon_utils.enable("rigify", default_set=True) is None:
            Path(target).write_text(json.dumps({"lacking": "this Blender has no Rigify"}))
            return
        bpy.ops.object.armature_human_metarig_add()
    else:
        bpy.ops.import_scene.gltf(filepath=rig)
    armature = next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    bpy.context.view_layer.objects.active = armature
    before = {thing.name for thing in bpy.data.objects}
    assert addon.GestureFromSpeech.poll(bpy.context)
    action = addon.gesture(armature, Path(sound), program, [], 10)
    assert {thing.name for thing in bpy.data.objects} == before, "what was made for the way is removed"
    editor = scene.sequence_editor
    strips = getattr(editor, "strips", None) or editor.sequences
    frames = []
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        frames.append({bone.name: list(armature.matrix_world @ bone.head) for bone in armature.pose.bones})
    Path(target).write_text(json.dumps({
        "frames": frames, "range": [scene.frame_start, scene.frame_end], "action": action.name,
        "strips": [[strip.type, strip.frame_start] for strip in strips]}))
    addon.unregister()


if __name__ == "__main__":
    main(*(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]))
