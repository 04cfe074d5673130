"""Interpreters: from speech to lexemes and style codes. One protocol (`interpreters.base`), several systems.

A new interpreter is one file and one entry here, or an entry point of another package (`data_module.registry`). This
file imports none of them: the command line lists the names.
"""

from __future__ import annotations

from dataclasses import dataclass

from data_module.registry import Registry, RegistryEntry

__part_of__ = "gesticulator"
"""By which `gesticulator.version` tells this package from another of the same name."""


@dataclass(frozen=True)
class InterpreterEntry(RegistryEntry):
    """A lexeme interpreter that a bundle may hold.

    about: a line for the command line. where: module and class. part: the part of a bundle that it is, empty for one
    without weights, which is made by a call with the speakers' lexeme frequencies [speakers, S] and the lexemes'
    transitions [S, S] (rows from, each summing to 1). text_part: the part that is taken when the speech has words.
    prior: the interpreter that it stands on and that is handed to it, empty for one that stands alone.
    """

    part: str = ""
    text_part: str = ""
    prior: str = ""


INTERPRETERS: Registry[InterpreterEntry] = Registry("interpreters", "an interpreter", {
    "lstm": InterpreterEntry("the LSTM of Rhythmic Gesticulator", "interpreters.lstm:LstmInterpreter",
                             part="interpreter", text_part="interpreter_text"),
    "cql": InterpreterEntry("RACER's Q-network", "interpreters.cql:QNetwork", part="q_network"),
    "advantage": InterpreterEntry("the LSTM, biased by a learned reward; see --beta",
                                  "interpreters.advantage:AdvantageInterpreter", part="advantage", prior="lstm"),
    "statistical": InterpreterEntry("the speaker's lexeme frequencies",
                                    "interpreters.statistical:StatisticalInterpreter"),
}, InterpreterEntry)
"""By name; the first that a bundle has is taken when none is named."""
