"""Blender add-on: recorded speech becomes an action on the selected armature.

Install this one file from disk (`Edit > Preferences > Add-ons > Install from Disk`), tell its preferences where the
`gesticulator` program is, select an armature, and run `Object > Animation > Gesture from Speech`. The armature's rig is
handed over as a small GLB, the motion comes back as one, and its keys become an action; frame rate, frame range and a
sound strip are set to go with it. The add-on itself needs nothing but Blender (4.2 or newer).
"""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper
from mathutils import Quaternion, Vector

bl_info = {
    "name": "Gesture from Speech",
    "author": "gesticulator",
    "version": (0, 1, 0),
    "blender": (4, 2, 0),
    "location": "Object > Animation > Gesture from Speech",
    "description": "Recorded speech in, gestures out, on the selected armature",
    "category": "Animation",
}

PROXY = "gesticulator proxy"
"""Name of the mesh that makes every bone part of a skin while the rig is handed over."""


# ---------------------------------------------------------------- handing the rig over

def export_rig(armature: Any, target: Path) -> None:
    """Write the armature at rest as GLB, with a triangle on each bone, so that all bones are joints of a skin."""
    bones = armature.data.bones
    mesh = bpy.data.meshes.new(PROXY)
    corners = [bone.head_local + Vector(away) * 0.01 for bone in bones for away in ((0, 0, 0), (1, 0, 0), (0, 0, 1))]
    mesh.from_pydata(corners, [], [(3 * k, 3 * k + 1, 3 * k + 2) for k in range(len(bones))])
    proxy = bpy.data.objects.new(PROXY, mesh)
    bpy.context.scene.collection.objects.link(proxy)
    proxy.parent = armature
    for index, bone in enumerate(bones):
        proxy.vertex_groups.new(name=bone.name).add([3 * index, 3 * index + 1, 3 * index + 2], 1.0, "REPLACE")
    proxy.modifiers.new("skin", "ARMATURE").object = armature
    selected, active = list(bpy.context.selected_objects), bpy.context.view_layer.objects.active
    pose = armature.data.pose_position
    try:
        armature.data.pose_position = "REST"
        _select([armature, proxy], armature)
        bpy.ops.export_scene.gltf(filepath=str(target), use_selection=True, export_animations=False,
                                  export_rest_position_armature=True)
    finally:
        armature.data.pose_position = pose
        bpy.data.objects.remove(proxy)
        bpy.data.meshes.remove(mesh)
        _select(selected, active)


def _select(things: list[Any], active: Any) -> None:
    bpy.context.view_layer.update()  # what was just removed is still listed otherwise
    for thing in bpy.context.view_layer.objects:
        if thing is not None:
            thing.select_set(thing in things)
    bpy.context.view_layer.objects.active = active


# ---------------------------------------------------------------- taking the motion

def read_motion(source: Path) -> tuple[list[float], dict[str, dict[str, Any]]]:
    """The times of the last animation of a GLB, and for each moved node its rest and its tracks.

    Node -> {"rest": {"translation", "rotation"}, "translation": [T, 3], "rotation": [T, 4] (w last)}.
    """
    data = source.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20:20 + length])
    binary = data[28 + length:]

    def numbers(index: int) -> Any:
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        return np.frombuffer(binary, "<f4", accessor["count"] * width, view.get("byteOffset", 0)).reshape(-1, width)

    animation = document["animations"][-1]
    moved: dict[str, dict[str, Any]] = {}
    for channel in animation["channels"]:
        node = document["nodes"][channel["target"]["node"]]
        own = moved.setdefault(node["name"], {"rest": node})
        own[channel["target"]["path"]] = numbers(animation["samplers"][channel["sampler"]]["output"])
    return numbers(animation["samplers"][0]["input"])[:, 0].tolist(), moved


def make_action(armature: Any, source: Path, name: str, start: int) -> Any:
    """The motion of a GLB as an action of the armature, from frame `start` on; the action.

    Bones of glTF have the axes of Blender's own, so a pose is what turns the rest into the animated transform.
    """
    times, moved = read_motion(source)
    scene = bpy.context.scene
    rate = scene.render.fps / scene.render.fps_base
    armature.animation_data_create().action = bpy.data.actions.new(name)
    for bone_name, own in moved.items():
        bone = armature.pose.bones.get(bone_name)
        if bone is None:
            continue
        for constraint in bone.constraints:  # they would win over the keys
            constraint.mute = True
        x, y, z, w = own["rest"].get("rotation", (0, 0, 0, 1))
        rest = Quaternion((w, x, y, z))
        bone.rotation_mode = "QUATERNION"
        before = None
        for time, (x, y, z, w) in zip(times, own["rotation"].tolist(), strict=True):
            turn = rest.inverted() @ Quaternion((w, x, y, z))
            if before is not None and turn.dot(before) < 0:
                turn.negate()
            before = turn.copy()
            bone.rotation_quaternion = turn
            bone.keyframe_insert("rotation_quaternion", frame=start + time * rate)
        if "translation" in own:
            origin = Vector(own["rest"].get("translation", (0, 0, 0)))
            for time, place in zip(times, own["translation"].tolist(), strict=True):
                bone.location = rest.inverted() @ (Vector(place) - origin)
                bone.keyframe_insert("location", frame=start + time * rate)
    return armature.animation_data.action


def lay_sound(sound: Path, start: int) -> None:
    """A strip with the recording in the scene's sequencer, and playback that keeps to it."""
    scene = bpy.context.scene
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences  # renamed in Blender 4.4
    used = {strip.channel for strip in strips}
    strips.new_sound(sound.name, str(sound), next(k for k in range(1, 129) if k not in used), start)
    scene.sync_mode = "AUDIO_SYNC"


# ---------------------------------------------------------------- the operator

def program(told: str) -> str | None:
    """Where the `gesticulator` program is; None where it is not found."""
    return shutil.which(bpy.path.abspath(told) or "gesticulator")


def gesture(armature: Any, sound: Path, command: str, options: list[str], start: int) -> Any:
    """Move an armature to a recording; the action. RuntimeError with gesticulator's own message where it refuses."""
    scene = bpy.context.scene
    rate = scene.render.fps / scene.render.fps_base
    with tempfile.TemporaryDirectory() as folder:
        rig, motion = Path(folder) / "rig.glb", Path(folder) / "motion.glb"
        export_rig(armature, rig)
        done = subprocess.run([command, "infer", str(sound), "--character", str(rig), "-o", str(motion), "--fps",
                               f"{rate:g}", "--quiet", *options], capture_output=True, text=True, check=False)
        if done.returncode:
            said = done.stderr.strip().splitlines()
            raise RuntimeError(said[-1] if said else f"gesticulator ended with {done.returncode}")
        action = make_action(armature, motion, f"gesture {sound.stem}", start)
    lay_sound(sound, start)
    scene.frame_start, scene.frame_end = start, max(start, round(action.frame_range[1]))
    return action


class GestureFromSpeech(bpy.types.Operator, ImportHelper):
    """Move the selected armature to a recorded voice."""

    bl_idname = "object.gesture_from_speech"
    bl_label = "Gesture from Speech"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - as Blender asks for it

    filter_glob: StringProperty(default="*.wav;*.flac;*.ogg;*.mp3", options={"HIDDEN"})  # type: ignore[valid-type]
    stance: EnumProperty(name="Body", items=[  # type: ignore[valid-type]
        ("STANDING", "Standing", "She stands on her legs and shifts her weight"),
        ("SEATED", "Seated", "Hips and legs stay as they rest")])
    seed: IntProperty(name="Seed", min=0, description="Another take of the same speech")  # type: ignore[valid-type]
    start: IntProperty(name="First frame", default=1)  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Whether an armature is active."""
        return context.object is not None and context.object.type == "ARMATURE"

    def execute(self, context: Any) -> set[str]:
        """Do it; what gesticulator refuses is shown as it says it."""
        preferences = context.preferences.addons.get(__name__)
        command = program(preferences.preferences.program if preferences else "")
        if command is None:
            self.report({"ERROR"}, "gesticulator was not found: name the program in the add-on's preferences")
            return {"CANCELLED"}
        options = ["--seed", str(self.seed), *(["--seated"] if self.stance == "SEATED" else [])]
        try:
            action = gesture(context.object, Path(self.filepath), command, options, self.start)
        except (RuntimeError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{action.name}: {round(action.frame_range[1] - action.frame_range[0]) + 1} frames")
        return {"FINISHED"}


class GesticulatorPreferences(bpy.types.AddonPreferences):
    """Where the program is."""

    bl_idname = __name__
    program: StringProperty(name="gesticulator program", subtype="FILE_PATH",  # type: ignore[valid-type]
                            description="Found by its name where this is empty")

    def draw(self, context: Any) -> None:
        """One line: the path."""
        self.layout.prop(self, "program")


def _menu(self: Any, context: Any) -> None:
    self.layout.operator(GestureFromSpeech.bl_idname)


def register() -> None:
    """Called by Blender when the add-on is switched on."""
    bpy.utils.register_class(GesticulatorPreferences)
    bpy.utils.register_class(GestureFromSpeech)
    bpy.types.VIEW3D_MT_object_animation.append(_menu)


def unregister() -> None:
    """Called by Blender when the add-on is switched off."""
    bpy.types.VIEW3D_MT_object_animation.remove(_menu)
    bpy.utils.unregister_class(GestureFromSpeech)
    bpy.utils.unregister_class(GesticulatorPreferences)
