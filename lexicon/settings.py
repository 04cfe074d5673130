"""Sizes and weights of the two codecs of motion."""

from dataclasses import dataclass
from typing import Annotated

from data_module.settings import NotNegative, SettingChoice, SettingRange, Share, Width, Widths

__all__ = ["LexiconConfig", "RacerConfig"]

HALVINGS = 3
"""Number of times that the encoder of RACER's codec halves the frame rate."""
FRAMES = 2**HALVINGS
"""Frames per code of RACER's codec."""
DILATIONS = (1, 3, 9)
"""Of the residual blocks of a stage, in the encoder's order."""

@dataclass(frozen=True)
class LexiconConfig:
    """Sizes and weights of the lexicon; the defaults are the paper's if it gives them."""

    quantizer: Annotated[str, SettingChoice(("k-means", "vq-vae"))] = "k-means"
    """Of the lexicon of movements: "k-means" over the coefficients of a movement, without steps or the settings below
    `levels`; "vq-vae": a learned encoder, codebook and decoder (`lexicon.movement`)."""
    size: Width = 50
    """N_s, lexemes in the lexicon (50 Trinity and Chinese, 100 TED)."""
    trunk_components: Width = 24
    """Principal components of the torso and of the head: 99.5 % of the residual variance of the predictor."""
    arm_components: Width = 40
    """Principal components of each arm: 99.6 % of the residual variance."""
    finger_components: Width = 12
    """Principal components of the fingers of each hand."""
    levels: Annotated[tuple[int, ...], SettingRange(1, 2**16)] = (64, 64)
    """Sizes of the residual codebooks of each part, below the lexeme."""
    code_width: Width = 192
    """Width of a lexeme."""
    widths: Widths = (64, 128, 156, 192)
    """Channels of the four convolutions."""
    hidden: Width = 256
    """Units of the hidden layers of the VQ-VAE over movements, which has no convolutions."""
    revive_below: NotNegative = 1.0
    """A lexeme used less often than this per batch, on average, is revived."""
    commitment: NotNegative = 1.0
    """w_alpha of Eq. 3."""
    warm_up: Share = 0.3
    """Share of the training run as a plain autoencoder, before k-means starts the codebook."""

    def components_of(self, part: str) -> int:
        if part.endswith("fingers"):
            return self.finger_components
        return self.trunk_components if part in ("torso", "head") else self.arm_components


@dataclass(frozen=True)
class RacerConfig:
    """Sizes and weights of the codec; the defaults are the paper's if it gives them (RACER 5.2)."""

    width: Width = 512
    """C, channels of every layer and width of a code."""
    size: Width = 512
    """N, codes in the codebook."""
    revive_below: NotNegative = 1.0
    """A code used less often than this per batch (64 x 15 codes in the paper), on average, is revived."""
