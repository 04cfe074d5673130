"""Rhythmic Gesticulator (RG), in the order of the paper.

Speech is cut at its beats into blocks of K frames (RG 4.2, `gesticulator.sampling.cutter`). A VQ-VAE over blocks makes
the lexicon of gesture lexemes (RG 5.1), a generator with learned style codes turns lexemes into motion (RG 5.2, 5.3),
and two interpreters predict lexemes and style codes from speech (RG 6).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from gesticulator.bundle.features import CONTROL_WIDTH

if TYPE_CHECKING:
    from generator.model import Generator
    from gesticulator.bundle.config import Config
    from gesticulator.bundle.features import Sizes
    from interpreters.lstm import StyleInterpreter
    from lexicon.autoencoder import Lexicon

NAME = "paper"
PARTS = ("generator", "interpreter")
CODEBOOK = "quantizer.vectors"
BLOCKS = SILENCE = True
IN_CONTEXT = VARIES = False
STAGES = ("speech", "contrast", "lexicon", "interpreter", "interpreter_text", "gate", "planner", "reward",
          "reward_judge", "q_network", "q_network_literal", "advantage", "generator", "style", "style_text")


def codebook_shape(config: Config) -> tuple[int, int]:
    """(S, D_s) of the lexicon."""
    return config.lexicon.size, config.lexicon.code_width


def lexicon(sizes: Sizes) -> Lexicon:
    """The VQ-VAE over blocks of motion (RG 5.1, Eq. 3)."""
    from lexicon.autoencoder import Lexicon

    return Lexicon(sizes.config.lexicon, sizes.frames, sizes.motion, sizes.present)


def generator(sizes: Sizes) -> Generator:
    """G, E_M, E_A and, in training, a style code for each block (RG 5.2, 5.3, Eq. 5 to 14)."""
    from generator.model import Generator, GeneratorWidths

    config = sizes.config
    widths = GeneratorWidths(sizes.frames, sizes.motion, sizes.low, codebook_shape(config)[1], CONTROL_WIDTH)
    return Generator(config.generator, widths, sizes.training_blocks, sizes.present)


def style(sizes: Sizes, reads: bool) -> StyleInterpreter:
    """The style interpreter (RG 6.2, Eq. 19), or without the words (RG 6.3)."""
    from interpreters.lstm import StyleInterpreter

    settings = sizes.config.style
    return StyleInterpreter(settings if reads else settings.without_text(), sizes.frames, sizes.low, sizes.lexemes,
                            sizes.config.generator.style_width, sizes.speakers, sizes.text)
