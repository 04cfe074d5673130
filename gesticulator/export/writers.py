"""The table of writers: which file suffix is written by what, and the one function that writes.

A new format is one writer in this folder and one entry in `WRITERS`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gesticulator.performance import Performance

import os
from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError

if TYPE_CHECKING:

    pass

WRITERS = {
    ".bml": "gesticulator.plan.bml:write_bml",
    ".bvh": "gesticulator.export.bvh:write_bvh_file",
    ".csv": "gesticulator.export.table:write_csv",
    ".fbx": "gesticulator.export.fbx:write_fbx",
    ".g1.csv": "gesticulator.export.g1:write_g1",
    ".gif": "gesticulator.export.film:write_gif",
    ".glb": "gesticulator.export.glb:write_glb",
    ".html": "gesticulator.export.html:write_preview",
    ".json": "gesticulator.directing.record:write_plan",
    ".mp4": "gesticulator.export.film:write_film",
    ".npz": "gesticulator.export.smplx:write_smplx",
    ".parquet": "gesticulator.export.table:write_parquet",
    ".usda": "gesticulator.export.usd:write_usd",
    ".usdc": "gesticulator.export.usd:write_usd",
    ".vrma": "gesticulator.export.vrma:write_vrma",
    ".webm": "gesticulator.export.film:write_film",
}
"""Suffix -> module and name of writer(path, performance) -> path, imported when something is written. A new format is
one writer in `gesticulator.export` and one entry here."""

NEEDS = {
    ".gif": ("PIL", "Pillow", "video"),
    ".mp4": ("av", "PyAV", "video"),
    ".parquet": ("pyarrow", "pyarrow", "parquet"),
    ".usda": ("pxr", "usd-core", "usd"),
    ".usdc": ("pxr", "usd-core", "usd"),
    ".webm": ("av", "PyAV", "video"),
}
"""Suffix -> module that its writer imports, the package that has it, and our extra that installs it."""

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
    module, package, extra = NEEDS.get(suffix, ("", "", ""))
    if module and find_spec(module) is None:
        raise InputError(target, f"needs {package}, which is not installed", f'pip install "gesticulator[{extra}]"')
    if suffix == ".fbx":
        from gesticulator.characters.blender import check_blender

        check_blender(target)


def writer_for(path: str | os.PathLike[str]) -> Callable[..., Path]:
    """The writer for a path by its suffix, in any case; `InputError` as of `check_output`."""
    check_output(path)
    module, name = WRITERS[suffix_of(path)].split(":")
    found: Callable[..., Path] = getattr(import_module(module), name)
    return found


def write(path: str | os.PathLike[str], performance: Performance, *, unit: str = "cm") -> Path:
    """Write a performance, whole or not at all, in the format of the suffix; unit: that of a BVH file.

    Returns `path`. `InputError` as of `check_output`; OSError where the disk refuses.
    """
    check_output(path, unit)
    writer = writer_for(path)
    return (writer if unit == "cm" else partial(writer, unit=unit))(Path(path), performance)
