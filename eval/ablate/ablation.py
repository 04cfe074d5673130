"""The rows of both papers, and the cells that hold their figures: a finished cell is not made again."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tqdm import tqdm

from eval.ablate import figures
from eval.ablate.cells import Cell, CellStore, summaries
from eval.ablate.racer import RacerRows
from eval.ablate.rows import CONTROLS, DOSED, REFERENCES, ROWS, is_racer
from eval.ablate.run import RgRows
from eval.ablate.tables import write
from eval.table import Provenance
from gesticulator.bundle import config as configs


@dataclass
class Ablation:
    """Both papers' rows and where their cells are kept."""

    rg: RgRows
    cells: CellStore
    _racer: dict[int, RacerRows] = field(default_factory=dict, init=False)

    def racer(self, seed: int) -> RacerRows:
        """RACER's rows over the lexicon of a seed."""
        if seed not in self._racer:
            self._racer[seed] = RacerRows.over(self.rg, seed)
        return self._racer[seed]

    def run(self, only: Sequence[str], seeds: int, systems: Mapping[str, Path], about: Provenance) -> dict[str, Any]:
        """Run the rows and figures of `only` (empty: all) that are not finished, and write the tables of all that is.

        systems: folders of other systems' motion for the test speech. about: where the figures come from. Gives the
        facts of the first table.
        """
        names, store = [name for name in ROWS if name in (only or ROWS)], self.rg.context.store
        # All rows at one seed before the next: a run that is stopped has every row.
        bar = tqdm([(name, seed) for seed in range(1, seeds + 1) for name in names], desc="rows",
                   disable=not self.rg.context.progress)
        for name, seed in bar:
            bar.set_postfix_str(f"{name}, seed {seed}")
            self.cell(name, seed)
        # Each paper's rows stand on their own hash, so a run of one alone must not open what the other needs.
        rg_names = [name for name in names if not is_racer(name)]
        shared = {seed: self.racer(seed).shared for seed in range(1, seeds + 1) if len(rg_names) < len(names)}
        if rg_names or not names:
            shared[0] = self.rg.shared
            for split in dict.fromkeys(["test", *(ROWS[name].split for name in rg_names)]):
                for name in (*REFERENCES, *CONTROLS, *DOSED):
                    self.reference(name, split)
        for name, folder in systems.items():
            self.system(name, folder)
        # Cells of settings that have changed since stay in the folder and out of the tables.
        cells = {row: current for row, by_seed in self.cells.read().items()
                 if (current := {seed: cell for seed, cell in by_seed.items() if self._current(cell, shared)})}
        facts: dict[str, Any] = {
            "preset": self.rg.first.config.name, "system": configs.digest(self.rg.first.config), "refused": {},
            "rows": summaries(cells),
            "store": {"name": store.corpus, "fingerprint": store.fingerprint,
                      "test_recordings": len(self.rg.names("test"))}}
        for name in figures.FIGURES:
            if not only or name in only:
                refused = figures.draw(self.rg, name, facts["rows"], self.cells.out)
                facts["refused"] |= {name: refused} if refused else {}
        write(cells, facts, self.cells.out, about)
        return facts

    def cell(self, name: str, seed: int) -> Cell:
        """One row at one seed: read if it was finished under the same key, else trained, played, measured and kept."""
        rows = self.rg if ROWS[name].train == "stages" else self.racer(seed)
        result = self._kept(name, seed, rows.cell_key(name, seed), rows.shared, lambda: rows.measured(name, seed),
                            "row")
        assert result is not None
        return result

    def reference(self, name: str, split: str) -> Cell | None:
        """The cell of a reference or a control; None where it cannot be made."""
        shown = name if split == "test" else f"{name}-{split}"
        key = configs.digest(self.rg.shared, name, split, self.rg.names(split))
        return self._kept(shown, 0, key, self.rg.shared, lambda: self.rg.reference(name, split),
                          "reference" if name in REFERENCES else "control")

    def system(self, name: str, folder: Path) -> Cell | None:
        """The cell of another system; InputError where it has no motion for a test recording."""
        key, clips = self.rg.foreign(name, folder)
        return self._kept(name, 0, key, self.rg.shared, lambda: self.rg.foreign_measured(folder, clips), "system")

    def _current(self, cell: Cell, shared: Mapping[int, str]) -> bool:
        """False for a cell of other settings. shared: hash of what RACER's rows of each seed stand on, the others' at
        0, of those that were run."""
        name, racer = cell["row"], is_racer(cell["row"])
        same = racer or name not in ROWS or cell["key"] == self.rg.cell_key(name, cell["seed"])
        return bool(same and cell["shared"] == shared.get(cell["seed"] if racer else 0, cell["shared"]))

    def _kept(self, name: str, seed: int, key: str, shared: str, make: Callable[[], Mapping[str, Any] | None],
              kind: str) -> Cell | None:
        """The cell of a row, a seed and a key, made and written where it is not there; None where none can be made."""
        known = self.cells.finished(name, seed, key)
        result = None if known is not None else make()
        if not result:
            return known
        written = {**result, "row": name, "seed": seed, "key": key, "shared": shared, "kind": kind}
        self.cells.add(written)
        return written
