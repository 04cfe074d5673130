"""The lexeme interpreter P_s of Rhythmic Gesticulator (RG 6.1, Eq. 16 to 18), audio and speaker as inputs."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import BlockLinear, repeat_frames
from interpreters.base import BlockFeatures, Scores

Hidden = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class LstmConfig:
    """Sizes of the lexeme interpreter."""

    audio_features: int = 128
    """d_A~, width of E_A^lex."""
    width: int = 512
    layers: int = 1
    use_speaker: bool = True
    """The one-hot I of Eq. 16."""
    dropout: float = 0.1
    label_smoothing: float = 0.0
    own_past_until: float = 0.5
    own_past_most: float = 0.5
    """The share of previous lexemes that are its own predictions rises from 0 to `own_past_most` by this share of the
    run (scheduled sampling in two passes)."""


@dataclass(frozen=True)
class LstmState:
    """The decoder's state and the speaker."""

    hidden: Hidden | None
    speaker: Tensor


class LstmInterpreter(nn.Module):
    """P_s: previous lexeme, three blocks of high-level audio and the speaker to scores over the lexicon.

    The K frames of a block run through the LSTM, whose state is carried across blocks; the last frame is classified.
    """

    lexemes: Tensor

    def __init__(self, config: LstmConfig, frames: int, audio_width: int, lexemes: Tensor, speakers: int) -> None:
        """lexemes: [S, D_s] the codebook; speakers: how many performers the one-hot ID tells apart."""
        super().__init__()
        self.config, self.frames, self.speakers = config, frames, speakers
        self.register_buffer("lexemes", lexemes.clone())
        self.encode_audio = BlockLinear(frames, audio_width, config.audio_features)
        width = config.audio_features + lexemes.shape[1] + (speakers if config.use_speaker else 0)
        self.dropout = nn.Dropout(config.dropout)
        self.lstm = nn.LSTM(width, config.width, config.layers, batch_first=True)
        self.classify = nn.Linear(config.width, len(lexemes))

    @property
    def weights(self) -> dict[str, float]:
        """Loss weights, keyed like `losses`."""
        return {"cross_entropy": 1.0}

    def scores(self, previous: Tensor, audio: Tensor, speaker: Tensor, hidden: Hidden | None = None
               ) -> tuple[Tensor, Hidden]:
        """Logits [B, N, S] for previous lexemes [B, N], audio windows [B, N, 3K, d] and speaker one-hot [B, speakers].

        previous[:, i] is the lexeme of the block before block i.
        """
        blocks = previous.shape[1]
        parts = [self.encode_audio(audio), repeat_frames(self.lexemes[previous], self.frames)]
        if self.config.use_speaker:
            parts.append(speaker[:, None, None].expand(-1, blocks, self.frames, -1))
        rows = self.dropout(torch.cat(parts, dim=-1)).flatten(1, 2)
        out, hidden = self.lstm(rows, hidden)
        last = out.unflatten(1, (blocks, self.frames))[:, :, -1]
        return self.classify(self.dropout(last)), hidden

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Cross-entropy of the next lexeme.

        batch: lexeme [B, N + 1] (with the silent hint), audio_high [B, N + 1, 3K, d], speaker [B, speakers],
        valid [B, N + 1]. The first block is the seed.
        """
        labels, audio = batch["lexeme"], batch["audio_high"][:, 1:]
        previous = labels[:, :-1]
        share = self.config.own_past_most * min(progress / max(self.config.own_past_until, 1e-9), 1.0)
        if self.training and share > 0:
            with torch.no_grad():
                drawn = torch.distributions.Categorical(
                    logits=self.scores(previous, audio, batch["speaker"])[0]).sample()
            shifted = torch.cat([labels[:, :1], drawn[:, :-1]], 1)
            previous = torch.where(torch.rand_like(previous, dtype=torch.float32) < share, shifted, previous)
        logits, _ = self.scores(previous, audio, batch["speaker"])
        each = functional.cross_entropy(logits.flatten(0, 1), labels[:, 1:].flatten(), reduction="none",
                                        label_smoothing=self.config.label_smoothing)
        valid = batch["valid"][:, 1:].flatten()
        return {"cross_entropy": (each * valid).sum() / valid.sum().clamp_min(1)}

    def start(self, speaker: int, first_lexeme: int) -> LstmState:
        """The state before the first block (the first lexeme comes back in `step` as the previous one)."""
        return LstmState(None, functional.one_hot(torch.tensor([speaker]), self.speakers).float())

    @torch.inference_mode()
    def step(self, state: LstmState, features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, LstmState]:
        """Log-probabilities [S] of this block's lexeme."""
        logits, hidden = self.scores(torch.tensor([[previous_lexeme]]), features.high[None, None], state.speaker,
                                     state.hidden)
        return functional.log_softmax(logits[0, 0].double(), -1).numpy(), LstmState(hidden, state.speaker)
