"""The training stages in the order in which they run.

Each entry is defined in its own file, with its name, requirements, settings, constructor and training. A new stage is
one file and one entry here; it does not change the seed of any other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from data_module.errors import InputError, complain
from data_module.registry import PROJECT, Registry, RegistryEntry
from gesticulator.bundle.bundle import Bundle, TextSource, rest_distances
from gesticulator.bundle.config import Config
from gesticulator.systems import SYSTEMS, system_of
from gesticulator.training.stages.advantage import ADVANTAGE, COUNTERFACTUALS
from gesticulator.training.stages.base import Node, Run, Stage, closure
from gesticulator.training.stages.corpus import BLOCKS, Corpus
from gesticulator.training.stages.generator import GENERATOR
from gesticulator.training.stages.heads import GATE, PLANNER
from gesticulator.training.stages.interpreter import INTERPRETER, INTERPRETER_TEXT, STYLE, STYLE_TEXT
from gesticulator.training.stages.lexicon import CODEC, LABELS, LEXICON, TOKENS, Labelled, Tokens
from gesticulator.training.stages.q_network import EPISODES, Q_LITERAL, Q_NETWORK
from gesticulator.training.stages.reward import REWARD, REWARD_JUDGE
from gesticulator.training.stages.speech import CONTRAST, CORPUS, ENCODER, SPEECH
from interpreters import entries

_HERE = "gesticulator.training.stages"
ENTRIES: Registry[RegistryEntry] = Registry("stages", "a gesticulator.training.stages.base.Stage", {
    "speech": RegistryEntry("the speech encoder, by predictive coding of sound", f"{_HERE}.speech:SPEECH"),
    "contrast": RegistryEntry("the speech encoder, by the contrastive loss with text", f"{_HERE}.speech:CONTRAST"),
    "lexicon": RegistryEntry("the gesture lexicon: an autoencoder of blocks with a codebook",
                             f"{_HERE}.lexicon:LEXICON"),
    "codec": RegistryEntry("RACER's codec of motion", f"{_HERE}.lexicon:CODEC"),
    "interpreter": RegistryEntry("the lexeme interpreter: from speech to lexemes", f"{_HERE}.interpreter:INTERPRETER"),
    "interpreter_text": RegistryEntry("the lexeme interpreter with words", f"{_HERE}.interpreter:INTERPRETER_TEXT"),
    "gate": RegistryEntry("whether to gesture at all on a block", f"{_HERE}.heads:GATE"),
    "planner": RegistryEntry("the planner of gesture units: phase, hand and size of each block",
                             f"{_HERE}.heads:PLANNER"),
    "reward": RegistryEntry("RACER's reward model: how well motion fits speech", f"{_HERE}.reward:REWARD"),
    "reward_judge": RegistryEntry("a second reward model, which judges", f"{_HERE}.reward:REWARD_JUDGE"),
    "q_network": RegistryEntry("RACER's Q-network, by conservative Q-learning", f"{_HERE}.q_network:Q_NETWORK"),
    "q_network_literal": RegistryEntry("RACER's Q-network as published: recorded lexemes only",
                                       f"{_HERE}.q_network:Q_LITERAL"),
    "advantage": RegistryEntry("the critics of the advantage interpreter", f"{_HERE}.advantage:ADVANTAGE"),
    "generator": RegistryEntry("the generator: from lexemes and styles to motion", f"{_HERE}.generator:GENERATOR"),
    "style": RegistryEntry("the style interpreter: from speech to style codes", f"{_HERE}.interpreter:STYLE"),
    "style_text": RegistryEntry("the style interpreter with words", f"{_HERE}.interpreter:STYLE_TEXT"),
}, RegistryEntry, fits=lambda value: isinstance(value, Stage))
"""Ours in the order in which they are trained, then those of other packages."""


class StageTable(Mapping[str, Stage[Any]]):
    """The stages by name: those of `ENTRIES`, then those that entries of interpreters name. Of one of another package
    that cannot be loaded a line is printed."""

    def _all(self) -> dict[str, Stage[Any]]:
        stages: list[Stage[Any]] = []
        for name in ENTRIES:
            try:
                stages.append(ENTRIES.load(name))
            except InputError as error:
                complain(f"{PROJECT}: {error}")
        stages += [entry.load_stage() for entry in entries().values() if entry.stage]
        return {stage.name: stage for stage in stages}

    def __getitem__(self, name: str) -> Stage[Any]:
        return self._all()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())


STAGES = StageTable()

__all__ = ["ADVANTAGE", "BLOCKS", "CODEC", "CONTRAST", "CORPUS", "COUNTERFACTUALS", "ENCODER", "EPISODES", "GATE",
           "GENERATOR", "INTERPRETER", "INTERPRETER_TEXT", "LABELS", "LEXICON", "PLANNER", "Q_LITERAL", "Q_NETWORK",
           "REWARD", "REWARD_JUDGE", "SPEECH", "STAGES", "STYLE", "STYLE_TEXT", "TOKENS", "Corpus", "Labelled", "Node",
           "Run", "Stage", "Tokens", "assemble", "closure", "wanted"]


def wanted(config: Config) -> list[Stage[Any]]:
    """The stages required by these settings, in order: those of the system, then those of other packages."""
    stages = dict(STAGES)
    # A stage that no system lists comes from another package and is always offered.
    listed = {name for system in SYSTEMS for name in SYSTEMS.load(system).STAGES}
    names = [*system_of(config).STAGES, *(name for name in stages if name not in listed)]
    return [stages[name] for name in names if stages[name].wanted(config)]


def assemble(run: Run, provenance: dict[str, Any] | None = None, leave_out: Sequence[Stage[Any]] = ()) -> Bundle:
    """Train or load every required stage except `leave_out`; returns them as a Bundle."""
    corpus, labelled, tokens = run.get(CORPUS), run.get(LABELS), run.get(TOKENS)
    parts = {stage.part: run.get(stage) for stage in wanted(run.config) if stage.part and stage not in leave_out}
    encoder = run.get(ENCODER)
    if encoder is not None:
        parts["encoder"] = encoder
    frequencies = np.stack([labelled.inventory.frequencies[name] for name in corpus.statistics.speakers])
    return Bundle(run.config, corpus.statistics, labelled.silent, frequencies, labelled.inventory.transitions,
                  tokens.vectors, rest_distances(tokens, corpus.statistics), parts, provenance or {}, dict(run.figures),
                  TextSource.of(run.config, corpus.text_width))
