"""Blender add-on: recorded speech becomes an action on the selected armature.

Install this folder as an extension (docs/tools.md), name the `gesticulator` program in its preferences, select an
armature, and run `Object > Animation > Gesture from Speech`. The rig is handed over as a small GLB, the motion comes
back as one, and its keys become an action; frame rate, frame range and a sound strip are set to match. The add-on needs
only Blender (4.2 or newer). While the program runs, Blender can be used, and Esc cancels.

A rig that Rigify generated is moved by its FK controls: the bones that it was made of are handed over, and each control
turns as its bone does.
"""

from __future__ import annotations

import json
import math
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path
from time import monotonic
from typing import Any

import bpy
import numpy as np
from bpy.props import EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper
from mathutils import Matrix, Quaternion, Vector

ADDON = __package__ or __name__
"""The name under which Blender keeps the preferences: that of the package where this is an extension."""
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
    """The times of the first track of the last animation of a GLB, and for each moved node its rest and its tracks.

    Node -> {"rest": {"translation", "rotation"}, "translation": [T, 3], "rotation": [T, 4] (w last), and the seconds
    of each track: "translation times", "rotation times"}.
    """
    data = source.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20:20 + length])
    binary = data[28 + length:]

    def numbers(index: int) -> Any:
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return np.frombuffer(binary, "<f4", accessor["count"] * width, start).reshape(-1, width)

    animation = document["animations"][-1]
    moved: dict[str, dict[str, Any]] = {}
    for channel in animation["channels"]:
        node = document["nodes"][channel["target"]["node"]]
        own, sampler = moved.setdefault(node["name"], {"rest": node}), animation["samplers"][channel["sampler"]]
        path = channel["target"]["path"]
        own[path], own[f"{path} times"] = numbers(sampler["output"]), numbers(sampler["input"])[:, 0].tolist()
    return numbers(animation["samplers"][0]["input"])[:, 0].tolist(), moved


def make_action(armature: Any, source: Path, name: str, start: int) -> Any:
    """The motion of a GLB as an action of the armature, from frame `start` on; the action.

    Bones of glTF have the axes of Blender's own, so a pose is what turns the rest into the animated transform.
    """
    _, moved = read_motion(source)
    armature.animation_data_create().action = bpy.data.actions.new(name)
    for bone_name, own in moved.items():
        bone = armature.pose.bones.get(bone_name)
        if bone is None:
            continue
        for constraint in bone.constraints:  # they would win over the keys
            constraint.mute = True
        turns, shifts = pose_of(own)
        _key(bone, own["rotation times"], start, turns)
        if shifts is not None:
            _move(bone, own["translation times"], start, shifts)
    return armature.animation_data.action


def pose_of(own: dict[str, Any]) -> tuple[list[Quaternion], list[Vector] | None]:
    """A node's track as a bone's pose: turns and, where it has any, shifts in the bone's own axes."""
    x, y, z, w = own["rest"].get("rotation", (0, 0, 0, 1))
    back = Quaternion((w, x, y, z)).inverted()
    turns = [back @ Quaternion((w, x, y, z)) for x, y, z, w in own["rotation"].tolist()]
    if "translation" not in own:
        return turns, None
    origin = Vector(own["rest"].get("translation", (0, 0, 0)))
    return turns, [back @ (Vector(place) - origin) for place in own["translation"].tolist()]


def _key(bone: Any, times: list[float], start: int, turns: list[Quaternion], shifts: list[Vector] | None = None
         ) -> None:
    """Keys of a bone's pose, `times` seconds after frame `start`, with signs such that no turn goes the long way."""
    scene = bpy.context.scene
    rate = scene.render.fps / scene.render.fps_base
    bone.rotation_mode = "QUATERNION"
    before = turns[0]
    for index, time in enumerate(times):
        turn = turns[index].copy()
        if turn.dot(before) < 0:
            turn.negate()
        before = bone.rotation_quaternion = turn
        bone.keyframe_insert("rotation_quaternion", frame=start + time * rate)
    if shifts is not None:
        _move(bone, times, start, shifts)


def _move(bone: Any, times: list[float], start: int, shifts: list[Vector]) -> None:
    """Keys of a bone's location, `times` seconds after frame `start`."""
    scene = bpy.context.scene
    rate = scene.render.fps / scene.render.fps_base
    for time, shift in zip(times, shifts, strict=True):
        bone.location = shift
        bone.keyframe_insert("location", frame=start + time * rate)


# ---------------------------------------------------------------- rigs that Rigify generated

_FINGERS = ("thumb", "f_index", "f_middle", "f_ring", "f_pinky")
CONTROLS: dict[str, tuple[str, str]] = {
    "spine.001": ("spine_fk.001", "torso"), "spine": ("spine_fk", "spine.001"), "spine.002": ("spine_fk.002", "torso"),
    "spine.003": ("spine_fk.003", "spine.002"), "spine.004": ("neck", "spine.003"), "spine.006": ("head", "spine.004")}
"""Bone of the metarig -> its control, and the bone (or the control `torso`) whose control carries that."""
for _side in ("L", "R"):
    CONTROLS |= {f"{_name}.{_side}": (f"{_control}.{_side}", _above if _above.startswith("spine") else
                                      f"{_above}.{_side}") for _name, _control, _above in (
        ("shoulder", "shoulder", "spine.003"), ("upper_arm", "upper_arm_fk", "shoulder"),
        ("forearm", "forearm_fk", "upper_arm"), ("hand", "hand_fk", "forearm"), ("thigh", "thigh_fk", "spine"),
        ("shin", "shin_fk", "thigh"), ("foot", "foot_fk", "shin"), ("toe", "toe_fk", "foot"),
        *((f"{finger}.0{place}", f"{finger}.0{place}", f"{finger}.0{place - 1}" if place > 1 else "hand")
          for finger in _FINGERS for place in (1, 2, 3)))}
_ABOVE = {"spine": "", "spine.001": "spine", "spine.002": "spine.001"}
"""Metarig bone -> the one above it, where that is not what carries its control: hips hang on the trunk's controls."""
_SWITCHES = {"upper_arm_parent.L": "IK_FK", "upper_arm_parent.R": "IK_FK", "thigh_parent.L": "IK_FK",
             "thigh_parent.R": "IK_FK"}
"""Control -> its property that is 1 where FK moves the limb."""
_FOLLOW = ("neck_follow", "head_follow")
"""Properties of `torso` that are 1 where the neck goes with the chest and the head with the neck."""


def is_generated(armature: Any) -> bool:
    """Whether Rigify made this rig of a metarig. RuntimeError where it did, but of none that is known here."""
    bones = armature.data.bones
    if "rig_id" not in armature.data or not any(bone.name.startswith("ORG-") for bone in bones):
        return False
    parts = [name for name in CONTROLS if not name.startswith((*_FINGERS, "spine.004"))]
    lacking = [name for name in ("torso", "hips", "chest", *_SWITCHES) if name not in bones]
    lacking += [name for part in parts for name in ("ORG-" + part, CONTROLS[part][0]) if name not in bones]
    if lacking:
        raise RuntimeError(f"{armature.name} was generated by Rigify, but lacks {lacking[0]}: only rigs of its human "
                           "metarigs are known, with arms and legs that have FK")
    return True


def make_skeleton(rig: Any) -> Any:
    """An armature of the bones that a generated rig was made of, named as in the metarig, where the rig stands."""
    data = bpy.data.armatures.new(PROXY)
    skeleton = bpy.data.objects.new(PROXY, data)
    bpy.context.scene.collection.objects.link(skeleton)
    skeleton.matrix_world = rig.matrix_world
    selected, active = list(bpy.context.selected_objects), bpy.context.view_layer.objects.active
    _select([skeleton], skeleton)
    bpy.ops.object.mode_set(mode="EDIT")
    for name in _metarig_bones(rig):
        own, bone = rig.data.bones["ORG-" + name], data.edit_bones.new(name)
        bone.head, bone.tail = own.head_local, own.tail_local
        bone.matrix = own.matrix_local
        above = _ABOVE.get(name, CONTROLS[name][1])
        bone.parent = data.edit_bones[above] if above else None
    bpy.ops.object.mode_set(mode="OBJECT")
    _select(selected, active)
    return skeleton


def _metarig_bones(rig: Any) -> list[str]:
    """Names of the bones that the rig has, those above before those below."""
    names = [*_ABOVE, *(name for name in CONTROLS if name not in _ABOVE)]
    return [name for name in names if "ORG-" + name in rig.data.bones and CONTROLS[name][0] in rig.data.bones]


def move_controls(rig: Any, skeleton: Any, source: Path, name: str, start: int) -> Any:
    """The motion of a GLB of `skeleton` as an action of the generated rig's FK controls; the action.

    A bone's turn against its rest, D, is its control's, too. Under a control that turns by D' it has the rotation
    B^-1 D'^-1 D B, where B is its own at rest. The trunk hangs on `torso`, which turns as the hips do.
    """
    times, moved = read_motion(source)
    bones = rig.data.bones
    turns: dict[str, list[Quaternion]] = {}
    worlds: dict[str, list[Matrix]] = {}
    for part in _metarig_bones(rig):
        rest, above = skeleton.data.bones[part].matrix_local, _ABOVE.get(part, CONTROLS[part][1])
        poses, shifts = pose_of(moved[part]) if part in moved else ([Quaternion()] * len(times), None)
        local = (skeleton.data.bones[above].matrix_local.inverted() if above else Matrix()) @ rest
        worlds[part] = [(worlds[above][k] if above else Matrix()) @ local @ Matrix.LocRotScale(
            shifts[k] if shifts else None, poses[k], None) for k in range(len(times))]
        turns[part] = [(world @ rest.inverted()).to_quaternion() for world in worlds[part]]
    turns["torso"] = turns["spine"]
    rig.animation_data_create().action = bpy.data.actions.new(name)
    _prepare(rig, start)
    rest = bones["torso"].matrix_local
    pivot = skeleton.data.bones["spine.002"].head_local  # where hips and chest meet
    shifts = [rest.to_quaternion().inverted() @ (
        world.translation + turn @ (rest.translation - pivot) - rest.translation)
        for world, turn in zip(worlds["spine.002"], turns["torso"], strict=True)]
    _key(rig.pose.bones["torso"], times, start, _own(rest, turns["torso"]), shifts)
    for part in _metarig_bones(rig):
        control, above = CONTROLS[part]
        _key(rig.pose.bones[control], times, start, _own(bones[control].matrix_local, turns[part], turns[above]))
    return rig.animation_data.action


def _own(rest: Matrix, turns: list[Quaternion], above: list[Quaternion] | None = None) -> list[Quaternion]:
    """World turns against the rest as rotations in the axes of a control, under one that turns by `above`."""
    axes = rest.to_quaternion()
    return [axes.inverted() @ (turn if above is None else above[k].inverted() @ turn) @ axes
            for k, turn in enumerate(turns)]


def _prepare(rig: Any, start: int) -> None:
    """FK for all limbs, a head that goes with the trunk, and the controls of hips and chest where they rest; keyed."""
    pose = rig.pose.bones
    for bone, switch in (*_SWITCHES.items(), *(("torso", name) for name in _FOLLOW)):
        if switch in pose[bone]:
            pose[bone][switch] = 1.0
            pose[bone].keyframe_insert(f'["{switch}"]', frame=start)
    for bone in ("hips", "chest"):
        _key(pose[bone], [0.0], start, [Quaternion()], [Vector()])


def lay_sound(sound: Path, start: int, owner: str) -> None:
    """A strip with the recording in the scene's sequencer, in the place of the one that an earlier run made for the
    armature `owner`, and playback that keeps to it."""
    scene = bpy.context.scene
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences  # renamed in Blender 4.4
    earlier = [strip for strip in strips if strip.get(OWNER) == owner]
    channel = earlier[0].channel if earlier else None
    for strip in earlier:
        strips.remove(strip)
    used = {strip.channel for strip in strips}
    made = strips.new_sound(sound.name, str(sound), channel or next(k for k in range(1, 129) if k not in used), start)
    made[OWNER] = owner
    scene.sync_mode = "AUDIO_SYNC"


OWNER = "gesticulator"
"""Property of a sound strip: the name of the armature that it was laid for."""


# ---------------------------------------------------------------- the operator

def program(told: str) -> str | None:
    """Where the `gesticulator` program is; None where it is not found."""
    return shutil.which(bpy.path.abspath(told) or "gesticulator")


class GestureJob:
    """A run of the program for an armature; `begin`, then `finish` or `cancel`, once each."""

    def __init__(self, armature: Any, sound: Path, command: str, options: list[str], start: int) -> None:
        """RuntimeError for a rig that is not known."""
        self.armature, self.sound, self.start = armature, sound, start
        self._command, self._options = command, options
        self._skeleton = make_skeleton(armature) if is_generated(armature) else None
        self._folder = tempfile.TemporaryDirectory()
        self._process: subprocess.Popen[str] | None = None
        self.begun = monotonic()

    def begin(self) -> None:
        """Hand the rig over and start the program."""
        scene = bpy.context.scene
        rate = scene.render.fps / scene.render.fps_base
        rig = Path(self._folder.name) / "rig.glb"
        export_rig(self._skeleton or self.armature, rig)
        # Controls of a generated rig depend on several bones at once, so they need all at the same frames.
        keys = ["--keys", "all"] if self._skeleton is not None else []
        self._process = subprocess.Popen(
            [self._command, "infer", str(self.sound), "--character", str(rig), "-o", str(self._motion), "--fps",
             f"{rate:g}", "--quiet", *keys, *self._options], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            text=True)

    @property
    def _motion(self) -> Path:
        return Path(self._folder.name) / "motion.glb"

    @property
    def runs(self) -> bool:
        """Whether the program is still at work."""
        return self._process is not None and self._process.poll() is None

    def finish(self) -> Any:
        """The action. RuntimeError with gesticulator's message where it refuses."""
        assert self._process is not None
        try:
            _, complaint = self._process.communicate()
            if self._process.returncode:
                lines = complaint.strip().splitlines()
                raise RuntimeError(lines[-1] if lines else f"gesticulator ended with {self._process.returncode}")
            name = f"gesture {self.sound.stem}"
            action = (make_action(self.armature, self._motion, name, self.start) if self._skeleton is None
                      else move_controls(self.armature, self._skeleton, self._motion, name, self.start))
        finally:
            self._clean()
        lay_sound(self.sound, self.start, self.armature.name)
        scene = bpy.context.scene
        scene.frame_start, scene.frame_end = self.start, max(self.start, round(action.frame_range[1]))
        return action

    def cancel(self) -> None:
        """Stop the program and remove what was made for it."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.communicate()
        self._clean()

    def _clean(self) -> None:
        self._folder.cleanup()
        if self._skeleton is not None:
            bpy.data.armatures.remove(self._skeleton.data)  # and with it the object
            self._skeleton = None


def gesture(armature: Any, sound: Path, command: str, options: list[str], start: int) -> Any:
    """Move an armature to a recording, waiting for it; the action. RuntimeError with gesticulator's message where it
    refuses."""
    job = GestureJob(armature, sound, command, options, start)
    try:
        job.begin()
    except BaseException:
        job.cancel()
        raise
    return job.finish()


class GestureFromSpeech(bpy.types.Operator, ImportHelper):
    """Move the selected armature to a recorded voice."""

    bl_idname = "object.gesture_from_speech"
    bl_label = "Gesture from Speech"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - as Blender asks for it

    filter_glob: StringProperty(default="*.wav;*.flac;*.ogg;*.mp3", options={"HIDDEN"})  # type: ignore[valid-type]
    stance: EnumProperty(name="Body", items=[  # type: ignore[valid-type]
        ("STANDING", "Standing", "The character stands on its legs and shifts its weight"),
        ("SEATED", "Seated", "Hips and legs stay as they rest")])
    seed: IntProperty(name="Seed", min=0, description="Another take of the same speech")  # type: ignore[valid-type]
    start: IntProperty(name="First frame", default=1)  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Whether an armature is active."""
        return context.object is not None and context.object.type == "ARMATURE"

    def execute(self, context: Any) -> set[str]:
        """Start the program; in a window Blender goes on meanwhile. What gesticulator refuses is shown as it says
        it."""
        preferences = context.preferences.addons.get(ADDON)
        command = program(preferences.preferences.program if preferences else "")
        if command is None:
            self.report({"ERROR"}, "gesticulator was not found: name the program in the add-on's preferences")
            return {"CANCELLED"}
        options = ["--seed", str(self.seed), *(["--seated"] if self.stance == "SEATED" else [])]
        try:
            self._job = GestureJob(context.object, Path(self.filepath), command, options, self.start)
            self._job.begin()
        except (RuntimeError, OSError) as error:
            return self._refuse(error)
        if bpy.app.background:
            return self._conclude()
        window = context.window_manager
        self._timer = window.event_timer_add(0.1, window=context.window)
        window.progress_begin(0, 100)
        window.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        """Show that the program runs; Esc stops it."""
        if event.type == "ESC":
            self._job.cancel()
            self._leave(context)
            self.report({"INFO"}, "Cancelled")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self._job.runs:
            seconds = monotonic() - self._job.begun
            context.window_manager.progress_update(int(100.0 * (1.0 - math.exp(-seconds / 15.0))))
            context.workspace.status_text_set(f"Gesture from Speech: {seconds:.0f} s; Esc cancels")
            return {"RUNNING_MODAL"}
        self._leave(context)
        return self._conclude()

    def cancel(self, context: Any) -> None:
        """Called by Blender where it closes or loads another file meanwhile."""
        self._job.cancel()
        self._leave(context)

    def _leave(self, context: Any) -> None:
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)

    def _conclude(self) -> set[str]:
        try:
            action = self._job.finish()
        except (RuntimeError, OSError) as error:
            return self._refuse(error)
        self.report({"INFO"}, f"{action.name}: {round(action.frame_range[1] - action.frame_range[0]) + 1} frames")
        return {"FINISHED"}

    def _refuse(self, error: Exception) -> set[str]:
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}


class GesticulatorPreferences(bpy.types.AddonPreferences):
    """Where the program is."""

    bl_idname = ADDON
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
