"""The table of writers by file suffix, and the function `write`.

A new format is one writer in this folder and one entry in `WRITERS`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

from data_module.errors import InputError
from data_module.registry import Registry, RegistryEntry, Requirement

if TYPE_CHECKING:
    from gesticulator.export.scene import Scene

_VIDEO = Requirement("av", "PyAV", "video")
_USD = Requirement("pxr", "usd-core", "usd")

WRITERS: Registry[RegistryEntry] = Registry("writers", "a format that can be written", {
    ".bml": RegistryEntry("gestures with their times in Behavior Markup Language",
                          "gesticulator.export.plan_file:write_bml"),
    ".bvh": RegistryEntry("motion in centimetres and degrees", "gesticulator.export.bvh:write_bvh_file"),
    ".csv": RegistryEntry("positions and rotations, a row per joint and frame", "gesticulator.export.table:write_csv"),
    ".face.csv": RegistryEntry("the face in ARKit's names, as Live Link Face records it",
                               "gesticulator.export.face:write_live_link"),
    ".face.parquet": RegistryEntry("the table of .face.csv as Parquet", "gesticulator.export.face:write_face_parquet",
                                   needs=Requirement("pyarrow", "pyarrow", "parquet")),
    ".fbx": RegistryEntry("motion, or your own character, through Blender", "gesticulator.export.fbx:write_fbx"),
    ".g1.csv": RegistryEntry("joint angles of the robot Unitree G1", "gesticulator.export.g1:write_g1"),
    ".gif": RegistryEntry("an animated figure, looping", "gesticulator.export.film:write_gif",
                  needs=Requirement("PIL", "Pillow", "video")),
    ".glb": RegistryEntry("motion, or your own character, as binary glTF", "gesticulator.export.glb:write_glb"),
    ".html": RegistryEntry("a page that plays and edits the performance", "gesticulator.export.html:write_preview"),
    ".json": RegistryEntry("the gesture plan: the choice for each block and its reasons",
                           "gesticulator.export.plan_file:write_plan"),
    ".mp4": RegistryEntry("an animated figure with audio", "gesticulator.export.film:write_film", needs=_VIDEO),
    ".npz": RegistryEntry("SMPL-X poses in the format of BEAT2", "gesticulator.export.smplx:write_smplx"),
    ".parquet": RegistryEntry("the table of .csv as Parquet", "gesticulator.export.table:write_parquet",
                      needs=Requirement("pyarrow", "pyarrow", "parquet")),
    ".usda": RegistryEntry("a USD skeleton as text", "gesticulator.export.usd:write_usd", needs=_USD),
    ".usdc": RegistryEntry("a USD skeleton in binary", "gesticulator.export.usd:write_usd", needs=_USD),
    ".vrma": RegistryEntry("a VRM animation", "gesticulator.export.vrma:write_vrma"),
    ".webm": RegistryEntry("an animated figure with audio", "gesticulator.export.film:write_film", needs=_VIDEO),
}, RegistryEntry)
"""By suffix: writer(path, scene) -> path; writers write atomically."""

UNITS = {"cm": 0.01, "m": 1.0}
"""Unit of length of a BVH file -> metres."""


def suffix_of(path: str | os.PathLike[str]) -> str:
    """The suffix of a path that selects its format, in lower case: the last one, or the last two if they name a format
    (".g1.csv"); "" without one."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    both = "".join(suffixes[-2:])
    return both if both in WRITERS else "".join(suffixes[-1:])


def check_output(path: str | os.PathLike[str], unit: str = "cm") -> None:
    """`InputError` if a file of that name cannot be written: unknown suffix (the known ones are listed), missing
    dependency, or a unit that its format does not support."""
    target = Path(path)
    suffix = suffix_of(target)
    if suffix not in WRITERS:
        wrong = f"'{target.suffix}' is not a format that can be written" if target.suffix else "has no suffix"
        raise InputError(target, wrong, f"use one of {', '.join(sorted(WRITERS))}")
    if unit not in UNITS:
        raise InputError(f"unit {unit}", "is unknown", f"use one of {', '.join(UNITS)}")
    if unit != "cm" and suffix != ".bvh":
        raise InputError(target, f"cannot be in {unit}", "the unit is for .bvh; other formats have their own")
    needs = WRITERS[suffix].needs
    if needs is not None:
        needs.check(target)
    if suffix == ".fbx":
        from gesticulator.characters.blender import check_blender

        check_blender(target)


def writer_for(path: str | os.PathLike[str]) -> Callable[..., Path]:
    """The writer for a path by its suffix; `InputError` as for `check_output`."""
    check_output(path)
    return cast("Callable[..., Path]", WRITERS.load(suffix_of(path)))


def write(path: str | os.PathLike[str], scene: Scene, *, unit: str = "cm") -> Path:
    """Write a scene atomically in the format of the suffix; unit: of a BVH file. Returns `path`. `InputError` as for
    `check_output`; OSError for disk errors."""
    check_output(path, unit)
    writer = writer_for(path)
    return (writer if unit == "cm" else partial(writer, unit=unit))(Path(path), scene)
