"""The activity gate: whether to gesture at all on a block (the third limitation of RG 8).

The paper gestures at every beat; people do not. The gate hears what the style interpreter hears and gives the
probability that a performer would gesture on the block. A block it closes takes a silent lexeme instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import BlockLinear, run_lstm
from interpreters.base import BlockFeatures
from interpreters.settings import GateConfig

__all__ = ["ActivityGate"]

Hidden = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class GateState:
    """The LSTM's state and the speaker."""

    hidden: Hidden | None
    speaker: Tensor


class ActivityGate(nn.Module):
    """Three blocks of low-level audio and the speaker to the probability that the block holds a gesture.

    The K frames of a block run through the LSTM, whose state is carried across blocks; its last frame is classified.
    It hears neither lexemes nor its own past decisions, so it gives the same whatever was gestured before.
    """

    def __init__(self, config: GateConfig, frames: int, audio_width: int, speakers: int) -> None:
        """frames: K; audio_width: d of the low level; speakers: how many performers the one-hot ID tells apart."""
        super().__init__()
        self.config, self.frames, self.speakers = config, frames, speakers
        self.encode_audio = BlockLinear(frames, audio_width, config.audio_features, bottleneck=config.audio_bottleneck)
        width = config.audio_features + (speakers if config.use_speaker else 0)
        self.dropout = nn.Dropout(config.dropout)
        self.lstm = nn.LSTM(width, config.width, config.layers, batch_first=True)
        self.classify = nn.Linear(config.width, 1)

    @property
    def weights(self) -> dict[str, float]:
        """Loss weights, keyed like `losses`."""
        return {"activity": 1.0}

    def logits(self, audio: Tensor, speaker: Tensor, hidden: Hidden | None = None) -> tuple[Tensor, Hidden]:
        """Log odds of a gesture [B, N] for audio windows [B, N, 3K, d] and speaker one-hot [B, speakers]."""
        blocks = audio.shape[1]
        rows = self.encode_audio(audio)
        if self.config.use_speaker:
            rows = torch.cat([rows, speaker[:, None, None].expand(-1, blocks, self.frames, -1)], dim=-1)
        out, hidden = run_lstm(self.lstm, self.dropout(rows).flatten(1, 2), hidden)
        last = out.unflatten(1, (blocks, self.frames))[:, :, -1]
        return self.classify(self.dropout(last))[..., 0], hidden

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Binary cross-entropy of gesture or not, in nats a block.

        batch: audio_low [B, N + 1, 3K, d], active [B, N + 1] 1 where the block holds a gesture, speaker [B, speakers],
        valid [B, N + 1]. The seed block counts too: the gate is told nothing of it.
        """
        from data_module.parallel import batch_ratio  # only training asks for it

        logits, _ = self.logits(batch["audio_low"], batch["speaker"])
        each = functional.binary_cross_entropy_with_logits(logits, batch["active"].to(logits), reduction="none")
        valid = batch["valid"].to(logits)
        return {"activity": batch_ratio((each * valid).sum(), valid.sum())}

    def start(self, speaker: int) -> GateState:
        """The state before the first block, for a speaker (index)."""
        number = torch.tensor([speaker], device=self.classify.weight.device)
        return GateState(None, functional.one_hot(number, self.speakers).float())

    @torch.inference_mode()
    def step(self, state: GateState, features: BlockFeatures) -> tuple[float, GateState]:
        """The probability of a gesture on this block, and the state after it."""
        logits, hidden = self.logits(features.low[None, None], state.speaker, state.hidden)
        return float(torch.sigmoid(logits[0, 0].double())), GateState(hidden, state.speaker)

    @staticmethod
    def opened(probability: float, activity: float) -> bool:
        """See `opened`."""
        return opened(probability, activity)


def opened(probability: float, activity: float) -> bool:
    """Whether a block may gesture: probability >= 1 - activity, and never at activity 0.

    activity: 0 keeps still, 0.5 gestures where a gesture is as likely as not, 1 gestures on every block. Raising either
    number never closes the gate. ValueError for a number outside 0 to 1.
    """
    if not (0 <= probability <= 1 and 0 <= activity <= 1):
        raise ValueError(f"probability {probability} and activity {activity} must lie in 0 to 1")
    return activity > 0 and probability >= 1 - activity


@dataclass(frozen=True)
class Latch:
    """Where the gate stands: open or closed, and for how many blocks it has stood so (before the first block: none
    that bind it)."""

    open: bool = False
    since: float = math.inf


def follow(latch: Latch, probability: float, activity: float, hold: int = 1) -> Latch:
    """The latch after one more block, so that a gate does not flicker.

    It turns when `opened` says so and it has stood for `hold` blocks; hold 1 is `opened` itself. Activity 0 and 1 are
    orders and turn it at once. ValueError for hold below 1.
    """
    if hold < 1:
        raise ValueError(f"hold must be 1 or more, not {hold}")
    wanted = opened(probability, activity)
    if wanted != latch.open and (latch.since >= hold or activity in (0, 1)):
        return Latch(wanted, 1)
    return Latch(latch.open, latch.since + 1)
