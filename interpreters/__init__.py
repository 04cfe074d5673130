"""Interpreters: from speech to lexemes and style codes. One protocol (`interpreters.base`), several systems.

A new interpreter is one file and one entry here. This file imports none of them: the command line lists the names.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

__part_of__ = "gesticulator"
"""By which `gesticulator.neighbours` tells this package from another of the same name."""


@dataclass(frozen=True)
class InterpreterEntry:
    """A lexeme interpreter that a bundle may hold.

    about: a line for the command line. where: module and class. part: the part of a bundle that it is, empty for one
    that is made of the lexicon's counts alone. text_part: the part that is taken when the speech has words. prior: the
    interpreter that it stands on and that is handed to it, empty for one that stands alone.
    """

    about: str
    where: str
    part: str = ""
    text_part: str = ""
    prior: str = ""

    def load(self) -> Any:
        """Its class."""
        module, name = self.where.split(":")
        return getattr(import_module(module), name)


INTERPRETERS: dict[str, InterpreterEntry] = {
    "lstm": InterpreterEntry("the LSTM of Rhythmic Gesticulator", "interpreters.lstm:LstmInterpreter", "interpreter",
                  "interpreter_text"),
    "cql": InterpreterEntry("RACER's Q-network", "interpreters.cql:QNetwork", "q_network"),
    "advantage": InterpreterEntry("the LSTM, biased by a learned reward; see --beta",
                                  "interpreters.advantage:AdvantageInterpreter", "advantage", prior="lstm"),
    "statistical": InterpreterEntry("the speaker's lexeme frequencies",
                                    "interpreters.statistical:StatisticalInterpreter"),
}
"""By name; the first that a bundle has is taken when none is named."""
