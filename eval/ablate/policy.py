"""Lexeme interpreters as policies: what they choose on recorded speech, and what is measured of the choice.

Every policy is given the performer's first lexeme of a recording and chooses the rest by itself, in silent blocks among
the silent lexemes alone (where the bundle masks). M blocks are M - 1 decisions; S lexemes.

What fools it: Q-networks are trained to raise the training reward. A policy that gains there and not under the judging
model, which trained on other recordings, has found a hole in the reward and not a better gesture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.types import Array
from eval.context import Lexemes
from eval.metrics.accuracy import lexeme_accuracy
from eval.metrics.diversity import diversity, longest_run
from gesticulator.bundle import bundle as bundles
from gesticulator.training.stages import Corpus
from gesticulator.training.stages.q_network import features_of, takes_of
from interpreters.base import LexemeInterpreter, select
from interpreters.episodes import Demonstration
from interpreters.lstm_run import LstmRunner
from interpreters.reward_table import EnsembleReward, RewardTable

Mask = NDArray[np.bool_]

EPISODE = 15
"""Decisions in an episode, RACER's 6 seconds of codes."""


def episode_return(rewards: Array, steps: int = EPISODE) -> float:
    """The sum of r over `steps` decisions, the mean over all such windows of rewards [n]; NaN for fewer than that."""
    # A take that is shorter than an episode has no return of one; a sum over fewer steps would only look small.
    if len(rewards) < steps:
        return float("nan")
    return float(np.lib.stride_tricks.sliding_window_view(rewards, steps).sum(axis=1).mean())


# --------------------------------------------------------------------------------------------------------- policies

@dataclass(frozen=True)
class Decisions:
    """Decisions of every policy. takes: recordings with the performer's lexemes (hinted); the first lexeme of a take
    is given, decision i is block i from 1 on. silent: [n] the silent lexemes; masked: whether they are all that may be
    chosen in silence. size: S."""

    corpus: Corpus
    takes: list[Demonstration]
    silent: Lexemes
    masked: bool
    size: int

    @classmethod
    def of(cls, bundle: bundles.Bundle, corpus: Corpus, labels: Lexemes, limit: int | None = None) -> Decisions:
        """The first `limit` test recordings that hold a decision, with lexemes from labels [N]."""
        # The first lexeme is given, so a take of one block decides nothing.
        takes = [take for take in takes_of(corpus, labels, "test") if len(take.blocks) > 1]
        return cls(corpus, takes[:limit], bundle.silent, bundle.config.silence.mask, len(bundle.vectors))

    def allowed(self, take: Demonstration) -> Mask:
        """[M, S] True where a lexeme may be chosen: any in speech, a silent one in silence (all, where there is none).
        """
        allowed = np.ones((len(take.silent), self.size), dtype=bool)
        if self.masked and len(self.silent):
            allowed[take.silent] = np.isin(np.arange(self.size), self.silent)
        return allowed


def walk(interpreter: LexemeInterpreter, decisions: Decisions, take: Demonstration, teacher: bool = False) -> Lexemes:
    """The lexemes [M] of an interpreter that takes its best score on each block of a recording; the first is given.

    teacher: its past is the performer's lexemes.
    """
    allowed, features = decisions.allowed(take), features_of(decisions.corpus)
    reads = isinstance(interpreter, LstmRunner) and interpreter.config.reads
    # The first lexeme is the performer's: no policy decides it.
    lexemes = take.lexemes.copy()
    state = interpreter.start(take.speaker, int(lexemes[0]))
    for i in range(1, len(lexemes)):
        block, previous = int(take.blocks[i]), int((take.lexemes if teacher else lexemes)[i - 1])
        words = decisions.corpus.text(np.array([block]))[0].numpy() if reads else None
        scores, state = interpreter.step(state, replace(features(block), text=words), previous)
        lexemes[i] = select(scores, allowed=np.flatnonzero(allowed[i]))
    return lexemes


def accuracy(interpreter: LexemeInterpreter, decisions: Decisions, take: Demonstration, teacher: bool) -> float:
    """Percent of a take's blocks, but the first, on which the best score is the performer's lexeme (RG Table 6)."""
    return lexeme_accuracy(walk(interpreter, decisions, take, teacher)[1:], take.lexemes[1:])


# --------------------------------------------------------------------------------------------- figures of one take

def lexeme_values(take: Demonstration, lexemes: Lexemes, size: int, tables: Mapping[str, RewardTable | EnsembleReward]
                  ) -> dict[str, float]:
    """The figures of the lexemes [M] of `size` that a policy chose on one take: returns by each of the reward tables
    (by the prefix of their columns), accuracy (percent), diversity (nats) and the longest run of one lexeme."""
    chosen, returns = lexemes[1:], {}
    for prefix, rewards in tables.items():
        each = rewards.sequence_every(torch.as_tensor(lexemes), torch.as_tensor(take.blocks))[1:].double().numpy()
        returns[f"{prefix}return"] = episode_return(np.take_along_axis(each, chosen[:, None], axis=1)[:, 0])
    return {**returns, "accuracy": lexeme_accuracy(chosen, take.lexemes[1:]),
            "lexeme_diversity": diversity(chosen, size), "longest_run": longest_run([chosen])}
