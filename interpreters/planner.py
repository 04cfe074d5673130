"""The planner of gesture units: for each block a phase, the acting hand, the size of the stroke and its time to come.

A person who talks decides seldom: when a unit of gesture begins, which accents carry a stroke, with which hand, how
large, how long it is held. These few decisions are read from three blocks of audio and from the decisions before, so
that the lexeme interpreter can choose a movement within a phase. The planner is causal: it knows the block after, and
nothing later.

    p(decision_i | audio_1..i+1, decisions_1..i-1) = p(phase) p(hand | phase) p(size | phase, hand) p(apex | ...)

And the style of a unit: how large and how fast a person gestures, heard in the voice (RG 6.3). The generator with a
flow head is trained with a style code for every gesture unit. The code is measured on the unit's motion and
standardised per speaker, so that 0 is the speaker's habit:

    z = (log of the hands' speed, log of their range, their height, their distance from the chest)

The interpreter predicts z from sound. Effort (the tilt of the spectrum and the contrast of loudness), pitch range and
speech rate change slowly, so a GRU hears block by block, and the code of a unit is the mean of the predictions since
the unit began. A prediction varies less than what it predicts, and a generator would hardly move with it: each
dimension is scaled to the variance of the measured codes.

    z_i = g * mean of f(audio_1..j+1, speaker) over the blocks j of the unit up to i
"""

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import BlockLinear, masked_mean
from interpreters.planner_run import CLASSES, HANDS, PHASES
from interpreters.settings import PlannerConfig, StyleConfig

__all__ = ["UnitPlanner", "UnitStyleInterpreter", "one_hot"]



def one_hot(decisions: Tensor) -> Tensor:
    """[..., U] decisions [..., 4] by index, each one-hot, side by side."""
    return torch.cat([functional.one_hot(decisions[..., k], count) for k, count in enumerate(CLASSES)], -1).float()


DROPOUT = 0.2
"""Of the input and the output of the planner's GRU."""
PAST_DROPOUT = 0.2
"""Share of the blocks in training whose past decision is left out, so that the sound counts."""


class UnitPlanner(nn.Module):
    """Three blocks of low-level audio, the speaker and the decision before to the next decision.

    fit: [S, phases x hands] log p(phase, hand | lexeme) - log p(phase, hand), counted on the training blocks: how
    much more likely a lexeme is in a phase than by its frequency (`bias`).
    """

    fit: Tensor

    def __init__(self, config: PlannerConfig, frames: int, audio_width: int, speakers: int, lexemes: int) -> None:
        """frames: K; audio_width: d of the low level; speakers: length of the one-hot; lexemes: S."""
        super().__init__()
        self.config, self.speakers = config, speakers
        self.encode_audio = BlockLinear(frames, audio_width, config.audio_features, bottleneck=config.audio_bottleneck)
        # One more row of each: before the first block, and a past that is left out in training.
        self.past = nn.ModuleList(nn.Embedding(count + 1, config.embedding) for count in CLASSES)
        self.given = nn.ModuleList(nn.Embedding(count, config.embedding) for count in CLASSES[:-1])
        self.dropout = nn.Dropout(DROPOUT)
        self.gru = nn.GRU(frames * config.audio_features + len(CLASSES) * config.embedding + speakers, config.width,
                          batch_first=True)
        self.heads = nn.ModuleList(nn.Linear(config.width + level * config.embedding, count)
                                   for level, count in enumerate(CLASSES))
        self.register_buffer("fit", torch.zeros(lexemes, len(PHASES) * len(HANDS)))

    @property
    def weights(self) -> dict[str, float]:
        return dict.fromkeys(("phase", "hand", "size", "apex"), 1.0)

    def encode_speech(self, audio: Tensor, speaker: Tensor, before: Tensor, hidden: Tensor | None = None
                      ) -> tuple[Tensor, Tensor]:
        """[B, N, width] the state in which each block is decided, from audio windows [B, N, 3K, d], speaker one-hot
        [B, speakers] and the decisions before [B, N, 4]; and the GRU's state."""
        speech = self.encode_audio(audio).flatten(-2)
        past = [table(before[..., k]) for k, table in enumerate(self.past)]
        who = speaker[:, None].expand(-1, audio.shape[1], -1)
        out, hidden = self.gru(self.dropout(torch.cat([speech, *past, who], dim=-1)), hidden)
        return self.dropout(out), hidden

    def logits(self, state: Tensor, level: int, decided: Tensor) -> Tensor:
        """[..., classes] of the decision `level` (phase, hand, size, apex), given the ones before it [..., level]."""
        given = [self.given[k](decided[..., k]) for k in range(level)]
        return self.heads[level](torch.cat([state, *given], dim=-1))

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Cross-entropy of each decision in nats per block. batch: audio_low [B, N + 1, 3K, d], units [B, N + 1, 4],
        speaker [B, speakers], valid [B, N + 1]. The seed block is a past only."""
        units, valid = batch["units"], batch["valid"][:, 1:].to(batch["audio_low"])
        before = units[:, :-1]
        if self.training:
            # All decisions of a block are dropped together; the index after the last class is the row for a missing
            # past.
            gone = torch.rand(before.shape[:2], device=before.device) < PAST_DROPOUT
            before = torch.where(gone[..., None], torch.tensor(CLASSES, device=before.device), before)
        state, _ = self.encode_speech(batch["audio_low"][:, 1:], batch["speaker"], before)
        out = {}
        for level, name in enumerate(self.weights):
            each = functional.cross_entropy(self.logits(state, level, units[:, 1:]).flatten(0, 1),
                                            units[:, 1:, level].flatten(), reduction="none")
            out[name] = masked_mean(each, valid.flatten())
        return out

    def count(self, lexemes: np.ndarray, units: np.ndarray, ease: float = 0.5) -> None:
        """Set `fit` from the lexemes [N] and the decisions [N, 4] of training blocks. ease: added to each count in
        proportion to the frequency of the phase and hand, so that rare lexemes say little."""
        size, kinds = self.fit.shape
        counts = np.zeros((size, kinds))
        np.add.at(counts, (lexemes, units[:, 0] * len(HANDS) + units[:, 1]), 1.0)
        overall = (counts.sum(axis=0) + ease) / (counts.sum() + ease * kinds)
        # Each lexeme's distribution is shrunk towards the overall one, so that a rare lexeme has a bias near 0.
        weight = ease * kinds
        shares = (counts + weight * overall) / (counts.sum(axis=1, keepdims=True) + weight)
        self.fit.copy_(torch.as_tensor(np.log(shares) - np.log(overall)))


_MOST_GAIN, _HEARD = 4.0, 0.05
"""Largest factor on a prediction, and the share of its variance below which a dimension counts
for less: one that can hardly be heard must not become noise."""


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
                          batch_first=True)
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
        predicted, _ = self.predict(batch["audio_low"], batch["speaker"])
        # At rest there is no unit to measure a code on.
        weight = (batch["valid"] * batch["acting"])[..., None]
        return {"code": masked_mean((predicted - batch["code"]).pow(2), weight)}

    @torch.no_grad()
    def calibrate(self, predicted: Tensor, measured: Tensor) -> None:
        """Set the gain from predictions and measured codes [n, d_z] of blocks that were not trained on: the ratio of
        their deviations, less for a dimension of which less than `_HEARD` is explained, and 0 if nothing is."""
        # A prediction that does not vary would be divided by zero.
        deviation = predicted.std(0).clamp_min(1e-6)
        # Pearson's r for each dimension; r^2 is the share of the variance that the prediction explains.
        r = ((predicted - predicted.mean(0)) * (measured - measured.mean(0))).mean(0) / (deviation * measured.std(0))
        audible = (r.clamp_min(0.0).square() / _HEARD).clamp(max=1.0)
        self.gain.copy_(audible * (measured.std(0) / deviation).clamp(max=_MOST_GAIN))
