"""A reward model asked about a corpus: motion of any kind on the audio of any blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.types import Array
from gesticulator.bundle.bundle import Bundle
from gesticulator.training.stages.corpus import Corpus
from gesticulator.training.stages.lexicon import decoded_blocks
from gesticulator.training.stages.reward import MovementContext, block_audio, reward_table
from interpreters.episodes import Demonstration
from interpreters.reward import RewardEnsemble, RewardModel
from interpreters.reward_table import EnsembleReward

DURATIONS = "durations alone"
"""Motion that is the mean pose throughout."""
Integers = NDArray[np.int64]
_AT_ONCE = 2048
"""Windows that are scored at a time, to bound memory."""


@dataclass(frozen=True)
class RewardProbe:
    """A reward model or an ensemble over a corpus; rewards are the members' mean.

    blocks: [N, K, D_m] by the kind of motion; audio: [N, C] tokens for each member; times: [N] log durations. decoded:
    how windows of the performer's lexemes, labels [N], are decoded in context; None for blocks decoded one by one.
    """

    model: RewardModel | RewardEnsemble
    table: EnsembleReward
    blocks: dict[str, Tensor]
    audio: list[Tensor]
    times: Tensor
    labels: Tensor
    decoded: MovementContext | None = None

    @classmethod
    @torch.no_grad()
    def of(cls, model: RewardModel | RewardEnsemble, bundle: Bundle, corpus: Corpus, labels: Integers,
           context: MovementContext | None = None) -> RewardProbe:
        """labels: [N] the lexeme of every block; context: how lexemes are decoded (default: with the performer's
        detail, as policies are taught)."""
        shown = {"captured": corpus.motion, DURATIONS: torch.zeros_like(corpus.motion)}
        if context is None:
            shown["decoded"] = decoded_blocks(bundle.lexicon, labels, corpus)
        heard, times = block_audio(corpus).float(), torch.as_tensor(np.log(corpus.durations)).float()
        return cls(model, reward_table(model, bundle.lexicon, corpus, literal=True, context=context), shown,
                   [own.block_audio(heard) for own in model.models], times, torch.as_tensor(labels), context)

    @torch.no_grad()
    def score(self, kind: str, motion: Integers, audio: Integers) -> Array:
        """[B] the reward of motion blocks [B, W] that are played on audio blocks [B, W], in their durations."""
        return np.concatenate([self._score(kind, torch.as_tensor(motion[first:first + _AT_ONCE]),
                                           torch.as_tensor(audio[first:first + _AT_ONCE]))
                               for first in range(0, len(motion), _AT_ONCE)] or [np.zeros(0)])

    def _score(self, kind: str, at: Tensor, heard: Tensor) -> Array:
        shown = self._shown(kind, at)
        return _numbers(torch.stack([
            (_embedded(own, shown, self.times[heard]) * _heard(own, sound[heard])).sum(-1)
            for own, sound in self._members()]).mean(0))

    @torch.no_grad()
    def pairs(self, kind: str, own: Integers, retimed: bool) -> Array:
        """[n, n] rewards of the motion of each window (rows) of own [n, W] with the audio of each.

        retimed: in the durations of that audio; else in its own, which tell the true pair by themselves.
        """
        at, out = torch.as_tensor(own), []
        shown = self._shown(kind, at)
        for model, sound in self._members():
            heard = _heard(model, sound[at])
            if not retimed or (model.read_tempo is None and model.read_speeds is None):  # the same in any durations
                out.append(_numbers(_embedded(model, shown, self.times[at]) @ heard.T))
            else:
                out.append(np.stack([_numbers(_embedded(model, shown, self.times[there].expand(len(at), -1)) @ vector)
                                     for there, vector in zip(at, heard, strict=True)], axis=1))
        return np.mean(out, axis=0)

    def played(self, lexemes: Integers, audio: Integers) -> Array:
        """[B] the reward of lexemes [B, W] on audio blocks [B, W]."""
        heard = torch.as_tensor(audio)
        return _numbers(self.table.rewards(torch.as_tensor(lexemes), heard, torch.ones(heard.shape)))

    def every(self, take: Demonstration) -> Array:
        """[M - 1, S] the reward of each lexeme at each block of a take but the first, after the true ones."""
        return _numbers(self.table.sequence_every(torch.as_tensor(take.lexemes), torch.as_tensor(take.blocks))[1:])

    def _shown(self, kind: str, at: Tensor) -> Tensor:
        """[B, W, K, D_m] the motion of windows [B, W]."""
        if kind == "decoded" and self.decoded is not None:
            return self.decoded.shown(self.labels[at], at, torch.ones(at.shape))
        return self.blocks[kind][at].float()

    def _members(self) -> Iterator[tuple[RewardModel, Tensor]]:
        return zip(self.model.models, self.audio, strict=True)


def _embedded(model: RewardModel, motion: Tensor, times: Tensor) -> Tensor:
    """[B, P] of windows [B, W, K, D_m] whose blocks last exp(times [B, W]) seconds."""
    return model.embed_motion(model.block_motion(motion, times), torch.ones(times.shape))


def _heard(model: RewardModel, tokens: Tensor) -> Tensor:
    return model.embed_audio(tokens, torch.ones(tokens.shape[:2]))


def _numbers(values: Tensor) -> Array:
    return values.double().numpy()
