"""Rhythmic Gesticulator (RG), in the order of the paper.

    RG 4     speech is cut at its beats into blocks of K frames and encoded     `sampling.cutter`, `data_module.speech`
    RG 5.1   a VQ-VAE over blocks of motion makes the lexicon                   `lexicon`, below
    RG 5.2   a generator turns lexemes, audio and style codes into motion       `generator`, below
    RG 5.3   the style code of each block is learned with the generator         `generator.model.StyleCodes`
    RG 6.1   an interpreter predicts lexemes from speech                        `interpreters.lstm`
    RG 6.2   another predicts style codes                                       `style`, below
    RG 6.4   silence                                                            `step`, below
    Eq. 15   blocks are generated one after the other                           `step`, below

What the paper does not have is marked as an addition: the gate and rest by phrases, which no preset of it has, and the
style control of RG 7.2.1 at inference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_module.layers_run import Floats, Tensors
from generator.model_run import GeneratorRunner
from generator.settings import GeneratorWidths
from gesticulator.bundle.features import CONTROL_WIDTH
from gesticulator.bundle.models import interpreter_sizes
from gesticulator.sampling import loop
from interpreters.base import BlockFeatures
from interpreters.style_run import StyleRunner
from lexicon.autoencoder_run import LexiconRunner

if TYPE_CHECKING:
    from generator.model import Generator
    from gesticulator.bundle.bundle import Bundle
    from gesticulator.bundle.config import Config
    from gesticulator.bundle.features import Sizes
    from interpreters.lstm import StyleInterpreter
    from lexicon.autoencoder import Lexicon

NAME = "paper"
PARTS = ("generator", "interpreter")
CODEBOOK = "quantizer.vectors"
BLOCKS = SILENCE = True
IN_CONTEXT = VARIES = False

# ------------------------------------------------------------------------------------------------------------ training

STAGES = (
    "speech",             # RG 4.1.1: vq-wav2vec by predictive coding
    "contrast",           # RG 4.1.3, Eq. 1: audio and text side by side
    "lexicon",            # RG 5.1, Eq. 3: the gesture lexicon
    "interpreter",        # RG 6.3: lexemes from audio alone
    "interpreter_text",   # RG 6.1, Eq. 16 to 18: lexemes from audio and text
    "gate",               # addition: whether a block is gestured at all
    "reward",             # RACER 4.2 over the same lexicon (`systems.racer`), and the judge that evaluates it
    "reward_judge",
    "q_network",          # RACER 4.3, improved, and as published
    "q_network_literal",
    "generator",          # RG 5.2 and 5.3, Eq. 5 to 14: generator and style codes
    "style",              # RG 6.3, Table 3: style codes from audio alone
    "style_text",         # RG 6.2, Eq. 19: style codes from audio and text
)
"""In order (RG 7.1.2)."""

# ------------------------------------------------------------------------------------------------- models, RG 5 and 6.2


def codebook_shape(config: Config) -> tuple[int, int]:
    """(S, D_s) of the lexicon."""
    return config.lexicon.size, config.lexicon.code_width


def lexicon(sizes: Sizes) -> Lexicon:
    """The VQ-VAE over blocks of motion (RG 5.1, Eq. 3)."""
    import torch

    from lexicon.autoencoder import Lexicon

    return Lexicon(sizes.config.lexicon, sizes.frames, sizes.motion, torch.as_tensor(sizes.present))


def lexicon_runner(sizes: Sizes, tensors: Tensors) -> LexiconRunner:
    return LexiconRunner(sizes.config.lexicon, sizes.frames, sizes.present, tensors)


def generator(sizes: Sizes) -> Generator:
    """G, E_M, E_A and, in training, a style code for each block (RG 5.2, 5.3, Eq. 5 to 14)."""
    import torch

    from generator.model import Generator

    return Generator(sizes.config.generator, _widths(sizes), sizes.training_blocks, torch.as_tensor(sizes.present))


def generator_runner(sizes: Sizes, tensors: Tensors) -> GeneratorRunner:
    return GeneratorRunner(sizes.config.generator, _widths(sizes), sizes.present, tensors)


def _widths(sizes: Sizes) -> GeneratorWidths:
    return GeneratorWidths(sizes.frames, sizes.motion, sizes.low, codebook_shape(sizes.config)[1], CONTROL_WIDTH)


def style(sizes: Sizes, reads: bool) -> StyleInterpreter:
    """The style interpreter (RG 6.2, Eq. 19), or without the words (RG 6.3)."""
    import torch

    from interpreters.lstm import StyleInterpreter

    settings = sizes.config.style
    return StyleInterpreter(settings if reads else settings.without_text(), sizes.frames, sizes.low,
                            torch.as_tensor(sizes.lexemes), sizes.config.generator.style_width, sizes.speakers,
                            sizes.text)


def style_runner(sizes: Sizes, reads: bool, tensors: Tensors) -> StyleRunner:
    settings = sizes.config.style
    return StyleRunner(settings if reads else settings.without_text(), interpreter_sizes(sizes),
                       sizes.config.generator.style_width, tensors)


# ------------------------------------------------------------------------------------------- one block, RG 6 and Eq. 15

BLOCKS_BEFORE_REST = 2
"""Quiet blocks that are shown as generated, before rest decay begins: the arms come down in them."""


class GeneratorState(NamedTuple):
    """decoder: of the LSTM decoder; unguided: the same without the style control; style: of the style interpreter."""

    decoder: tuple[Floats, Floats]
    unguided: tuple[Floats, Floats]
    style: Any


def begin(bundle: Bundle, setup: loop.Setup, text: bool, keys: loop.Keys) -> loop.State:
    """The state before the first block: the resting pose and the silent lexeme nearest to it (a_0 and s_0)."""
    state = loop.at_rest(bundle, setup, text, keys)
    rest = bundle.rest_feature(setup.speaker)
    decoder = bundle.runners["generator"].start(rest, bundle.vectors[state.lexeme])
    interpreter = style_interpreter(bundle, text)
    style_state = None if interpreter is None else interpreter.start(setup.speaker)
    return replace(state, generator=GeneratorState(decoder, decoder, style_state))


def step(bundle: Bundle, setup: loop.Setup, state: loop.State, request: loop.Request
         ) -> tuple[loop.BlockMotion, loop.State]:
    """The next block, and the state after it (RG Eq. 15)."""
    settings, speech = bundle.config.silence, request.speech
    features = loop.features_of(bundle, request, state.past)

    # The lexeme s_i from speech, speaker and the lexemes before (Eq. 16 to 18).
    rested = loop.resting(bundle, setup, state, request, features)  # addition
    scores, interpreter, unguided = loop.scores_of(bundle, setup, state, features)
    # In silence only silent lexemes may follow (6.4.1).
    quiet = rested.closed or (features.silent and settings.mask)
    lexeme = loop.choose(setup, request, scores, bundle.silent if quiet else None)

    # The style code z_i (Eq. 19) and the motion of the block (Eq. 15).
    features = as_silence(bundle, features) if rested.closed and rested.rest is None else features
    code, style_state = style_code(bundle, state, features, lexeme)
    block, generator = generate(bundle, state, features, lexeme, code)

    # In a long silence the body comes to rest.
    in_a_row = state.quiet + 1 if quiet else 0
    if rested.rest is None and in_a_row > BLOCKS_BEFORE_REST and settings.rest_decay > 0:
        block = approach_rest(state.past[-1], block, settings.rest_decay)
    past, motion = loop.shown(bundle, rested.rest, block)

    record = loop.decided(speech, lexeme, scores, request.keys or state.keys,
                          rested.probability)
    after = replace(state, lexeme=lexeme, past=past, generated=past, interpreter=interpreter, unguided=unguided,
                    generator=generator._replace(style=style_state), gate=rested.gate, rest=rested.rest,
                    quiet=in_a_row, until=speech.end)
    return loop.BlockMotion(record, lexeme, motion, code), after


def style_interpreter(bundle: Bundle, text: bool) -> StyleRunner | None:
    """The one that reads the words, if there are any, or the audio-only one; None without style codes."""
    part = "style_text" if text and "style_text" in bundle.parts else "style"
    return bundle.runners.get(part)


def style_code(bundle: Bundle, state: loop.State, features: BlockFeatures, lexeme: int) -> tuple[Floats, Any]:
    """z_i [d_z] of a block (Eq. 19), and the state after it; zeros without a style interpreter."""
    interpreter = style_interpreter(bundle, state.text)
    if interpreter is None:
        return np.zeros(bundle.config.generator.style_width, np.float32), None
    return interpreter.step(state.generator.style, features, lexeme)


def generate(bundle: Bundle, state: loop.State, features: BlockFeatures, lexeme: int, code: Floats
             ) -> tuple[Floats, GeneratorState]:
    """M_i [K, D_m] = G(M_{i-1}, A_i, s_i, z_i) (Eq. 15), and the decoder's state."""
    model, before = bundle.runners["generator"], state.generator
    audio, vector, control = model.encode_audio(features.low), bundle.vectors[lexeme], features.control
    block, decoder = model.step(state.past, audio, vector, code, before.decoder, control)
    unguided = before.unguided
    if control is not None:
        # Style editing (RG 7.2.1), with classifier-free guidance: extrapolate from the block without control.
        free, unguided = model.step(state.past, audio, vector, code, unguided)
        block = free + bundle.config.selection.guidance * (block - free)
    return block, GeneratorState(decoder, unguided, before.style)


def as_silence(bundle: Bundle, features: BlockFeatures) -> BlockFeatures:
    """A block without gesture, for the generator: it gets the sound of silence."""
    quiet = bundle.statistics.quiet_low
    return features if quiet is None else replace(features, low=quiet.astype(np.float32), silent=True)


def approach_rest(last: Floats, block: Floats, share: float) -> Floats:
    """A block of rest [K, D_m]: a straight line from the last pose [D_m], `share` of the way to the block's mean pose.
    Each block shortens the distance to rest by `share`, so the body becomes still in a long rest."""
    steps = np.arange(1, len(block) + 1, dtype=np.float32)[:, None] / np.float32(len(block))
    return last + share * steps * (block.mean(0) - last)


def motion_of(bundle: Bundle, setup: loop.Setup, blocks: Sequence[loop.BlockMotion]) -> NDArray[np.float32]:
    """[N, K, D_m] motion of all blocks of a performance."""
    return np.stack([block.motion for block in blocks])
