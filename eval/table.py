"""The table: every judge gives its figures as one, and it is shown as Markdown and kept as JSON.

A cell is an interval, a number, a text, or None for nothing. What is undefined is NaN in numbers and null in JSON,
which has no NaN. A file of results is FILE.json with {"about": ..., "tables": [...]} for programs, and beside it the
same as FILE.md for readers; "about" says where the figures come from (`Provenance`), and nothing is written without it.
Raw values that no table shows (curves, settings) are `facts` of a table.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import math
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.files import read_object, write_text
from eval.stats import Interval

__all__ = ["Column", "Provenance", "Table", "load", "markdown", "publish", "save"]

MOST_COLUMNS = 8
"""Of a table on a page, the names of the rows among them; a wider one goes on below with the same rows."""
MOST_DIGITS = 15
"""Of a number behind the point: a float has no more."""
NOT_RECORDED = "not recorded"
NO_BUNDLE = "none"


@dataclass(frozen=True)
class Provenance:
    """Where figures come from. command: as it was typed; commit: of the program; bundle: the first 12 digits of the
    SHA-256 of its index, or `NO_BUNDLE`; date: ISO 8601; machine: cores, processor and system."""

    command: str
    commit: str
    bundle: str
    date: str
    machine: str

    def __post_init__(self) -> None:
        # A figure without its command and commit cannot be made again.
        empty = [entry.name for entry in fields(self) if not getattr(self, entry.name).strip()]
        if empty:
            raise ValueError(f"a table needs its {', '.join(empty)}")

    @classmethod
    def now(cls, command: str, index: Path | None = None) -> Provenance:
        """Of figures that are made now and here. index: the bundle's; None where no bundle is measured."""
        # The index holds the hashes of all other files, so its own hash names the whole bundle.
        bundle = NO_BUNDLE if index is None else hashlib.sha256(index.read_bytes()).hexdigest()[:12]
        return cls(command, _commit(), bundle, datetime.date.today().isoformat(),
                   f"{os.cpu_count()} cores, {platform.machine()}, {platform.system()}")

    def markdown(self) -> str:
        """One paragraph that stands above the tables."""
        commit, bundle = (value if value in (NOT_RECORDED, NO_BUNDLE) else f"`{value}`"
                          for value in (self.commit, self.bundle))
        return (f"`{self.command}` · commit {commit} · bundle {bundle} · {self.date} · machine: {self.machine}\n")


def _commit() -> str:
    """The commit of the checkout that this file lies in ("-dirty": changed since); `NOT_RECORDED` without one."""
    try:
        described = subprocess.run(["git", "describe", "--always", "--dirty", "--exclude=*"], cwd=Path(__file__).parent,
                               capture_output=True, text=True, check=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return NOT_RECORDED
    return described.stdout.strip() or NOT_RECORDED


@dataclass(frozen=True)
class Marked:
    """A value with a mark behind it, such as "(!)", and the reason of the mark or of what is undefined."""

    value: Interval | float | int | None
    mark: str = ""
    reason: str = ""


Cell = Interval | Marked | float | int | str | None


@dataclass(frozen=True)
class Column:
    """A heading, its unit, how many digits are shown, and what is good: "low", "high", "near" (the truth's), or ""."""

    title: str
    unit: str = ""
    digits: int = 2
    good: str = ""

    @property
    def heading(self) -> str:
        """With the unit."""
        return f"{self.title}, {self.unit}" if self.unit else self.title


@dataclass(frozen=True)
class Table:
    """Figures: columns by key, rows by name, of each row the cells by the columns' keys (one that lacks is None).

    head: what the rows are, the heading of the first column; notes: sentences below; facts: raw values for JSON alone.
    """

    title: str
    columns: Mapping[str, Column]
    rows: Mapping[str, Mapping[str, Cell]]
    head: str = ""
    notes: Sequence[str] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)

    def markdown(self) -> str:
        """Title, table, notes; a table of more than `MOST_COLUMNS` columns in parts of the same rows."""
        lines = [f"### {self.title}", ""] if self.title else []
        keys = list(self.columns)
        # Parts of nearly one width: eight columns and a last part of one would be hard to read.
        parts = math.ceil(len(keys) / (MOST_COLUMNS - 1))
        for part in np.array_split(np.array(keys, dtype=object), parts) if parts else ():
            columns = {key: self.columns[key] for key in part}
            lines += [_line([self.head, *(column.heading for column in columns.values())]),
                      "|---" * (len(columns) + 1) + "|",
                      *(_line([name, *(shown_cell(row.get(key), column.digits) for key, column in columns.items())])
                        for name, row in self.rows.items()), ""]
        return "\n".join([*lines, *(f"{note}\n" for note in self.notes)]).rstrip() + "\n"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"title": self.title, "head": self.head, "columns": {k: asdict(v) for k, v in self.columns.items()},
                "rows": {name: {key: _packed(cell) for key, cell in row.items()} for name, row in self.rows.items()},
                "notes": list(self.notes), "facts": dict(self.facts)}

    @classmethod
    def from_dict(cls, held: Mapping[str, Any]) -> Table:
        """The inverse of `to_dict`; ValueError for a number of digits that no cell can be shown with."""
        if not all(column.get("digits", 0) in range(MOST_DIGITS + 1) for column in held["columns"].values()):
            raise ValueError(f"digits are not 0 to {MOST_DIGITS}")
        return cls(held["title"], {key: Column(**column) for key, column in held["columns"].items()},
                   {name: {key: _unpacked(cell) for key, cell in row.items()} for name, row in held["rows"].items()},
                   held["head"], held["notes"], undefined(held["facts"]))


def shown_cell(cell: Cell, digits: int) -> str:
    """A cell for a reader; "-" for nothing."""
    if isinstance(cell, Marked):
        return f"{shown_cell(cell.value, digits)} {cell.mark}".rstrip()
    if isinstance(cell, Interval):
        return cell.text(digits)
    if isinstance(cell, float):
        return f"{cell:.{digits}f}" if math.isfinite(cell) else "-"
    # Whole numbers are counts, which have no digits behind the point.
    return "-" if cell is None else str(cell)


def _line(cells: Iterable[str]) -> str:
    escaped = (cell.replace("|", "\\|").replace("\n", " ") for cell in cells)
    return "| " + " | ".join(escaped) + " |"


def _packed(cell: Cell) -> Any:
    if isinstance(cell, Marked):
        return {"value": _packed(cell.value), "mark": cell.mark, "reason": cell.reason}
    return cell.to_dict() if isinstance(cell, Interval) else cell


def _unpacked(cell: Any) -> Cell:
    if not isinstance(cell, Mapping):
        known: Cell = cell
        return known
    if "mark" in cell:
        value = _unpacked(cell["value"])
        return Marked(value if isinstance(value, Interval | float | int) else None, cell["mark"], cell["reason"])
    return Interval.from_dict(cell)


# ---------------------------------------------------------------------------------------------------------------- JSON

def plain(value: Any) -> Any:
    """Null for what is no finite number, however deep it lies; numbers of numpy as those of Python."""
    # Numbers of numpy are no numbers to json.
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Mapping):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def dumps(value: Any, indent: int | None = None) -> str:
    """JSON, with a line's end."""
    return json.dumps(plain(value), indent=indent, allow_nan=False) + "\n"


def undefined(value: Any) -> Any:
    """JSON that was read, with NaN for null, however deep it lies."""
    if isinstance(value, dict):
        return {key: undefined(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [undefined(inner) for inner in value]
    return math.nan if value is None else value


def markdown(tables: Iterable[Table], about: Provenance | None = None) -> str:
    """All tables for a reader, below where they come from."""
    return "\n".join([*([about.markdown()] if about else []), *(table.markdown() for table in tables)])


def save(tables: Sequence[Table], out: str | Path, about: Provenance) -> None:
    """Write `out` (.json) and its .md, each whole or not at all; the folder is made where it lacks."""
    # JSON first: a reader of the page can make it again from there, and not the other way round.
    place = Path(out)
    place.parent.mkdir(parents=True, exist_ok=True)
    write_text(place, dumps({"about": asdict(about), "tables": [table.to_dict() for table in tables]}, indent=1))
    write_text(place.with_suffix(".md"), markdown(tables, about))


def load(path: str | Path) -> list[Table]:
    """The tables of a file of results; InputError where it is none."""
    return load_with_provenance(path)[0]


def load_with_provenance(path: str | Path) -> tuple[list[Table], Provenance]:
    """The tables of a file of results and where they come from; InputError where it is none."""
    if not Path(path).exists():
        raise InputError(path, "is not there", "run the command that writes it")
    try:
        held = read_object(path, "run the command that writes it", 1 << 28)
        tables, about = [Table.from_dict(table) for table in held["tables"]], Provenance(**held["about"])
        markdown(tables, about)  # what holds values of other types cannot be shown
        return tables, about
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(path, "holds no tables", "run the command that writes it again") from error


def publish(tables: Sequence[Table], out: str | Path | None, about: Provenance) -> None:
    """`save` where a file is wanted, and the tables on the screen."""
    if out:
        save(tables, out, about)
    print(markdown(tables), end="")
