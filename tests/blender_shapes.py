"""Run inside Blender: import a file as a user would, and write the value of each shape key in every frame, as JSON.

    python blender_shapes.py FILE FRAMES_PER_SECOND OUT.json
"""

import json
import sys
from pathlib import Path


def main(source: str, fps: str, target: str) -> None:
    """Name of a mesh -> for each shape key but the basis its values, and how far it moves the vertices at most."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = round(float(fps))
    {".glb": bpy.ops.import_scene.gltf, ".fbx": bpy.ops.import_scene.fbx, ".usda": bpy.ops.wm.usd_import,
     ".usdc": bpy.ops.wm.usd_import}[Path(source).suffix](filepath=source)
    last = max(round(action.frame_range[1]) for action in bpy.data.actions)
    out = {}
    for thing in bpy.data.objects:
        if thing.type != "MESH" or not thing.data.shape_keys:
            continue
        basis, *keys = thing.data.shape_keys.key_blocks
        values = {key.name: [] for key in keys}
        for frame in range(last + 1):
            scene.frame_set(frame)
            for key in keys:
                values[key.name].append(key.value)
        out[thing.name] = {key.name: {"values": values[key.name], "moves": max(
            (a.co - b.co).length for a, b in zip(key.data, basis.data, strict=True))} for key in keys}
    Path(target).write_text(json.dumps(out))


if __name__ == "__main__":
    main(*(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]))
