"""The manifest of a folder of clips: the files, the performers, and the times of the strokes."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path, PurePosixPath

from data_module.errors import InputError, shown
from data_module.files import read_table

_ADVICE = "take the manifest that came with the clips"
_LONGEST = 600.0
"""Longest plausible clip, seconds; the published clips last 20 s at most."""


def read_clips(folder: str | Path, columns: Set[str]) -> list[tuple[str, dict[str, str]]]:
    """The rows of `manifest.csv` in a folder, each with its place ("FILE, line N") and at least these columns. The
    column "file" names a clip in the folder; "emphasis", if requested, holds seconds or nothing. InputError names the
    line of a short row, of a clip outside the folder, or of an emphasis that is not a time."""
    manifest = Path(folder) / "manifest.csv"
    if not manifest.is_file():
        raise InputError(manifest, "does not exist", "give the folder that holds manifest.csv")
    rows = read_table(manifest, _ADVICE)
    lacking = sorted(columns - set(rows[0][1] if rows else ()))
    if lacking:
        raise InputError(manifest, f"lacks columns {', '.join(lacking)}", _ADVICE)
    checked = []
    for line, cells in rows:
        where = f"{manifest}, line {line}"
        row = {name: cell for name, cell in cells.items() if isinstance(cell, str)}
        if not set(row) >= columns:
            raise InputError(where, "has too few columns", _ADVICE)
        _check_file(where, row["file"])
        if "emphasis" in columns:
            _check_emphasis(where, row["emphasis"])
        checked.append((where, row))
    return checked


def _check_file(where: str, name: str) -> None:
    file = PurePosixPath(name.replace("\\", "/"))
    if file.is_absolute() or ".." in file.parts or not file.name or ":" in file.parts[0] \
            or not str(file).isprintable():
        raise InputError(where, f"names {shown(name)!r}, which is not a file in this folder", _ADVICE)


def _check_emphasis(where: str, cell: str) -> None:
    try:
        seconds = float(cell or "nan")
    except ValueError:
        seconds = -1.0
    if cell and not 0 <= seconds <= _LONGEST:
        raise InputError(where, f"has {shown(cell)!r} as the time of its emphasis, seconds", _ADVICE)
