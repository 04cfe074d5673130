"""A bundle with random weights, made in a moment: enough wherever it does not matter how well it moves."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from data_module.controls import Levels
from data_module.layers import freeze
from data_module.motion.movement import pasts_of
from data_module.speech.speech_encoder import SpeechEncoder, runner_of
from data_module.store import Store
from gesticulator.bundle import models
from gesticulator.bundle.bundle import Bundle, TextSource, rest_distances
from gesticulator.bundle.config import with_settings
from gesticulator.bundle.features import Normaliser, Sizes, Statistics, front_end_for, representation_of
from gesticulator.sampling import loop
from gesticulator.sampling.loop import BlockMotion, Request, Setup
from gesticulator.training.presets import preset
from gesticulator.training.stages import wanted
from gesticulator.training.stages.corpus import prepare
from gesticulator.training.stages.reward import block_audio
from interpreters.cql import QNetwork
from interpreters.reward import RewardModel
from interpreters.settings import QConfig, RewardConfig
from lexicon import movement_vqvae
from lexicon.movement import MovementLexicon, MovementVqVae

SPEAKERS = ("ann", "bob")
SILENT = (2, 5)
PLAIN = ("front_end.name=mel", "text.encoder=", "interpreter.text_features=0", "interpreter.use_control=false",
         "style.text_features=0", "generator.use_control=false", "schedules.gate.steps=0", "schedules.planner.steps=0",
         "schedules.cql.steps=0")
"""Settings of a bundle without text, learned speech levels, gate, style editing and Q-network."""


MOVING = ("system=movement", "generator.style_width=0", "schedules.style.steps=0")
"""Settings of a bundle that draws movements."""


def half(module: torch.nn.Module) -> torch.nn.Module:
    """Weights that half precision holds exactly, as those of a bundle that was read."""
    return freeze(module.half().float())


def untrained(*settings: str, text_width: int = 385, seed: int = 0) -> Bundle:
    """The tiny preset with these settings, every part at random but in range."""
    config = with_settings(preset("tiny"), list(settings))
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    learned = config.front_end.name == "vqwav2vec"
    encoder = half(SpeechEncoder(config.encoder.width)) if learned else None
    front = front_end_for(config, runner_of(encoder) if isinstance(encoder, SpeechEncoder) else None)
    low = high = front.width + 1
    width, frames, size = representation_of(config).width, config.rhythm.frames, config.lexicon.size
    words = text_width if config.text.encoder else 0
    pose = 0.1 * rng.normal(size=(len(SPEAKERS), width))
    levels = Levels(np.array([[-0.1, 0.1, 0.3], [0.1, 0.4, 0.8], [0.2, 0.3, 0.4]]), np.array([0.1, 0.4, 0.3]),
                    np.array([0.15, 0.3, 0.1])) if config.generator.use_control else None
    as_stored = [np.float32(a).astype(np.float64) for a in (pose, pose + 0.01, np.full(width, 0.1))]
    apart = float(learned)  # two levels of audio are normalised each by its own mean
    statistics = Statistics(
        SPEAKERS, *as_stored, np.stack([np.full(width, -3.0), np.full(width, 3.0)]),
        Normaliser(np.zeros(low), np.ones(low)), Normaliser(np.full(high, 1e-3 * apart), np.ones(high)),
        np.zeros((3 * frames, low)), np.zeros((3 * frames, high)), levels)
    sizes = Sizes(config, width, low, high, learned, len(SPEAKERS), words, statistics.present, silent=SILENT)
    lexicon = models.build("lexicon", sizes)
    if isinstance(lexicon, MovementLexicon):
        walk = torch.randn(400, frames, width).flatten(0, 1).cumsum(0).unflatten(0, (400, frames)) / 20
        told = pasts_of(walk, torch.full((400,), 0.3, dtype=torch.float64), walk[0, 0])
        if isinstance(lexicon, MovementVqVae):
            movement_vqvae.fit(lexicon, (walk, told), torch.ones(400, width), seed)
        else:
            lexicon.fit(walk, told, torch.ones(400, width), seed)
    else:
        lexicon.quantizer.set_vectors(torch.randn(size, config.lexicon.code_width))
    half(lexicon)
    sizes = dataclasses.replace(sizes, vectors=lexicon.vectors.numpy())
    parts = {stage.part: half(models.build(stage.part, sizes)) for stage in wanted(config)
             if stage.part and stage.part != "lexicon" and (words or not stage.part.endswith("_text"))}
    parts["lexicon"] = lexicon
    if isinstance(lexicon, MovementLexicon):
        parts["generator"].adopt(lexicon.basis, lexicon.basis.coefficients(walk, told),
                                   lexicon.added(torch.arange(lexicon.size)))
        half(parts["generator"])
    if encoder is not None:
        parts["encoder"] = encoder
    frequencies = rng.dirichlet(np.ones(size), size=2).astype(np.float32).astype(np.float64)
    moves = np.full((size, size), 1 / 16) if size == 16 else np.eye(size)
    return Bundle(
        config, statistics, np.array(SILENT), frequencies, moves, lexicon.vectors.numpy(),
        rest_distances(lexicon, statistics), parts,
        {"store": "none", "fingerprint": "0" * 64, "licence": "none", "hours": {"train": 0.0}}, {},
        TextSource.of(config, words))


def with_policies(store: Store, work: Path) -> Bundle:
    """A bundle of a store's performers that nobody trained, reward models and Q-network included."""
    bundle = untrained(*PLAIN, "selection.temperature=0.7")
    corpus = prepare(store, bundle.config, work, progress=False)
    names, frames, audio = corpus.statistics.speakers, bundle.config.rhythm.frames, block_audio(corpus).shape[-1]
    table = np.repeat(bundle.frequencies[:1], len(names), axis=0)
    reward, judge = (RewardModel(RewardConfig(width=16, projection=8), frames, corpus.motion.shape[-1], audio)
                     for _ in range(2))
    network = QNetwork(QConfig(width=16, heads=2, layers=1, audio_features=4, audio_bottleneck=4), frames,
                       corpus.high.shape[-1], len(bundle.vectors), len(names), bundle.silent.tolist())
    for module in (reward, judge, network):
        freeze(module)
    bundle = dataclasses.replace(bundle, statistics=corpus.statistics, frequencies=table)
    # Of as many performers as the store has.
    others = {name: half(models.build(name, bundle.sizes)) for name in bundle.parts if name != "lexicon"}
    return bundle.with_parts(**others | {"q_network": network, "reward": reward, "reward_judge": judge})


def sampled_blocks(bundle: Bundle, setup: Setup, requests: Sequence[Request], text: bool = False
                   ) -> list[BlockMotion]:
    """All blocks of a performance; arguments as of `loop.begin` and `loop.step`."""
    state, blocks = loop.begin(bundle, setup, text), []
    for request in requests:
        block, state = loop.step(bundle, setup, state, request)
        blocks.append(block)
    return blocks
