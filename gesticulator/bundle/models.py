"""Every model of a bundle, constructed here and nowhere else: by training, and by whoever opens a bundle.

What a model is shaped by besides the settings is measured on the data, and travels as `Sizes`. A model's module is
imported by the function that builds it, so whoever opens one part of a bundle imports that part alone.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from data_module.errors import InputError
from gesticulator.bundle.config import Config, RewardConfig, section
from gesticulator.bundle.features import CONTROL_WIDTH, representation_of
from gesticulator.bundle.system import system_of
from interpreters import InterpreterEntry, entries
from interpreters.base import InterpreterSizes

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder
    from generator.flow import FlowGenerator
    from generator.model import Generator
    from interpreters.gate import ActivityGate
    from interpreters.lstm import StyleInterpreter
    from interpreters.reward import RewardEnsemble
    from lexicon.autoencoder import Lexicon
    from lexicon.movement import MovementLexicon
    from lexicon.racer import RacerCodec


@dataclass(frozen=True)
class Sizes:
    """What shapes the models besides their settings.

    motion: D_m; low, high: widths d + 1 of the two levels of audio, the log duration included; two_levels: they are
    not one and the same; speakers: P; text: d_t + 1, 0 without words; present: [D_m] 1 where the training motion ever
    moved; vectors: [S, D_s] the codebook, where there is one already; silent: the silent lexemes; training_blocks:
    how many style codes are learned, 0 at inference, where the generator has no table of them.
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
        """[S, D_s] the codebook; ValueError before there is one."""
        if self.vectors is None:
            raise ValueError("this model is built over a codebook, and there is none yet")
        return self.vectors

    @property
    def block_audio(self) -> int:
        """Width of what the reward models hear: both levels where there are two, the log duration once."""
        return self.low + self.high - 1 if self.two_levels else self.low


def encoder(sizes: Sizes) -> SpeechEncoder:
    """The speech levels (RG 4.1.3)."""
    from data_module.speech.speech_encoder import SpeechEncoder

    return SpeechEncoder(sizes.config.encoder)


def parts_of_body(config: Config) -> dict[str, tuple[int, ...]]:
    """Part of the body -> its numbers of D_m under these settings."""
    from data_module.motion.movement import body_parts
    from data_module.motion.skeletons import CHARACTERS

    representation = representation_of(config)
    if representation.name != "rotations":
        return {"body": tuple(range(representation.width))}
    return body_parts(CHARACTERS[config.motion.joints].names)


def lexicon(sizes: Sizes) -> Lexicon | MovementLexicon:
    """The VQ-VAE over blocks (RG 5.1), or the lexicon of movements."""
    if system_of(sizes.config).naming.in_context:
        from lexicon.movement import MovementLexicon

        return MovementLexicon(sizes.config.lexicon, sizes.frames, parts_of_body(sizes.config))
    from lexicon.autoencoder import Lexicon

    return Lexicon(sizes.config.lexicon, sizes.frames, sizes.motion, sizes.present)


def codec(sizes: Sizes) -> RacerCodec:
    """RACER's own codec (RACER 4.1)."""
    from lexicon.racer import RacerCodec

    return RacerCodec(sizes.config.racer, sizes.motion, sizes.present)


def tokens(sizes: Sizes) -> Lexicon | MovementLexicon | RacerCodec:
    """What names gestures under these settings."""
    return lexicon(sizes) if system_of(sizes.config).blocks else codec(sizes)


def generator(sizes: Sizes) -> Generator | FlowGenerator:
    """G, E_M, E_A and, while it is trained, the style codes (RG 5.2); or its form with a sampling head."""
    from generator.model import Generator, GeneratorWidths

    config = sizes.config
    widths = GeneratorWidths(sizes.frames, sizes.motion, sizes.low, codebook_shape(config)[1], CONTROL_WIDTH,
                             config.lexicon.size, sizes.speakers)
    if system_of(config).drawing.samples:
        from generator.flow import FlowGenerator
        from lexicon.movement import basis_for

        return FlowGenerator(config.generator, widths, basis_for(config.lexicon, sizes.frames, parts_of_body(config)),
                             sizes.present)
    return Generator(config.generator, widths, sizes.training_blocks, sizes.present)


def style(sizes: Sizes) -> StyleInterpreter:
    """The style interpreter that hears alone (RG 6.2, 6.3)."""
    return _style_interpreter(sizes, False)


def style_text(sizes: Sizes) -> StyleInterpreter:
    """The style interpreter that reads the words too (RG 6.2)."""
    return _style_interpreter(sizes, True)


def _style_interpreter(sizes: Sizes, reads: bool) -> StyleInterpreter:
    from interpreters.lstm import StyleInterpreter

    config = sizes.config.style
    return StyleInterpreter(config if reads else config.without_text(), sizes.frames, sizes.low, sizes.lexemes,
                            sizes.config.generator.style_width, sizes.speakers, sizes.text)


def gate(sizes: Sizes) -> ActivityGate:
    """Whether to gesture at all on a block."""
    from interpreters.gate import ActivityGate

    return ActivityGate(sizes.config.gate, sizes.frames, sizes.low, sizes.speakers)


def reward(sizes: Sizes) -> RewardEnsemble:
    """E_m and E_u of several models (RACER 4.2): what teaches a policy."""
    return _reward(sizes, sizes.config.reward)


def reward_judge(sizes: Sizes) -> RewardEnsemble:
    """The same of other sizes: what judges a policy."""
    return _reward(sizes, sizes.config.judge)


def _reward(sizes: Sizes, config: RewardConfig) -> RewardEnsemble:
    from interpreters.reward import RewardEnsemble

    if not system_of(sizes.config).naming.in_context:
        config = replace(config, choice=0.0)  # only movements are decoded in context, lexeme by lexeme
    return RewardEnsemble(config, sizes.frames, sizes.motion, sizes.block_audio)


@dataclass(frozen=True)
class BundlePart:
    """A part of a bundle. file: without the ending; build: the model, untrained; tied: its weights are worthless over
    another codebook than they were trained on."""

    file: str
    build: Callable[[Sizes], nn.Module]
    tied: bool = False


PARTS = {"encoder": BundlePart("speech_encoder", encoder), "lexicon": BundlePart("lexicon", tokens),
         "generator": BundlePart("generator", generator), "style": BundlePart("style_interpreter", style),
         "style_text": BundlePart("style_interpreter_text", style_text), "gate": BundlePart("gate", gate)}
"""The parts beside the lexeme interpreters; only the lexicon is never absent."""


def part_table() -> dict[str, BundlePart]:
    """Every part that a bundle may have, those of the lexeme interpreters by their entries."""
    return {**PARTS, **{part: BundlePart(file, partial(_interpreter, entry, part), entry.tied)
                        for entry in entries().values() for part, file in entry.files.items()}}


def _interpreter(entry: InterpreterEntry, part: str, sizes: Sizes) -> nn.Module:
    """The weights of a lexeme interpreter, for speech with words or without."""
    settings = section(sizes.config, entry.settings)
    if entry.text_part and part != entry.text_part:
        settings = settings.without_text()
    model: nn.Module = entry.load_model().build(settings, InterpreterSizes(
        sizes.frames, sizes.low, sizes.high, sizes.speakers, sizes.text, CONTROL_WIDTH, sizes.motion, sizes.lexemes,
        sizes.silent))
    return model


def build(part: str, sizes: Sizes) -> Any:
    """The model of a part, untrained."""
    return part_table()[part].build(sizes)


def codebook_shape(config: Config) -> tuple[int, int]:
    """(S, D_s) of the codebook under these settings."""
    naming = system_of(config).naming
    if not naming.blocks:
        return config.racer.size, config.racer.width
    if naming.in_context:
        from lexicon.movement import basis_for

        with torch.device("meta"):
            return config.lexicon.size, basis_for(config.lexicon, config.rhythm.frames, parts_of_body(config)).width
    return config.lexicon.size, config.lexicon.code_width


def codebook_name(config: Config) -> str:
    """The tensor of the codebook in the lexicon's file."""
    return system_of(config).naming.codebook


def shapes(name: str, sizes: Sizes) -> dict[str, tuple[int, ...]]:
    """The shape of every tensor of a part, found without taking memory for one; InputError where the settings do not
    go together."""
    on_meta = replace(sizes, present=sizes.present.to("meta"),
                      vectors=None if sizes.vectors is None else sizes.vectors.to("meta"))
    try:
        with torch.device("meta"), warnings.catch_warnings(action="ignore", category=UserWarning):
            return {key: tuple(value.shape) for key, value in build(name, on_meta).state_dict().items()}
    except (ValueError, RuntimeError, IndexError, OverflowError, ZeroDivisionError) as error:
        raise InputError("settings", f"no {name} can be built of them ({str(error).splitlines()[0][:200]})",
                         "change them") from None
