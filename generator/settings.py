"""Sizes and weights of both generators, and what their torch modules and runners have in common."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from data_module.settings import (
    Count,
    Depth,
    NotNegative,
    Positive,
    SettingChoice,
    SettingRange,
    Share,
    Width,
    WidthOrNone,
)

__all__ = ["BLEND", "GROUP_WIDTH", "GeneratorConfig", "GeneratorWidths", "positional_block"]

GROUP_WIDTH = 8
"""Width of the vector behind each class of each group."""
BLEND = 0.1
"""Temperature of nearly equal classes: their logits differ by a few tenths."""
TEMPERATURE = 2.0, 0.5
"""Gumbel temperature at the start and at the end of training; it falls geometrically."""


@dataclass(frozen=True)
class GeneratorConfig:
    """Sizes and weights of the generator; the defaults are the paper's if it gives them."""

    motion_features: Width = 128
    """d_m~, width of E_M."""
    audio_features: WidthOrNone = 128
    """d_a~, width of E_A."""
    audio_bottleneck: WidthOrNone = 0
    """Width of a projection of each row of audio before E_A; 0 for none (the paper)."""
    style_width: WidthOrNone = 32
    """d_z."""
    position_width: WidthOrNone = 32
    """d_P; 0 for no positional block (Table 7)."""
    hidden: Width = 512
    """Width of the MLP encoder."""
    groups: Width = 64
    """H."""
    classes: Width = 128
    """C."""
    lstm_width: Width = 1024
    """Units of each layer of the decoder."""
    lstm_layers: Depth = 2
    """Layers of the decoder."""
    lexeme: NotNegative = 0.2
    """Weight of L_lexeme (RG Eq. 9 and 13)."""
    use_control: bool = False
    """Use the style control (C_i of RG 7.2.1) as input."""
    swap_share: Share = 1.0
    """Share of the batch's blocks that the lexeme loss pairs with other lexemes."""
    style_rate: Positive = 3e-4
    """Learning rate of the style codes, which get only one gradient per epoch each."""
    # The remaining settings are used by the flow head only.
    style_dropout: Share = 0.0
    """Share of training windows without style codes."""
    blocks: Count = 28
    """Blocks of a training window: about nine seconds, more than a phrase."""
    context: Width = 256
    """Units of the LSTM over blocks, and width of the context of the head."""
    lexeme_width: Width = 64
    """Width of the embeddings of the lexeme and of a block's audio that bypass the bottleneck."""
    hears_through: Annotated[str, SettingChoice(("both", "code"))] = "both"
    """How audio and lexeme reach the flow head: "both": by the Gumbel code and beside it; "code": by the code alone,
    which must then tell them apart. What is known of the past stands beside the code in either case."""
    units: bool = False
    """Take the planner's decision for each block as input."""
    flow_width: Width = 384
    """Units of the head."""
    dropout: Annotated[float, SettingRange(0.0, 0.95)] = 0.2
    """Dropout of the context's units in training."""
    after_dropout: Share = 0.0
    """Share of training windows without the audio, duration and silence of the next block, so that a stream need not
    wait for it."""
    history_dropout: Share = 0.0
    """Share of training windows without previous motion (E_M, and the coefficients of the previous blocks)."""
    past_noise: NotNegative = 0.25
    """Largest deviation of the noise on the pose before a block, in standard deviations of each dimension."""
    velocity_noise: NotNegative = 0.1
    """Largest deviation of the noise on the velocity before a block, as a share of it."""
    bend: Positive = 2.0
    """b of asinh(b y / sd): nearly linear below 1 / b deviations, logarithmic above."""

    @property
    def styled(self) -> bool:
        """Whether it takes style codes: one a block with the regression head, learned (RG 5.3); one a gesture unit with
        the flow head, measured (`interpreters.planner`)."""
        return self.style_width > 0

    def temperature(self, progress: float) -> float:
        """Gumbel temperature at a share of the run, geometric between the two of `TEMPERATURE`."""
        start, end = TEMPERATURE
        return float(start * (end / start) ** progress)


@dataclass(frozen=True)
class GeneratorWidths:
    """The sizes of a generator that depend on the data. frames: K; motion: D_m; audio: d + 1; lexeme: D_s; control: 2
    F, used with `use_control`; lexemes: S, speakers: P and units: the width of a planner's decision, used by the flow
    head only."""

    frames: int
    motion: int
    audio: int
    lexeme: int
    control: int = 0
    lexemes: int = 0
    speakers: int = 0
    units: int = 0


def positional_block(frames: int, width: int, beta: float = 10_000.0) -> NDArray[np.float32]:
    """P [K, width]: p(k, 2j) = sin(k / beta^(2j / width)), p(k, 2j + 1) = cos of the same, k = 0..K-1 (RG Eq. 8). The
    paper prints K in place of the frame index k (the literal form is the same on every frame)."""
    if width % 2:
        raise ValueError("the positional block needs an even width")
    angles = np.arange(frames)[:, None] * beta ** (-np.arange(0, width, 2) / max(width, 1))
    return np.stack([np.sin(angles), np.cos(angles)], axis=-1).reshape(frames, width).astype(np.float32)
