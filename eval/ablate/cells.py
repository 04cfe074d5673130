"""Cells: what was measured of one row at one seed, each a JSON file of its own, and the rows' figures from them.

A cell OUT/cells/ROW-SEED.json has "row", "seed" (0 for what has none), "split", "key" (hash of all that shapes it),
"shared" (hash of what all rows stand on), "clips" (one mapping a clip, by column) and "sets"
(figures of all clips). A file is written whole or not at all, so a run that is stopped goes on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.files import read_object, write_text
from data_module.types import Array
from eval import stats
from eval.ablate.rows import COLUMNS, DECIDED
from eval.crossed import crossed
from eval.table import dumps, undefined

FOLDER = "cells"
LARGEST = 1 << 24
"""Bytes of a cell that is read: one of 60 clips has 30 kB."""
BY_DECISIONS = ("accuracy", "teacher_forced")
"""Columns by which a clip counts as often as it has decisions, where the cell says how many."""
Cell = dict[str, Any]
Cells = dict[str, dict[int, Cell]]
"""By row and seed; what has no seed is at 0."""


@dataclass(frozen=True)
class CellStore:
    """The cells of an output folder."""

    out: Path

    def file(self, row: str, seed: int) -> Path:
        """Where a cell is."""
        return self.out / FOLDER / f"{row}-{seed}.json"

    def finished(self, row: str, seed: int, key: str) -> Cell | None:
        """The cell of a row at a seed; None where it is missing or of other settings."""
        file = self.file(row, seed)
        cell = _read(file) if file.is_file() else None
        return cell if cell is not None and cell["key"] == key else None

    def add(self, cell: Cell) -> None:
        """Keep a cell, in place of an older one of its row and seed."""
        file = self.file(cell["row"], cell["seed"])
        file.parent.mkdir(parents=True, exist_ok=True)
        write_text(file, dumps(cell))

    def read(self) -> Cells:
        """Every cell, by row and seed."""
        cells: Cells = {}
        for cell in map(_read, sorted((self.out / FOLDER).glob("*.json"))):
            cells.setdefault(cell["row"], {})[int(cell["seed"])] = cell
        return {row: dict(sorted(by_seed.items())) for row, by_seed in sorted(cells.items())}


def _read(file: Path) -> Cell:
    remedy = "remove it, and the same command makes it again"
    cell: Cell = undefined(read_object(file, remedy, LARGEST))
    if not {"row", "seed", "key", "shared", "clips", "sets"} <= set(cell) or not isinstance(cell["clips"], list):
        raise InputError(file, "is no cell of an ablation", remedy)
    return cell


# ------------------------------------------------------------------------------------------------------------- figures

def values_of(cells: Sequence[Cell], key: str) -> Array:
    """[seeds, clips] of one column, over the clips that have it in some cell."""
    there = [k for k, _ in enumerate(cells[0]["clips"]) if any(key in cell["clips"][k] for cell in cells)]
    return np.array([[cell["clips"][k].get(key, np.nan) for k in there] for cell in cells],
                    dtype=np.float64).reshape(len(cells), len(there))


def interval_of(cells: Sequence[Cell], key: str) -> stats.Interval:
    """The mean of a column over seeds and clips with its 95 % interval (`eval.crossed`)."""
    values = values_of(cells, key)
    return crossed(values, _weights(cells[0], key)) if values.size else stats.Interval.undefined()


def _weights(cell: Cell, key: str) -> list[float] | None:
    """By clip how often it counts; None where all count alike."""
    # Accuracy is a share of decisions: a clip of twenty must not count like one of two hundred.
    weights = [float(clip["decisions"]) for clip in cell["clips"] if key in clip and "decisions" in clip]
    return weights if key in BY_DECISIONS and weights else None


def pairs(first: Mapping[int, Cell], second: Mapping[int, Cell], key: str) -> tuple[list[int], Array]:
    """Seeds, and [seeds, clips] first less second, on those that both have; what has no seed pairs with all."""
    shared = sorted(set(first) & set(second))
    # Seed 0 stands for what has no seed, such as the performer: it pairs with every seed of the other.
    if (set(first) == {0}) != (set(second) == {0}):
        shared = sorted({*first, *second} - {0})
    if not shared:
        return [], np.zeros((0, 0))
    sides = [[{clip["name"]: clip.get(key, np.nan) for clip in cells.get(seed, cells.get(0, {"clips": []}))["clips"]}
              for seed in shared] for cells in (first, second)]
    # Pairs only: a clip that some seed of either row lacks is left out of all.
    names = [name for name in sides[0][0] if all(name in values for side in sides for values in side)]
    one, other = (np.array([[values[name] for name in names] for values in side], dtype=np.float64) for side in sides)
    return shared, np.asarray(one - other)


def difference(cells: Cells, first: str, second: str, key: str) -> stats.Interval:
    """A row less another by a column, paired over seeds and clips; undefined where either was not run."""
    if first not in cells or second not in cells:
        return stats.Interval.undefined()
    seeds, apart = pairs(cells[first], cells[second], key)
    # Clips have the same decisions at every seed, so any seed's weights serve all.
    weights = _weights(cells[first][seeds[0]], key) if seeds and seeds[0] in cells[first] else None
    return crossed(apart, weights) if apart.size else stats.Interval.undefined()


def summaries(cells: Cells) -> dict[str, dict[str, Any]]:
    """Every row's figures with their intervals over seeds and clips, as plain values but for the intervals."""
    rows: dict[str, dict[str, Any]] = {}
    for name, by_seed in cells.items():
        every = list(by_seed.values())
        curves = [cell["sets"]["pmb_curve"]["percent"] for cell in every if "pmb_curve" in cell["sets"]]
        rows[name] = {
            "kind": every[0].get("kind", "row"),
            "seeds": list(by_seed), "decided": set(by_seed) == {0} or len(by_seed) >= DECIDED,
            "pmb_curve": np.mean(curves, axis=0).tolist() if curves else [],
            "figures": {key: interval_of(every, key) for key in COLUMNS}}
    return rows
