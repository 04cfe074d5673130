"""RACER, in the order of the paper: a codec at a fixed rate (RACER 4.1), a reward of motion and speech (4.2), and a
Q-network that chooses the codes (4.3). The codes are decoded together; there is no generator (RACER 5.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from data_module.errors import InputError

if TYPE_CHECKING:
    from gesticulator.bundle.config import Config
    from gesticulator.bundle.features import Sizes
    from lexicon.racer import RacerCodec

NAME = "racer"
PARTS = ("q_network",)
CODEBOOK = "quantizer.vectors"
BLOCKS = IN_CONTEXT = SILENCE = VARIES = False
STAGES = ("speech", "contrast", "codec", "reward", "reward_judge", "q_network", "q_network_literal")


def codebook_shape(config: Config) -> tuple[int, int]:
    """(N, C) of the codec (RACER 5.2)."""
    return config.racer.size, config.racer.width


def lexicon(sizes: Sizes) -> RacerCodec:
    """The codec: a convolutional VQ-VAE that halves the frame rate three times (RACER 4.1, Eq. 4 and 5)."""
    from lexicon.racer import RacerCodec

    return RacerCodec(sizes.config.racer, sizes.motion, sizes.present)


def generator(sizes: Sizes) -> NoReturn:
    """InputError: the codec decodes its codes itself."""
    raise InputError("system=racer", "has no generator", "use system=paper or system=movement")


def style(sizes: Sizes, reads: bool) -> NoReturn:
    """InputError: there are no style codes."""
    raise InputError("system=racer", "has no style codes", "use system=paper or system=movement")
