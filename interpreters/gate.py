"""The activity gate: whether to gesture at all on a block (the third limitation of RG 8).

The paper gestures at every beat; people do not. From the inputs of the style interpreter the gate predicts the
probability that a performer gestures on a block. If the gate is closed, the block takes a silent lexeme.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import BlockLinear, Linear, masked_mean, run_lstm
from interpreters.base import BlockFeatures
from interpreters.settings import GateConfig

__all__ = ["ActivityGate"]

DROPOUT = 0.1
"""Of the input and the output of the LSTM."""
Hidden = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class GateState:
    """The LSTM's state and the speaker."""

    hidden: Hidden | None
    speaker: Tensor


class ActivityGate(nn.Module):
    """Three blocks of low-level audio and the speaker to the probability that the block holds a gesture. The K frames
    of a block run through the LSTM, whose state is carried across blocks; its last frame is classified. Its inputs
    include neither lexemes nor past decisions, so the result does not depend on previous gestures."""

    def __init__(self, config: GateConfig, frames: int, audio_width: int, speakers: int) -> None:
        """frames: K; audio_width: d of the low level; speakers: length of the one-hot."""
        super().__init__()
        self.config, self.frames, self.speakers = config, frames, speakers
        self.encode_audio = BlockLinear(frames, audio_width, config.audio_features, bottleneck=config.audio_bottleneck)
        width = config.audio_features + speakers
        self.dropout = nn.Dropout(DROPOUT)
        self.lstm = nn.LSTM(width, config.width, batch_first=True)
        self.classify = Linear(config.width, 1)

    @property
    def weights(self) -> dict[str, float]:
        return {"activity": 1.0}

    def logits(self, audio: Tensor, speaker: Tensor, hidden: Hidden | None = None) -> tuple[Tensor, Hidden]:
        """Log odds of a gesture [B, N] for audio windows [B, N, 3K, d] and speaker one-hot [B, speakers]."""
        blocks = audio.shape[1]
        rows = self.encode_audio(audio)
        # Performers differ greatly in how often they gesture.
        rows = torch.cat([rows, speaker[:, None, None].expand(-1, blocks, self.frames, -1)], dim=-1)
        # Frame by frame, so that loudness within a block counts; only the last frame's output is classified.
        out, hidden = run_lstm(self.lstm, self.dropout(rows).flatten(1, 2), hidden)
        last = out.unflatten(1, (blocks, self.frames))[:, :, -1]
        return self.classify(self.dropout(last))[..., 0], hidden

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Binary cross-entropy of gesture or not, in nats per block. batch: audio_low [B, N + 1, 3K, d], active [B, N +
        1] 1 if the block has a gesture, speaker [B, speakers], valid [B, N + 1]. The seed block counts too, because it
        is not an input."""
        logits, _ = self.logits(batch["audio_low"], batch["speaker"])
        each = functional.binary_cross_entropy_with_logits(logits, batch["active"].to(logits), reduction="none")
        return {"activity": masked_mean(each, batch["valid"])}

    def start(self, speaker: int) -> GateState:
        number = torch.tensor([speaker], device=self.classify.weight.device)
        return GateState(None, functional.one_hot(number, self.speakers).float())

    @torch.inference_mode()
    def step(self, state: GateState, features: BlockFeatures) -> tuple[float, GateState]:
        logits, hidden = self.logits(features.low[None, None], state.speaker, state.hidden)
        # In doubles, so that a probability near 1 still differs from 1.
        return float(torch.sigmoid(logits[0, 0].double())), GateState(hidden, state.speaker)

    @staticmethod
    def opened(probability: float, activity: float) -> bool:
        return opened(probability, activity)


def opened(probability: float, activity: float) -> bool:
    """Whether a block may have a gesture: probability >= 1 - activity, and never at activity 0. activity: 0 for no
    gestures, 0.5 for gestures that are more likely than not, 1 for a gesture on every block. Raising either number
    never closes the gate. ValueError for a number outside 0 to 1."""
    if not (0 <= probability <= 1 and 0 <= activity <= 1):
        raise ValueError(f"probability {probability} and activity {activity} must lie in 0 to 1")
    # At activity 0 a certain gesture (probability 1) would pass the comparison.
    return activity > 0 and probability >= 1 - activity


@dataclass(frozen=True)
class Latch:
    """Whether the gate is open, and for how many blocks it has been so (infinite before the first block)."""

    open: bool = False
    since: float = math.inf


def follow(latch: Latch, probability: float, activity: float, hold: int = 1) -> Latch:
    """The latch after one more block, with hysteresis. It changes to `opened` once it has been in its state for `hold`
    blocks (hold 1 is `opened` itself); at activity 0 and 1 it changes at once. ValueError for hold below 1."""
    if hold < 1:
        raise ValueError(f"hold must be 1 or more, not {hold}")
    wanted = opened(probability, activity)
    # The extremes of the setting mean always and never, without a delay.
    if wanted != latch.open and (latch.since >= hold or activity in (0, 1)):
        return Latch(wanted, 1)
    return Latch(latch.open, latch.since + 1)
