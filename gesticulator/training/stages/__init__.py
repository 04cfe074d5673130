"""The training stages in the order in which they run.

Each is defined in a file of this package, with its name, requirements, settings, constructor and training; which of
them a system has stands in its file (`gesticulator.systems`). A new stage does not change the seed of any other.
"""

from typing import Any

import numpy as np

from gesticulator.bundle.bundle import Bundle, TextSource, rest_distances
from gesticulator.bundle.config import Config
from gesticulator.bundle.models import system_of
from gesticulator.training.stages.base import Node, Run, Stage
from gesticulator.training.stages.corpus import BLOCKS, Corpus
from gesticulator.training.stages.generator import GENERATOR
from gesticulator.training.stages.heads import GATE, PLANNER
from gesticulator.training.stages.interpreter import INTERPRETER, INTERPRETER_TEXT, STYLE, STYLE_TEXT
from gesticulator.training.stages.lexicon import CODEC, LABELS, LEXICON, TOKENS, Labelled, Tokens
from gesticulator.training.stages.q_network import EPISODES, Q_LITERAL, Q_NETWORK
from gesticulator.training.stages.reward import REWARD, REWARD_JUDGE
from gesticulator.training.stages.speech import CONTRAST, CORPUS, ENCODER, SPEECH

__all__ = ["BLOCKS", "CODEC", "CONTRAST", "CORPUS", "ENCODER", "EPISODES", "GATE",
           "GENERATOR", "INTERPRETER", "INTERPRETER_TEXT", "LABELS", "LEXICON", "PLANNER", "Q_LITERAL", "Q_NETWORK",
           "REWARD", "REWARD_JUDGE", "SPEECH", "STAGES", "STYLE", "STYLE_TEXT", "TOKENS", "Corpus", "Labelled", "Node",
           "Run", "Stage", "Tokens", "assemble", "wanted"]

STAGES: dict[str, Stage[Any]] = {stage.name: stage for stage in (
    SPEECH, CONTRAST, LEXICON, CODEC, INTERPRETER, INTERPRETER_TEXT, GATE, PLANNER, REWARD, REWARD_JUDGE, Q_NETWORK,
    Q_LITERAL, GENERATOR, STYLE, STYLE_TEXT)}


def wanted(config: Config) -> list[Stage[Any]]:
    """The stages required by these settings, in order."""
    return [STAGES[name] for name in system_of(config).STAGES if STAGES[name].wanted(config)]


def assemble(run: Run, provenance: dict[str, Any] | None = None) -> Bundle:
    """Train or load every required stage; returns them as a Bundle."""
    corpus, labelled, tokens = run.get(CORPUS), run.get(LABELS), run.get(TOKENS)
    parts = {stage.part: run.get(stage) for stage in wanted(run.config) if stage.part}
    encoder = run.get(ENCODER)
    if encoder is not None:
        parts["encoder"] = encoder
    frequencies = np.stack([labelled.inventory.frequencies[name] for name in corpus.statistics.speakers])
    vectors = tokens.vectors.cpu().numpy()
    return Bundle(run.config, corpus.statistics, labelled.silent, frequencies, labelled.inventory.transitions, vectors,
                  rest_distances(tokens, corpus.statistics), parts, provenance or {}, dict(run.figures),
                  TextSource.of(run.config, corpus.text_width))
