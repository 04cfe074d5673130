"""The table of writers: which file suffix is written by what, and the one function that writes.

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
    ".csv": RegistryEntry("places and rotations of joints, a row a frame", "gesticulator.export.table:write_csv"),
    ".fbx": RegistryEntry("motion, or your own character, through Blender", "gesticulator.export.fbx:write_fbx"),
    ".g1.csv": RegistryEntry("joint angles of the robot Unitree G1", "gesticulator.export.g1:write_g1"),
    ".gif": RegistryEntry("a stick figure that repeats", "gesticulator.export.film:write_gif",
                  needs=Requirement("PIL", "Pillow", "video")),
    ".glb": RegistryEntry("motion, or your own character, as binary glTF", "gesticulator.export.glb:write_glb"),
    ".html": RegistryEntry("a page that shows, plays and edits", "gesticulator.export.html:write_preview"),
    ".json": RegistryEntry("the plan: what was chosen for each block, and why",
                           "gesticulator.export.plan_file:write_plan"),
    ".mp4": RegistryEntry("a stick figure with the sound", "gesticulator.export.film:write_film", needs=_VIDEO),
    ".npz": RegistryEntry("poses of SMPL-X as BEAT2 has them", "gesticulator.export.smplx:write_smplx"),
    ".parquet": RegistryEntry("the table of .csv as Parquet", "gesticulator.export.table:write_parquet",
                      needs=Requirement("pyarrow", "pyarrow", "parquet")),
    ".usda": RegistryEntry("a USD skeleton as text", "gesticulator.export.usd:write_usd", needs=_USD),
    ".usdc": RegistryEntry("a USD skeleton in binary", "gesticulator.export.usd:write_usd", needs=_USD),
    ".vrma": RegistryEntry("a VRM animation", "gesticulator.export.vrma:write_vrma"),
    ".webm": RegistryEntry("a stick figure with the sound", "gesticulator.export.film:write_film", needs=_VIDEO),
}, RegistryEntry)
"""By suffix: writer(path, scene) -> path, which writes whole or not at all."""

UNITS = {"cm": 0.01, "m": 1.0}
"""Unit of length of a BVH file -> metres."""


def suffix_of(path: str | os.PathLike[str]) -> str:
    """The ending of a path that picks its format, in small letters: the last one, or the last two where those are one
    format (".g1.csv"); "" where it has none."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    both = "".join(suffixes[-2:])
    return both if both in WRITERS else "".join(suffixes[-1:])


def check_output(path: str | os.PathLike[str], unit: str = "cm") -> None:
    """`InputError` where a file of that name cannot be written here: its suffix is unknown (the known ones are listed),
    or what its writer needs is not installed, or the unit is not its own."""
    target = Path(path)
    suffix = suffix_of(target)
    if suffix not in WRITERS:
        said = f"'{target.suffix}' is no format that can be written" if target.suffix else "has no suffix"
        raise InputError(target, said, f"use one of {', '.join(sorted(WRITERS))}")
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
    """The writer for a path by its suffix, in any case; `InputError` as of `check_output`."""
    check_output(path)
    return cast("Callable[..., Path]", WRITERS.load(suffix_of(path)))


def write(path: str | os.PathLike[str], scene: Scene, *, unit: str = "cm") -> Path:
    """Write a scene, whole or not at all, in the format of the suffix; unit: that of a BVH file.

    Returns `path`. `InputError` as of `check_output`; OSError where the disk refuses.
    """
    check_output(path, unit)
    writer = writer_for(path)
    return (writer if unit == "cm" else partial(writer, unit=unit))(Path(path), scene)
