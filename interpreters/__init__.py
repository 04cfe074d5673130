"""Interpreters: from speech to lexemes and style codes. One protocol (`interpreters.base`), several systems.

A new interpreter is one file and one entry here, or an entry point of another package (`data_module.registry`); one
with weights has its training stage in a file too. This file imports none of them: the command line lists the names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

from data_module.registry import Registry, RegistryEntry

__part_of__ = "gesticulator"
"""By which `gesticulator.version` tells this package from another of the same name."""


@dataclass(frozen=True)
class InterpreterEntry(RegistryEntry):
    """A lexeme interpreter that a bundle may hold.

    about: a line for the command line. where: module and class, an `interpreters.base.Interpreter`. part: its weights'
    name in a bundle, empty for one without weights, which is made by a call with the speakers' lexeme frequencies
    [speakers, S] and the lexemes' transitions [S, S] (rows from, each summing to 1) unless its class says otherwise
    (`InterpreterDefaults.open`). text_part: the part that is taken when the speech has words. prior: the interpreter
    that it stands on and that is handed to it, empty for one that stands alone.

    What follows is of one with weights. section: the group of settings (of `Config`, or of its `others`); the name of
    the part where empty. model: module and class of the weights, where they are not the interpreter itself: it has
    `build(settings, sizes)`, and `Settings`, the class of its settings, where those are among `others`. file: of the
    part and of the text part, without the ending; named like them where empty. tied: the weights are worthless over
    another codebook. stage: module and name of the stage that trains it, where the table of stages does not have it.
    """

    part: str = ""
    text_part: str = ""
    prior: str = ""
    section: str = ""
    model: str = ""
    file: tuple[str, ...] = ()
    tied: bool = True
    stage: str = ""

    def load_model(self) -> Any:
        """The class of its weights."""
        return _object(self.model or self.where)

    def load_stage(self) -> Any:
        """The stage that trains it."""
        return _object(self.stage)

    @property
    def settings(self) -> str:
        """The name of its group of settings."""
        return self.section or self.part

    @property
    def files(self) -> dict[str, str]:
        """Part of a bundle -> its file, without the ending."""
        parts = [part for part in (self.part, self.text_part) if part]
        return dict(zip(parts, self.file or parts, strict=True))


def _object(where: str) -> Any:
    module, name = where.split(":")
    return getattr(import_module(module), name)


INTERPRETERS: Registry[InterpreterEntry] = Registry("interpreters", "an interpreter", {
    "lstm": InterpreterEntry(
        "the LSTM of Rhythmic Gesticulator", "interpreters.lstm:LstmInterpreter", "interpreter", "interpreter_text",
        file=("lexeme_interpreter", "lexeme_interpreter_text"), tied=False),
    "cql": InterpreterEntry("RACER's Q-network", "interpreters.cql:QNetwork", "q_network", section="cql"),
    "advantage": InterpreterEntry(
        "the LSTM, biased by a learned reward; see --beta", "interpreters.advantage:AdvantageInterpreter", "advantage",
        prior="lstm", model="interpreters.advantage:Critics"),
    "statistical": InterpreterEntry(
        "the speaker's lexeme frequencies", "interpreters.statistical:StatisticalInterpreter", section="statistical"),
}, InterpreterEntry)
"""By name; the first that a bundle has is taken when none is named."""


def entries() -> Mapping[str, InterpreterEntry]:
    """Every interpreter that can be used, in full."""
    return _usable(tuple(INTERPRETERS))


@cache
def _usable(names: tuple[str, ...]) -> Mapping[str, InterpreterEntry]:
    """Once for each set of names: of an interpreter that cannot be imported a line is printed."""
    return INTERPRETERS.usable()
