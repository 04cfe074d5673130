"""The rows of both papers, and the cells that hold their figures: a finished cell is not made again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from eval.ablate.cells import Cell, Cells, CellStore
from eval.ablate.racer import RacerRows
from eval.ablate.rows import CONTROLS, REFERENCES, ROWS, is_racer
from eval.ablate.run import RgRows
from gesticulator.bundle import config as configs


@dataclass
class Ablation:
    """Both papers' rows and where their cells are kept. bundle: what RACER's rows stand on; None for the row
    "q-network", trained here."""

    rg: RgRows
    cells: CellStore
    bundle: str | None = None

    @cached_property
    def racer(self) -> RacerRows:
        """RACER's rows."""
        return RacerRows.over(self.rg, self.bundle)

    def cell(self, name: str, seed: int) -> Cell:
        """One row at one seed: read if it was finished under the same key, else trained, played, measured and kept."""
        row, rows = ROWS[name], self.rg if ROWS[name].train == "stages" else self.racer
        result = self._kept(name, seed, rows.cell_key(name, seed), rows.shared, lambda: rows.measured(name, seed),
                           kind="row", question=row.ask, settings=list(row.set), split=row.split)
        assert result is not None
        return result

    def reference(self, name: str, split: str) -> Cell | None:
        """The cell of a reference or a control; None where it cannot be made."""
        shown = name if split == "test" else f"{name}-{split}"
        key = configs.digest(self.rg.shared, name, split, self.rg.names(split))
        return self._kept(shown, 0, key, self.rg.shared, lambda: self.rg.reference(name, split),
                          kind="reference" if name in REFERENCES else "control",
                          question={**REFERENCES, **CONTROLS}[name], settings=[], split=split)

    def system(self, name: str, folder: Path) -> Cell | None:
        """The cell of another system; InputError where it has no motion for a test recording."""
        key, clips = self.rg.foreign(name, folder)
        return self._kept(name, 0, key, self.rg.shared, lambda: self.rg.foreign_measured(folder, clips), kind="system",
                          settings=[], split="test", question=f"another system's motion, {len(clips)} clips")

    def current(self, shared: Mapping[bool, str]) -> Cells:
        """All cells but those of rows whose settings have changed since."""
        cells = self.cells.read(shared)
        for name in [name for name in cells if name in ROWS and not is_racer(name)]:
            cells[name] = {seed: cell for seed, cell in cells[name].items()
                           if cell["key"] == self.rg.cell_key(name, seed)}
        return {name: by_seed for name, by_seed in cells.items() if by_seed}

    def _kept(self, name: str, seed: int, key: str, shared: str, make: Callable[[], Mapping[str, Any] | None],
              **about: Any) -> Cell | None:
        """The cell of a row, a seed and a key, made and written where it is not there; None where none can be made."""
        known = self.cells.finished(name, seed, key)
        result = None if known is not None else make()
        if not result:
            return known
        written = {**result, "row": name, "seed": seed, "key": key, "shared": shared, **about}
        self.cells.add(written)
        return written
