"""Tables of clips: the manifests and what lies beside them."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

from data_module.errors import InputError
from data_module.files import read_table

_ADVICE = "take the tables that came with the clips"


def read_clips(folder: str | Path, columns: Set[str]) -> list[dict[str, str]]:
    """The rows of `manifest.csv` in a folder, as of `complete_rows`."""
    return complete_rows(Path(folder) / "manifest.csv", columns)


def complete_rows(file: Path, columns: Set[str]) -> list[dict[str, str]]:
    """The rows of a CSV file, each with at least these columns. InputError for a file that is missing or lacks a
    column, and for a short row."""
    if not file.is_file():
        raise InputError(file, "does not exist", f"give the folder that holds {file.name}")
    rows = []
    for line, cells in read_table(file, _ADVICE):
        row = {name: cell for name, cell in cells.items() if isinstance(cell, str)}
        if lacking := sorted(columns - set(row)):
            raise InputError(f"{file}, line {line}", f"lacks columns {', '.join(lacking)}", _ADVICE)
        rows.append(row)
    return rows
