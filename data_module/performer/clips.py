"""The manifest of a folder of clips: which files there are, who moves in them, and when their strokes are."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path, PurePosixPath

from data_module.errors import InputError, shown
from data_module.files import read_table

_ADVICE = "take the manifest that came with the clips"
_LONGEST = 600.0
"""Seconds of a clip; those published last twenty at most."""


def read_clips(folder: str | Path, columns: Set[str]) -> list[tuple[str, dict[str, str]]]:
    """The rows of `manifest.csv` in a folder, each with its place ("FILE, line N") and at least these columns.

    A column "file" names a clip of the folder, "emphasis" (where it is asked for) holds seconds or nothing. InputError
    with the line for a short row, a clip outside of the folder, or an emphasis that is no time.
    """
    manifest = Path(folder) / "manifest.csv"
    if not manifest.is_file():
        raise InputError(manifest, "does not exist", "give the folder that holds manifest.csv")
    rows = read_table(manifest, _ADVICE)
    lacking = sorted(columns - set(rows[0][1] if rows else ()))
    if lacking:
        raise InputError(manifest, f"lacks columns {', '.join(lacking)}", _ADVICE)
    checked = []
    for line, told in rows:
        where = f"{manifest}, line {line}"
        row = {name: cell for name, cell in told.items() if isinstance(cell, str)}
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
        raise InputError(where, f"names {shown(name)!r}, no file of this folder", _ADVICE)


def _check_emphasis(where: str, cell: str) -> None:
    try:
        seconds = float(cell or "nan")
    except ValueError:
        seconds = -1.0
    if cell and not 0 <= seconds <= _LONGEST:
        raise InputError(where, f"has {shown(cell)!r} for the seconds of its emphasis", _ADVICE)
