"""The default system: lexemes of movements, a planner of gesture units, and a flow generator that samples.

It keeps RG's structure (blocks at the beat, lexemes, style codes, block by block). A lexeme stands for the movement
that a block adds to its past, not for a pose; a sampled continuation takes the place of the mean of all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from gesticulator.bundle.features import CONTROL_WIDTH, body_columns

if TYPE_CHECKING:
    from collections.abc import Mapping

    from generator.flow import FlowGenerator
    from gesticulator.bundle.config import Config, LexiconConfig
    from gesticulator.bundle.features import Sizes
    from interpreters.planner import UnitStyleInterpreter
    from lexicon.movement import MovementLexicon

NAME = "movement"
PARTS = ("generator", "interpreter")
CODEBOOK = "vectors"
BLOCKS = IN_CONTEXT = SILENCE = VARIES = True
STAGES = ("speech", "contrast", "lexicon", "interpreter", "interpreter_text", "gate", "planner", "reward",
          "reward_judge", "q_network", "q_network_literal", "advantage", "generator", "style")


def codebook_shape(config: Config) -> tuple[int, int]:
    """(S, D_s) of the lexicon."""
    from lexicon.movement import basis_for, code_width

    with torch.device("meta"):
        width = basis_for(config.lexicon, config.rhythm.frames, body_columns(config)).width
    return config.lexicon.size, code_width(config.lexicon, width)


def lexicon(sizes: Sizes) -> MovementLexicon:
    """The lexicon of movements: a VQ-VAE, or k-means, over the coefficients that a block adds to its past."""
    return movement_lexicon(sizes.config.lexicon, sizes.frames, body_columns(sizes.config))


def movement_lexicon(settings: LexiconConfig, frames: int, parts: Mapping[str, tuple[int, ...]]) -> MovementLexicon:
    """The lexicon of movements of these settings; arguments as of `MovementLexicon`."""
    if settings.quantizer == "vq-vae":
        from lexicon.movement import MovementVqVae

        return MovementVqVae(settings, frames, parts)
    from lexicon.movement import MovementLexicon

    return MovementLexicon(settings, frames, parts)


def generator(sizes: Sizes) -> FlowGenerator:
    """The generator of RG 5.2 with a head that samples by conditional flow matching (`generator.flow`)."""
    from generator.flow import FlowGenerator
    from generator.model import GeneratorWidths
    from interpreters.planner import CLASSES
    from lexicon.movement import basis_for

    config = sizes.config
    widths = GeneratorWidths(sizes.frames, sizes.motion, sizes.low, codebook_shape(config)[1], CONTROL_WIDTH,
                             config.lexicon.size, sizes.speakers, sum(CLASSES) if config.generator.units else 0)
    basis = basis_for(config.lexicon, sizes.frames, body_columns(config))
    return FlowGenerator(config.generator, widths, basis, sizes.present)


def style(sizes: Sizes, reads: bool) -> UnitStyleInterpreter:
    """The style interpreter of gesture units, which takes no words."""
    from interpreters.planner import UnitStyleInterpreter

    return UnitStyleInterpreter(sizes.config.style, sizes.frames, sizes.low, sizes.speakers,
                                sizes.config.generator.style_width)
