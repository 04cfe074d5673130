"""The style of gesture units: how large and how fast a person gestures, heard in the voice (RG 6.3).

The generator with a flow head is trained with a style code for every gesture unit. The code is measured on the unit's
motion and standardised per speaker, so that 0 is the speaker's habit:

    z = (log of the hands' speed, log of their range, their height, their distance from the chest)

The interpreter predicts z from sound. Effort (the tilt of the spectrum and the contrast of loudness), pitch range and
speech rate change slowly, so a GRU hears block by block, and the code of a unit is the mean of the predictions since
the unit began. A prediction varies less than what it predicts, and a generator would hardly move with it: each
dimension is scaled to the variance of the measured codes.

    z_i = g * mean of f(audio_1..j+1, speaker) over the blocks j of the unit up to i
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from data_module.layers import BlockLinear
from interpreters.base import BlockFeatures
from interpreters.settings import StyleConfig

__all__ = ["CODE", "UnitStyleInterpreter"]

CODE = ("speed", "range", "height", "reach")
"""The dimensions of a style code."""
_MOST_GAIN, _MOST, _HEARD = 4.0, 2.5, 0.05
"""Largest factor on a prediction, largest value of a code, and the share of its variance below which a dimension counts
for less: one that can hardly be heard must not become noise."""


@dataclass(frozen=True)
class UnitStyleState:
    """hidden: of the GRU; speaker: [1, speakers] one-hot; total: [1, d_z] sum of the predictions of this unit's blocks
    so far, and their number."""

    hidden: Tensor | None
    speaker: Tensor
    total: Tensor
    count: int


class UnitStyleInterpreter(nn.Module):
    """Three blocks of low-level audio and the speaker to the style code of the gesture unit, [d_z]."""

    gain: Tensor

    def __init__(self, config: StyleConfig, frames: int, audio_width: int, speakers: int, code_width: int) -> None:
        """frames: K; audio_width: d of the low level; speakers: length of the one-hot; code_width: d_z."""
        super().__init__()
        self.config, self.speakers, self.code_width = config, speakers, code_width
        self.encode_audio = BlockLinear(frames, audio_width, config.audio_features, bottleneck=config.audio_bottleneck)
        self.dropout = nn.Dropout(config.dropout)
        self.gru = nn.GRU(frames * config.audio_features + (speakers if config.use_speaker else 0), config.width,
                          config.layers, batch_first=True)
        self.to_code = nn.Linear(config.width, code_width)
        self.register_buffer("gain", torch.ones(code_width))

    @property
    def weights(self) -> dict[str, float]:
        return {"code": 1.0}

    def predict(self, audio: Tensor, speaker: Tensor, hidden: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Predictions [B, N, d_z] before scaling, of audio windows [B, N, 3K, d] and speaker one-hot [B, speakers]; and
        the GRU's state."""
        rows = [self.encode_audio(audio).flatten(-2)]
        if self.config.use_speaker:
            rows.append(speaker[:, None].expand(-1, audio.shape[1], -1))
        out, hidden = self.gru(self.dropout(torch.cat(rows, dim=-1)), hidden)
        return self.to_code(self.dropout(out)), hidden

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Mean squared error over the blocks of units. batch: code [B, N + 1, d_z], acting [B, N + 1] whether a block
        belongs to a unit, audio_low [B, N + 1, 3K, d], speaker [B, speakers], valid [B, N + 1]."""
        from data_module.parallel import batch_ratio  # only training needs it

        predicted, _ = self.predict(batch["audio_low"], batch["speaker"])
        weight = (batch["valid"] * batch["acting"])[..., None].expand_as(predicted)
        return {"code": batch_ratio(((predicted - batch["code"]).pow(2) * weight).sum(), weight.sum())}

    @torch.no_grad()
    def calibrate(self, predicted: Tensor, measured: Tensor) -> None:
        """Set the gain from predictions and measured codes [n, d_z] of blocks that were not trained on: the ratio of
        their deviations, less for a dimension of which less than `_HEARD` is explained, and 0 if nothing is."""
        deviation = predicted.std(0).clamp_min(1e-6)
        r = ((predicted - predicted.mean(0)) * (measured - measured.mean(0))).mean(0) / (deviation * measured.std(0))
        heard = (r.clamp_min(0.0).square() / _HEARD).clamp(max=1.0)
        self.gain.copy_(heard * (measured.std(0) / deviation).clamp(max=_MOST_GAIN))

    def start(self, speaker: int) -> UnitStyleState:
        """Before the first block."""
        device = self.gain.device
        who = nn.functional.one_hot(torch.tensor([speaker], device=device), self.speakers).float()
        return UnitStyleState(None, who, torch.zeros(1, self.code_width, device=device), 0)

    @torch.inference_mode()
    def step(self, state: UnitStyleState, features: BlockFeatures, resting: bool = False
             ) -> tuple[Tensor, UnitStyleState]:
        """The code [1, d_z] of the next block's unit, and the state after it; resting: the block belongs to no unit, so
        the next unit starts anew and the code is 0."""
        predicted, hidden = self.predict(features.low[None, None], state.speaker, state.hidden)
        if resting:
            return torch.zeros_like(state.total), UnitStyleState(hidden, state.speaker, state.total * 0, 0)
        total, count = state.total + predicted[:, 0], state.count + 1
        code = (self.gain * total / count).clamp(-_MOST, _MOST)
        return code, UnitStyleState(hidden, state.speaker, total, count)
