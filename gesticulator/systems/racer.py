"""RACER, in the order of the paper.

    RACER 4.1   a codec turns motion at a fixed rate into codes                       `lexicon`, below (Eq. 4 and 5)
    RACER 4.2   a reward says how well motion fits speech                             `interpreters.reward` (Eq. 6 to 8)
    RACER 4.3   a Q-network learns offline which code to take                         `interpreters.cql` (Eq. 9 to 12)
    RACER 4.3   at inference the code of the largest Q value is taken, one by one     `step`, below
    RACER 5.2   the codec decodes all codes together                                  `motion_of`, below

Blocks are eight frames at a fixed rate. There is no generator, no style, no gate and no silence. The same reward and
Q-network are trained over the lexicons of the other two systems, too (`--interpreter cql`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.layers_run import Tensors
from gesticulator.sampling import loop
from lexicon.racer_run import CodecRunner

if TYPE_CHECKING:
    from gesticulator.bundle.bundle import Bundle
    from gesticulator.bundle.config import Config
    from gesticulator.bundle.features import Sizes
    from lexicon.racer import RacerCodec

NAME = "racer"
PARTS = ("q_network",)
CODEBOOK = "quantizer.vectors"
BLOCKS = IN_CONTEXT = SILENCE = VARIES = False

# ------------------------------------------------------------------------------------------------------------ training

STAGES = (
    "speech",             # the audio front end; the presets use mel bands
    "contrast",
    "codec",              # RACER 4.1, Eq. 4 and 5
    "reward",             # RACER 4.2, Eq. 6 to 8
    "reward_judge",       # another reward, which evaluates the policy
    "q_network",          # RACER 4.3, Eq. 9 to 12
    "q_network_literal",  # the same on recorded codes only
)
"""In order (RACER 5.2)."""

# --------------------------------------------------------------------------------------------------- models, RACER 4.1


def codebook_shape(config: Config) -> tuple[int, int]:
    """(N, C) of the codec (RACER 5.2)."""
    return config.racer.size, config.racer.width


def lexicon(sizes: Sizes) -> RacerCodec:
    """The codec: a convolutional VQ-VAE that halves the frame rate three times (RACER 4.1, Eq. 4 and 5)."""
    import torch

    from lexicon.racer import RacerCodec

    return RacerCodec(sizes.config.racer, sizes.motion, torch.as_tensor(sizes.present))


def lexicon_runner(sizes: Sizes, tensors: Tensors) -> CodecRunner:
    return CodecRunner(sizes.config.racer, sizes.present, tensors)


def generator(sizes: Sizes) -> NoReturn:
    """InputError: the codec decodes its codes itself."""
    raise InputError("system=racer", "has no generator", "use system=paper or system=movement")


def generator_runner(sizes: Sizes, tensors: Tensors) -> NoReturn:
    generator(sizes)


def style(sizes: Sizes, reads: bool) -> NoReturn:
    """InputError: there are no style codes."""
    raise InputError("system=racer", "has no style codes", "use system=paper or system=movement")


def style_runner(sizes: Sizes, reads: bool, tensors: Tensors) -> NoReturn:
    style(sizes, reads)


# ---------------------------------------------------------------------------------------------- one code, RACER 4.3

def begin(bundle: Bundle, setup: loop.Setup, text: bool, keys: loop.Keys) -> loop.State:
    """The state before the first code, a_0: the code nearest to standing still in the resting pose."""
    code = bundle.rest_lexeme(setup.speaker)
    interpreter = setup.interpreter.start(setup.speaker, code)
    past = np.repeat(bundle.rest_feature(setup.speaker)[None], bundle.frames, axis=0)
    return loop.State(keys, text, code, past, past, interpreter, interpreter)


def step(bundle: Bundle, setup: loop.Setup, state: loop.State, request: loop.Request
         ) -> tuple[loop.BlockMotion, loop.State]:
    """The next code, without motion, and the state after it; activity 0 holds the resting code."""
    scores, interpreter, unguided = loop.scores_of(bundle, setup, state, loop.features_of(bundle, request))
    code = loop.choose(setup, request, scores)
    if setup.activity == 0:
        code = bundle.rest_lexeme(setup.speaker)
    record = loop.decided(request.speech, code, scores, state.keys)
    after = replace(state, lexeme=code, interpreter=interpreter, unguided=unguided, until=request.speech.end)
    return loop.BlockMotion(record, code, np.empty((0, 0), np.float32), np.empty(0, np.float32)), after


def motion_of(bundle: Bundle, setup: loop.Setup, blocks: Sequence[loop.BlockMotion]) -> NDArray[np.float32]:
    """[N, K, D_m] all codes decoded together, after a resting code, so that the motion begins at rest (RACER 5.2)."""
    codes = [bundle.rest_lexeme(setup.speaker), *(block.lexeme for block in blocks)]
    codec: CodecRunner = bundle.runners["lexicon"]
    return codec.decode(codes)[1:]
