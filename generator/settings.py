"""Sizes and weights of the generator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from data_module.settings import Depth, NotNegative, Positive, SettingChoice, SettingRange, Share, Width, WidthOrNone


@dataclass(frozen=True)
class GeneratorConfig:
    """Sizes and weights of the generator; the defaults are the paper's where it gives them."""

    motion_features: Width = 128
    """d_m~, width of E_M."""
    audio_features: WidthOrNone = 128
    """d_a~, width of E_A."""
    audio_bottleneck: WidthOrNone = 0
    """Width that each row of audio is brought to before E_A; 0 for none (the paper)."""
    style_width: WidthOrNone = 32
    """d_z."""
    position_width: WidthOrNone = 32
    """d_P; 0 leaves the positional block out (Table 7)."""
    position_direction: Annotated[str, SettingChoice(("forward", "to_beat"))] = "forward"
    """Whether the positional block counts the frames since the last beat or those that are left to the next."""
    hidden: Width = 512
    """Width of the MLP encoder."""
    groups: Width = 64
    """H."""
    classes: Width = 128
    """C."""
    group_width: Width = 8
    """Width of the vector behind each class of each group."""
    lstm_width: Width = 1024
    """Units of each layer of the decoder."""
    lstm_layers: Depth = 2
    """Layers of the decoder."""
    temperature_start: Positive = 2.0
    """Of the Gumbel choice when training begins."""
    temperature_end: Positive = 0.5
    """The Gumbel temperature falls geometrically from one to the other over the run."""
    residual: bool = True
    """Add the last pose of the block before, fading linearly to nothing at the block's end. It closes the seams, and
    unlike a sum of differences it cannot drift: every block ends on what the network itself says."""
    own_past_from: Share = 0.0
    """Share of the run before which a block always sees the recorded block before it."""
    own_past_until: Share = 0.5
    """Between these shares of the run the probability of being fed its own past block rises from 0 to 1."""
    reconstruction: NotNegative = 1.0
    """Weight of L_rec (RG Eq. 9 and 10)."""
    perceptual: NotNegative = 0.5
    """Weight of L_perc (RG Eq. 9 and 11)."""
    lexeme: NotNegative = 0.2
    """Weight of L_lexeme (RG Eq. 9 and 13)."""
    style: NotNegative = 1.0
    """Weight of L_z (RG Eq. 9 and 14)."""
    use_control: bool = False
    """Hear what is asked of the style (C_i of RG 7.2.1)."""
    velocity: NotNegative = 0.0
    """Weight of the squared error of frame differences; off in the paper."""
    style_dropout: Share = 0.0
    """Share of training windows that get the zero code instead of their own. A learned code tells what only hindsight
    knows; without it the generator must take its timing from the sound. Off in the paper."""
    swaps: Annotated[int, SettingRange(0, 64)] = 1
    """N_J, permutations of the other inputs for the lexeme loss."""
    swap_share: Share = 1.0
    """Share of the batch's blocks that each permutation takes."""
    style_rate: Positive = 1e-2
    """Learning rate of the style codes: each gets one gradient per epoch, so the common rate would leave them put."""
