"""The input of writers (`Scene`), the table of writers by file suffix, `write`, and the writer of BVH files.

A new format is one writer in this folder and one entry in `WRITERS`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from data_module.errors import InputError
from data_module.registry import Registry, RegistryEntry, Requirement

if TYPE_CHECKING:
    from data_module.types import Motion, Speech
    from gesticulator.characters.rig import CharacterMotion
    from gesticulator.export.clip import ClipLayout
    from gesticulator.export.nodes import NodeMotion
    from gesticulator.face.motion import FaceMotion
    from gesticulator.plan.plan import GesturePlan

_USD = Requirement("pxr", "usd-core", "usd")

WRITERS: Registry[RegistryEntry] = Registry("writers", "a format that can be written", {
    ".bvh": RegistryEntry("motion in centimetres and degrees", "gesticulator.export.writers:write_bvh_file"),
    ".csv": RegistryEntry("positions and rotations, a row per joint and frame", "gesticulator.export.table:write_csv"),
    ".fbx": RegistryEntry("motion, or your own character, through Blender", "gesticulator.export.fbx:write_fbx"),
    ".glb": RegistryEntry("motion, or your own character, as binary glTF", "gesticulator.export.glb:write_glb"),
    ".html": RegistryEntry("a page that plays and edits the performance", "gesticulator.export.html:write_preview"),
    ".json": RegistryEntry("the gesture plan: the choice for each block and its reasons",
                           "gesticulator.export.writers:write_plan"),
    ".mp4": RegistryEntry("an animated figure with audio", "gesticulator.export.film:write_film",
                          needs=Requirement("av", "PyAV", "video")),
    ".npz": RegistryEntry("SMPL-X poses in the format of BEAT2", "gesticulator.export.smplx:write_smplx"),
    ".usda": RegistryEntry("a USD skeleton as text", "gesticulator.export.usd:write_usd", needs=_USD),
    ".usdc": RegistryEntry("a USD skeleton in binary", "gesticulator.export.usd:write_usd", needs=_USD),
    ".vrma": RegistryEntry("a VRM animation", "gesticulator.export.vrma:write_vrma"),
}, RegistryEntry)
"""By suffix: writer(path, scene) -> path; writers write atomically."""

ELSEWHERE = {".g1.csv": "gesticulator-extra"}
"""Suffix -> the distribution that writes it, for the message where that is not installed: without it, a path such as
"talk.g1.csv" would become a plain table."""


@dataclass(frozen=True)
class Scene:
    """A recording with gestures, ready to be written.

    motion: on the default skeleton, as generated. speech: the audio. make_plan: computes the plan, only for writers
    that need it. character: the same motion on the user's character, if any. layout: how it is laid out for animation
    tools; None: by default. face: of the same frames, if any.
    """

    motion: Motion
    speech: Speech
    make_plan: Callable[[], GesturePlan]
    character: CharacterMotion | None = None
    layout: ClipLayout | None = None
    face: FaceMotion | None = None

    @property
    def clip(self) -> ClipLayout:
        """How the motion is laid out for animation tools."""
        from gesticulator.export.clip import ClipLayout

        return self.layout or ClipLayout()

    @property
    def plan(self) -> GesturePlan:
        """The blocks with their gestures, the reasons for them, and the names of the lexemes."""
        return self.make_plan()

    @property
    def standing(self) -> Motion:
        """The motion on the default skeleton, standing on the floor."""
        from data_module.motion.skeletons import standing

        return standing(self.motion)

    @property
    def nodes(self) -> NodeMotion:
        """The nodes to write: the user's character if there is one, else the default skeleton."""
        from gesticulator.export.nodes import of_character, of_motion

        return of_motion(self.standing) if self.character is None else of_character(self.character)


def suffix_of(path: str | os.PathLike[str]) -> str:
    """The suffix of a path that selects its format, in lower case: the last one, or the last two if they name a format
    (".g1.csv"); "" without one."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    # Two-part formats first: .csv alone would match .g1.csv, too.
    both = "".join(suffixes[-2:])
    return both if both in WRITERS or both in ELSEWHERE else "".join(suffixes[-1:])


def check_output(path: str | os.PathLike[str]) -> None:
    """`InputError` if a file of that name cannot be written: unknown suffix (the known ones are listed), or missing
    dependency."""
    target = Path(path)
    suffix = suffix_of(target)
    if suffix not in WRITERS and suffix in ELSEWHERE:
        package = ELSEWHERE[suffix]
        raise InputError(target, f"needs {package}, which is not installed", f"pip install {package}")
    if suffix not in WRITERS:
        wrong = f"'{target.suffix}' is not a format that can be written" if target.suffix else "has no suffix"
        near = "name a VRM with its animation .glb, an animation for any VRM .vrma, or " if suffix == ".vrm" else ""
        raise InputError(target, wrong, f"{near}use one of {', '.join(sorted(WRITERS))}")
    if (needs := WRITERS[suffix].needs) is not None:
        needs.check(target)
    if suffix == ".fbx":
        from gesticulator.characters.blender import check_blender

        check_blender(target)


def write(path: str | os.PathLike[str], scene: Scene) -> Path:
    """Write a scene atomically in the format of the suffix. Returns `path`. `InputError` as for `check_output`; OSError
    for disk errors."""
    check_output(path)
    return cast("Callable[[Path, Scene], Path]", WRITERS.load(suffix_of(path)))(Path(path), scene)


def write_plan(path: Path, scene: Scene) -> Path:
    """`.json`: write the gesture plan. Returns `path`."""
    from gesticulator.plan.plan_file import write_plan_file

    return write_plan_file(path, scene.plan)


def write_bvh_file(path: Path, scene: Scene) -> Path:
    """`.bvh`: write the motion in centimetres, standing on the floor, at its frame rate. A character from a BVH file
    keeps that file's hierarchy and unit. Returns `path`."""
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
    bvh.write_bvh(path, motion)
    return path
