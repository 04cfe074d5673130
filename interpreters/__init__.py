"""Interpreters: from speech to lexemes and style codes. One protocol (`interpreters.base`), several systems.

A new interpreter is one file and one entry here, or an entry point of another package (`data_module.registry`); those
of other packages have no weights. This file imports none of them: the command line lists the names.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

from data_module.registry import Registry, RegistryEntry


@dataclass(frozen=True)
class InterpreterEntry(RegistryEntry):
    """A lexeme interpreter that a bundle may hold.

    about: a line of help. where: module and class, an `interpreters.base.Interpreter`. part: name of its weights in a
    bundle; empty for an interpreter without weights, which is called with the speakers' lexeme frequencies
    [speakers, S] and the lexemes' transitions [S, S] (rows from, each summing to 1) unless its class overrides
    `InterpreterDefaults.open`. text_part: the part to use if the speech has words.

    For interpreters with weights, which are played by the class itself, made from settings, sizes and tensors: section:
    the group of settings of `Config`, by default the name of the part. model: module and class of the network that is
    trained, if not the interpreter itself: it has `build(settings, sizes)`. file: names of the files of the part and
    the text part without suffix, by default the names of the parts. tied: the weights fit one codebook only.
    temperature: its default temperature, if it is not that of the bundle. doubt: the warning with which it plays, if it
    is no better than another by our figures; empty for none.
    """

    part: str = ""
    text_part: str = ""
    section: str = ""
    model: str = ""
    file: tuple[str, ...] = ()
    tied: bool = True
    temperature: float | None = None
    doubt: str = ""

    def load_model(self) -> Any:
        return class_at(self.model or self.where)

    def load_runner(self) -> Any:
        return class_at(self.where)

    @property
    def settings(self) -> str:
        return self.section or self.part

    @property
    def files(self) -> dict[str, str]:
        """Part of a bundle -> its file, without suffix."""
        parts = [part for part in (self.part, self.text_part) if part]
        return dict(zip(parts, self.file or parts, strict=True))


def class_at(where: str) -> Any:
    """The class of a module:class."""
    module, name = where.split(":")
    return getattr(import_module(module), name)


INTERPRETERS: Registry[InterpreterEntry] = Registry("interpreters", "an interpreter", {
    "lstm": InterpreterEntry(
        "the LSTM of Rhythmic Gesticulator", "interpreters.lstm_run:LstmRunner", "interpreter", "interpreter_text",
        model="interpreters.lstm:LstmInterpreter", file=("lexeme_interpreter", "lexeme_interpreter_text"), tied=False),
    "cql": InterpreterEntry(
        "RACER's Q-network", "interpreters.cql_run:QRunner", "q_network", section="cql",
        model="interpreters.cql:QNetwork",
        doubt="cql chooses gestures no better than lstm by any figure of this project, and at temperature 0 it repeats "
              "a few"),
    "cql-literal": InterpreterEntry(
        "RACER's Q-network as published: recorded lexemes only, arg max", "interpreters.cql_run:LiteralQRunner",
        "q_network_literal", section="cql_literal", model="interpreters.cql:QNetwork", temperature=0.0,
        doubt="cql-literal is RACER's as published, for comparison: it repeats few lexemes, and lstm chooses better"),
    "statistical": InterpreterEntry(
        "the speaker's lexeme frequencies", "interpreters.statistical:StatisticalInterpreter",
        doubt="statistical draws lexemes without listening to the speech; lstm chooses better by the judge of "
              "rewards"),
}, InterpreterEntry)
"""By name; the default is the first that a bundle has."""


def entries() -> Mapping[str, InterpreterEntry]:
    return _usable(tuple(INTERPRETERS))


@cache
def _usable(names: tuple[str, ...]) -> Mapping[str, InterpreterEntry]:
    """Cached, so that the warning about an interpreter that cannot be imported is printed once."""
    return INTERPRETERS.usable()
