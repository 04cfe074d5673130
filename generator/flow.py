"""The generator with a sampling head: conditional flow matching over the motion that a block adds to its past.

The structure is that of RG 5.2: E_M on the previous block, E_A on three blocks of audio, the lexeme, the positional
block, a Gumbel-quantised code, an LSTM. Three things differ from `generator.model`:

- Pose, velocity and acceleration before a block bypass the bottleneck, because a code of a few classes cannot encode
  the position of a hand.
- The LSTM runs over blocks and gives a context h; the head samples all of a block's coefficients y
  (`data_module.motion.movement`) at once. With u = asinh(b y / sd) / sd_u, whose tails are light, it learns
  v(u_t, t, h) = u - e on u_t = (1 - t) e + t u, where e is Gaussian noise and t uniform. Sampling integrates
  du/dt = v from noise to u by the Adams method. A regression would give the mean of all continuations, which hardly
  moves.
- Audio and lexeme are left out in part of the training, for classifier-free guidance: v + g_a (v - v without audio) +
  g_l (v - v without lexeme). So is the previous motion, which predicts the liveliness of the next block so well that
  the model would copy it instead of using the audio, and become calmer and calmer on its own output.

Training uses true pasts with added noise, never generated blocks: learning to return from a shifted past to the truth
keeps long performances from drifting.

`FlowHead` gives v and is trained. A stream samples few rows many times, so that call overhead and the transfer of
weights dominate. `SamplingHead` computes the same v with less of both: work shared by the contexts is done once, the
part that depends on time alone is a cached bias, and weights are stored in the layout of the product.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import (
    SLOPE,
    BlockLinear,
    convolutions,
    masked_mean,
    repeat_frames,
    without_after,
)
from data_module.motion.movement import MovementBasis, Pasts
from data_module.motion.movement_run import PAST
from generator.flow_run import CIRCUMSTANCES, FREQUENCIES, LAYERS, MOST, Circumstances, alone, rates
from generator.model import GumbelCodes, State
from generator.settings import GROUP_WIDTH, GeneratorConfig, GeneratorWidths, positional_block

__all__ = ["FlowGenerator", "FlowHead", "FlowInputs"]

NearestLexeme = Callable[[Tensor], Tensor]
"""Coefficients [B, n] to the lexemes [B] nearest to them."""
AUDIO_DROPOUT = LEXEME_DROPOUT = 0.15
"""Shares of training windows without audio, and without lexemes, for guidance."""
UNIT_DROPOUT = 0.1
"""Share of training windows without the planner's decisions, for guidance."""
ADDED_DROPOUT = 0.15
"""Share of blocks without the coefficients of the previous block: relying on them causes loops."""
DRAWS = 2
"""Samples of time and noise over which the loss of each block is averaged."""


def circumstances(durations: Tensor, silent: Tensor) -> Tensor:
    """[N, 8] `Circumstances.step` of the blocks of a recording, durations [N] s and silent [N]; the first and the last
    block are repeated beyond the ends."""
    seconds, quiet, state, places = durations.tolist(), silent.tolist(), Circumstances(), []
    for i in range(len(quiet)):
        three = max(i - 1, 0), i, min(i + 1, len(quiet) - 1)
        place, state = state.step([seconds[n] for n in three], [quiet[n] for n in three])
        places.append(place)
    return torch.as_tensor(np.stack(places))


@dataclass(frozen=True)
class FlowInputs:
    """Inputs of N blocks: audio windows [B, N, 3K, d], lexemes [B, N] (S for none), the previous blocks
    [B, N, K, D_m] with the ratios of durations [B, N], circumstances [B, N, 8], the speaker one-hot [B, P], and the
    style control [B, N, K, 2 F], None without. without_audio: [B] the audio is left out. without_history: [B] the
    previous motion is left out, except for the last frames. unit: [B, N, U] the planner's decisions, one-hot and side
    by side, or None. style: [B, N, d_z] the style codes of the blocks' units, or None. All but the lexemes may have 1
    in place of B if they are the same for all B.
    """

    audio: Tensor
    lexeme: Tensor
    before: Tensor
    ratio: Tensor
    circumstances: Tensor
    speaker: Tensor
    control: Tensor | None = None
    without_audio: Tensor | None = None
    without_history: Tensor | None = None
    unit: Tensor | None = None
    style: Tensor | None = None

    @property
    def past(self) -> Pasts:
        return Pasts(self.before[..., -PAST:, :], self.ratio)


class FlowGenerator(nn.Module):
    """E_M, E_A, the Gumbel code, the LSTM over blocks and the flow head, with the basis of the coefficients."""

    position: Tensor
    present: Tensor
    deviation: Tensor
    centres: Tensor

    def __init__(self, config: GeneratorConfig, widths: GeneratorWidths, basis: MovementBasis,
                 present: Tensor | None = None) -> None:
        """basis: a separate `MovementBasis`, whose values are copied from the lexicon's (`adopt`). present: [D_m] 1
        for the dimensions in the data; the others are 0."""
        super().__init__()
        c, frames = config, widths.frames
        self.config, self.frames, self.basis, self.lexemes = config, frames, basis, widths.lexemes
        self.register_buffer("present", torch.ones(widths.motion) if present is None else present, persistent=False)
        self.register_buffer("deviation", torch.ones(basis.width))
        self.register_buffer("centres", torch.zeros(widths.lexemes + 1, basis.width))  # u of each lexeme; 0 for none
        position = torch.as_tensor(positional_block(frames, c.position_width))
        self.register_buffer("position", position, persistent=False)
        self.control_width = widths.control if c.use_control else 0
        self.encode_motion = convolutions((widths.motion, *[c.motion_features] * 3), norm=False)
        self.encode_audio = BlockLinear(frames, widths.audio, c.audio_features, bottleneck=c.audio_bottleneck)
        # Beside the code, unless it is the only way, audio and lexeme go straight to the LSTM and the head. The lexeme
        # does so as its coefficients, too, so that its meaning need not be learned.
        self.bypassed = c.hears_through == "both"
        self.hear = nn.Sequential(nn.Linear(frames * c.audio_features, c.lexeme_width), nn.GELU(),
                                  nn.Dropout(c.dropout)) if self.bypassed else nn.Identity()
        self.unheard = nn.Parameter(torch.zeros(frames, c.audio_features))
        self.name = nn.Embedding(widths.lexemes + 1, c.lexeme_width)
        nn.init.normal_(self.name.weight, std=0.1)
        rows = c.motion_features + c.audio_features + c.lexeme_width + c.position_width + self.control_width
        self.mlp = nn.Sequential(nn.Linear(rows, c.hidden), nn.LeakyReLU(SLOPE))
        self.codes = GumbelCodes(c.hidden, c.groups, c.classes, GROUP_WIDTH)
        beside, centre = (c.lexeme_width, basis.width) if self.bypassed else (0, 0)
        known = 2 * beside + c.groups * GROUP_WIDTH + 3 * widths.motion + basis.width
        known += CIRCUMSTANCES + widths.speakers + self.control_width
        self.unit_width, self.style_width = widths.units if c.units else 0, c.style_width
        known += self.unit_width + self.style_width
        head_width = c.context + centre
        self.gather = nn.Sequential(nn.Linear(known, c.context), nn.GELU(), nn.Dropout(c.dropout))
        self.lstm = nn.LSTM(c.context, c.context, c.lstm_layers, batch_first=True)
        self.to_context = nn.Sequential(nn.Linear(2 * c.context + beside, c.context), nn.GELU(),
                                        nn.Dropout(c.dropout))
        self.head = FlowHead(basis.width, head_width, c.flow_width, LAYERS)

    @property
    def weights(self) -> dict[str, float]:
        return {"flow": 1.0}

    # --------------------------------------------------------------------------------------------- coefficients

    def squeeze(self, coefficients: Tensor) -> Tensor:
        """y [..., n] to u = asinh(b y / sd) / sd_u."""
        # The division by the deviation of u in the training data makes u a variable of variance 1, as `FlowHead`
        # assumes.
        return torch.asinh(self.config.bend * coefficients / self.basis.scale) / self.deviation

    def stretch(self, squeezed: Tensor) -> Tensor:
        """The inverse of `squeeze`, clipped to the range of the training data."""
        # Limited before and after: sinh would overflow, and an outlier in u is exponentially far in y.
        y = torch.sinh((squeezed * self.deviation).clamp(-MOST, MOST)) / self.config.bend * self.basis.scale
        return torch.maximum(torch.minimum(y, self.basis.limits[1]), self.basis.limits[0])

    @torch.no_grad()
    def adopt(self, basis: MovementBasis, coefficients: Tensor, lexemes: Tensor) -> None:
        """Copy a fitted basis; coefficients: [N, n] of the training blocks, lexemes: [S, n] of the lexicon."""
        self.basis.load_state_dict(basis.state_dict())
        bent = torch.asinh(self.config.bend * coefficients / self.basis.scale)
        self.deviation.copy_(bent.std(0, correction=0).clamp_min(1e-3))
        self.centres[:-1] = self.squeeze(lexemes)

    # -------------------------------------------------------------------------------------------------- context

    def contexts(self, given: FlowInputs, added: Tensor, state: State | None = None, temperature: float = 1.0
                 ) -> tuple[Tensor, State]:
        """h [B, N, C + n] of N blocks (C, if audio and lexeme have no way past the code) and the LSTM's state after
        them; added: [B, N, n] u of the previous blocks."""
        batch, blocks = given.lexeme.shape
        audio = self.encode_audio(given.audio)
        if given.without_audio is not None:
            audio = torch.where(given.without_audio[:, None, None, None], self.unheard, audio)
        name = self.name(given.lexeme)
        moved = self.encode_motion(given.before.flatten(0, 1).transpose(1, 2)).transpose(1, 2).unflatten(
            0, given.before.shape[:2])
        if given.without_history is not None:
            remembers = (~given.without_history)[:, None, None].to(added.dtype)
            moved, added = moved * remembers[..., None], added * remembers
        rows = [moved, audio, repeat_frames(name, self.frames), self.position.expand(1, blocks, -1, -1)]
        pose, velocity, acceleration = given.past.state()
        beside = [self.hear(audio.flatten(-2)), name] if self.bypassed else []
        # A velocity (per frame) is a small part of a pose in size: the factors bring the three nearer to each other.
        known = [*beside, pose, 4.0 * velocity, 6.0 * acceleration, added,
                 given.circumstances, given.speaker[:, None].expand(-1, blocks, -1)]
        if self.control_width:
            free = audio.new_zeros(1, blocks, self.frames, self.control_width)
            rows.append(free if given.control is None else given.control)
            # The LSTM steps by block, so it takes the mean over the frames of what the code has frame by frame.
            known.append(rows[-1].mean(-2))
        for width, given_rows in ((self.unit_width, given.unit), (self.style_width, given.style)):
            known.append(added.new_zeros(1, blocks, width) if given_rows is None else given_rows)
        hidden = self.mlp(_side_by_side(rows, batch))
        code = self.codes(hidden, temperature)[0] if self.training else self.codes.best(hidden)
        gathered = self.gather(_side_by_side([*known, code.mean(-2)], batch))
        out, state = self.lstm(gathered, state)
        context = self.to_context(_side_by_side([out, gathered, *beside[1:]], batch))
        return (torch.cat([context, self.centres[given.lexeme]], -1) if self.bypassed else context), state

    # ------------------------------------------------------------------------------------------------- training

    def losses(self, batch: dict[str, Tensor], progress: float, nearest: NearestLexeme,
               left_out: tuple[float, float, float, float] | None = None) -> dict[str, Tensor]:
        """The flow matching loss |v - (u - e)|^2 on windows of N blocks after a seed block.

        batch: motion [B, N + 1, K, D_m], audio [B, N + 1, 3K, d], ratio [B, N + 1], circumstances [B, N + 1, 8],
        speaker [B, P], mask [B, D_m], valid [B, N + 1], control [B, N + 1, K, 2 F], unit [B, N + 1, U] and code [B, N +
        1, d_z] if used. nearest: the lexicon's arg min over coefficients; a shifted past changes the coefficients of a
        block, and so its lexeme. left_out: probabilities of dropping audio, lexeme and previous motion of a window,
        and the previous coefficients of a block; those of the settings by default.
        """
        c, motion = self.config, batch["motion"]
        no_audio, no_lexeme, no_history, no_added = left_out or (AUDIO_DROPOUT, LEXEME_DROPOUT, c.history_dropout,
                                                                 ADDED_DROPOUT)
        before, true = self._shifted(motion[:, :-1]), motion[:, 1:]
        ratio = batch["ratio"][:, 1:]
        past = Pasts(before[..., -PAST:, :], ratio)
        fading = _fade(self.frames, motion)[:, None]
        # The target leads from the shifted past back to the recorded motion within the block: what the generator has to
        # do after an error of its own.
        back = true + (before[..., -1:, :] - motion[:, :-1, -1:]) * fading
        y = self.basis.coefficients(back, past)
        u = self.squeeze(y)
        # The coefficients of the seed block are not known: they depend on a past before the window.
        added = torch.cat([torch.zeros_like(u[:, :1]), u[:, :-1]], 1)
        share = torch.rand(*u.shape[:2], 1, device=u.device)
        added = torch.where(share < no_added, torch.zeros_like(added), added)
        # Labels anew from the shifted blocks, so that a lexeme always names the movement that is to be made.
        lexeme = nearest(y.flatten(0, 1)).unflatten(0, y.shape[:2])
        # One number for each window and input: guidance runs whole performances without an input, not single blocks.
        some = torch.rand(5, len(motion), device=u.device)
        lexeme = torch.where((some[0] < no_lexeme)[:, None], torch.full_like(lexeme, self.lexemes), lexeme)
        control = batch["control"][:, 1:] if self.control_width and "control" in batch else None
        audio, place = batch["audio"][:, 1:], batch["circumstances"][:, 1:]
        if self.training and c.after_dropout:
            hidden = torch.rand(len(motion), device=u.device) < c.after_dropout
            audio = without_after(audio, hidden)
            place = torch.where(hidden[:, None, None], alone(place), place)
        given = FlowInputs(audio, lexeme, before, ratio, place, batch["speaker"], control, some[1] < no_audio,
                           some[2] < no_history, *(
                               None if key not in batch else batch[key][:, 1:] * (some[k] >= share)[:, None, None]
                               for k, key, share in ((3, "unit", UNIT_DROPOUT * self.training),
                                                     (4, "code", c.style_dropout * self.training))))
        context, _ = self.contexts(given, added, temperature=self.temperature(progress))
        conditions = self.head.conditions(context)
        # No loss on parts of the body that the source lacks, nor on padding.
        weight = self.basis.known(batch["mask"])[:, None] * self.component_weights() * batch["valid"][:, 1:, None]
        total = u.new_zeros(())
        # The context costs most of a step and does not depend on time or noise, so several samples share it.
        for _ in range(DRAWS):
            time, noise = torch.rand(*u.shape[:2], 1, device=u.device), torch.randn_like(u)
            v = self.head((1 - time) * noise + time * u, FlowTime.of(time), conditions)
            total = total + masked_mean((v - (u - noise)).pow(2), weight)
        return {"flow": total / DRAWS}

    def component_weights(self) -> Tensor:
        """[n] loss weight of each coefficient: its share of its part's deviation, so that large movements count; mean
        1."""
        weight = self.basis.scale * self.basis.weight
        return weight / weight.mean()

    def temperature(self, progress: float) -> float:
        return self.config.temperature(progress)

    def _shifted(self, before: Tensor) -> Tensor:
        """Blocks [B, N, K, D_m] with noise on their pose, the same on every frame, and on their last velocity."""
        c, shape = self.config, (*before.shape[:2], 1, 1)
        if not self.training:
            return before
        noise = torch.randn_like(before[..., :1, :]) * c.past_noise * torch.rand(shape, device=before.device)
        speed = (before[..., -1:, :] - before[..., -2:-1, :]).abs().mean(-1, keepdim=True)
        faster = torch.randn_like(noise) * c.velocity_noise * torch.rand(shape, device=before.device) * speed
        steps = torch.arange(1 - self.frames, 1, device=before.device, dtype=before.dtype)[:, None]
        return before + noise + faster * steps

    # -------------------------------------------------------------------------------------------------- drawing

def _side_by_side(parts: Sequence[Tensor], batch: int) -> Tensor:
    """Concatenate parts [B or 1, ..., D] to [B, ..., sum D]."""
    return torch.cat([part.expand(batch, *part.shape[1:]) for part in parts], -1)


def _fade(frames: int, like: Tensor) -> Tensor:
    """[K, 1] weights from nearly 1 to 0, by which a shift of the past fades over the block without a jump of velocity.
    """
    x = (torch.arange(frames, device=like.device, dtype=like.dtype) + 1) / frames
    return (1 - x) ** 3 * (1 + 3 * x + 6 * x * x)


@dataclass(frozen=True)
class FlowTime:
    """The inputs of `FlowHead` from times t. waves: [..., 2 F] sines and cosines; deviation: [..., 1] sqrt(s); share:
    [..., 1] (2 t - 1) / s."""

    waves: Tensor
    deviation: Tensor
    share: Tensor

    @classmethod
    def of(cls, time: Tensor) -> FlowTime:
        angles, variance = time * torch.as_tensor(rates()).to(time), time**2 + (1 - time) ** 2
        return cls(torch.cat([angles.sin(), angles.cos()], -1), variance.sqrt(), (2 * time - 1) / variance)


class FlowHead(nn.Module):
    """v(u_t, t, h): the velocity for unit Gaussian data plus an MLP of residual blocks, each scaled and shifted by the
    context:

        v = (2 t - 1) / s u_t + F(u_t / sqrt(s), t, h) / sqrt(s)        s = t^2 + (1 - t)^2

    s is the variance of u_t for data of variance 1, as u is, and F then has unit variance at every t (the scaling of
    Karras et al. 2022). With F = 0 every coefficient is sampled with its variance in the data, so that untrained inputs
    give lively motion instead of none.
    """

    def __init__(self, width: int, context: int, hidden: int, layers: int) -> None:
        """width: n; context: C; hidden: units of each of the layers."""
        super().__init__()
        self.enter = nn.Linear(width + 2 * FREQUENCIES, hidden)
        self.condition = nn.ModuleList([nn.Linear(context, 2 * hidden) for _ in range(layers)])
        self.inner = nn.ModuleList([nn.Linear(hidden, hidden) for _ in range(layers)])
        self.outer = nn.ModuleList([nn.Linear(hidden, hidden) for _ in range(layers)])
        self.leave = nn.Linear(hidden, width)
        # F = 0 at the start: v is that of unit Gaussian data, as in the class's equation.
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def conditions(self, context: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Scale and shift of every layer for the context [..., C]; they are constant during sampling."""
        both = (layer(context).chunk(2, -1) for layer in self.condition)
        return [(1 + gain, shift) for gain, shift in both]

    def forward(self, noisy: Tensor, time: FlowTime, conditions: list[tuple[Tensor, Tensor]]) -> Tensor:
        """v [..., n] of noisy u_t [..., n]; conditions: as of `conditions`."""
        # Scaled to variance 1 at every t, so that the layers need not learn the scale of the noise.
        x = self.enter(torch.cat([noisy / time.deviation, time.waves.expand(*noisy.shape[:-1], -1)], -1))
        for (scale, shift), inner, outer in zip(conditions, self.inner, self.outer, strict=True):
            x = x + outer(functional.gelu(inner(functional.layer_norm(x, x.shape[-1:]) * scale + shift)))
        # No final normalisation: the output must see the size of the noise, or large movements could not be sampled.
        v: Tensor = time.share * noisy + self.leave(x) / time.deviation
        return v
