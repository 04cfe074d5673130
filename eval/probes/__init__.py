"""Probes: one question each about a bundle, a data set or a voice. `gesticulator probe NAME`, `--list` shows all.

A probe is a module with `arguments(parser)`, which adds what it takes, and `run(arguments)`, which gives the tables
that answer the question; the command keeps and prints them. A new one is a file and an entry here.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eval.table import Table


@dataclass(frozen=True)
class Probe:
    """module: imported when the probe is called, since most need torch. question: what it answers."""

    module: str
    question: str

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add what it takes, without --out."""
        self._load().arguments(parser)

    def run(self, arguments: argparse.Namespace) -> Sequence[Table]:
        """The answer; InputError for input that cannot be used."""
        tables: Sequence[Table] = self._load().run(arguments)
        return tables

    def _load(self) -> Any:
        return importlib.import_module(self.module)


PROBES: dict[str, Probe] = {
    "quality": Probe("eval.probes.quality", "how good is a bundle on the test split, beside baselines?"),
    "policies": Probe("eval.probes.policies", "which interpreter chooses best, judged as policies?"),
    "parts": Probe("eval.probes.parts", "what did words and the learned speech levels buy?"),
}
