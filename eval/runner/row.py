"""The cells of an ablation: each row at each seed, trained, played, measured and kept once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from eval.ablate.racer import RacerRows
from eval.context import EvalContext
from eval.rows import CONTROLS, REFERENCES, ROWS, racer
from eval.rows.cells import Cell, CellStore, family
from eval.runner.rg import RgRows
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.models import JUDGES
from gesticulator.training.stages import STAGES


class RowFamily(Protocol):
    """Rows that are compared: they stand on the same data and are judged by the same models."""

    @property
    def shared(self) -> str:
        """Hash of what the rows share."""

    def original(self, name: str) -> str:
        """The row whose cell a row is a copy of; itself, where it is none."""

    def cell_key(self, name: str, seed: int) -> str:
        """Hash of everything that shapes a row's cell."""

    def measured(self, name: str, seed: int) -> Mapping[str, Any]:
        """"clips", "sets" and "seconds" of a row's cell."""


@dataclass
class Ablation:
    """Both papers' rows and where their cells are kept. bundle: what RACER's rows stand on; None for the row
    "q-network", trained here."""

    rg: RgRows
    cells: CellStore
    bundle: str | None = None

    @property
    def context(self) -> EvalContext:
        """The data, the preset and the networks."""
        return self.rg.context

    @cached_property
    def racer(self) -> RacerRows:
        """RACER's rows."""
        first = self.rg.first
        if self.bundle:
            bundle = bundles.load(self.bundle)
        else:
            bundle, run = self.rg.trained("q-network", 1)
            bundle = bundle.with_parts(**{name: run.get(STAGES[name]) for name in JUDGES})
        context = EvalContext.over(first.store, bundle, first.work, self.context.limit, first.progress)
        return RacerRows.of(replace(context, networks=self.context.networks), racer.PRESETS[first.config.name])

    def family(self, group: str) -> RowFamily:
        """The rows of a family (see `eval.rows.cells.family`)."""
        return self.racer if group == "racer" else self.rg

    def original(self, name: str) -> str:
        """The row whose cell a row is a copy of."""
        return self.family(family(name)).original(name)

    def key(self, name: str, seed: int) -> str:
        """Hash of everything that shapes a row's cell."""
        return self.family(family(name)).cell_key(name, seed)

    def cell(self, name: str, seed: int) -> Cell:
        """One row at one seed: read if it was finished under the same key, else trained, played, measured and kept."""
        same, rows, row = self.original(name), self.family(family(name)), ROWS[name]

        def made() -> Mapping[str, Any]:
            return rows.measured(name, seed) if same == name else {**self.cell(same, seed), "run_as": same}

        found = self._kept((name, seed, rows.cell_key(same, seed)), made, kind="row", question=row.question,
                           settings=list(row.settings), split=row.split)
        assert found is not None
        return found

    def reference(self, name: str, split: str) -> Cell | None:
        """The cell of a reference or a control; None where it cannot be made."""
        shown = name if split == "test" else f"{name}-{split}"
        return self._kept((shown, 0, self.rg.reference_key(name, split)), lambda: self.rg.reference(name, split),
                          kind="reference" if name in REFERENCES else "control",
                          question={**REFERENCES, **CONTROLS}[name], settings=[], split=split)

    def system(self, name: str, folder: Path) -> Cell | None:
        """The cell of another system; InputError where it has no motion for a test recording."""
        theirs = self.rg.foreign(name, folder)
        return self._kept((name, 0, theirs.key), theirs.measured, kind="system", settings=[], split="test",
                          question=f"another system's motion, {theirs.clips} clips")

    def _kept(self, at: tuple[str, int, str], make: Callable[[], Mapping[str, Any] | None], **about: Any
              ) -> Cell | None:
        """The cell of a row, a seed and a key, made and written where it is not there; None where none can be made."""
        name, seed, key = at
        known = self.cells.finished(name, seed, key)
        if known is not None:
            return known
        found = make()
        if not found:
            return None
        made = {**found, "row": name, "seed": seed, "key": key, "shared": self.family(family(name)).shared, **about}
        self.cells.add(made)
        return made
