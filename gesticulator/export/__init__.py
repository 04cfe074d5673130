"""Writing a performance: the suffix of the file picks the writer. A new format is one file and one entry here."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from data_module.errors import InputError
from gesticulator.export.bvh import write_bvh_file
from gesticulator.export.html import write_preview
from gesticulator.export.plan import write_plan
from gesticulator.performance import Performance

Writer = Callable[[Path, Performance], Path]

WRITERS: dict[str, Writer] = {
    ".bvh": write_bvh_file,
    ".html": write_preview,
    ".json": write_plan,
}
"""Suffix -> writer(path, performance) -> the file to open, which a long preview moves into a folder of its own."""


def writer_for(path: str | os.PathLike[str]) -> Writer:
    """The writer for a path by its suffix, in any case; InputError that lists the known ones."""
    target = Path(path)
    writer = WRITERS.get(target.suffix.lower())
    if writer is None:
        said = f"'{target.suffix}' is no format that can be written" if target.suffix else "has no suffix"
        raise InputError(target, said, f"use one of {', '.join(sorted(WRITERS))}")
    return writer


def write(path: str | os.PathLike[str], performance: Performance) -> Path:
    """Write a performance, whole or not at all, in the format of the suffix.

    Returns the file to open. It is `path`, except for a preview of a long recording, which becomes a folder.
    InputError for an unknown suffix; OSError where the disk refuses.
    """
    return writer_for(path)(Path(path), performance)
