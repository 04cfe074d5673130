"""The generator G: Gumbel-quantised MLP encoder and LSTM decoder, block by block (RG 5.2, Eq. 5 to 8 and 15)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import SLOPE, BlockLinear, convolutions, repeat_frames
from generator.settings import BLEND, GROUP_WIDTH, GeneratorConfig, GeneratorWidths, positional_block

if TYPE_CHECKING:
    from generator.losses import Encoder

__all__ = ["BlockInputs", "Generator"]

RECONSTRUCTION, PERCEPTUAL, STYLE = 1.0, 0.5, 1.0
"""Weights of L_rec, L_perc and L_z (RG Eq. 9); that of L_lexeme is the setting `lexeme`, which the paper ablates."""
State = tuple[Tensor, Tensor]
"""Hidden and cell state of the decoder, [layers, B, width] each."""


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
        self.logits = nn.Linear(width, groups * classes)
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
        that are nearly equal are blended (a softmax at temperature `BLEND`), or the rounding errors of a recording at
        another level would flip a class here and there, and with it the motion."""
        share = torch.softmax(self.logits(hidden).unflatten(-1, (self.groups, self.classes)) / BLEND, -1)
        return torch.einsum("...hc,hcw->...hw", share, self.vectors).flatten(-2)


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
        position = torch.as_tensor(positional_block(frames, c.position_width))
        self.register_buffer("position", position, persistent=False)
        self.register_buffer("fade", torch.arange(frames - 1, -1, -1.0)[:, None] / frames, persistent=False)
        self.control_width = widths.control if c.use_control else 0
        width = c.motion_features + c.audio_features + widths.lexeme + c.style_width + c.position_width
        width += self.control_width
        self.mlp = nn.Sequential(nn.Linear(width, c.hidden), nn.LeakyReLU(SLOPE),
                                 nn.Linear(c.hidden, c.hidden), nn.LeakyReLU(SLOPE))
        self.codes = GumbelCodes(c.hidden, c.groups, c.classes, GROUP_WIDTH)
        self.lstm = nn.LSTM(c.groups * GROUP_WIDTH, c.lstm_width, c.lstm_layers, batch_first=True)
        self.to_motion = nn.Linear(c.lstm_width, widths.motion)
        self.start = nn.Sequential(nn.Linear(widths.motion + widths.lexeme, c.hidden), nn.LeakyReLU(SLOPE),
                                   nn.Linear(c.hidden, 2 * c.lstm_layers * c.lstm_width))
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
        hidden, state = self.lstm(vectors, state)
        # The last pose fades over the block. It closes the seams and, unlike a sum of differences, cannot drift: every
        # block ends on the output of the network.
        motion = self.to_motion(hidden) + self.fade * past[:, -1:]
        return motion * self.present, state, choice

    def roll_out(self, seed: Tensor, given: BlockInputs, motion: Tensor | None = None, temperature: float = 1.0
                 ) -> tuple[Tensor, Tensor]:
        """Blocks 1..N in sequence, with the decoder's state carried over. seed: [B, K, D_m] the block before the first;
        motion: [B, N, K, D_m] the truth, which is then the past of each block (Eq. 5, training), or None: it is the
        generated block (Eq. 15, use). Returns [B, N, K, D_m] and the code choices [B, N, K, H, C]."""
        audio = self.encode_audio(given.audio)
        state = self.first_state(seed[:, -1], given.lexeme[:, 0])
        past, blocks, choices = seed, [], []
        for i in range(given.lexeme.shape[1]):
            control = None if given.control is None else given.control[:, i]
            block, state, choice = self.step(past, audio[:, i], given.lexeme[:, i], given.style[:, i], state,
                                             temperature, control)
            blocks.append(block)
            choices.append(choice)
            # Trained on its own past, it jumped at the edges of blocks and lost its timing (docs/paper.md).
            past = block if motion is None else motion[:, i]
        return torch.stack(blocks, 1), torch.stack(choices, 1)

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
                                     temperature)
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
