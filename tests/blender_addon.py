"""Run inside Blender: the add-on moves an armature to a recording; where the bones are then is written as JSON.

    python blender_addon.py RIG.glb|metarig|rigify SOUND PROGRAM FRAMES_PER_SECOND OUT.json
"""

import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

ADDON = Path(__file__).resolve().parent.parent / "integrations" / "blender" / "gesticulator_blender" / "__init__.py"


def curves_of(action: Any) -> list[Any]:
    """The curves of an action, which has layers since Blender 4.4."""
    if not getattr(action, "layers", None):
        return list(action.fcurves)
    return [curve for layer in action.layers for strip in layer.strips for bag in strip.channelbags
            for curve in bag.fcurves]


def refuses_a_rig_without_fk(addon: Any, rig: Any) -> None:
    """What cannot be moved is told in one line, before anything is made."""
    rig.data.bones["forearm_fk.L"].name = "taken away"
    said = ""
    try:
        addon.is_generated(rig)
    except RuntimeError as error:
        said = str(error)
    finally:
        rig.data.bones["taken away"].name = "forearm_fk.L"
    assert "lacks forearm_fk.L" in said


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
    if rig in ("metarig", "rigify"):
        if addon_utils.enable("rigify", default_set=True) is None:
            Path(target).write_text(json.dumps({"lacking": "this Blender has no Rigify"}))
            return
        bpy.ops.object.armature_human_metarig_add()
        if rig == "rigify":
            metarig = bpy.context.object
            bpy.ops.pose.rigify_generate()
            bpy.data.objects.remove(metarig)
            refuses_a_rig_without_fk(addon, bpy.context.object)
    else:
        bpy.ops.import_scene.gltf(filepath=rig)
    armature = next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    bpy.context.view_layer.objects.active = armature
    before = {thing.name for thing in bpy.data.objects}
    armatures = len(bpy.data.armatures)
    assert addon.GestureFromSpeech.poll(bpy.context)
    addon.gesture(armature, Path(sound), program, ["--seed", "7"], 3)
    action = addon.gesture(armature, Path(sound), program, [], 10)  # replaces the sound strip of the first
    cancelled = addon.GestureJob(armature, Path(sound), program, [], 10)
    cancelled.begin()
    assert cancelled.runs
    cancelled.cancel()
    assert not cancelled.runs
    assert {thing.name for thing in bpy.data.objects} == before, "what was made for the way is removed"
    assert len(bpy.data.armatures) == armatures
    editor = scene.sequence_editor
    strips = getattr(editor, "strips", None) or editor.sequences
    frames = []
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        frames.append({bone.name: list(armature.matrix_world @ bone.head) for bone in armature.pose.bones})
    Path(target).write_text(json.dumps({
        "frames": frames, "range": [scene.frame_start, scene.frame_end], "action": action.name,
        "keyed": sorted({curve.data_path.split('"')[1] for curve in curves_of(action)}),
        "strips": [[strip.type, strip.frame_start] for strip in strips]}))
    addon.unregister()


if __name__ == "__main__":
    main(*(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]))
