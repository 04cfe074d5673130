"""Make a Blender scene of a GLB and its sound. Run it in Blender, which has its own Python:

    gesticulator examples/speech.flac -o talk.glb --fps 30
    blender --background --python examples/to_blender.py -- talk.glb examples/speech.flac talk.blend
"""

from __future__ import annotations

import sys
from pathlib import Path

FPS = 30
"""Frames per second of the scene; the file was written at the same rate."""


def main(motion: str, sound: str, output: str) -> None:
    """Import the motion, lay the sound under it, and save the scene."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = FPS  # before importing: keys are put at times
    bpy.ops.import_scene.gltf(filepath=str(Path(motion).resolve()))
    last = max(action.frame_range[1] for action in bpy.data.actions)
    scene.frame_start, scene.frame_end = 0, round(last)
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences  # renamed in Blender 4.4
    strips.new_sound(Path(sound).name, str(Path(sound).resolve()), 1, 0)
    scene.sync_mode = "AUDIO_SYNC"
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(output).resolve()))


if __name__ == "__main__":
    main(*(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]))
