"""Cells: what was measured of one row at one seed, kept one a line in OUT/cells.jsonl, and the rows' figures from them.

A cell has "row", "seed" (0 for what has none), "split", "key" (hash of all that shapes it), "shared" (hash of what all
rows stand on), "question", "settings", "clips" (one mapping a clip, by column) and "sets" (figures of all clips). A
cell that is finished is appended at once, so a long run that is stopped goes on, also from a commit, and two commands
may divide the rows between them. Of two lines of one row and seed the later counts; one that was cut short does not.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.files import write_text
from data_module.types import Array
from eval import stats
from eval.crossed import crossed
from eval.rows.racer import PREFIX
from eval.rows.row import COLUMNS, DECIDED, DECISIONS, RowColumn
from eval.table import dumps, loads

FILE = "cells.jsonl"
PARTS = "cells"
"""The folder of cells that are not gathered."""
Cell = dict[str, Any]
Cells = dict[str, dict[int, Cell]]
"""By row and seed; what has no seed is at 0."""


@dataclass(frozen=True)
class CellStore:
    """The cells of a folder. alone: whether nobody else writes there; if others do, each cell is a file of its own,
    until it is gathered."""

    folder: Path
    alone: bool = True

    @property
    def file(self) -> Path:
        """All of them, one a line."""
        return self.folder / FILE

    def lines(self) -> list[Cell]:
        """Every whole line, in the order in which they were finished, then what is not gathered."""
        found = []
        for file in (self.file, *self._parts()):
            with contextlib.suppress(FileNotFoundError):  # nothing yet, or gathered since
                found += _cells(file.read_text())
        return found

    def _parts(self) -> list[Path]:
        return sorted((self.folder / PARTS).glob("*.json"))

    def gather(self) -> None:
        """Take what others wrote into the one file."""
        for part in self._parts():
            cells = _cells(part.read_text())
            known = {(cell["row"], cell["seed"], cell["key"]) for cell in _cells(self.file.read_text())} \
                if self.file.exists() else set()
            for cell in cells:
                if (cell["row"], cell["seed"], cell["key"]) not in known:  # a gathering that was killed had it
                    self._append(cell)
            part.unlink()
        with contextlib.suppress(OSError):
            (self.folder / PARTS).rmdir()

    def finished(self, row: str, seed: int, key: str) -> Cell | None:
        """The cell of a row at a seed; None where it is missing or of other settings."""
        same = [cell for cell in self.lines() if (cell["row"], cell["seed"], cell["key"]) == (row, seed, key)]
        return same[-1] if same else None

    def add(self, cell: Cell) -> None:
        """Keep a cell."""
        if self.alone:
            self._append(cell)
            return
        (self.folder / PARTS).mkdir(parents=True, exist_ok=True)
        write_text(self.folder / PARTS / f"{cell['row']}-{cell['seed']}-{cell['key']}.json", dumps(cell))

    def _append(self, cell: Cell) -> None:
        """In one write, on a line of its own, synced."""
        self.folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(self.file, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        try:
            size = os.fstat(handle).st_size
            torn = size > 0 and os.pread(handle, 1, size - 1) != b"\n"
            os.write(handle, (b"\n" if torn else b"") + dumps(cell).encode())
            os.fsync(handle)
        finally:
            os.close(handle)

    def read(self, shared: Mapping[str, str] | None = None) -> Cells:
        """The latest cell of every row and seed; InputError when rows that are compared do not stand on the same.

        shared: hash of what rows stand on, by family (see `family`); cells of that family with another are left out.
        """
        cells: Cells = {}
        stands: dict[str, set[str]] = {}
        for cell in self.lines():
            group = family(cell["row"])
            if shared is not None and cell.get("shared") != shared.get(group, cell.get("shared")):
                continue
            stands.setdefault(group, set()).add(cell.get("shared", ""))
            cells.setdefault(cell["row"], {})[int(cell["seed"])] = cell
        if any(len(hashes) > 1 for hashes in stands.values()):
            raise InputError(self.file, "holds figures of different presets, stores or versions",
                             "keep them in two folders")
        return dict(sorted(cells.items()))


def _cells(text: str) -> list[Cell]:
    found = []
    for line in text.splitlines():
        try:
            cell = loads(line)
        except ValueError:
            continue  # cut short: that cell is made again
        if isinstance(cell, dict) and {"row", "seed", "key", "clips"} <= set(cell):
            found.append(cell)
    return found


def family(row: str) -> str:
    """Which rows a row is compared with: RACER's stand on a bundle of their own."""
    return "racer" if row.startswith(PREFIX) else "rg"


def columns_of(row: str) -> dict[str, RowColumn]:
    """What a row is judged by."""
    if family(row) == "rg":
        return COLUMNS
    return {key: column for columns in DECISIONS.values() for key, column in columns.items()}


def values_of(cells: Sequence[Cell], key: str) -> Array:
    """[seeds, clips] of one column, over the clips that have it in some cell."""
    there = [k for k, clip in enumerate(cells[0]["clips"]) if any(key in cell["clips"][k] for cell in cells)]
    return np.array([[cell["clips"][k].get(key, np.nan) for k in there] for cell in cells],
                    dtype=np.float64).reshape(len(cells), len(there))


def weights_of(cells: Sequence[Cell], key: str, column: RowColumn) -> Array:
    """[clips] beside `values_of`: decisions, or one a clip."""
    clips = [clip for k, clip in enumerate(cells[0]["clips"]) if any(key in cell["clips"][k] for cell in cells)]
    return np.array([float(clip["decisions"]) if column.by_blocks else 1.0 for clip in clips])


def interval_of(cells: Sequence[Cell], key: str, column: RowColumn) -> stats.Interval:
    """The mean of a column over seeds and clips."""
    values = values_of(cells, key)
    return crossed(values, weights_of(cells, key, column)) if values.size else stats.Interval.undefined()


def latest(cells: Sequence[Cell]) -> dict[str, float]:
    """By stage how much of its validation figure was still gained in the last quarter of the training, the most of
    all seeds; where it was not validated before then, NaN."""
    stages = dict.fromkeys(stage for cell in cells for stage in cell.get("late_gains", {}))
    return {stage: max((cell["late_gains"][stage] for cell in cells if stage in cell.get("late_gains", {})),
                       key=lambda gain: np.inf if np.isnan(gain) else gain) for stage in stages}


def summaries(cells: Cells) -> dict[str, dict[str, Any]]:
    """Every row's figures with their intervals over seeds and clips, as plain values but for the intervals."""
    rows: dict[str, dict[str, Any]] = {}
    for name, by_seed in cells.items():
        every = [by_seed[seed] for seed in sorted(by_seed)]
        first = every[0]
        curves = [cell["sets"]["pmb_curve"]["percent"] for cell in every if "pmb_curve" in cell["sets"]]
        rows[name] = {
            "settings": first["settings"], "question": first["question"], "kind": first.get("kind", "row"),
            "run_as": first.get("run_as", name), "seeds": sorted(by_seed),
            "decided": set(by_seed) == {0} or len(by_seed) >= DECIDED,
            "seconds": [cell["seconds"]["training"] for cell in every if "seconds" in cell],
            "late_gains": latest(every), "pmb_curve": np.mean(curves, axis=0).tolist() if curves else [],
            "fgd": [cell["sets"]["fgd"] for cell in every if "fgd" in cell["sets"]],
            "figures": {key: interval_of(every, key, column) for key, column in columns_of(name).items()}}
    return rows
