"""The activity gate: whether to gesture at all on a block (the third limitation of RG 8).

The paper gestures at every beat; people do not. From the inputs of the style interpreter the gate predicts the
probability that a performer gestures on a block. If the gate is closed, the block takes a silent lexeme.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import BlockLinear, masked_mean
from interpreters.settings import GateConfig

__all__ = ["ActivityGate"]

DROPOUT = 0.1
"""Of the input and the output of the LSTM."""
Hidden = tuple[Tensor, Tensor]


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
        self.classify = nn.Linear(config.width, 1)

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
        out, hidden = self.lstm(self.dropout(rows).flatten(1, 2), hidden)
        last = out.unflatten(1, (blocks, self.frames))[:, :, -1]
        return self.classify(self.dropout(last))[..., 0], hidden

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Binary cross-entropy of gesture or not, in nats per block. batch: audio_low [B, N + 1, 3K, d], active [B, N +
        1] 1 if the block has a gesture, speaker [B, speakers], valid [B, N + 1]. The seed block counts too, because it
        is not an input."""
        logits, _ = self.logits(batch["audio_low"], batch["speaker"])
        each = functional.binary_cross_entropy_with_logits(logits, batch["active"].to(logits), reduction="none")
        return {"activity": masked_mean(each, batch["valid"])}
