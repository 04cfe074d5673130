"""The generator G: Gumbel-quantised MLP encoder and LSTM decoder, block by block (RG 5.2, Eq. 5 to 8 and 15)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import SLOPE, BlockLinear, convolutions, repeat_frames, run_lstm
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

State = tuple[Tensor, Tensor]
"""Hidden and cell state of the decoder, [layers, B, width] each."""


@dataclass(frozen=True)
class GeneratorConfig:
    """Sizes and weights of the generator; the defaults are the paper's where it gives them."""

    head: Annotated[str, SettingChoice(("regression", "flow"))] = "regression"
    """"regression": the motion itself (RG 5.2, `generator.model`); "flow": what a block adds to its past is drawn from
    a distribution (`generator.flow`), which needs the lexicon of movements."""
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
    # The rest is read by the flow head alone.
    blocks: Count = 28
    """Blocks of a training window: about nine seconds, for what comes and goes over a phrase."""
    context: Width = 256
    """Units of the LSTM over blocks, and width of what the head is told."""
    lexeme_width: Width = 64
    """Of a lexeme's embedding, and of what is heard of a block, past the bottleneck."""
    flow_width: Width = 384
    """Units of the head."""
    flow_layers: Depth = 3
    """Residual blocks of the head."""
    dropout: Annotated[float, SettingRange(0.0, 0.95)] = 0.2
    """In training, share of the context's units that are left out."""
    audio_dropout: Share = 0.15
    """Share of training windows that hear nothing, for guidance."""
    after_dropout: Share = 0.0
    """Share of training windows that do not hear the block after a block, nor how long it lasts or whether it is
    silent, so that a stream need not wait for it."""
    lexeme_dropout: Share = 0.15
    """Share of training windows that are told no lexeme, for guidance."""
    history_dropout: Share = 0.0
    """Share of training windows that are not told how the body moved before (E_M, and what the blocks before added)."""
    added_dropout: Share = 0.15
    """Share of blocks that are not told what the block before added: leaning on it makes loops."""
    past_noise: NotNegative = 0.25
    """Largest deviation of the noise on the pose before a block, in deviations of each number."""
    velocity_noise: NotNegative = 0.1
    """Largest deviation of the noise on the velocity before a block, as a share of it."""
    bend: Positive = 2.0
    """b of asinh(b y / sd): below 1 / b deviations a coefficient is told as it is, above by its logarithm."""
    draws: Count = 2
    """Times and noises that the loss is averaged over for each block."""

    @property
    def styled(self) -> bool:
        """Whether it takes a style code for every block."""
        return self.head == "regression" and self.style_width > 0


@dataclass(frozen=True)
class GeneratorWidths:
    """What shapes a generator besides its settings.

    frames: K; motion: D_m; audio: d + 1; lexeme: D_s; control: 2 F of a control's rows, read only where the settings
    ask for it; lexemes: S and speakers: P, which the flow head alone reads.
    """

    frames: int
    motion: int
    audio: int
    lexeme: int
    control: int = 0
    lexemes: int = 0
    speakers: int = 0


@dataclass(frozen=True)
class BlockInputs:
    """What N blocks are made from: audio windows [B, N, 3K, d], lexemes [B, N, D_s], style codes [B, N, d_z], and what
    is asked of the style [B, N, K, 2 F], None when nothing is."""

    audio: Tensor
    lexeme: Tensor
    style: Tensor
    control: Tensor | None = None


class StyleCodes(nn.Module):
    """One learnable style code per training block (RG 5.3); row 0 is the zero code of inserted silent blocks."""

    def __init__(self, blocks: int, width: int) -> None:
        super().__init__()
        self.table = nn.Embedding(blocks + 1, width, padding_idx=0, sparse=True)
        with torch.no_grad():
            nn.init.normal_(self.table.weight, std=0.3)
            self.table.weight[0] = 0.0

    def forward(self, index: Tensor) -> Tensor:
        """Codes [..., width] of block indices [...] (1 for the first block, 0 for none)."""
        return self.table(index)


class GumbelCodes(nn.Module):
    """H groups of C classes: a straight-through Gumbel-softmax choice in each, read as a vector (RG 5.2)."""

    def __init__(self, width: int, groups: int, classes: int, group_width: int) -> None:
        super().__init__()
        self.groups, self.classes = groups, classes
        self.logits = nn.Linear(width, groups * classes)
        self.vectors = nn.Parameter(torch.randn(groups, classes, group_width) / group_width**0.5)

    def forward(self, hidden: Tensor, temperature: float) -> tuple[Tensor, Tensor]:
        """Hidden [..., width] to (codebook vector [..., H * group_width], one-hot choice [..., H, C]).

        In training the choice is sampled and its gradient is that of the soft one; in evaluation it is the arg max.
        """
        logits = self.logits(hidden).unflatten(-1, (self.groups, self.classes))
        if self.training:
            choice = functional.gumbel_softmax(logits, tau=temperature, hard=True)
        else:
            choice = functional.one_hot(logits.argmax(-1), self.classes).to(logits.dtype)
        return torch.einsum("...hc,hcw->...hw", choice, self.vectors).flatten(-2), choice

    def best(self, hidden: Tensor) -> Tensor:
        """The codebook vector of evaluation alone, [..., H * group_width] of hidden [..., width]."""
        chosen = self.logits(hidden).unflatten(-1, (self.groups, self.classes)).argmax(-1)
        return self.vectors[torch.arange(self.groups, device=hidden.device), chosen].flatten(-2)


def positional_block(frames: int, width: int, beta: float = 10_000.0, direction: str = "forward") -> Tensor:
    """P [K, width]: p(k, 2j) = sin(k / beta^(2j / width)), p(k, 2j + 1) = cos of the same, k = 0..K-1 (RG Eq. 8).

    The paper prints K where the frame index k must stand (its literal form is the same on every frame).
    direction "to_beat" counts the frames that are left to the beat instead.
    """
    if direction not in ("forward", "to_beat"):
        raise ValueError(f"direction must be forward or to_beat, not {direction!r}")
    if width % 2:
        raise ValueError("the positional block needs an even width")
    k = torch.arange(frames, dtype=torch.float64)
    if direction == "to_beat":
        k = k.flip(0)
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
        """style_blocks: how many style codes are learned, 0 for none (inference). present: [D_m] 1 where the data have
        the dimension; elsewhere no loss would hold it, so it is 0."""
        super().__init__()
        self.register_buffer("present", torch.ones(widths.motion) if present is None else present, persistent=False)
        c, frames = config, widths.frames
        self.config, self.frames = config, frames
        self.encode_motion = convolutions((widths.motion, *[c.motion_features] * 3), norm=False)
        self.encode_audio = BlockLinear(frames, widths.audio, c.audio_features, bottleneck=c.audio_bottleneck)
        position = positional_block(frames, c.position_width, direction=c.position_direction) \
            if c.position_width else torch.zeros(frames, 0)
        self.register_buffer("position", position, persistent=False)
        self.register_buffer("fade", torch.arange(frames - 1, -1, -1.0)[:, None] / frames, persistent=False)
        self.control_width = widths.control if c.use_control else 0
        width = c.motion_features + c.audio_features + widths.lexeme + c.style_width + c.position_width
        width += self.control_width
        self.mlp = nn.Sequential(nn.Linear(width, c.hidden), nn.LeakyReLU(SLOPE),
                                 nn.Linear(c.hidden, c.hidden), nn.LeakyReLU(SLOPE))
        self.codes = GumbelCodes(c.hidden, c.groups, c.classes, c.group_width)
        self.lstm = nn.LSTM(c.groups * c.group_width, c.lstm_width, c.lstm_layers, batch_first=True)
        self.to_motion = nn.Linear(c.lstm_width, widths.motion)
        self.start = nn.Sequential(nn.Linear(widths.motion + widths.lexeme, c.hidden), nn.LeakyReLU(SLOPE),
                                   nn.Linear(c.hidden, 2 * c.lstm_layers * c.lstm_width))
        self.styles = StyleCodes(style_blocks, c.style_width) if style_blocks else None

    @property
    def weights(self) -> dict[str, float]:
        """Loss weights, keyed like `losses` (RG Eq. 9)."""
        c = self.config
        return {"reconstruction": c.reconstruction, "perceptual": c.perceptual, "lexeme": c.lexeme, "style": c.style,
                "velocity": c.velocity}

    def sparse_parameters(self) -> Iterator[tuple[Tensor, float]]:
        """The parameters that want SparseAdam, each with its learning rate."""
        if self.styles is not None:
            yield self.styles.table.weight, self.config.style_rate

    def first_state(self, pose: Tensor, lexeme: Tensor) -> State:
        """The decoder's state before the first block, from the seed pose [B, D_m] and the first lexeme [B, D_s]."""
        c = self.config
        both = self.start(torch.cat([pose, lexeme], dim=-1))
        hidden, cell = both.unflatten(-1, (2, c.lstm_layers, c.lstm_width)).permute(1, 2, 0, 3)
        return torch.tanh(hidden).contiguous(), cell.contiguous()

    def step(self, past: Tensor, audio: Tensor, lexeme: Tensor, style: Tensor, state: State, temperature: float = 1.0,
             control: Tensor | None = None) -> tuple[Tensor, State, Tensor]:
        """One block (RG Eq. 15).

        past: [B, K, D_m] the block before; audio: [B, K, audio_features] (`encode_audio` of the three-block window);
        lexeme: [B, D_s]; style: [B, d_z]; control: [B, K, 2 F], None when nothing is asked. Gives the block
        [B, K, D_m], the state, and the choice [B, K, H, C].
        """
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
        motion = self.to_motion(hidden)
        if self.config.residual:
            motion = motion + self.fade * past[:, -1:]
        return motion * self.present, state, choice

    def roll_out(self, seed: Tensor, given: BlockInputs, motion: Tensor | None = None, own_past: float = 1.0,
                 temperature: float = 1.0) -> tuple[Tensor, Tensor]:
        """Blocks 1..N one after the other, the decoder's state carried across.

        seed: [B, K, D_m] the block before the first; motion: [B, N, K, D_m] the truth (needed when own_past < 1). With
        probability `own_past` a block sees what was generated, else the truth. Gives [B, N, K, D_m] and the code
        choices [B, N, K, H, C].
        """
        heard = self.encode_audio(given.audio)
        state = self.first_state(seed[:, -1], given.lexeme[:, 0])
        past, made, choices = seed, [], []
        for i in range(given.lexeme.shape[1]):
            asked = None if given.control is None else given.control[:, i]
            block, state, choice = self.step(past, heard[:, i], given.lexeme[:, i], given.style[:, i], state,
                                             temperature, asked)
            made.append(block)
            choices.append(choice)
            past = block
            if own_past < 1.0 and motion is not None:
                own = torch.rand(len(seed), 1, 1, device=seed.device) < own_past
                past = torch.where(own, block, motion[:, i])
        return torch.stack(made, 1), torch.stack(choices, 1)

    def own_past_probability(self, progress: float) -> float:
        """0 before `own_past_from` of the run, 1 after `own_past_until`, linear between."""
        c = self.config
        span = max(c.own_past_until - c.own_past_from, 1e-9)
        return min(max((progress - c.own_past_from) / span, 0.0), 1.0)

    def temperature(self, progress: float) -> float:
        """Geometric from `temperature_start` to `temperature_end`."""
        c = self.config
        return float(c.temperature_start * (c.temperature_end / c.temperature_start) ** progress)

    def losses(self, batch: dict[str, Tensor], progress: float, encoder: Encoder) -> dict[str, Tensor]:
        """The four losses of RG Eq. 9 on windows of N blocks after a seed block.

        batch: motion [B, N + 1, K, D_m], audio [B, N + 1, 3K, d], lexeme [B, N + 1, D_s], style [B, N + 1] block
        numbers (0 for inserted silence), mask [B, D_m] present joints, valid [B, N + 1] (0 where a short recording was
        filled up), control [B, N + 1, K, 2 F] where it is heard. encoder: the lexicon's frozen E.
        """
        from generator import losses  # only training asks for them

        if self.styles is None:
            raise ValueError("a generator without style codes cannot be trained")
        motion, audio, lexemes = batch["motion"], batch["audio"][:, 1:], batch["lexeme"][:, 1:]
        numbers = batch["style"][:, 1:]
        style = self.styles(numbers)
        temperature = self.temperature(progress)
        control = batch["control"][:, 1:] if self.control_width else None
        worn = style
        if self.training and self.config.style_dropout > 0:
            worn = style * (torch.rand(len(style), 1, 1, device=style.device) >= self.config.style_dropout)
        made, _ = self.roll_out(motion[:, 0], BlockInputs(audio, lexemes, worn, control), motion[:, 1:],
                                self.own_past_probability(progress), temperature)
        valid = batch["valid"][:, 1:]
        mask = batch["mask"][:, None, None] * valid[:, :, None, None]
        kept = valid > 0
        before = torch.cat([motion[:, :1, -1], made[:, :-1, -1]], 1)[:, :, None]
        before_true = motion[:, :-1, -1][:, :, None]
        velocity = torch.diff(torch.cat([before, made], 2), dim=2) \
            - torch.diff(torch.cat([before_true, motion[:, 1:]], 2), dim=2)
        return {
            "reconstruction": losses.reconstruction(made, motion[:, 1:], mask),
            "perceptual": losses.perceptual(made[kept], motion[:, 1:][kept], encoder),
            "lexeme": self._lexeme_loss(motion, audio, lexemes, style, temperature, encoder, control),
            "style": losses.style_divergence(style[(numbers > 0) & kept]),
            "velocity": losses.reconstruction(velocity, torch.zeros_like(velocity), mask),
        }

    def _lexeme_loss(self, motion: Tensor, audio: Tensor, lexemes: Tensor, style: Tensor, temperature: float,
                     encoder: Encoder, control: Tensor | None) -> Tensor:
        """RG Eq. 12 and 13: past, audio, style (and control) of random blocks j of the batch, lexemes of blocks i."""
        from data_module.parallel import batch_rows, draws_along, own_rows, shares
        from generator.losses import lexeme as lexeme_loss

        past, heard = batch_rows(motion[:, :-1].flatten(0, 1)), batch_rows(audio.flatten(0, 1))
        wanted, styles = batch_rows(lexemes.flatten(0, 1)), batch_rows(style.flatten(0, 1))
        control = None if control is None else batch_rows(control.flatten(0, 1))
        count = max(1, round(len(past) * self.config.swap_share))
        # Where the pairs cannot be divided evenly, every process takes them all, with the same noise.
        divided = count % shares() == 0
        own = own_rows(count) if divided else slice(count)
        total = motion.new_zeros(())
        for _ in range(self.config.swaps):
            i = torch.randperm(len(past), device=past.device)[:count][own]
            j = torch.randperm(len(past), device=past.device)[:count][own]
            state = self.first_state(past[j, -1], wanted[i])
            asked = None if control is None else control[j]
            with draws_along(0 if divided else None):
                made, _, _ = self.step(past[j], self.encode_audio(heard[j]), wanted[i], styles[j], state, temperature,
                                       asked)
            total = total + lexeme_loss(made, wanted[i], encoder)
        return total / max(self.config.swaps, 1)
