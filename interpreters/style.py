"""The style interpreter P_z: from low-level audio, and text where wanted, to a block's style code (RG 6.2, Eq. 19)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from data_module.layers import BlockLinear, repeat_frames
from interpreters.base import BlockFeatures
from interpreters.settings import StyleConfig

Hidden = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class StyleState:
    """The decoder's state, the last code [1, d_z] and the speaker."""

    hidden: Hidden | None
    code: Tensor
    speaker: Tensor


class StyleInterpreter(nn.Module):
    """P_z: previous code, lexeme, three blocks of low-level audio and text to the code of the block, [d_z]."""

    lexemes: Tensor

    def __init__(self, config: StyleConfig, frames: int, audio_width: int, lexemes: Tensor, code_width: int,
                 speakers: int, text_width: int = 0) -> None:
        super().__init__()
        self.config, self.frames, self.code_width, self.speakers = config, frames, code_width, speakers
        self.register_buffer("lexemes", lexemes.clone())
        self.encode_audio = BlockLinear(frames, audio_width, config.audio_features, bottleneck=config.audio_bottleneck)
        self.encode_text = BlockLinear(frames, text_width, config.text_features, config.text_blocks,
                                       config.text_bottleneck) if config.text_features else None
        width = config.audio_features + lexemes.shape[1] + code_width + (speakers if config.use_speaker else 0)
        width += config.text_features
        self.dropout = nn.Dropout(config.dropout)
        self.lstm = nn.LSTM(width, config.width, config.layers, batch_first=True)
        self.to_code = nn.Linear(config.width, code_width)

    @property
    def weights(self) -> dict[str, float]:
        """Loss weights, keyed like `losses`."""
        return {"code": 1.0}

    def codes(self, previous: Tensor, lexeme: Tensor, audio: Tensor, speaker: Tensor, hidden: Hidden | None = None,
              text: Tensor | None = None) -> tuple[Tensor, Hidden]:
        """Codes [B, N, d_z] for previous codes [B, N, d_z], lexemes [B, N], audio windows [B, N, 3K, d] and, where it
        is read, text [B, N, 3K, d_t + 1]."""
        blocks = lexeme.shape[1]
        parts = [self.encode_audio(audio), repeat_frames(self.lexemes[lexeme], self.frames),
                 repeat_frames(previous, self.frames)]
        if self.encode_text is not None:
            if text is None:
                raise ValueError("this interpreter reads text; take the audio-only one")
            parts.append(self.encode_text(text))
        if self.config.use_speaker:
            parts.append(speaker[:, None, None].expand(-1, blocks, self.frames, -1))
        rows = self.dropout(torch.cat(parts, dim=-1)).flatten(1, 2)
        out, hidden = self.lstm(rows, hidden)
        return self.to_code(out.unflatten(1, (blocks, self.frames))[:, :, -1]), hidden

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Mean squared error of the codes.

        batch: code [B, N + 1, d_z] (learned), lexeme [B, N + 1], audio_low [B, N + 1, 3K, d], speaker,
        valid [B, N + 1], text [B, N + 1, 3K, d_t + 1] where it is read.
        """
        code = batch["code"]
        previous = code[:, :-1]
        if self.training:
            # At inference it hears its own codes, which are calmer than the learned ones: noise keeps it from
            # leaning on them.
            previous = previous + 0.5 * progress * torch.randn_like(previous)
        text = batch["text"][:, 1:] if self.encode_text is not None else None
        made, _ = self.codes(previous, batch["lexeme"][:, 1:], batch["audio_low"][:, 1:], batch["speaker"], None, text)
        valid = batch["valid"][:, 1:, None].expand_as(made)
        return {"code": ((made - code[:, 1:]).pow(2) * valid).sum() / valid.sum().clamp_min(1)}

    def start(self, speaker: int) -> StyleState:
        """The state before the first block: the zero code of stillness."""
        device = self.lexemes.device
        one_hot = nn.functional.one_hot(torch.tensor([speaker], device=device), self.speakers).float()
        return StyleState(None, torch.zeros(1, self.code_width, device=device), one_hot)

    @torch.inference_mode()
    def step(self, state: StyleState, features: BlockFeatures, lexeme: int) -> tuple[Tensor, StyleState]:
        """The code [1, d_z] of this block, given its lexeme."""
        played = torch.tensor([[lexeme]], device=self.lexemes.device)
        code, hidden = self.codes(state.code[:, None], played, features.low[None, None],
                                  state.speaker, state.hidden,
                                  None if features.text is None else features.text[None, None])
        return code[:, 0], StyleState(hidden, code[:, 0], state.speaker)
