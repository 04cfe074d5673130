"""Block by block from encoded speech to motion features: the loop of inference (RG 6, Eq. 15; RACER 4.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gesticulator.bundle import Bundle
from gesticulator.drawing import Keys, drawer_for
from gesticulator.features import SpeechFeatures, representation_of
from gesticulator.performance import BEST, LexemeWorth
from gesticulator.rest import Rest, span_of
from interpreters.base import BlockFeatures, LexemeInterpreter, select

if TYPE_CHECKING:
    from lexicon.racer import RacerCodec

OnBlock = Callable[[int, int], None]
"""Called after each block with how many are done, and how many there are."""

_BLOCKS_BEFORE_REST = 2
"""Quiet blocks that are played as they are generated: the arms come down in them."""


@dataclass(frozen=True)
class Sampling:
    """How a lexeme is chosen from scores: see `interpreters.select`. top: 0 for all; seed: of the random numbers;
    variation: another manner of drawing the same lexemes."""

    temperature: float
    top: int
    seed: int
    variation: int = 0

    @property
    def keys(self) -> Keys:
        """Of the noise that blocks are drawn from."""
        return Keys(self.seed, self.variation)


@dataclass(frozen=True)
class RolloutResult:
    """What a rollout gives: motion features [N, K, D_m], lexemes [N], the best lexemes [N, M] and their scores [N, M],
    style codes [N, d_z] and the gate's probabilities [N], NaN where it was not asked. prior, advantage: [N, M + 1] of
    the best lexemes and, last, the one that was played (`performance.LexemeWorth`), NaN where nobody weighed them."""

    motion: NDArray[np.float32]
    lexemes: NDArray[np.int64]
    best: NDArray[np.int64]
    scores: NDArray[np.float64]
    codes: NDArray[np.float32]
    gate: NDArray[np.float64]
    prior: NDArray[np.float64]
    advantage: NDArray[np.float64]

    @classmethod
    def empty(cls, blocks: int, lexemes: int, motion: tuple[int, ...], code_width: int) -> RolloutResult:
        """Arrays to be filled, for N blocks of a lexicon of S lexemes; motion: [K, D_m]."""
        best = min(BEST, lexemes)
        return cls(np.empty((blocks, *motion), np.float32), np.empty(blocks, np.int64),
                   np.empty((blocks, best), np.int64), np.empty((blocks, best)),
                   np.empty((blocks, code_width), np.float32), np.full(blocks, np.nan),
                   np.full((blocks, best + 1), np.nan), np.full((blocks, best + 1), np.nan))

    def keep_best(self, i: int, scores: NDArray[np.float64]) -> None:
        """Note the best lexemes of block i among scores [S]; of equals the lower number comes first."""
        self.best[i] = np.argsort(-scores, kind="stable")[:self.best.shape[1]]
        self.scores[i] = scores[self.best[i]]

    def keep_worth(self, i: int, state: object) -> None:
        """Note what the interpreter's state says of block i's best lexemes and of the one that was played, where it
        weighs them; after `keep_best`."""
        log_prior, advantage = getattr(state, "log_prior", None), getattr(state, "advantage", None)
        if log_prior is not None and advantage is not None:
            at = [*self.best[i], self.lexemes[i]]
            self.prior[i], self.advantage[i] = np.exp(log_prior[at]), advantage[at]

    @property
    def worth(self) -> LexemeWorth | None:
        """What was weighed; None where nothing was."""
        return None if np.isnan(self.prior).any() else LexemeWorth(self.prior, self.advantage)


def rollout(bundle: Bundle, interpreter: LexemeInterpreter, speaker: int, sampling: Sampling, activity: float
            ) -> Rollout | CodecRollout:
    """The loop that the bundle's lexicon needs. speaker: its index; activity: how readily to gesture, 0 to 1."""
    kind = CodecRollout if bundle.config.tokens == "racer" else Rollout
    return kind(bundle, interpreter, speaker, sampling, activity)


def approach_rest(last: Tensor, block: Tensor, share: float) -> Tensor:
    """A block of rest [B, K, D_m]: evenly from the last pose [B, 1, D_m] a share of the way to the block's mean pose.

    The distance to rest shrinks by `share` with each block, so a long rest becomes still.
    """
    frames = block.shape[1]
    steps = torch.arange(1, frames + 1, dtype=block.dtype, device=block.device)[:, None] / frames
    return last + share * steps * (block.mean(dim=1, keepdim=True) - last)


class Rollout:
    """One performance over a lexicon of blocks: the states of interpreter, gate, style and generator."""

    def __init__(self, bundle: Bundle, interpreter: LexemeInterpreter, speaker: int, sampling: Sampling,
                 activity: float) -> None:
        self.bundle, self.interpreter, self.speaker = bundle, interpreter, speaker
        self.sampling, self.activity = sampling, activity
        self.rng = np.random.default_rng(sampling.seed)
        self.device = bundle.vectors.device
        self.quiet_low = None if bundle.statistics.quiet_low is None else self._tensor(bundle.statistics.quiet_low)

    @torch.inference_mode()
    def run(self, encoded: SpeechFeatures, asked: NDArray[np.float32] | None, on_block: OnBlock | None = None,
            lexemes: NDArray[np.int64] | None = None) -> RolloutResult:
        """Every block in turn. asked: [N, K, 2 F] rows of the control, or None; lexemes: [N] to play, whatever the
        interpreter says, or None."""
        b, count = self.bundle, len(encoded.blocks)
        gate = b.gate if self.activity < 1 else None
        previous = b.rest_lexeme(self.speaker)
        rest = b.rest_feature(self.speaker)
        past = rest.expand(1, b.frames, -1)
        drawer = drawer_for(b, encoded, self.speaker, previous, self.sampling.keys)
        inner = free = self.interpreter.start(self.speaker, previous)
        gate_state = None if gate is None else gate.start(self.speaker)
        guidance, rest_decay = b.config.selection.guidance, b.config.silence.rest_decay
        low, high = self._tensor(b.statistics.bounds)
        made = RolloutResult.empty(count, len(b.vectors), past.shape[1:], b.code_width)
        life = None if b.config.silence.rest == "decay" else Rest(
            b.statistics, representation_of(b.config), self.speaker, self.activity, self.sampling.seed)
        resting = _BLOCKS_BEFORE_REST  # who has not begun is at rest
        for i in range(count):
            features = self._features(encoded, i, asked, past[0])
            closed = self.activity == 0
            if gate is not None and gate_state is not None:
                made.gate[i], gate_state = gate.step(gate_state, features)
                closed = not gate.opened(float(made.gate[i]), self.activity)
            if life is not None:
                closed = life.hear(span_of(encoded, i), float(made.gate[i]))
            # Style guidance: beyond what the models do when asked, away from what they do unasked.
            scores, inner = self.interpreter.step(inner, features, previous)
            if asked is not None:
                unasked, free = self.interpreter.step(free, replace(features, control=None), previous)
                scores = unasked + guidance * (scores - unasked)
            quiet = closed or (features.silent and b.config.silence.mask)
            previous = int(lexemes[i]) if lexemes is not None else self._select(scores, b.silent if quiet else None)
            if closed and life is None and self.quiet_low is not None:
                # A block on which nothing is to be done is one on which nothing is said.
                features = replace(features, low=self.quiet_low, silent=True)
            block, code = drawer.block(i, features, previous, past)
            resting = resting + 1 if quiet else 0
            if life is None and resting > _BLOCKS_BEFORE_REST and rest_decay > 0:
                block = approach_rest(past[:, -1:], block, rest_decay)
            # What it was never shown it must not feed itself: one odd pose would lead to the next.
            past = torch.clamp(block, low, high)
            if life is not None:
                past = self._tensor(life.step(past[0].cpu().numpy()))[None]
            drawn = past[0].cpu().numpy()
            made.motion[i] = drawn if life is None else life.alive(drawn)
            made.lexemes[i], made.codes[i] = previous, code[0].cpu().numpy()
            made.keep_best(i, scores)
            made.keep_worth(i, inner)
            if on_block is not None:
                on_block(i + 1, count)
        return made

    def _select(self, scores: NDArray[np.float64], allowed: NDArray[np.int64] | None = None) -> int:
        return select(scores, allowed=allowed, temperature=self.sampling.temperature, top=self.sampling.top or None,
                      rng=self.rng)

    def _tensor(self, values: NDArray) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=self.device)

    def _features(self, encoded: SpeechFeatures, i: int, asked: NDArray[np.float32] | None,
                  past: Tensor | None = None) -> BlockFeatures:
        s, seconds = self.bundle.statistics, encoded.blocks.durations
        return BlockFeatures(self._tensor(s.low.apply(encoded.low[i])), self._tensor(s.high.apply(encoded.high[i])),
                             bool(encoded.blocks.silent[i]),
                             None if encoded.text is None else self._tensor(encoded.text[i]),
                             None if asked is None else self._tensor(asked[i]), past,
                             (float(seconds[max(i - 1, 0)]), float(seconds[i])))


class CodecRollout(Rollout):
    """A performance of RACER's own: codes are chosen one by one and decoded together, without a generator (RACER 5.2).

    There is no style, no gate and no silence in it; `activity` 0 holds the resting code.
    """

    @torch.inference_mode()
    def run(self, encoded: SpeechFeatures, asked: NDArray[np.float32] | None, on_block: OnBlock | None = None,
            lexemes: NDArray[np.int64] | None = None) -> RolloutResult:
        """Every code in turn; nothing can be asked of the style. lexemes: see `Rollout.run`."""
        codec = cast("RacerCodec", self.bundle.lexicon)
        count = len(encoded.blocks)
        rest = previous = self.bundle.rest_lexeme(self.speaker)
        made = RolloutResult.empty(count, len(self.bundle.vectors), (0, 0), 0)
        state = self.interpreter.start(self.speaker, previous)
        for i in range(count):
            scores, state = self.interpreter.step(state, self._features(encoded, i, asked), previous)
            previous = self._select(scores) if lexemes is None else int(lexemes[i])
            made.lexemes[i] = previous = rest if self.activity == 0 else previous
            made.keep_best(i, scores)
            if on_block is not None:
                on_block(i + 1, count)
        # The resting code before the first: the codec then begins where the figure stands.
        codes = torch.as_tensor(np.concatenate([[rest], made.lexemes]), device=self.device)[None]
        return replace(made, motion=codec.decode_tokens(codes)[0, 1:].cpu().numpy())
