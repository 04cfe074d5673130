"""Constructs every model of a bundle, for training and for loading; loads each part when it is first used.

Model shapes that depend on the data and not on the settings are passed as `Sizes`. Each model's module is imported by
the function that builds it, so that loading one part imports only that part. The parts of a bundle on disk are loaded
on first use (`StoredParts`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from data_module.errors import InputError
from data_module.layers import freeze
from gesticulator.bundle.config import Config, RewardConfig, section, system_of
from gesticulator.bundle.features import CONTROL_WIDTH, representation_of
from gesticulator.bundle.files import Weights, lexicon_hash
from interpreters import InterpreterEntry, entries
from interpreters.base import InterpreterSizes

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder
    from generator.flow import FlowGenerator
    from generator.model import Generator
    from interpreters.gate import ActivityGate
    from interpreters.lstm import StyleInterpreter
    from interpreters.planner import UnitPlanner, UnitStyleInterpreter
    from interpreters.reward import RewardEnsemble
    from lexicon.autoencoder import Lexicon
    from lexicon.movement import MovementLexicon
    from lexicon.racer import RacerCodec
    from lexicon.settings import LexiconConfig


@dataclass(frozen=True)
class Sizes:
    """Model dimensions that depend on the data.

    motion: D_m; low, high: widths d + 1 of the two audio levels, including the log duration; two_levels: whether they
    differ; speakers: P; text: d_t + 1, 0 without words; present: [D_m] 1 for dimensions that ever move in training;
    vectors: [S, D_s] the codebook, if there is one; silent: the silent lexemes; training_blocks: number of learned
    style codes, 0 at inference, where the generator has no table of them.
    """

    config: Config
    motion: int
    low: int
    high: int
    two_levels: bool
    speakers: int
    text: int
    present: Tensor
    vectors: Tensor | None = None
    silent: tuple[int, ...] = ()
    training_blocks: int = 0

    @property
    def frames(self) -> int:
        """K, frames per block."""
        return self.config.rhythm.frames

    @property
    def lexemes(self) -> Tensor:
        """[S, D_s] the codebook; ValueError if there is none yet."""
        if self.vectors is None:
            raise ValueError("this model is built over a codebook, and there is none yet")
        return self.vectors

    @property
    def block_audio(self) -> int:
        """Audio width of the reward models: both levels if they differ, the log duration once."""
        return self.low + self.high - 1 if self.two_levels else self.low


def encoder(sizes: Sizes) -> SpeechEncoder:
    """The speech encoder (RG 4.1.3)."""
    from data_module.speech.speech_encoder import SpeechEncoder

    return SpeechEncoder(sizes.config.encoder)


def parts_of_body(config: Config) -> dict[str, tuple[int, ...]]:
    """Body part -> its indices in D_m under these settings."""
    from data_module.motion.movement import body_parts
    from data_module.motion.skeletons import CHARACTERS

    representation = representation_of(config)
    if representation.name != "rotations":
        return {"body": tuple(range(representation.width))}
    return body_parts(CHARACTERS[config.motion.joints].names)


def lexicon(sizes: Sizes) -> Lexicon | MovementLexicon:
    """The VQ-VAE over blocks (RG 5.1), or the lexicon of movements, itself a VQ-VAE or k-means."""
    if system_of(sizes.config).naming.in_context:
        return movement_lexicon(sizes.config.lexicon, sizes.frames, parts_of_body(sizes.config))
    from lexicon.autoencoder import Lexicon

    return Lexicon(sizes.config.lexicon, sizes.frames, sizes.motion, sizes.present)


def movement_lexicon(config: LexiconConfig, frames: int, parts: Mapping[str, tuple[int, ...]]) -> MovementLexicon:
    """The lexicon of movements of these settings; arguments as of `MovementLexicon`."""
    if config.quantizer == "vq-vae":
        from lexicon.movement import MovementVqVae

        return MovementVqVae(config, frames, parts)
    from lexicon.movement import MovementLexicon

    return MovementLexicon(config, frames, parts)


def codec(sizes: Sizes) -> RacerCodec:
    """RACER's codec (RACER 4.1)."""
    from lexicon.racer import RacerCodec

    return RacerCodec(sizes.config.racer, sizes.motion, sizes.present)


def tokens(sizes: Sizes) -> Lexicon | MovementLexicon | RacerCodec:
    """The lexicon or codec of these settings."""
    return lexicon(sizes) if system_of(sizes.config).blocks else codec(sizes)


def generator(sizes: Sizes) -> Generator | FlowGenerator:
    """G, E_M, E_A and, in training, the style codes (RG 5.2); or the variant with a flow head."""
    from generator.model import Generator, GeneratorWidths

    config = sizes.config
    widths = GeneratorWidths(sizes.frames, sizes.motion, sizes.low, codebook_shape(config)[1], CONTROL_WIDTH,
                             config.lexicon.size, sizes.speakers, _decision_width() if config.generator.units else 0)
    if system_of(config).drawing.samples:
        from generator.flow import FlowGenerator
        from lexicon.movement import basis_for

        return FlowGenerator(config.generator, widths, basis_for(config.lexicon, sizes.frames, parts_of_body(config)),
                             sizes.present)
    return Generator(config.generator, widths, sizes.training_blocks, sizes.present)


def _decision_width() -> int:
    from interpreters.planner import CLASSES

    return sum(CLASSES)


def style(sizes: Sizes, reads: bool = False) -> StyleInterpreter | UnitStyleInterpreter:
    """The style interpreter, audio-only (RG 6.3) or also reading the words (RG 6.2); with a flow head that of gesture
    units, which does not read."""
    config = sizes.config.style
    if system_of(sizes.config).drawing.samples:
        from interpreters.planner import UnitStyleInterpreter

        return UnitStyleInterpreter(config, sizes.frames, sizes.low, sizes.speakers, sizes.config.generator.style_width)
    from interpreters.lstm import StyleInterpreter

    return StyleInterpreter(config if reads else config.without_text(), sizes.frames, sizes.low, sizes.lexemes,
                            sizes.config.generator.style_width, sizes.speakers, sizes.text)


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

    if not system_of(sizes.config).naming.in_context:
        config = replace(config, choice=0.0)  # only movements are decoded in context, lexeme by lexeme
    return RewardEnsemble(config, sizes.frames, sizes.motion, sizes.block_audio)


@dataclass(frozen=True)
class BundlePart:
    """A part of a bundle. file: without the suffix; build: returns the untrained model; tied: whether its weights are
    valid only for the codebook that they were trained with."""

    file: str
    build: Callable[[Sizes], nn.Module]
    tied: bool = False


PARTS = {"encoder": BundlePart("speech_encoder", encoder), "lexicon": BundlePart("lexicon", tokens),
         "generator": BundlePart("generator", generator), "style": BundlePart("style_interpreter", style),
         "style_text": BundlePart("style_interpreter_text", partial(style, reads=True)),
         "gate": BundlePart("gate", gate), "planner": BundlePart("planner", planner, tied=True)}
"""The parts other than lexeme interpreters; only the lexicon is always present."""


def part_table() -> dict[str, BundlePart]:
    """Every part that a bundle may have, including those of all registered lexeme interpreters."""
    return {**PARTS, **{part: BundlePart(file, partial(_interpreter, entry, part), entry.tied)
                        for entry in entries().values() for part, file in entry.files.items()}}


def _interpreter(entry: InterpreterEntry, part: str, sizes: Sizes) -> nn.Module:
    """The model of a lexeme interpreter, with or without text."""
    settings = section(sizes.config, entry.settings)
    if entry.text_part and part != entry.text_part:
        settings = settings.without_text()
    model: nn.Module = entry.load_model().build(settings, InterpreterSizes(
        sizes.frames, sizes.low, sizes.high, sizes.speakers, sizes.text, CONTROL_WIDTH, sizes.motion, sizes.lexemes,
        sizes.silent))
    return model


def build(part: str, sizes: Sizes) -> Any:
    return part_table()[part].build(sizes)


def codebook_shape(config: Config) -> tuple[int, int]:
    """(S, D_s) of the codebook under these settings."""
    naming = system_of(config).naming
    if not naming.blocks:
        return config.racer.size, config.racer.width
    if naming.in_context:
        from lexicon.movement import basis_for, code_width

        with torch.device("meta"):
            width = basis_for(config.lexicon, config.rhythm.frames, parts_of_body(config)).width
        return config.lexicon.size, code_width(config.lexicon, width)
    return config.lexicon.size, config.lexicon.code_width


def codebook_name(config: Config) -> str:
    """Name of the codebook tensor in the lexicon's file."""
    return system_of(config).naming.codebook


def shapes(name: str, sizes: Sizes) -> dict[str, tuple[int, ...]]:
    """The shape of every tensor of a part, computed without allocating memory; InputError for inconsistent settings."""
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


class ChangedParts(Mapping[str, nn.Module]):
    """Parts with some replaced or removed; the others are loaded only when used."""

    def __init__(self, parts: Mapping[str, nn.Module], changes: Mapping[str, nn.Module | None]) -> None:
        unknown = sorted(set(changes) - {*part_table(), *JUDGES})
        if unknown:
            raise ValueError(f"no parts of a bundle: {', '.join(unknown)}")
        self._parts, self._changes = parts, dict(changes)

    def __getitem__(self, name: str) -> nn.Module:
        if name not in self._changes:
            return self._parts[name]
        changed = self._changes[name]
        if changed is None:
            raise KeyError(name)
        return changed

    def __iter__(self) -> Iterator[str]:
        names = [*self._parts, *(name for name in self._changes if name not in self._parts)]
        return (name for name in names if self._changes.get(name, self) is not None)

    def __len__(self) -> int:
        return sum(1 for _ in self)


class StoredParts(Mapping[str, nn.Module]):
    """The models of a bundle on disk, each loaded when it is first used."""

    def __init__(self, weights: Weights, sizes: Sizes) -> None:
        self._weights, self._sizes = weights, sizes
        self._opened: dict[str, nn.Module] = {}

    def __getitem__(self, name: str) -> nn.Module:
        if name not in self._opened:
            part = part_table().get(name)
            if part is None or part.file not in self._weights:
                raise KeyError(name)
            tied = lexicon_hash(self._sizes.lexemes) if part.tied else None
            tensors = self._weights.read(part.file, shapes(name, self._sizes), tied)
            model = part.build(self._sizes)
            model.load_state_dict(tensors)
            self._opened[name] = freeze(model)
        return self._opened[name]

    def __contains__(self, name: object) -> bool:
        part = part_table().get(str(name))
        return part is not None and part.file in self._weights

    def __iter__(self) -> Iterator[str]:
        return (name for name in part_table() if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)
