"""A reward model asked about a corpus: motion of any kind on the audio of any blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.types import Array
from gesticulator.bundle import Bundle
from gesticulator.stages.corpus import Corpus
from gesticulator.stages.lexicon import decoded_blocks
from gesticulator.stages.reward import block_audio, reward_table
from interpreters.episodes import Demonstration
from interpreters.reward import RewardModel, RewardTable

DURATIONS = "durations alone"
"""Motion that is the mean pose throughout."""
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class RewardProbe:
    """A reward model over a corpus, all blocks read once. motion: tokens [N, C] by the kind of motion, without the
    duration of the block; audio: [N, C]; tempo: [N, C] what a block's duration adds to the motion played in it."""

    model: RewardModel
    table: RewardTable
    motion: dict[str, Tensor]
    audio: Tensor
    tempo: Tensor

    @classmethod
    @torch.no_grad()
    def of(cls, model: RewardModel, bundle: Bundle, corpus: Corpus, labels: Integers) -> RewardProbe:
        """labels: [N] the lexeme of every block."""
        shown = {"captured": corpus.motion, "decoded": decoded_blocks(bundle.lexicon, labels, corpus),
                 DURATIONS: torch.zeros_like(corpus.motion)}
        no_duration = torch.zeros(len(corpus.motion))
        return cls(model, reward_table(model, bundle.lexicon, corpus),
                   {name: model.block_motion(motion, no_duration) for name, motion in shown.items()},
                   model.block_audio(block_audio(corpus).float()),
                   model.tempo(torch.as_tensor(np.log(corpus.durations)).float()))

    @torch.no_grad()
    def score(self, kind: str, motion: Integers, audio: Integers) -> Array:
        """[B] the reward of motion blocks [B, W] that are played on audio blocks [B, W], in their durations."""
        heard = torch.as_tensor(audio)
        vectors = self._motion(self.motion[kind][torch.as_tensor(motion)] + self.tempo[heard])
        return _numbers((vectors * self._audio(heard)).sum(-1))

    @torch.no_grad()
    def pairs(self, kind: str, own: Integers, retimed: bool) -> Array:
        """[n, n] rewards of the motion of each window (rows) of own [n, W] with the audio of each.

        retimed: in the durations of that audio; else in its own, which tell the true pair by themselves.
        """
        at = torch.as_tensor(own)
        tokens, heard = self.motion[kind][at], self._audio(at)
        if not retimed:
            return _numbers(self._motion(tokens + self.tempo[at]) @ heard.T)
        return np.stack([_numbers(self._motion(tokens + self.tempo[there]) @ vector)
                         for there, vector in zip(at, heard, strict=True)], axis=1)

    def played(self, lexemes: Integers, audio: Integers) -> Array:
        """[B] the reward of lexemes [B, W] on audio blocks [B, W]."""
        heard = torch.as_tensor(audio)
        return _numbers(self.table.rewards(torch.as_tensor(lexemes), heard, torch.ones(heard.shape)))

    def every(self, take: Demonstration) -> Array:
        """[M - 1, S] the reward of each lexeme at each block of a take but the first, after the true ones."""
        return _numbers(self.table.sequence_every(torch.as_tensor(take.lexemes), torch.as_tensor(take.blocks))[1:])

    def _motion(self, tokens: Tensor) -> Tensor:
        return self.model.embed_motion(tokens, torch.ones(tokens.shape[:2]))

    def _audio(self, blocks: Tensor) -> Tensor:
        return self.model.embed_audio(self.audio[blocks], torch.ones(blocks.shape))


def _numbers(values: Tensor) -> Array:
    return values.double().numpy()
