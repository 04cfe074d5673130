"""The training stages in the order in which they run.

Each entry is defined in its own file, with its name, requirements, settings, constructor and training. A new stage is
one file and one entry here; it does not change the seed of any other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gesticulator.bundle.bundle import Bundle, TextSource, rest_distances
from gesticulator.bundle.config import Config
from gesticulator.bundle.system import system_of
from gesticulator.training.stages.advantage import ADVANTAGE, COUNTERFACTUALS
from gesticulator.training.stages.base import Node, Run, Stage, closure
from gesticulator.training.stages.corpus import BLOCKS, Corpus
from gesticulator.training.stages.features import CORPUS
from gesticulator.training.stages.gate import GATE
from gesticulator.training.stages.generator import GENERATOR
from gesticulator.training.stages.interpreter import INTERPRETER, INTERPRETER_TEXT
from gesticulator.training.stages.labels import LABELS, Labelled
from gesticulator.training.stages.lexicon import CODEC, LEXICON, TOKENS, Tokens
from gesticulator.training.stages.others import other_stages
from gesticulator.training.stages.q_network import EPISODES, Q_NETWORK
from gesticulator.training.stages.reward import REWARD, REWARD_JUDGE
from gesticulator.training.stages.speech import CONTRAST, ENCODER, SPEECH
from gesticulator.training.stages.style import STYLE, STYLE_TEXT
from interpreters import entries

OURS: tuple[Stage[Any], ...] = (SPEECH, CONTRAST, LEXICON, CODEC, INTERPRETER, INTERPRETER_TEXT, GATE, REWARD,
                                REWARD_JUDGE, Q_NETWORK, ADVANTAGE, GENERATOR, STYLE, STYLE_TEXT)


class StageTable(Mapping[str, Stage[Any]]):
    """The stages by name: those of other packages, ours in order, then those of registered interpreters."""

    def _all(self) -> dict[str, Stage[Any]]:
        named = [entry.load_stage() for entry in entries().values() if entry.stage]
        return {stage.name: stage for stage in (*other_stages().values(), *OURS, *named)}

    def __getitem__(self, name: str) -> Stage[Any]:
        return self._all()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())


STAGES = StageTable()

__all__ = ["ADVANTAGE", "BLOCKS", "CODEC", "CONTRAST", "CORPUS", "COUNTERFACTUALS", "ENCODER", "EPISODES", "GATE",
           "GENERATOR", "INTERPRETER", "INTERPRETER_TEXT", "LABELS", "LEXICON", "Q_NETWORK", "REWARD", "REWARD_JUDGE",
           "SPEECH", "STAGES", "STYLE", "STYLE_TEXT", "TOKENS", "Corpus", "Labelled", "Node", "Run", "Stage", "Tokens",
           "assemble", "closure", "wanted"]


def wanted(config: Config) -> list[Stage[Any]]:
    """The stages required by these settings, in order."""
    system = system_of(config)
    return [stage for stage in STAGES.values() if system.uses(stage.name) and stage.wanted(config)]


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
