"""`.bvh`: the default skeleton, or a character."""

from __future__ import annotations

from pathlib import Path

from gesticulator.export.scene import Scene
from gesticulator.export.writers import UNITS


def write_bvh_file(path: Path, scene: Scene, unit: str = "cm") -> Path:
    """Write the motion, standing on the floor, at its frame rate. A character from a BVH file keeps that file's
    hierarchy and unit. Returns `path`."""
    from data_module.motion import bvh

    moved = scene.character
    if moved is not None and moved.character.kind == "bvh":
        from gesticulator.characters.bvh_rig import write_character_bvh

        placed = None if moved.translations is None else (moved.hips, moved.translations)
        write_character_bvh(path, moved.character, moved.rotations, placed, moved.fps)
        return path
    motion = scene.standing
    if moved is not None:
        from gesticulator.export.nodes import of_character, with_identity_rest

        motion = with_identity_rest(of_character(moved))
    bvh.write_bvh(path, motion, UNITS[unit])
    return path
