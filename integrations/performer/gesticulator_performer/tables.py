"""The tables of sentences, words and voices, which are data files beside the code, and tables of clips."""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Set
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from data_module.files import read_table

ROOM = Path(__file__).parent
_ADVICE = "take the tables that came with the clips"


@functools.cache
def table(name: str) -> dict[str, Any]:
    """The TOML file `name`, by its path in the package."""
    return tomllib.loads((ROOM / name).read_text(encoding="utf-8"))


def templates(name: str, held_out: bool) -> dict[str, tuple[str, ...]]:
    """The sentences of sentences/NAME.txt by kind: those that are held out for test, or the others."""
    kinds: dict[str, list[str]] = {}
    kind = ""
    for line in (ROOM / "sentences" / f"{name}.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            continue
        if not line.startswith(" "):
            kind = line
            kinds[kind] = []
        elif line.startswith(" =") == held_out:
            kinds[kind].append(line.removeprefix(" =").strip())
    return {kind: tuple(lines) for kind, lines in kinds.items()}


def entries(text: str, mark: str) -> tuple[str, ...]:
    """The entries of a list in a table, which `mark` separates; a list may run over several lines."""
    return tuple(entry.strip() for entry in " ".join(text.split()).split(mark))


def files() -> list[Path]:
    """Every data file, in a fixed order."""
    return sorted([*ROOM.glob("*.toml"), *(ROOM / "sentences").iterdir()])


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
