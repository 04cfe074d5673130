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


@dataclass(frozen=True)
class RewardProbe:
    """A reward model or an ensemble over a corpus, all blocks read once by each member; rewards are the members' mean.

    motion: for each member tokens [N, C] by the kind of motion, without the duration of the block; audio: [N, C];
    tempo: [N, C] what a block's duration adds to the motion played in it.
    """

    model: RewardModel | RewardEnsemble
    table: EnsembleReward
    motion: list[dict[str, Tensor]]
    audio: list[Tensor]
    tempo: list[Tensor]

    @classmethod
    @torch.no_grad()
    def of(cls, model: RewardModel | RewardEnsemble, bundle: Bundle, corpus: Corpus, labels: Integers,
           context: MovementContext | None = None) -> RewardProbe:
        """labels: [N] the lexeme of every block; context: how lexemes are decoded (default: with the performer's
        detail, as policies are taught)."""
        shown = {"captured": corpus.motion, "decoded": decoded_blocks(bundle.lexicon, labels, corpus),
                 DURATIONS: torch.zeros_like(corpus.motion)}
        no_duration = torch.zeros(len(corpus.motion))
        heard, times = block_audio(corpus).float(), torch.as_tensor(np.log(corpus.durations)).float()
        return cls(model, reward_table(model, bundle.lexicon, corpus, literal=True, context=context),
                   [{name: own.block_motion(motion, no_duration) for name, motion in shown.items()}
                    for own in model.models],
                   [own.block_audio(heard) for own in model.models], [own.tempo(times) for own in model.models])

    @torch.no_grad()
    def score(self, kind: str, motion: Integers, audio: Integers) -> Array:
        """[B] the reward of motion blocks [B, W] that are played on audio blocks [B, W], in their durations."""
        heard, at = torch.as_tensor(audio), torch.as_tensor(motion)
        return _numbers(torch.stack([
            (_embedded(own, kinds[kind][at] + tempo[heard]) * _heard(own, sound[heard])).sum(-1)
            for own, kinds, sound, tempo in self._members()]).mean(0))

    @torch.no_grad()
    def pairs(self, kind: str, own: Integers, retimed: bool) -> Array:
        """[n, n] rewards of the motion of each window (rows) of own [n, W] with the audio of each.

        retimed: in the durations of that audio; else in its own, which tell the true pair by themselves.
        """
        at, out = torch.as_tensor(own), []
        for model, kinds, sound, tempo in self._members():
            tokens, heard = kinds[kind][at], _heard(model, sound[at])
            if not retimed or model.read_tempo is None:  # who is told no durations sees the same in all
                out.append(_numbers(_embedded(model, tokens + tempo[at]) @ heard.T))
            else:
                out.append(np.stack([_numbers(_embedded(model, tokens + tempo[there]) @ vector)
                                     for there, vector in zip(at, heard, strict=True)], axis=1))
        return np.mean(out, axis=0)

    def played(self, lexemes: Integers, audio: Integers) -> Array:
        """[B] the reward of lexemes [B, W] on audio blocks [B, W]."""
        heard = torch.as_tensor(audio)
        return _numbers(self.table.rewards(torch.as_tensor(lexemes), heard, torch.ones(heard.shape)))

    def every(self, take: Demonstration) -> Array:
        """[M - 1, S] the reward of each lexeme at each block of a take but the first, after the true ones."""
        return _numbers(self.table.sequence_every(torch.as_tensor(take.lexemes), torch.as_tensor(take.blocks))[1:])

    def _members(self) -> Iterator[tuple[RewardModel, dict[str, Tensor], Tensor, Tensor]]:
        return zip(self.model.models, self.motion, self.audio, self.tempo, strict=True)


def _embedded(model: RewardModel, tokens: Tensor) -> Tensor:
    return model.embed_motion(tokens, torch.ones(tokens.shape[:2]))


def _heard(model: RewardModel, tokens: Tensor) -> Tensor:
    return model.embed_audio(tokens, torch.ones(tokens.shape[:2]))


def _numbers(values: Tensor) -> Array:
    return values.double().numpy()
