"""Run inside Blender: a GLB file becomes an FBX file.

    python fbx_child.py IN.glb OUT.fbx FRAMES_PER_SECOND

It imports nothing of ours: Blender has a Python of its own.
"""

from __future__ import annotations

import datetime
import sys
import types
from typing import Any

# What Blender writes into a file as the time of its making: the same bytes for the same motion.
MOMENT = datetime.datetime(2000, 1, 1)


class FixedDay(datetime.datetime):
    """A moment that never passes."""

    @classmethod
    def now(cls, tz: datetime.tzinfo | None = None) -> Any:
        """Always `MOMENT`."""
        return MOMENT


def convert(source: str, target: str, fps: int) -> None:
    """Import a GLB into an empty scene at `fps` frames per second, and export all of it as FBX."""
    import bpy  # type: ignore[import-not-found, unused-ignore]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene: Any = bpy.context.scene
    scene.render.fps, scene.render.fps_base = fps, 1.0
    bpy.ops.import_scene.gltf(filepath=source, disable_bone_shape=True, bone_heuristic="BLENDER")
    ends = [action.frame_range[1] for action in bpy.data.actions]
    scene.frame_start, scene.frame_end = 0, max(1, round(max(ends, default=1)))
    from io_scene_fbx import export_fbx_bin  # type: ignore[import-not-found, unused-ignore]

    export_fbx_bin.datetime = types.SimpleNamespace(datetime=FixedDay)
    bpy.ops.export_scene.fbx(
        filepath=target, object_types={"ARMATURE", "MESH", "EMPTY"}, add_leaf_bones=False,
        # Metres stay metres: other tools find scale 1 on the armature.
        apply_scale_options="FBX_SCALE_ALL", axis_forward="-Z", axis_up="Y",
        bake_anim=True, bake_anim_use_nla_strips=False, bake_anim_use_all_actions=False, bake_anim_step=1.0,
        bake_anim_simplify_factor=0.0, path_mode="COPY", embed_textures=True)


if __name__ == "__main__":
    # Blender, given this file, passes what stands behind "--"; a Python with bpy passes all.
    given = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    convert(given[0], given[1], int(given[2]))
