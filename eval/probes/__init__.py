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
    "corpus": Probe("eval.probes.corpus", "is a built data set good enough to learn from?"),
    "beat-labels": Probe("eval.probes.beat_labels", "are the beats that are found those that people marked by hand?"),
    "languages": Probe("eval.probes.languages", "does one language's model gesture in time with another?"),
    "two-languages": Probe("eval.probes.two_languages", "does a speech encoder gain from a second language?"),
    "gate": Probe("eval.probes.gate", "does the gate know when people gesture, and what does it do?"),
    "rewards": Probe("eval.probes.rewards", "does RACER's reward rank?"),
    "speech-levels": Probe("eval.probes.speech_levels", "what does each level of the speech encoder know?"),
    "style-editing": Probe("eval.probes.style_editing", "does the motion do what is asked of its style?"),
    "lexicon-rhythm": Probe("eval.probes.lexicon_rhythm", "do lexemes carry the rhythm?"),
}
