"""Writing a performance: the suffix of the file picks the writer. A new format is one writer and one entry here.

BVH, the format that every animation tool opens, is a few lines and stands here; the others have files of their own."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError
from data_module.motion import bvh
from data_module.motion.skeletons import standing

if TYPE_CHECKING:
    from gesticulator.performance import Performance

WRITERS = {
    ".bvh": "gesticulator.export:write_bvh_file",
    ".html": "gesticulator.export.html:write_preview",
    ".json": "gesticulator.export.plan:write_plan",
}
"""Suffix -> module and name of writer(path, performance) -> path; imported when something is written."""


def writer_for(path: str | os.PathLike[str]) -> Callable[[Path, Performance], Path]:
    """The writer for a path by its suffix, in any case; InputError that lists the known ones."""
    target = Path(path)
    writer = WRITERS.get(target.suffix.lower())
    if writer is None:
        said = f"'{target.suffix}' is no format that can be written" if target.suffix else "has no suffix"
        raise InputError(target, said, f"use one of {', '.join(sorted(WRITERS))}")
    module, name = writer.split(":")
    found: Callable[[Path, Performance], Path] = getattr(import_module(module), name)
    return found


def write(path: str | os.PathLike[str], performance: Performance) -> Path:
    """Write a performance, whole or not at all, in the format of the suffix.

    Returns `path`. InputError for an unknown suffix; OSError where the disk refuses.
    """
    return writer_for(path)(Path(path), performance)


def write_bvh_file(path: Path, performance: Performance) -> Path:
    """Write the motion, standing on the floor, at its own frame rate. Returns `path`."""
    bvh.write_bvh(path, standing(performance.motion))
    return path
