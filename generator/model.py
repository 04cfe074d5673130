"""The generator G: Gumbel-quantised MLP encoder and LSTM decoder, block by block (RG 5.2, Eq. 5 to 8 and 15)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import SLOPE, BlockLinear, Linear, convolutions, repeat_frames, run_lstm
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

if TYPE_CHECKING:
    from generator.losses import Encoder

__all__ = ["BlockInputs", "Generator", "GeneratorConfig"]

GROUP_WIDTH = 8
"""Width of the vector behind each class of each group."""
TEMPERATURE = 2.0, 0.5
"""Gumbel temperature at the start and at the end of training; it falls geometrically."""
RECONSTRUCTION, PERCEPTUAL, STYLE = 1.0, 0.5, 1.0
"""Weights of L_rec, L_perc and L_z (RG Eq. 9); that of L_lexeme is the setting `lexeme`, which the paper ablates."""
_BLEND = 0.1
"""Temperature of nearly equal classes: their logits differ by a few tenths."""
State = tuple[Tensor, Tensor]
"""Hidden and cell state of the decoder, [layers, B, width] each."""


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
    own_past_until: Share = 0.0
    """Share of the run after which the past is always the generated block; the probability rises linearly between. 0
    (the paper) never: Eq. 5 takes the true block, and Eq. 15 the generated one in use."""
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


@dataclass(frozen=True)
class BlockInputs:
    """Inputs of N blocks: audio windows [B, N, 3K, d], lexemes [B, N, D_s], style codes [B, N, d_z], and the style
    control [B, N, K, 2 F], None without."""

    audio: Tensor
    lexeme: Tensor
    style: Tensor
    control: Tensor | None = None


class StyleCodes(nn.Module):
    """One learnable style code per training block (RG 5.3); row 0 is the zero code of inserted silent blocks."""

    def __init__(self, blocks: int, width: int) -> None:
        super().__init__()
        self.table = nn.Embedding(blocks + 1, width, padding_idx=0)
        with torch.no_grad():
            nn.init.normal_(self.table.weight, std=0.3)
            self.table.weight[0] = 0.0

    def forward(self, index: Tensor) -> Tensor:
        """Codes [..., width] of block indices [...] (1 for the first block, 0 for none)."""
        return self.table(index)


class GumbelCodes(nn.Module):
    """H groups of C classes: a straight-through Gumbel-softmax choice in each, mapped to a vector (RG 5.2)."""

    def __init__(self, width: int, groups: int, classes: int, group_width: int) -> None:
        super().__init__()
        self.groups, self.classes = groups, classes
        self.logits = Linear(width, groups * classes)
        # Vectors of length 1 on average, whatever their width.
        self.vectors = nn.Parameter(torch.randn(groups, classes, group_width) / group_width**0.5)

    def forward(self, hidden: Tensor, temperature: float) -> tuple[Tensor, Tensor]:
        """Hidden [..., width] to (codebook vector [..., H * group_width], one-hot choice [..., H, C]). In training the
        choice is sampled, with the gradient of the soft choice; in evaluation it is the arg max."""
        logits = self.logits(hidden).unflatten(-1, (self.groups, self.classes))
        if self.training:
            # Straight-through: hard as in evaluation, so the decoder never sees a mixture of classes in training.
            choice = functional.gumbel_softmax(logits, tau=temperature, hard=True)
        else:
            choice = functional.one_hot(logits.argmax(-1), self.classes).to(logits.dtype)
        # Choice (one-hot) times vectors: a look-up whose gradient reaches the choice.
        return torch.einsum("...hc,hcw->...hw", choice, self.vectors).flatten(-2), choice

    def best(self, hidden: Tensor) -> Tensor:
        """The codebook vector of the flow head in evaluation, [..., H * group_width] of hidden [..., width]. Classes
        that are nearly equal are blended (a softmax at temperature `_BLEND`), or the rounding errors of a recording at
        another level would flip a class here and there, and with it the motion."""
        share = torch.softmax(self.logits(hidden).unflatten(-1, (self.groups, self.classes)) / _BLEND, -1)
        return torch.einsum("...hc,hcw->...hw", share, self.vectors).flatten(-2)


def positional_block(frames: int, width: int, beta: float = 10_000.0) -> Tensor:
    """P [K, width]: p(k, 2j) = sin(k / beta^(2j / width)), p(k, 2j + 1) = cos of the same, k = 0..K-1 (RG Eq. 8). The
    paper prints K in place of the frame index k (the literal form is the same on every frame)."""
    if width % 2:
        raise ValueError("the positional block needs an even width")
    k = torch.arange(frames, dtype=torch.float64)
    rates = beta ** (-torch.arange(0, width, 2, dtype=torch.float64) / width)
    angles = k[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(1).float()


class Generator(nn.Module):
    """G, E_M, E_A and the style codes. Motion is in the lexicon's normalised features, [B, K, D_m]."""

    position: Tensor
    fade: Tensor
    present: Tensor

    def __init__(self, config: GeneratorConfig, widths: GeneratorWidths, style_blocks: int = 0,
                 present: Tensor | None = None) -> None:
        """style_blocks: number of learned style codes, 0 for none (inference). present: [D_m] 1 for the dimensions in
        the data; the others have no loss, so the output there is 0."""
        super().__init__()
        self.register_buffer("present", torch.ones(widths.motion) if present is None else present, persistent=False)
        c, frames = config, widths.frames
        self.config, self.frames = config, frames
        self.encode_motion = convolutions((widths.motion, *[c.motion_features] * 3), norm=False)
        self.encode_audio = BlockLinear(frames, widths.audio, c.audio_features, bottleneck=c.audio_bottleneck)
        position = positional_block(frames, c.position_width) if c.position_width else torch.zeros(frames, 0)
        self.register_buffer("position", position, persistent=False)
        self.register_buffer("fade", torch.arange(frames - 1, -1, -1.0)[:, None] / frames, persistent=False)
        self.control_width = widths.control if c.use_control else 0
        width = c.motion_features + c.audio_features + widths.lexeme + c.style_width + c.position_width
        width += self.control_width
        self.mlp = nn.Sequential(Linear(width, c.hidden), nn.LeakyReLU(SLOPE),
                                 Linear(c.hidden, c.hidden), nn.LeakyReLU(SLOPE))
        self.codes = GumbelCodes(c.hidden, c.groups, c.classes, GROUP_WIDTH)
        self.lstm = nn.LSTM(c.groups * GROUP_WIDTH, c.lstm_width, c.lstm_layers, batch_first=True)
        self.to_motion = Linear(c.lstm_width, widths.motion)
        self.start = nn.Sequential(Linear(widths.motion + widths.lexeme, c.hidden), nn.LeakyReLU(SLOPE),
                                   Linear(c.hidden, 2 * c.lstm_layers * c.lstm_width))
        self.styles = StyleCodes(style_blocks, c.style_width) if style_blocks else None

    @property
    def weights(self) -> dict[str, float]:
        c = self.config
        return {"reconstruction": RECONSTRUCTION, "perceptual": PERCEPTUAL, "lexeme": c.lexeme, "style": STYLE}

    def sparse_parameters(self) -> Iterator[tuple[Tensor, float]]:
        if self.styles is not None:
            yield self.styles.table.weight, self.config.style_rate

    def first_state(self, pose: Tensor, lexeme: Tensor) -> State:
        """The decoder's state before the first block, from the seed pose [B, D_m] and the first lexeme [B, D_s]."""
        c = self.config
        both = self.start(torch.cat([pose, lexeme], dim=-1))
        hidden, cell = both.unflatten(-1, (2, c.lstm_layers, c.lstm_width)).permute(1, 2, 0, 3)
        # The hidden state of an LSTM lies between -1 and 1, its cell state has no bounds.
        return torch.tanh(hidden).contiguous(), cell.contiguous()

    def step(self, past: Tensor, audio: Tensor, lexeme: Tensor, style: Tensor, state: State, temperature: float = 1.0,
             control: Tensor | None = None) -> tuple[Tensor, State, Tensor]:
        """One block (RG Eq. 15). past: [B, K, D_m] the previous block; audio: [B, K, audio_features] (`encode_audio` of
        the three-block window); lexeme: [B, D_s]; style: [B, d_z]; control: [B, K, 2 F], None without. Returns the
        block [B, K, D_m], the state, and the choice [B, K, H, C]."""
        if control is None:
            control = audio.new_zeros(len(past), self.frames, self.control_width)
        rows = torch.cat([
            self.encode_motion(past.transpose(1, 2)).transpose(1, 2),
            audio,
            repeat_frames(lexeme, self.frames),
            repeat_frames(style, self.frames),
            self.position.expand(len(past), -1, -1),
            control[..., :self.control_width],
        ], dim=-1)
        vectors, choice = self.codes(self.mlp(rows), temperature)
        hidden, state = run_lstm(self.lstm, vectors, state)
        # The last pose fades over the block. It closes the seams and, unlike a sum of differences, cannot drift: every
        # block ends on the output of the network.
        motion = self.to_motion(hidden) + self.fade * past[:, -1:]
        return motion * self.present, state, choice

    def roll_out(self, seed: Tensor, given: BlockInputs, motion: Tensor | None = None, own_past: float = 1.0,
                 temperature: float = 1.0) -> tuple[Tensor, Tensor]:
        """Blocks 1..N in sequence, with the decoder's state carried over. seed: [B, K, D_m] the block before the first;
        motion: [B, N, K, D_m] the truth (needed if own_past < 1). With probability `own_past` the past of a block is
        the generated one, else the truth. Returns [B, N, K, D_m] and the code choices [B, N, K, H, C]."""
        audio = self.encode_audio(given.audio)
        state = self.first_state(seed[:, -1], given.lexeme[:, 0])
        past, blocks, choices = seed, [], []
        for i in range(given.lexeme.shape[1]):
            control = None if given.control is None else given.control[:, i]
            block, state, choice = self.step(past, audio[:, i], given.lexeme[:, i], given.style[:, i], state,
                                             temperature, control)
            blocks.append(block)
            choices.append(choice)
            past = block
            if own_past < 1.0 and motion is not None:
                generated = torch.rand(len(seed), 1, 1, device=seed.device) < own_past
                # Drawn per window: in one batch some windows follow the truth and others their own output.
                past = torch.where(generated, block, motion[:, i])
        return torch.stack(blocks, 1), torch.stack(choices, 1)

    def own_past_probability(self, progress: float) -> float:
        """0 at the start of the run, 1 after `own_past_until` of it, linear between; always 0 without that setting."""
        until = self.config.own_past_until
        return min(progress / until, 1.0) if until else 0.0

    def temperature(self, progress: float) -> float:
        return self.config.temperature(progress)

    def losses(self, batch: dict[str, Tensor], progress: float, encoder: Encoder) -> dict[str, Tensor]:
        """The four losses of RG Eq. 9 on windows of N blocks after a seed block.

        batch: motion [B, N + 1, K, D_m], audio [B, N + 1, 3K, d], lexeme [B, N + 1, D_s], style [B, N + 1] block
        numbers (0 for inserted silence), mask [B, D_m] present joints, valid [B, N + 1] (0 for the padding of a short
        recording), control [B, N + 1, K, 2 F] if used. encoder: the lexicon's frozen E.
        """
        from generator import losses  # only training needs them

        if self.styles is None:
            raise ValueError("a generator without style codes cannot be trained")
        motion, audio, lexemes = batch["motion"], batch["audio"][:, 1:], batch["lexeme"][:, 1:]
        numbers = batch["style"][:, 1:]
        style = self.styles(numbers)
        temperature = self.temperature(progress)
        control = batch["control"][:, 1:] if self.control_width else None
        generated, _ = self.roll_out(motion[:, 0], BlockInputs(audio, lexemes, style, control), motion[:, 1:],
                                     self.own_past_probability(progress), temperature)
        valid = batch["valid"][:, 1:]
        mask = batch["mask"][:, None, None] * valid[:, :, None, None]
        real = valid > 0
        return {
            "reconstruction": losses.reconstruction(generated, motion[:, 1:], mask),
            "perceptual": losses.perceptual(generated[real], motion[:, 1:][real], encoder),
            "lexeme": self._lexeme_loss(motion, audio, lexemes, style, temperature, encoder, control),
            "style": losses.style_divergence(style[(numbers > 0) & real]),
        }

    def _lexeme_loss(self, motion: Tensor, audio: Tensor, lexemes: Tensor, style: Tensor, temperature: float,
                     encoder: Encoder, control: Tensor | None) -> Tensor:
        """RG Eq. 12 and 13 with N_J = 1: past, audio, style (and control) of random blocks j of the batch with lexemes
        of blocks i."""
        from generator.losses import lexeme as lexeme_loss

        past, windows, wanted, styles = (part.flatten(0, 1) for part in (motion[:, :-1], audio, lexemes, style))
        control = None if control is None else control.flatten(0, 1)
        count = max(1, round(len(past) * self.config.swap_share))
        i, j = (torch.randperm(len(past), device=past.device)[:count] for _ in range(2))
        # The decoder starts anew, because the pairs are single blocks out of their context.
        state = self.first_state(past[j, -1], wanted[i])
        block, _, _ = self.step(past[j], self.encode_audio(windows[j]), wanted[i], styles[j], state,
                                temperature, None if control is None else control[j])
        return lexeme_loss(block, wanted[i], encoder)
