"""Run inside Blender: a character's GLB as FBX, its mesh made finer.

    python zoo_fbx.py IN.glb TIMES OUT.fbx

TIMES is how often each edge is halved. It imports nothing from this project.
"""

from __future__ import annotations

import sys


def main(source: str, times: str, target: str) -> None:
    """Import the file, subdivide what bones move, and write it without an animation."""
    import bpy  # type: ignore[import-not-found, unused-ignore]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=source, disable_bone_shape=True)
    for thing in bpy.data.objects if int(times) else ():
        if thing.type == "MESH" and thing.find_armature() is not None:
            bpy.context.view_layer.objects.active = thing
            bpy.ops.object.mode_set(mode="EDIT")
            bpy.ops.mesh.select_all(action="SELECT")
            for _ in range(int(times)):
                bpy.ops.mesh.subdivide(number_cuts=1)
            bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.export_scene.fbx(filepath=target, add_leaf_bones=False, bake_anim=False)


if __name__ == "__main__":
    main(*(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]))
