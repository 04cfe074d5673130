"""Constructs every model of a bundle, for training and for loading.

Lexicon, generator and style interpreter are those of the system (`System`). Model shapes that depend on
the data and not on the settings are passed as `Sizes`. Each model's module is imported by the function that builds it,
so that loading one part imports only that part. The parts of a bundle on disk are loaded on first use (`LazyParts`).
"""

from __future__ import annotations

import warnings
from collections import UserDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, cast

import torch
from torch import nn

from data_module.errors import InputError
from data_module.layers import freeze
from data_module.registry import Registry, RegistryEntry
from gesticulator.bundle.config import Config, RewardConfig
from gesticulator.bundle.features import CONTROL_WIDTH, Sizes
from gesticulator.bundle.files import Weights, lexicon_hash
from interpreters import InterpreterEntry, entries
from interpreters.base import InterpreterSizes

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder
    from interpreters.gate import ActivityGate
    from interpreters.planner import UnitPlanner
    from interpreters.reward import RewardEnsemble


class System(Protocol):
    """A module of `gesticulator.systems`, as the rest of the product sees it. NAME: the word of `Config.system`. PARTS:
    the models that its bundle needs besides the lexicon; STAGES: the names of its training stages in order
    (`gesticulator.training.stages`), whether or not the settings want each. CODEBOOK: the name of the tensor of code
    vectors in the lexicon's file. BLOCKS: blocks at the beat are generated one by one, so that a single one can be
    generated again; IN_CONTEXT: the motion of a lexeme depends on the block before; SILENCE: some lexemes are silent
    (RG 6.4.1); VARIES: the same lexemes can be sampled as different motion. begin, step: of the same arguments as those
    of `gesticulator.sampling.loop`; motion_of: the motion [N, K, D_m] of all N blocks."""

    NAME: str
    PARTS: tuple[str, ...]
    STAGES: tuple[str, ...]
    CODEBOOK: str
    BLOCKS: bool
    IN_CONTEXT: bool
    SILENCE: bool
    VARIES: bool
    begin: Callable[..., Any]
    step: Callable[..., Any]
    motion_of: Callable[..., Any]

    def codebook_shape(self, config: Config) -> tuple[int, int]:
        """(S, D_s): the number of lexemes, and the width of a lexeme's vector."""

    def lexicon(self, sizes: Sizes) -> nn.Module:
        """The untrained lexicon or codec."""

    def generator(self, sizes: Sizes) -> nn.Module:
        """The untrained generator; InputError if the system has none."""

    def style(self, sizes: Sizes, reads: bool) -> nn.Module:
        """The untrained style interpreter; reads: it also takes the words. InputError if the system has none."""


SYSTEMS: Registry[RegistryEntry] = Registry("systems", "a system", {
    "paper": RegistryEntry("Rhythmic Gesticulator as published", "gesticulator.systems.paper"),
    "movement": RegistryEntry("movements, gesture units and a flow generator", "gesticulator.systems.movement"),
    "racer": RegistryEntry("RACER as published", "gesticulator.systems.racer"),
}, RegistryEntry)
"""By name. A bundle names one of these three; other packages add interpreters, not systems."""


def system_of(config: Config) -> System:
    """The system of these settings."""
    return cast(System, SYSTEMS.load(config.system))


def encoder(sizes: Sizes) -> SpeechEncoder:
    """The speech encoder (RG 4.1.3)."""
    from data_module.speech.speech_encoder import SpeechEncoder

    return SpeechEncoder(sizes.config.encoder.width)


def gate(sizes: Sizes) -> ActivityGate:
    """The gate, which decides whether a block is gestured."""
    from interpreters.gate import ActivityGate

    return ActivityGate(sizes.config.gate, sizes.frames, sizes.low, sizes.speakers)


def planner(sizes: Sizes) -> UnitPlanner:
    """The planner of gesture units."""
    from interpreters.planner import UnitPlanner

    return UnitPlanner(sizes.config.planner, sizes.frames, sizes.low, sizes.speakers, len(sizes.lexemes))


def reward(sizes: Sizes) -> RewardEnsemble:
    """The ensemble of E_m and E_u that trains a policy (RACER 4.2)."""
    return _reward(sizes, sizes.config.reward)


def reward_judge(sizes: Sizes) -> RewardEnsemble:
    """An ensemble of other sizes that evaluates a policy."""
    return _reward(sizes, sizes.config.judge)


def _reward(sizes: Sizes, config: RewardConfig) -> RewardEnsemble:
    from interpreters.reward import RewardEnsemble

    # The term compares lexemes that follow one another.
    if not system_of(sizes.config).IN_CONTEXT:
        config = replace(config, choice=0.0)  # only movements are decoded in context, lexeme by lexeme
    return RewardEnsemble(config, sizes.frames, sizes.motion, sizes.block_audio)


@dataclass(frozen=True)
class BundlePart:
    """A part of a bundle. file: without the suffix; build: returns the untrained model; tied: whether its weights are
    valid only for the codebook that they were trained with."""

    file: str
    build: Callable[[Sizes], nn.Module]
    tied: bool = False


PARTS = {"encoder": BundlePart("speech_encoder", encoder),
         "lexicon": BundlePart("lexicon", lambda sizes: system_of(sizes.config).lexicon(sizes)),
         "generator": BundlePart("generator", lambda sizes: system_of(sizes.config).generator(sizes)),
         "style": BundlePart("style_interpreter", lambda sizes: system_of(sizes.config).style(sizes, False)),
         "style_text": BundlePart("style_interpreter_text", lambda sizes: system_of(sizes.config).style(sizes, True)),
         "gate": BundlePart("gate", gate), "planner": BundlePart("planner", planner, tied=True)}
"""The parts other than lexeme interpreters; only the lexicon is always present."""


def part_table() -> dict[str, BundlePart]:
    """Every part that a bundle may have, including those of all registered lexeme interpreters."""
    # Computed on each call, because packages can be registered while the program runs.
    return {**PARTS, **{part: BundlePart(file, partial(_interpreter, entry, part), entry.tied)
                        for entry in entries().values() for part, file in entry.files.items()}}


def _interpreter(entry: InterpreterEntry, part: str, sizes: Sizes) -> nn.Module:
    """The model of a lexeme interpreter, with or without text."""
    # The audio-only twin has the same settings, but no layer for words.
    settings = getattr(sizes.config, entry.settings)
    if entry.text_part and part != entry.text_part:
        settings = settings.without_text()
    model: nn.Module = entry.load_model().build(settings, InterpreterSizes(
        sizes.frames, sizes.low, sizes.high, sizes.speakers, sizes.text, CONTROL_WIDTH, sizes.motion, sizes.lexemes,
        sizes.silent))
    return model


def build(part: str, sizes: Sizes) -> Any:
    return part_table()[part].build(sizes)


def shapes(name: str, sizes: Sizes) -> dict[str, tuple[int, ...]]:
    """The shape of every tensor of a part, computed without allocating memory; InputError for inconsistent settings."""
    # Tensors on the meta device have shapes and no memory, so any size in a broken file is safe.
    on_meta = replace(sizes, present=sizes.present.to("meta"),
                      vectors=None if sizes.vectors is None else sizes.vectors.to("meta"))
    try:
        with torch.device("meta"), warnings.catch_warnings(action="ignore", category=UserWarning):
            return {key: tuple(value.shape) for key, value in build(name, on_meta).state_dict().items()}
    except (ValueError, RuntimeError, IndexError, OverflowError, ZeroDivisionError) as error:
        raise InputError("settings", f"no {name} can be built of them ({str(error).splitlines()[0][:200]})",
                         "change them") from None


JUDGES = ("reward", "reward_judge")
"""Models that train and evaluate a policy and are not used at inference: they stay in the work folder of the training;
evaluation adds them to an opened bundle (`with_parts`). Saving a bundle omits them."""


class LazyParts(UserDict[str, Any]):
    """Models by name; those that are given by a function are loaded when they are first used."""

    def __getitem__(self, name: str) -> nn.Module:
        part = self.data[name]
        if not isinstance(part, nn.Module):
            # Kept, because loading reads and checks a file.
            part = self.data[name] = part()
        return part


def stored_parts(weights: Weights, sizes: Sizes, device: torch.device) -> LazyParts:
    """The models of a bundle on disk."""
    return LazyParts({name: partial(_opened, part, name, weights, sizes, device)
                      for name, part in part_table().items() if part.file in weights})


def _opened(part: BundlePart, name: str, weights: Weights, sizes: Sizes, device: torch.device) -> nn.Module:
    tied = lexicon_hash(sizes.lexemes) if part.tied else None
    # Before the model is built: a width in a broken index could take all memory.
    tensors = weights.read(part.file, shapes(name, sizes), tied)
    model = part.build(sizes)
    model.load_state_dict(tensors)
    return freeze(model.to(device))
