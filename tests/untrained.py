"""A bundle with random weights, made in a moment: enough wherever it does not matter how well it moves."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from data_module.controls import Levels
from data_module.layers import freeze
from data_module.speech.features import Normaliser
from data_module.speech.speech_encoder import SpeechEncoder
from generator.model import Generator
from gesticulator.bundle import Bundle, TextSource
from gesticulator.config import Config, preset, with_settings
from gesticulator.speech_features import front_end_for
from gesticulator.statistics import CONTROL_WIDTH, Statistics, representation_of
from gesticulator.train import Run
from interpreters.cql import QNetwork
from interpreters.gate import ActivityGate
from interpreters.lstm import LstmInterpreter
from interpreters.reward import RewardModel
from interpreters.style import StyleInterpreter
from lexicon.autoencoder import Lexicon
from lexicon.inventory import Inventory

SPEAKERS = ("ann", "bob")
SILENT = (2, 5)
PLAIN = ("front_end.name=mel", "text.encoder=", "interpreter.text_features=0", "interpreter.use_control=false",
         "style.text_features=0", "generator.use_control=false", "schedules.gate.steps=0", "schedules.cql.steps=0")
"""Settings of a bundle without text, learned speech levels, gate, style editing and Q-network."""


def half(module: torch.nn.Module) -> torch.nn.Module:
    """Weights that half precision holds exactly, as those of a bundle that was read."""
    return freeze(module.half().float())


def untrained(*settings: str, text_width: int = 385, seed: int = 0) -> Bundle:
    """The tiny preset with these settings, every part at random but in range."""
    config = with_settings(preset("tiny"), list(settings))
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    learned = config.front_end.name == "vqwav2vec"
    encoder = half(SpeechEncoder(config.encoder)) if learned else None
    front = front_end_for(config, encoder)  # type: ignore[arg-type]
    low, high = front.width_low + 1, front.width_high + 1
    width, frames, size = representation_of(config).width, config.rhythm.frames, config.lexicon.size
    words = text_width if config.text.encoder else 0
    pose = 0.1 * rng.normal(size=(len(SPEAKERS), width))
    levels = Levels(np.array([[-0.1, 0.1, 0.3], [0.1, 0.4, 0.8], [0.2, 0.3, 0.4]]), np.array([0.1, 0.4, 0.3]),
                    np.array([0.15, 0.3, 0.1])) if config.generator.use_control else None
    as_stored = [np.float32(a).astype(np.float64) for a in (pose, pose + 0.01, np.full(width, 0.1))]
    statistics = Statistics(
        SPEAKERS, *as_stored, np.stack([np.full(width, -3.0), np.full(width, 3.0)]),
        Normaliser(np.zeros(low), np.ones(low)), Normaliser(np.zeros(high), np.ones(high)),
        np.zeros((3 * frames, low)), np.zeros((3 * frames, high)), levels)
    lexicon = Lexicon(config.lexicon, frames, width, statistics.present)
    lexicon.quantizer.set_vectors(torch.randn(size, config.lexicon.code_width))
    half(lexicon)
    shared = frames, low, lexicon.vectors, config.generator.style_width, len(SPEAKERS), words

    def lexemes(stage: str) -> LstmInterpreter:
        run = Run(config, None, None)  # type: ignore[arg-type]
        return half(LstmInterpreter(run.sized(stage), frames, high, lexicon.vectors, len(SPEAKERS), words,
                                    CONTROL_WIDTH))  # type: ignore[return-value]

    def style(stage: str) -> StyleInterpreter:
        return half(StyleInterpreter(Run(config, None, None).sized(stage), *shared))  # type: ignore[arg-type, return-value]

    frequencies = rng.dirichlet(np.ones(size), size=2).astype(np.float32).astype(np.float64)
    moves = np.full((size, size), 1 / 16) if size == 16 else np.eye(size)
    return Bundle(
        config, statistics, lexicon,
        half(Generator(config.generator, frames, width, low, config.lexicon.code_width, control_width=CONTROL_WIDTH,
                       present=statistics.present)),  # type: ignore[arg-type]
        lexemes("interpreter"), style("style"), Inventory(dict(zip(SPEAKERS, frequencies, strict=True)), moves),
        np.array(SILENT), {"store": "none", "fingerprint": "0" * 64, "licence": "none", "hours": {"train": 0.0}}, {},
        encoder=encoder,  # type: ignore[arg-type]
        gate=half(ActivityGate(config.gate, frames, low, len(SPEAKERS))) if config.schedules.gate.steps else None,  # type: ignore[arg-type]
        interpreter_text=lexemes("interpreter_text") if words and config.interpreter.reads else None,
        style_text=style("style_text") if words and config.style.text_features else None,
        text=TextSource.of(config, words), **racer(config, lexicon, low, high, learned))


def racer(config: Config, lexicon: Lexicon, low: int, high: int, two_levels: bool) -> dict[str, Any]:
    """Q-network and reward models, where the settings train them."""
    if not config.schedules.cql.steps:
        return {}
    heard = low + high - 1 if two_levels else low
    return {"q_network": half(QNetwork(config.cql, config.rhythm.frames, high, len(lexicon.vectors), len(SPEAKERS),
                                       SILENT)),
            **{name: half(RewardModel(config.reward, config.rhythm.frames, lexicon.motion_width, heard))
               for name in ("reward", "reward_judge")}}
