"""Lexeme interpreters as policies: what they choose on recorded speech, and what is measured of the choice.

Every policy is given the performer's first lexeme of a recording and chooses the rest by itself, in silent blocks among
the silent lexemes alone (where the bundle masks). M blocks are M - 1 decisions; S lexemes.

What fools it: Q-networks are trained to raise the training reward. A policy that gains there and not under the judging
model, which trained on other recordings, has found a hole in the reward and not a better gesture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from data_module.store import Recording
from data_module.types import Array, Motion
from eval.baselines.interpreters import ReplayInterpreter
from eval.metrics.accuracy import lexeme_accuracy
from eval.metrics.diversity import diversity, longest_run
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.features import SpeechFeatures
from gesticulator.gesticulator import Gesticulator
from gesticulator.training.stages import Corpus
from gesticulator.training.stages.q_network import features_of, takes_of
from interpreters.base import BlockFeatures, LexemeInterpreter, select
from interpreters.episodes import Demonstration
from interpreters.lstm import LstmInterpreter

Lexemes = NDArray[np.int64]
Mask = NDArray[np.bool_]

EPISODE = 15
"""Decisions in an episode, RACER's 6 seconds of codes."""
SEED = 0
_TEMPERATURES = (0.002, 50.0)
"""Between these a matched one is sought; Q values may differ by hundredths."""


# ------------------------------------------------------------------------------- quantities: arrays in, numbers out

def episode_return(rewards: Array, steps: int = EPISODE) -> float:
    """The sum of r over `steps` decisions, the mean over all such windows of rewards [n]; NaN for fewer than that."""
    if len(rewards) < steps:
        return float("nan")
    return float(np.lib.stride_tricks.sliding_window_view(rewards, steps).sum(axis=1).mean())


def taken(values: Array, lexemes: Lexemes) -> Array:
    """[n] the value of the lexeme that was taken, from the values of all [n, S]."""
    return np.asarray(np.take_along_axis(values, lexemes[:, None], axis=1)[:, 0], dtype=np.float64)


def entropy_of(scores: Tensor) -> float:
    """Mean entropy in nats of softmax(scores [n, S])."""
    odds = scores.double().log_softmax(-1)
    return float(-(odds.exp() * odds).sum(-1).mean())


def matched_temperature(scores: Tensor, nats: float) -> float:
    """The temperature at which softmax(scores [n, S] / T) has this mean entropy; by bisection: entropy rises with T."""
    low, high = _TEMPERATURES
    for _ in range(40):
        # The geometric middle: temperatures span four decades.
        middle = (low * high) ** 0.5
        low, high = (middle, high) if entropy_of(scores / middle) < nats else (low, middle)
    return float(f"{(low * high) ** 0.5:.4g}")


def allowed_lexemes(silent: Mask, silent_lexemes: Lexemes, size: int) -> Mask:
    """[M, S] True where a lexeme may be chosen: any in speech, a silent one in silence (all, where there is none)."""
    allowed = np.ones((len(silent), size), dtype=bool)
    if len(silent_lexemes):
        allowed[silent] = np.isin(np.arange(size), silent_lexemes)
    return allowed


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
        takes = [take for take in takes_of(corpus, labels, "test") if len(take.blocks) > 1]
        return cls(corpus, takes[:limit], bundle.silent, bundle.config.silence.mask, len(bundle.vectors))

    def allowed(self, take: Demonstration) -> Mask:
        """[M, S] which lexemes may be chosen on each block."""
        return allowed_lexemes(take.silent & self.masked, self.silent, self.size)

    def features(self, block: int, text: bool = False) -> BlockFeatures:
        """The input of an interpreter on a block of the corpus (see `features_of`)."""
        words = self.corpus.text(np.array([block]))[0] if text else None
        return replace(features_of(self.corpus)(block), text=words)


@dataclass(frozen=True)
class Policy:
    """An interpreter and how a lexeme is chosen from its scores (`interpreters.select`)."""

    interpreter: LexemeInterpreter
    temperature: float = 0.0
    top: int | None = None


class Rewards(Protocol):
    """The methods of a reward table that are used here (interpreters/reward.py)."""

    window: int
    """Blocks that a reward looks back on."""

    def every(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """[B, S] rewards of each last lexeme after a history [B, W - 1] on blocks [B, W]."""
        ...

    def sequence_every(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """[M, S] rewards of each lexeme at each block of a recording, the ones before it as they are."""
        ...


Walk = tuple[Lexemes, Array]
"""The lexemes [M] that a policy took and its scores [M - 1, S] for them."""


@torch.inference_mode()
def walk(policy: Policy, decisions: Decisions, take: Demonstration, teacher: bool = False) -> Walk:
    """Run a policy over a recording; the first lexeme is given.

    teacher: its past is the performer's lexemes. Draws depend on the seed and the recording alone.
    """
    rng, allowed = np.random.default_rng([SEED, take.recording]), decisions.allowed(take)
    reads = isinstance(policy.interpreter, LstmInterpreter) and policy.interpreter.config.reads
    # The first lexeme is the performer's: no policy decides it.
    lexemes, scores = take.lexemes.copy(), np.empty((len(take.blocks) - 1, decisions.size))
    state = policy.interpreter.start(take.speaker, int(lexemes[0]))
    for i in range(1, len(lexemes)):
        previous = int((take.lexemes if teacher else lexemes)[i - 1])
        features = decisions.features(int(take.blocks[i]), reads)
        scores[i - 1], state = policy.interpreter.step(state, features, previous)
        lexemes[i] = select(scores[i - 1], allowed=np.flatnonzero(allowed[i]), temperature=policy.temperature,
                            top=policy.top, rng=rng)
    return lexemes, scores


def accuracy(interpreter: LexemeInterpreter, decisions: Decisions, take: Demonstration, teacher: bool) -> float:
    """Percent of a take's blocks, but the first, on which the best score is the performer's lexeme (RG Table 6)."""
    return lexeme_accuracy(walk(Policy(interpreter), decisions, take, teacher)[0][1:], take.lexemes[1:])


def every_reward(rewards: Rewards, take: Demonstration, lexemes: Lexemes) -> Array:
    """[M - 1, S] the reward that each lexeme would have had at each decision."""
    each: Array = rewards.sequence_every(torch.as_tensor(lexemes), torch.as_tensor(take.blocks))[1:].double().numpy()
    return each


# --------------------------------------------------------------------------------------------- figures of one take

@dataclass(frozen=True)
class PolicyJudge:
    """Judges chosen lexemes. tables: reward tables by the prefix of their columns."""

    decisions: Decisions
    tables: Mapping[str, Rewards]

    def lexeme_values(self, take: Demonstration, lexemes: Lexemes) -> dict[str, float]:
        """The figures of the lexemes [M] that a policy chose on one take: returns by each reward, accuracy (percent),
        diversity (nats) and the longest run of one lexeme."""
        chosen = lexemes[1:]
        returns = {f"{prefix}return": episode_return(taken(every_reward(rewards, take, lexemes), chosen))
                   for prefix, rewards in self.tables.items()}
        return {**returns, "accuracy": 100.0 * float((chosen == take.lexemes[1:]).mean()),
                "lexeme_diversity": diversity(chosen, self.decisions.size), "longest_run": longest_run([chosen])}


def perform(system: Gesticulator, recordings: Sequence[Recording], lexemes: Sequence[Lexemes], label: str,
            progress: bool, encoded: Sequence[SpeechFeatures] | None = None) -> list[Motion]:
    """Motion that the generator draws of lexemes [M] for the speech of recordings, the gate open. encoded: the
    recordings' speech, where it was encoded before."""
    size = len(system.bundle.vectors)
    return [system(replace(recording.speech, words=None), speaker=recording.info.speaker,
                   interpreter=ReplayInterpreter([lexemes[place]], size),
                   temperature=0.0, activity=1.0, encoded=encoded[place] if encoded else None).motion
            for place, recording in enumerate(tqdm(recordings, desc=label, disable=not progress))]
