"""Run inside Blender: convert GLB to FBX, or animate a character's FBX file and save it as FBX, or save it as GLB.

    python fbx_child.py IN.glb OUT.fbx FRAMES_PER_SECOND KEYS NAME
    python fbx_child.py IN.fbx OUT.fbx FRAMES_PER_SECOND KEYS NAME MOTION.npz
    python fbx_child.py IN.fbx OUT.glb

KEYS is the bound on the error of reduced keys in degrees, 0 for every frame; NAME that of the take. MOTION.npz holds
bone poses, and values of shape keys, as from `gesticulator.export.fbx`. The script imports nothing from this
package: Blender has its own Python.
"""

from __future__ import annotations

import datetime
import os
import sys
import types
import zlib
from typing import Any

# The creation time that Blender writes into a file, fixed so that the same motion gives the same bytes.
MOMENT = datetime.datetime(2000, 1, 1)


class FixedDay(datetime.datetime):
    """A clock that always shows `MOMENT`."""

    @classmethod
    def now(cls, tz: datetime.tzinfo | None = None) -> Any:
        return MOMENT


def convert(source: str, target: str, fps: float = 30.0, keys: float = 0.0, name: str = "", motion: str = "") -> None:
    """Import a file into an empty scene at `fps` frames per second, animate it, and export the scene."""
    import bpy  # type: ignore[import-not-found, unused-ignore]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene: Any = bpy.context.scene
    whole = max(1, round(fps))
    if source.lower().endswith(".fbx"):
        bpy.ops.import_scene.fbx(filepath=source, use_anim=False)
        to_bind_pose()
    else:
        # The importer of glTF takes the product of the two numbers for the frame rate, where it is their quotient.
        scene.render.fps, scene.render.fps_base = whole, fps / whole
        bpy.ops.import_scene.gltf(filepath=source, disable_bone_shape=True, bone_heuristic="BLENDER")
    scene.render.fps, scene.render.fps_base = whole, whole / fps  # the importer of FBX sets that of the file
    if target.endswith(".glb"):
        bpy.ops.export_scene.gltf(filepath=target, export_format="GLB", export_animations=False)
        return
    if motion:
        animate(motion)
    ends = [action.frame_range[1] for action in bpy.data.actions]
    scene.frame_start, scene.frame_end = 0, max(1, round(max(ends, default=1)))
    scene.name = name or "gesture"
    export_fbx(target, keys)


def largest_armature() -> Any:
    """The armature that is animated."""
    import bpy

    armatures = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    return max(armatures, key=lambda thing: len(thing.data.bones))


def to_bind_pose() -> None:
    """Put the bones where the mesh was bound to them. A file may stand otherwise, with bones moved and scaled, and what
    no key of ours sets would stay so and tear the mesh."""
    for bone in largest_armature().pose.bones:
        bone.matrix_basis.identity()


def animate(motion: str) -> None:
    """Add an action with the poses in a file to the largest armature."""
    import bpy
    import numpy as np

    poses = np.load(motion)
    armature = largest_armature()
    action: Any = bpy.data.actions.new("gesture")
    armature.animation_data_create().action = action
    for place, name in enumerate(poses["names"].tolist()):
        bone = armature.pose.bones[name]
        bone.rotation_mode = "QUATERNION"
        keys(action, armature, bone.path_from_id("rotation_quaternion"), poses["turns"][:, place])
    if len(poses["shifts"]):
        keys(action, armature, armature.pose.bones[poses["hips"].tolist()[0]].path_from_id("location"), poses["shifts"])
    if "shape_values" in poses:
        animate_shapes(poses["shape_meshes"].tolist(), poses["shape_keys"].tolist(), poses["shape_values"])


def animate_shapes(meshes: list[str], names: list[str], values: Any) -> None:
    """Add actions with the values [T, k] of shape keys, by the names of their mesh objects and their own."""
    import bpy

    for column, (mesh, name) in enumerate(zip(meshes, names, strict=True)):
        block = bpy.data.objects[mesh].data.shape_keys
        moved = block.animation_data or block.animation_data_create()
        if moved.action is None:
            moved.action = bpy.data.actions.new("gesture")
        keys(moved.action, block, block.key_blocks[name].path_from_id("value"), values[:, column:column + 1])


def keys(action: Any, owner: Any, path: str, values: Any) -> None:
    """Add keyframes of a property [T, n], one per frame from 0. path: from the `owner` of the action."""
    for index, track in enumerate(values.T.tolist()):
        if hasattr(action, "fcurve_ensure_for_datablock"):  # since Blender 4.5
            curve = action.fcurve_ensure_for_datablock(owner, path, index=index)
        else:
            curve = action.fcurves.new(path, index=index)
        # `foreach_set` copies all numbers in one call, without a Python object for each key.
        curve.keyframe_points.add(len(track))
        curve.keyframe_points.foreach_set("co", [number for pair in enumerate(track) for number in pair])
        curve.keyframe_points.foreach_set("interpolation", [1] * len(track))  # linear
        curve.update()


def export_fbx(target: str, keys: float) -> None:
    """Export the scene with its animation, with keys that linear interpolation needs within `keys` degrees."""
    import bpy
    from io_scene_fbx import encode_bin, export_fbx_bin  # type: ignore[import-not-found, unused-ignore]

    # Blender packs arrays as fast as it can; meshes and the times of keys become a little smaller.
    encode_bin.zlib = types.SimpleNamespace(compress=lambda data, *_: zlib.compress(data, 9))
    export_fbx_bin.datetime = types.SimpleNamespace(datetime=FixedDay)
    export_fbx_bin.AnimationCurveNodeWrapper.simplify = lambda curves, *_: reduce_keys(curves, keys)
    if not hasattr(export_fbx_bin, "all_animations"):  # once in a process
        export_fbx_bin.all_animations = export_fbx_bin.fbx_animations
    export_fbx_bin.fbx_animations = lambda data: without_modifiers(export_fbx_bin.all_animations, data)
    bpy.ops.export_scene.fbx(
        filepath=target, object_types={"ARMATURE", "MESH", "EMPTY"}, add_leaf_bones=False,
        # Metres stay metres: other tools find scale 1 on the armature.
        apply_scale_options="FBX_SCALE_ALL", axis_forward="-Z", axis_up="Y",
        bake_anim=True, bake_anim_use_nla_strips=False, bake_anim_use_all_actions=False, bake_anim_step=1.0,
        bake_anim_simplify_factor=0.0, path_mode="COPY", embed_textures=True)


def without_modifiers(bake: Any, data: Any) -> Any:
    """Bake the bones' motion while meshes are not deformed: that took nearly all of the time, and is not used."""
    import bpy

    shown = [modifier for thing in bpy.data.objects for modifier in thing.modifiers if modifier.show_viewport]
    try:
        for modifier in shown:
            modifier.show_viewport = False
        return bake(data)
    finally:
        for modifier in shown:
            modifier.show_viewport = True


METRES_PER_DEGREE = 0.005
"""Bound on the error of translations per degree of the bound on rotations."""


SHARES = (0.8, 0.7, 0.6, 0.5, 0.4, 1.0 / 3.0)
"""Bounds on each angle of a rotation that are tried, of the bound on the rotation. With a third of it any rotation is
within the bound."""


def reduce_keys(curves: Any, keys: float) -> None:
    """Choose the keys of the curves X, Y, Z of a property: none where it stays at its default, else the fewest found
    that keep it within its bound."""
    import numpy as np

    values = curves._frame_values_array
    if values is None:
        return
    turns = curves.fbx_group[0] == "Lcl Rotation"
    rests = np.array(curves.default_values)[:, None]
    still = np.abs(values - rests).max() < (1e-4 if turns else 1e-5)
    masks = curves._frame_write_mask_array
    masks[:] = not still
    if not keys or still:
        return
    for bound in [share * keys for share in SHARES] if turns else [keys * METRES_PER_DEGREE / 2.0]:
        for row, mask in zip(values, masks, strict=True):
            mask[:] = needed(row, bound)
        if not turns or turned_by(values, played(values, masks)) <= keys:
            return


def played(values: Any, masks: Any) -> Any:
    """[C, T] curves as a player interpolates them from their keys."""
    import numpy as np

    frames = np.arange(values.shape[1])
    return np.stack([np.interp(frames, frames[mask], row[mask]) for row, mask in zip(values, masks, strict=True)])


def turned_by(angles: Any, others: Any) -> float:
    """The largest angle between rotations about X, then Y, then Z by angles [3, T] and by nearly equal ones, degrees.

    With differences x, y, z, it is the length of the sum of x, y and z times the axes about which they turn, of which
    those of X and Z enclose a right angle plus Y.
    """
    import numpy as np

    # Small differences: the rotation vector is linear in them.
    x, y, z = others - angles
    between = np.sin(np.radians(angles[1]))
    return float(np.sqrt(np.max(x * x + y * y + z * z - 2.0 * between * x * z)))


def needed(row: Any, bound: float) -> Any:
    """[T] which values of a curve need a key: added where the error is the greatest until none is beyond the bound."""
    import numpy as np

    has_key = np.zeros(len(row), dtype=bool)
    has_key[[0, -1]] = True
    frames = np.arange(len(row))
    while True:
        # Ramer, Douglas and Peucker, all segments of a curve in one step.
        at = np.flatnonzero(has_key)
        off = np.abs(np.interp(frames, at, row[at]) - row)
        worst = np.maximum.reduceat(off, at)
        bad = worst > bound
        if not bad.any():
            return has_key
        segment = np.cumsum(has_key) - 1
        has_key |= bad[segment] & (off == worst[segment])


if __name__ == "__main__":
    # Blender passes the arguments after "--"; a Python with bpy passes all.
    given = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    # Omitted arguments take the defaults of `convert`.
    numbers = [float(number) for number in given[2:4]] + [30.0, 0.0][len(given[2:4]):]
    convert(given[0], given[1], numbers[0], numbers[1], *given[4:])
    # The file is complete; Blender as a Python module may crash while it is torn down.
    sys.stdout.flush()
    os._exit(0)
