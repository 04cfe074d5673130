"""Run inside Blender: convert GLB to FBX, or animate a character's FBX file and save it as GLB or FBX.

    python fbx_child.py IN.glb OUT.fbx FRAMES_PER_SECOND
    python fbx_child.py IN.fbx OUT.glb|fbx FRAMES_PER_SECOND MOTION.npz

MOTION.npz holds bone poses, as from `gesticulator.export.own_fbx.pose`.
It imports nothing from this package: Blender has its own Python.
"""

from __future__ import annotations

import datetime
import sys
import types
from typing import Any

# The creation time that Blender writes into a file, fixed so that the same motion gives the same bytes.
MOMENT = datetime.datetime(2000, 1, 1)


class FixedDay(datetime.datetime):
    """A clock that always shows `MOMENT`."""

    @classmethod
    def now(cls, tz: datetime.tzinfo | None = None) -> Any:
        return MOMENT


def convert(source: str, target: str, fps: float, motion: str = "") -> None:
    """Import a file into an empty scene at `fps` frames per second, animate it, and export the scene."""
    import bpy  # type: ignore[import-not-found, unused-ignore]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene: Any = bpy.context.scene
    rate = max(1, round(fps)), max(1, round(fps)) / fps
    scene.render.fps, scene.render.fps_base = rate
    if source.lower().endswith(".fbx"):
        bpy.ops.import_scene.fbx(filepath=source, use_anim=False)
        scene.render.fps, scene.render.fps_base = rate  # the importer sets that of the file
    else:
        bpy.ops.import_scene.gltf(filepath=source, disable_bone_shape=True, bone_heuristic="BLENDER")
    if motion:
        animate(motion)
    ends = [action.frame_range[1] for action in bpy.data.actions]
    scene.frame_start, scene.frame_end = 0, max(1, round(max(ends, default=1)))
    if target.endswith(".glb"):
        bpy.ops.export_scene.gltf(filepath=target, export_format="GLB", export_animation_mode="ACTIONS",
                                  export_force_sampling=True, export_optimize_animation_size=False)
    else:
        export_fbx(target)


def animate(motion: str) -> None:
    """Add an action with the poses in a file to the largest armature."""
    import bpy
    import numpy as np

    poses = np.load(motion)
    armature: Any = max((thing for thing in bpy.data.objects if thing.type == "ARMATURE"),
                        key=lambda thing: len(thing.data.bones))
    action: Any = bpy.data.actions.new("gesture")
    armature.animation_data_create().action = action
    for place, name in enumerate(poses["names"].tolist()):
        bone = armature.pose.bones[name]
        bone.rotation_mode = "QUATERNION"
        keys(action, armature, bone.path_from_id("rotation_quaternion"), poses["turns"][:, place])
    if len(poses["shifts"]):
        keys(action, armature, armature.pose.bones[poses["hips"].tolist()[0]].path_from_id("location"), poses["shifts"])


def keys(action: Any, armature: Any, path: str, values: Any) -> None:
    """Add keyframes of a property [T, n], one per frame from 0."""
    for index, track in enumerate(values.T.tolist()):
        if hasattr(action, "fcurve_ensure_for_datablock"):  # since Blender 4.5
            curve = action.fcurve_ensure_for_datablock(armature, path, index=index)
        else:
            curve = action.fcurves.new(path, index=index)
        curve.keyframe_points.add(len(track))
        curve.keyframe_points.foreach_set("co", [number for pair in enumerate(track) for number in pair])
        curve.keyframe_points.foreach_set("interpolation", [1] * len(track))  # linear
        curve.update()


def export_fbx(target: str) -> None:
    """Export the scene with its animation, one key per frame."""
    import bpy
    from io_scene_fbx import export_fbx_bin  # type: ignore[import-not-found, unused-ignore]

    export_fbx_bin.datetime = types.SimpleNamespace(datetime=FixedDay)
    bpy.ops.export_scene.fbx(
        filepath=target, object_types={"ARMATURE", "MESH", "EMPTY"}, add_leaf_bones=False,
        # Metres stay metres: other tools find scale 1 on the armature.
        apply_scale_options="FBX_SCALE_ALL", axis_forward="-Z", axis_up="Y",
        bake_anim=True, bake_anim_use_nla_strips=False, bake_anim_use_all_actions=False, bake_anim_step=1.0,
        bake_anim_simplify_factor=0.0, path_mode="COPY", embed_textures=True)


if __name__ == "__main__":
    # Blender passes the arguments after "--"; a Python with bpy passes all.
    given = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    convert(given[0], given[1], float(given[2]), *given[3:])
