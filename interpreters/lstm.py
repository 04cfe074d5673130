"""The two LSTMs of Rhythmic Gesticulator, with text or from audio alone (RG 6.3): the lexeme interpreter P_s (RG 6.1,
Eq. 16 to 18), and the style interpreter P_z, from low-level audio to a block's style code (RG 6.2, Eq. 19)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import BlockLinear, masked_mean, repeat_frames, without_after
from interpreters.base import InterpreterSizes, pose_of
from interpreters.settings import LstmConfig, StyleConfig

if TYPE_CHECKING:
    pass

__all__ = ["LstmInterpreter", "StyleInterpreter"]

Hidden = tuple[Tensor, Tensor]
_NO_TEXT = "this interpreter needs text; use the audio-only one"
_NO_POSE = "this interpreter needs the pose; give it the previous block"

OWN_PAST_UNTIL = 0.5
"""Share of the run after which scheduled sampling is complete."""
CODE_NOISE = 0.5
"""Standard deviation of the noise on the previous style code at the end of the run; it rises linearly."""
TEXT_HEAD_DROPOUT = 0.5
"""Dropout in the text head, which would memorise the few words of a few hours."""


@dataclass(frozen=True)
class InterpreterWidths:
    """The sizes of a lexeme interpreter that depend on the data. frames: K; audio: d of the high level; speakers:
    length of the one-hot; text: d_t + 1, control: 2 F and motion: D_m, used only if the settings enable them."""

    frames: int
    audio: int
    speakers: int
    text: int = 0
    control: int = 0
    motion: int = 0


class LstmInterpreter(nn.Module):
    """P_s: previous lexeme, three blocks of high-level audio, text and the speaker to scores over the lexicon. The K
    frames of a block run through the LSTM, whose state is carried across blocks (or starts from zero `memory` blocks
    before the scored one); the last frame is classified. With `pose_features` the pose is an input too."""

    lexemes: Tensor

    def __init__(self, config: LstmConfig, lexemes: Tensor, widths: InterpreterWidths) -> None:
        """lexemes: [S, D_s] the codebook."""
        super().__init__()
        frames, speakers, text_width = widths.frames, widths.speakers, widths.text
        self.config, self.frames, self.speakers = config, frames, speakers
        self.register_buffer("lexemes", lexemes.clone())
        self.encode_audio = BlockLinear(frames, widths.audio, config.audio_features,
                                        bottleneck=config.audio_bottleneck)
        self.encode_text = BlockLinear(frames, text_width, config.text_features, 1,
                                       config.text_bottleneck) if config.text_features else None
        self.encode_pose = nn.Linear(3 * widths.motion, config.pose_features) if config.pose_features else None
        self.text_head = None
        if config.text_head:
            from interpreters.text_head import TextHead

            self.text_head = TextHead(text_width, config.text_head, config.text_bottleneck or text_width,
                                      config.lexeme_features or lexemes.shape[1], speakers, len(lexemes),
                                      TEXT_HEAD_DROPOUT)
        self.frozen = False
        """All weights except the text head are frozen."""
        self.control_width = widths.control if config.use_control else 0
        self.by_block = config.reads_by == "block"
        self.learned = nn.Embedding(len(lexemes), config.lexeme_features) if config.lexeme_features else None
        rows = frames if self.by_block else 1
        self.words_at = rows * config.audio_features + (config.lexeme_features or lexemes.shape[1])
        """Index of the first text feature in the input of the LSTM."""
        self.words_width = rows * config.text_features
        width = self.words_at + self.words_width + rows * self.control_width + config.pose_features
        width += speakers if config.use_speaker else 0
        self.dropout = nn.Dropout(config.dropout)
        self.enter = nn.Linear(width, config.width) if self.by_block else None
        self.lstm = nn.LSTM(config.width if self.by_block else width, config.width, batch_first=True)
        # By block, the block's row of inputs reaches the classifier past the recurrence, too.
        self.classify = nn.Linear((2 if self.by_block else 1) * config.width, len(lexemes))

    @classmethod
    def build(cls, settings: LstmConfig, sizes: InterpreterSizes) -> LstmInterpreter:
        widths = InterpreterWidths(sizes.frames, sizes.high, sizes.speakers, sizes.text, sizes.control, sizes.motion)
        return cls(settings, torch.as_tensor(sizes.lexemes), widths)

    @torch.no_grad()
    def init_from_audio_only(self, audio_only: LstmInterpreter) -> None:
        """Copy the weights of an audio-only interpreter of the same sizes; the scores do not depend on text at first.
        With a text head all other weights are then frozen. Without one, the columns of the first layer for the text
        start at zero."""
        if self.text_head is not None:
            self.load_state_dict(audio_only.state_dict(), strict=False)
            for name, parameter in self.named_parameters():
                parameter.requires_grad_(name.startswith("text_head."))
            # Frozen weights need no regularisation.
            self.frozen, self.dropout.p = True, 0.0
            return
        # Only the first layer has columns for the text; they lie in the middle of its input (`rows`).
        weights, reads = self.state_dict(), "enter.weight" if self.by_block else "lstm.weight_ih_l0"
        for name, value in audio_only.state_dict().items():
            if name != reads:
                weights[name].copy_(value)
        before, first = self.words_at, audio_only.state_dict()[reads]
        weights[reads].copy_(torch.cat(
            [first[:, :before], first.new_zeros(len(first), self.words_width), first[:, before:]], dim=1))

    def _vectors(self, lexemes: Tensor) -> Tensor:
        return self.lexemes[lexemes] if self.learned is None else self.learned(lexemes)

    @property
    def weights(self) -> dict[str, float]:
        return {"nll": 1.0}

    def scores(self, previous: Tensor, audio: Tensor, speaker: Tensor, hidden: Hidden | None = None,
               text: Tensor | None = None, control: Tensor | None = None, pose: Tensor | None = None
               ) -> tuple[Tensor, Hidden | None]:
        """Logits [B, N, S] for previous lexemes [B, N], audio windows [B, N, 3K, d] and speaker one-hot [B, speakers].

        previous[:, i] is the lexeme of the block before block i. text: [B, N, 3K, d_t + 1]; control: [B, N, K, 2 F] or
        None; pose: [B, N, 3 D_m] `pose_of` the block before block i. Inputs that the settings do not enable are
        ignored. With limited memory block i is scored from blocks i - memory + 1 to i, `hidden` is ignored and the
        returned state is None.
        """
        rows = self.rows(previous, audio, speaker, text, control, pose)
        last, hidden = self._recent(rows) if self.config.memory else self._read(rows, hidden)
        return self._classified(last, previous, speaker, text), hidden

    def _classified(self, last: Tensor, previous: Tensor, speaker: Tensor, text: Tensor | None) -> Tensor:
        """Logits [B, N, S] from the features of each block [B, N, width]."""
        logits: Tensor = self.classify(self.dropout(last))
        if self.text_head is not None:
            assert text is not None
            logits = logits + self.text_head(text, self._vectors(previous), speaker)
        return logits

    def rows(self, previous: Tensor, audio: Tensor, speaker: Tensor, text: Tensor | None, control: Tensor | None,
             pose: Tensor | None) -> Tensor:
        """[B, N, n, W] the input rows of the LSTM from the arguments of `scores`: n = K per block, or 1 if it reads by
        block. ValueError without needed text or pose."""
        if self.config.reads and text is None:
            raise ValueError(_NO_TEXT)
        parts = [self.encode_audio(audio), self._vectors(previous)]  # rows of frames, or a vector for the block
        if self.encode_text is not None:
            parts.append(self.encode_text(text))
        if self.control_width:
            # Zeros are targets of value 0 whose flag says that they are not set.
            free = audio.new_zeros(*audio.shape[:2], self.frames, self.control_width)
            parts.append(free if control is None else control)
        if self.config.use_speaker:
            parts.append(speaker[:, None].expand(-1, previous.shape[1], -1))
        if self.encode_pose is not None:
            if pose is None:
                raise ValueError(_NO_POSE)
            parts.append(functional.gelu(self.encode_pose(pose)))
        if self.enter is not None:
            row = torch.cat([part.flatten(2) for part in parts], dim=-1)
            return self.dropout(functional.gelu(self.enter(self.dropout(row))))[:, :, None]
        return self.dropout(torch.cat([part if part.dim() == 4 else repeat_frames(part, self.frames)
                                       for part in parts], dim=-1))

    def _read(self, rows: Tensor, hidden: Hidden | None = None) -> tuple[Tensor, Hidden]:
        """Rows [B, N, n, W] to features [B, N, width] (twice that by block), and the state after them."""
        out, hidden = self.lstm(rows.flatten(1, 2), hidden)
        last = out.unflatten(1, rows.shape[1:3])[:, :, -1]
        return torch.cat([last, rows[:, :, -1]], dim=-1) if self.by_block else last, hidden

    def _recent(self, rows: Tensor) -> tuple[Tensor, None]:
        memory, blocks = self.config.memory, rows.shape[1]
        first, _ = self._read(rows[:, :memory])
        if blocks <= memory:
            return first, None
        # Every later block is the last of its window of `memory` blocks, each window read from a zero state. The first
        # window is that of `first`, which gives the blocks up to it as well.
        recent = rows.unfold(1, memory, 1)[:, 1:].permute(0, 1, 4, 2, 3)
        last, _ = self._read(recent.flatten(0, 1))
        return torch.cat([first, last[:, -1].unflatten(0, (len(rows), blocks - memory))], dim=1), None

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """NLL of the next lexeme, in nats per block. batch: lexeme [B, N + 1] (with the silent hint), audio_high [B, N
        + 1, 3K, d], speaker [B, speakers], valid [B, N + 1], and if used text [B, N + 1, 3K, d_t + 1], control [B, N +
        1, K, 2 F], motion [B, N + 1, K, D_m] and duration [B, N + 1] s. The first block is the seed."""
        labels, audio = batch["lexeme"], batch["audio_high"][:, 1:]
        text = batch["text"][:, 1:] if self.config.reads else None
        control = batch["control"][:, 1:] if self.control_width else None
        pose = self.poses(batch)
        previous = labels[:, :-1]
        if self.training and pose is not None and self.config.pose_noise and not self.frozen:
            pose = pose + self.config.pose_noise * torch.randn_like(pose)
        # Scheduled sampling in two passes: the lexemes sampled from the first pass, moved on by a block, replace a part
        # of the recorded past, because in inference the past consists of the model's choices.
        share = self.config.own_past_most * min(progress / max(OWN_PAST_UNTIL, 1e-9), 1.0)
        if self.training and share > 0 and not self.frozen:
            with torch.no_grad():
                sampled = torch.distributions.Categorical(
                    logits=self.scores(previous, audio, batch["speaker"], None, text, control, pose)[0]).sample()
            shifted = torch.cat([labels[:, :1], sampled[:, :-1]], 1)
            previous = torch.where(torch.rand_like(previous, dtype=torch.float32) < share, shifted, previous)
        if self.training and self.config.history_dropout and not self.frozen:
            # A random lexeme, unlike a zero vector, is an input that also occurs in inference.
            lost = torch.rand_like(previous, dtype=torch.float32) < self.config.history_dropout
            previous = torch.where(lost, torch.randint_like(previous, len(self.lexemes)), previous)
        if self.training and self.config.audio_dropout and not self.frozen:
            # Whole windows, because guidance (`InterpreterByEar`) runs one state without any audio.
            audio = audio * (torch.rand(len(audio), 1, 1, 1, device=audio.device) >= self.config.audio_dropout)
        if self.training and self.config.after_dropout and not self.frozen:
            audio = without_after(audio, torch.rand(len(audio), device=audio.device) < self.config.after_dropout)
        # Every window starts from a zero state: what lies before the seed block is not in the batch.
        logits, _ = self.scores(previous, audio, batch["speaker"], None, text, control, pose)
        each = functional.cross_entropy(logits.flatten(0, 1), labels[:, 1:].flatten(), reduction="none")
        valid = batch["valid"][:, 1:].flatten()
        return {"nll": masked_mean(each, valid)}

    def poses(self, batch: dict[str, Tensor]) -> Tensor | None:
        """[B, N, 3 D_m] the pose before every block of a batch (see `losses`) except the seed; None if not used."""
        if self.encode_pose is None:
            return None
        motion, durations = batch["motion"], batch["duration"].to(batch["motion"])[..., None]
        return torch.cat(pose_of(motion[:, :-1], (durations[:, :-1], durations[:, 1:])), dim=-1)

class StyleInterpreter(nn.Module):
    """P_z: previous code, lexeme, three blocks of low-level audio and text to the code of the block, [d_z]."""

    lexemes: Tensor

    def __init__(self, config: StyleConfig, frames: int, audio_width: int, lexemes: Tensor, code_width: int,
                 speakers: int, text_width: int = 0) -> None:
        super().__init__()
        self.config, self.frames, self.code_width, self.speakers = config, frames, code_width, speakers
        self.register_buffer("lexemes", lexemes.clone())
        self.encode_audio = BlockLinear(frames, audio_width, config.audio_features, bottleneck=config.audio_bottleneck)
        self.encode_text = BlockLinear(frames, text_width, config.text_features, 1,
                                       config.text_bottleneck) if config.text_features else None
        width = config.audio_features + lexemes.shape[1] + code_width + (speakers if config.use_speaker else 0)
        width += config.text_features
        self.dropout = nn.Dropout(config.dropout)
        self.lstm = nn.LSTM(width, config.width, batch_first=True)
        self.to_code = nn.Linear(config.width, code_width)

    @property
    def weights(self) -> dict[str, float]:
        return {"code": 1.0}

    def codes(self, previous: Tensor, lexeme: Tensor, audio: Tensor, speaker: Tensor, hidden: Hidden | None = None,
              text: Tensor | None = None) -> tuple[Tensor, Hidden]:
        """Codes [B, N, d_z] for previous codes [B, N, d_z], lexemes [B, N], audio windows [B, N, 3K, d] and, if used,
        text [B, N, 3K, d_t + 1]."""
        blocks = lexeme.shape[1]
        parts = [self.encode_audio(audio), repeat_frames(self.lexemes[lexeme], self.frames),
                 repeat_frames(previous, self.frames)]
        if self.encode_text is not None:
            if text is None:
                raise ValueError(_NO_TEXT)
            parts.append(self.encode_text(text))
        if self.config.use_speaker:
            parts.append(speaker[:, None, None].expand(-1, blocks, self.frames, -1))
        rows = self.dropout(torch.cat(parts, dim=-1)).flatten(1, 2)
        out, hidden = self.lstm(rows, hidden)
        return self.to_code(out.unflatten(1, (blocks, self.frames))[:, :, -1]), hidden

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Mean squared error of the codes. batch: code [B, N + 1, d_z] (learned), lexeme [B, N + 1], audio_low [B, N +
        1, 3K, d], speaker, valid [B, N + 1], text [B, N + 1, 3K, d_t + 1] if used."""
        # The codes are the generator's learned ones, so it must have been trained before.
        code = batch["code"]
        previous = code[:, :-1]
        if self.training:
            # In inference the previous codes are predictions, which vary less than the learned codes: noise reduces
            # the reliance on them.
            previous = previous + CODE_NOISE * progress * torch.randn_like(previous)
        text = batch["text"][:, 1:] if self.encode_text is not None else None
        predicted, _ = self.codes(previous, batch["lexeme"][:, 1:], batch["audio_low"][:, 1:], batch["speaker"], None,
                                  text)
        return {"code": masked_mean((predicted - code[:, 1:]).pow(2), batch["valid"][:, 1:, None])}
