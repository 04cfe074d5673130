"""The manifest of a folder of clips: the files, the performers, and the times of the strokes."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path, PurePosixPath

from data_module.errors import InputError, shown
from data_module.files import read_table

_ADVICE = "take the manifest that came with the clips"
# Longest plausible clip, seconds; the published clips last 20 s at most.
_LONGEST = 600.0


def read_clips(folder: str | Path, columns: Set[str]) -> list[tuple[str, dict[str, str]]]:
    """The rows of `manifest.csv` in a folder, each with its place ("FILE, line N") and at least these columns. The
    column "file" names a clip in the folder; "emphasis", if requested, holds seconds or nothing. InputError names the
    line of a short row, of a clip outside the folder, or of an emphasis that is not a time."""
    rows = complete_rows(Path(folder) / "manifest.csv", columns)
    for where, row in rows:
        check_file(where, row["file"])
        if "emphasis" in columns:
            check_time(where, row["emphasis"], "emphasis")
    return rows


def complete_rows(file: Path, columns: Set[str]) -> list[tuple[str, dict[str, str]]]:
    """The rows of a CSV file, each with its place ("FILE, line N") and at least these columns. InputError for a file
    that is missing or lacks a column, and for a short row."""
    if not file.is_file():
        raise InputError(file, "does not exist", f"give the folder that holds {file.name}")
    rows = read_table(file, _ADVICE)
    lacking = sorted(columns - set(rows[0][1] if rows else ()))
    if lacking:
        raise InputError(file, f"lacks columns {', '.join(lacking)}", _ADVICE)
    checked = []
    for line, cells in rows:
        where = f"{file}, line {line}"
        row = {name: cell for name, cell in cells.items() if isinstance(cell, str)}
        if not set(row) >= columns:
            raise InputError(where, "has too few columns", _ADVICE)
        checked.append((where, row))
    return checked


# Bytes of a name in the file systems of today.
_LONGEST_NAME = 255


def check_file(where: str, name: str) -> None:
    """InputError if a name is not that of a file in a folder or below it."""
    file = PurePosixPath(name.replace("\\", "/"))
    if file.is_absolute() or ".." in file.parts or not file.name or ":" in file.parts[0] \
            or not str(file).isprintable() or max(len(part.encode()) for part in file.parts) > _LONGEST_NAME:
        raise InputError(where, f"names {shown(name)!r}, which is not a file in this folder", _ADVICE)


def check_time(where: str, cell: str, what: str) -> None:
    """InputError if a cell, the time of `what`, is neither empty nor a number of seconds."""
    try:
        seconds = float(cell or "nan")
    except ValueError:
        seconds = -1.0
    if cell and not 0 <= seconds <= _LONGEST:
        raise InputError(where, f"has {shown(cell)!r} as the time of its {what}, seconds", _ADVICE)
