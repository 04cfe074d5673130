"""One step of inference: from a block of encoded speech to its lexeme and its motion (RG 6, Eq. 15; RACER 4.3).

People decide stroke by stroke: a preparation begins where the hand happens to be, but what is prepared does not depend
on how the hand came there. So where the planner lets the hands set out (a preparation begins, or a stroke that was not
prepared), the block is generated as the first of a performance, from a pose h that is keyed by seed and time, at rest.
What is shown is the generated motion g plus an offset that fades from the difference of the pose p and the velocity v
last shown (inertialisation, as in games; `data_module.motion.kinematics`):

    x(t) = g(t) + (p - h) a(s) + v T b(s),   s = (t - t_0) / T

a and b have no jump in value, speed or acceleration at either end. Two performances of nearly the same sound that
parted are one again T seconds after the hands set out next.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.layers import without_after
from data_module.motion.kinematics import fade_weights
from data_module.types import Array
from gesticulator.body.life import SIDES
from gesticulator.body.rest import Rest, RestKnots
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import Span, SpeechBlock, representation_of
from gesticulator.drawing.drawer import FREE, Direction, Keys, drawer_for
from gesticulator.plan.plan import Block, BlockDraw, LexemeChoice
from interpreters.base import BlockFeatures, Explanation, LexemeInterpreter, as_interpreter, select
from interpreters.planner import PHASES

if TYPE_CHECKING:
    from gesticulator.bundle.config import SelectionConfig
    from interpreters.planner import UnitDecision
    from lexicon.racer import RacerCodec

BEST = 5
"""Number of alternative lexemes stored for a block."""

_CONTIGUOUS = 1e-3
"""Seconds between two blocks without a gap."""
AFRESH = 1.6
"""Seconds of strokes after which the next one is prepared anew."""
_BLOCKS_BEFORE_REST = 2
"""Quiet blocks that are played as generated, before rest decay begins: the arms come down in them."""
FADES = 0.6
"""T, seconds: as long as a preparation takes."""
_LOWEST, _HIGHEST = 0.55, -0.45
"""How far towards the resting pose an arm's first pose may be, as a share of the way from the mean pose."""


@dataclass(frozen=True)
class Sampling:
    """How lexemes and motion are sampled; see `interpreters.select`. top: number of best lexemes to sample from, 0 for
    all; seed: of the random numbers; variation: selects other motion for the same lexemes."""

    temperature: float
    top: int
    seed: int
    variation: int = 0

    @property
    def keys(self) -> Keys:
        """Keys of the noise of the blocks' motion."""
        return Keys(self.seed, self.variation)


class FirstPoses:
    """The poses h of one performance, from which preparations are generated."""

    def __init__(self, keys: Keys, names: Sequence[str], rest: Array) -> None:
        """names: of the J joints; rest: [D_m] the normalised resting pose, three numbers a joint; 0 is the mean
        pose."""
        self._keys, self._rest = keys, rest
        self._arms = [np.repeat([name.startswith(side) for name in names], 3) for side in SIDES]

    def at(self, time: float) -> Array:
        """[D_m] h of a preparation that begins at `time` seconds, normalised. Each arm is somewhere between the mean
        and the resting pose, or a little above the mean pose."""
        pose = np.zeros_like(self._rest)
        for columns, chance in zip(self._arms, self._keys.uniform(time, len(self._arms)), strict=True):
            pose[columns] = (_HIGHEST + (_LOWEST - _HIGHEST) * chance) * self._rest[columns]
        return pose.astype(np.float32)


@dataclass(frozen=True)
class Offset:
    """The fading offset from `begin` seconds. pose: [D_m] p - h; velocity: [D_m] v, a second."""

    begin: float
    pose: Tensor
    velocity: Tensor

    def at(self, times: Array) -> Tensor:
        """[K, D_m] at times [K], seconds."""
        s = np.clip((np.asarray(times) - self.begin) / FADES, 0.0, 1.0)
        sinks, coasts, _ = fade_weights(s)
        weights = torch.as_tensor(np.stack([sinks, FADES * coasts]), dtype=self.pose.dtype, device=self.pose.device)
        return weights[0][:, None] * self.pose + weights[1][:, None] * self.velocity

    def over(self, time: float) -> bool:
        """Whether it has faded at `time` seconds."""
        return time >= self.begin + FADES


@dataclass(frozen=True)
class BlockMotion:
    """A generated block.

    block: the block of the plan, without names of lexemes (`directing.record.named`). lexeme: the one that was played;
    where the hands are to rest, an edited plan may hold another. motion: [K, D_m] features with rest and idle motion.
    code: [d_z] style code. unit: the decision of the planner of gesture units; None without one.
    """

    block: Block
    lexeme: int
    motion: NDArray[np.float32]
    code: NDArray[np.float32]
    unit: UnitDecision | None = None


def decided(speech: SpeechBlock, lexeme: int, scores: NDArray[np.float64], explanation: Explanation | None,
            keys: Keys, gate: float = math.nan) -> Block:
    """The block of a plan that records the choice of a lexeme.

    scores: [S] of the interpreter; alternatives are ordered by score, equal ones by number. explanation: of the scores,
    by interpreters that have one. gate: the gate's probability, NaN without a gate.
    """
    best = np.argsort(-scores, kind="stable")[:BEST].tolist()
    draw = BlockDraw(keys.seed, keys.variation, speech.number)
    block = Block(speech.start, speech.end, lexeme, speech.silent[1], draw, speech.flag.name.lower(),
                  gate=None if math.isnan(gate) else gate)
    if np.isfinite(scores[lexeme]):  # an edit may ask for a lexeme that the interpreter rules out
        block = replace(block, score=float(scores[lexeme]), rank=int(np.sum(scores >= scores[lexeme])))
    if explanation is None:
        return replace(block, alternatives=tuple(LexemeChoice(n, "", float(scores[n])) for n in best))
    lexemes = [*best, lexeme]
    prior, advantage = np.exp(explanation.log_prior[lexemes]).tolist(), explanation.advantage[lexemes].tolist()
    other = next((rank for rank, n in enumerate(best) if n != lexeme), 0)
    return replace(
        block, alternatives=tuple(LexemeChoice(n, "", float(scores[n]), prior[rank], advantage[rank])
                                  for rank, n in enumerate(best)),
        chosen={"prior": prior[-1], "advantage": advantage[-1]},
        runner_up={"id": best[other], "worth_more": advantage[other] - advantage[-1]})


def approach_rest(last: Tensor, block: Tensor, share: float) -> Tensor:
    """A block of rest [B, K, D_m]: a straight line from the last pose [B, 1, D_m], `share` of the way to the block's
    mean pose.

    Each block shortens the distance to rest by `share`, so the body becomes still in a long rest.
    """
    frames = block.shape[1]
    steps = torch.arange(1, frames + 1, dtype=block.dtype, device=block.device)[:, None] / frames
    return last + share * steps * (block.mean(dim=1, keepdim=True) - last)


def phrasing(settings: SelectionConfig, speech: SpeechBlock) -> NDArray[np.float64]:
    """[5] what is added to the planner's logits of the phases: holds, above all where a pause goes on, and preparations
    just before the voice returns."""
    bias = np.zeros(len(PHASES))
    bias[PHASES.index("hold")] = settings.hold
    if speech.quiet.mean() >= 0.5 and speech.ahead is not None:
        if speech.ahead.all():
            bias[PHASES.index("hold")] += settings.phrasing
        else:
            bias[PHASES.index("preparation")] = settings.setting_out
    return bias


class Rollout:
    """Block-by-block generation with a lexicon of blocks: the states of interpreter, gate, style and generator.

    Call `begin`, then `step` for each block. The body begins at rest.
    """

    def __init__(self, bundle: Bundle, interpreter: LexemeInterpreter, speaker: int, sampling: Sampling,
                 activity: float) -> None:
        self.bundle, self.interpreter, self.speaker = bundle, as_interpreter(interpreter), speaker
        self.sampling, self.activity = sampling, activity

    @torch.inference_mode()
    def begin(self, text: bool = False) -> None:
        """Reset to the start. text: the blocks that follow come with words."""
        b, speaker = self.bundle, self.speaker
        self.device = b.vectors.device
        self._quiet_low = None if b.statistics.quiet_low is None else self._tensor(b.statistics.quiet_low)
        self._low, self._high = self._tensor(b.statistics.bounds)
        self._previous = b.rest_lexeme(speaker)
        self._inner = self._free = self.interpreter.start(speaker, self._previous)
        self._begin_body(text)

    def _begin_body(self, text: bool) -> None:
        """Put the body at rest; reset the drawer, the gate and the rest controller."""
        b, speaker = self.bundle, self.speaker
        self._gate = b.gate if self.activity < 1 else None
        self._planner = b.planner
        self._planner_state = None if self._planner is None else self._planner.start(speaker)
        self._drawn = self._past = b.rest_feature(speaker).expand(1, b.frames, -1)
        self._drawer = drawer_for(b, speaker, self._previous, self.sampling.keys, text)
        self._gate_state = None if self._gate is None else self._gate.start(speaker)
        self.life = Rest(b.statistics, representation_of(b.config), speaker, self.activity,
                         self.sampling.seed) if b.rests_by_phrase else None
        self._resting = _BLOCKS_BEFORE_REST  # the body is at rest at the start
        self._first_poses, rest = None, b.statistics.rest_pose[speaker]
        if b.config.selection.fresh and self.life is not None:
            names = representation_of(b.config).motion(rest[None], 1.0).skeleton.names
            self._first_poses = FirstPoses(self.sampling.keys, names, b.statistics.normalise(rest, speaker))
        self._offset: Offset | None = None
        self._until = 0.0
        self._unit: UnitDecision | None = None
        self._set_out = 0.0

    @torch.inference_mode()
    def step(self, speech: SpeechBlock, control: NDArray[np.float32] | None = None, direction: Direction = FREE
             ) -> BlockMotion:
        """The next block. control: rows [K, 2 F], or None; direction: instructions for the block."""
        b = self.bundle
        if abs(speech.start - self._until) > _CONTIGUOUS:  # what has passed unseen has not faded an offset
            self._drawn, self._offset = self._past, None
        self._until = speech.end
        features = self._features(speech, control, self._drawn[0])
        unit = self._planned(speech, features)
        if self._sets_out(speech, unit) and direction.keys is None:
            self._begin_unit(speech)
            features = replace(features, past=self._drawn[0])
        self._unit = unit
        closed, probability = self._closed(speech, features, direction, self._still(unit, direction))
        scores = self._within(self._scores(features), unit)
        quiet = closed or (features.silent and b.config.silence.mask)
        if direction.lexeme is None:
            self._previous = self._select(direction, scores, speech, b.silent if quiet else None)
        else:
            self._previous = direction.lexeme
        if closed and self.life is None and self._quiet_low is not None:
            # The generator gets a block without gesture as silence.
            features = replace(features, low=self._quiet_low, silent=True)
        self._drawer.keys = direction.keys or self.sampling.keys
        self._drawer.asked = direction.bias is not None
        self._drawer.unseen = self.life is not None and self.life.rests_wholly
        shift = None if self._offset is None else self._offset.at(speech.span.times)
        block, code = self._drawer.block(speech, features, self._previous, self._drawn, unit,
                                         None if shift is None else torch.cat([(self._past - self._drawn)[0], shift]))
        self._resting = self._resting + 1 if quiet else 0
        rest_decay = b.config.silence.rest_decay
        if self.life is None and self._resting > _BLOCKS_BEFORE_REST and rest_decay > 0:
            block = approach_rest(self._past[:, -1:], block, rest_decay)
        motion = self._advance(block, shift)
        if self._offset is not None and self._offset.over(speech.end):
            self._offset = None
        decision = decided(speech, self._previous, scores, self.interpreter.explain(self._inner), self._drawer.keys,
                           probability)
        return BlockMotion(decision, self._previous, motion, code[0].cpu().numpy(), unit)

    def _sets_out(self, speech: SpeechBlock, unit: UnitDecision | None) -> bool:
        """Whether what was before is forgotten in this block: the planner lets the hands set out, or one stroke has
        followed another for long."""
        if self._first_poses is None or unit is None:
            return False
        return unit.begins_after(self._unit) or (unit.follows(self._unit) and speech.start - self._set_out >= AFRESH)

    def _begin_unit(self, speech: SpeechBlock) -> None:
        """Forget what was before: the next block is generated as the first of a performance."""
        assert self._first_poses is not None
        shown = self._past[0]
        velocity = (shown[-1] - shown[-2]) * (shown.shape[0] / speech.durations[0])
        first = torch.clamp(self._tensor(self._first_poses.at(speech.keyed_at)), self._low, self._high)
        self._set_out = speech.start
        self._offset = Offset(speech.start, shown[-1] - first, velocity)
        self._drawn = first.expand_as(shown)[None]
        self._previous = self.bundle.rest_lexeme(self.speaker)
        self._inner = self._free = self.interpreter.start(self.speaker, self._previous)
        if self._planner_state is not None:
            self._planner_state = self._planner_state.begins()
        self._drawer.restart()

    @torch.inference_mode()
    def idle(self, start: float, seconds: float, knots: int) -> NDArray[np.float32]:
        """[knots, D_m] frames of rest at intervals of `seconds`, the first one interval after `start`.

        `InputError` if the bundle does not rest by phrases (silence.rest=decay).
        """
        if self.life is None:
            raise InputError("the bundle", "cannot rest without speech", "use one with silence.rest=life")
        past = self._past
        self.life.rest(Span(start, seconds * knots, np.ones(knots, bool)))
        motion = self._advance(past[:, -1:].expand(1, knots, -1))
        self._drawn = self._past = torch.cat([past, self._past], 1)[:, -past.shape[1]:]
        self._offset = None
        return motion

    def hurry(self, on: bool) -> None:
        """Generate the following blocks at lower cost, or at full quality again."""
        self._drawer.hurried = on

    def break_off(self, knots: RestKnots, time: float) -> None:
        """Return to these knots (K or more), and go to rest from there at once; time: of the interruption, seconds."""
        assert self.life is not None
        frames = self.bundle.frames
        before = np.repeat(knots.poses[:1], max(frames - len(knots.poses), 0), axis=0)
        self._drawn = self._past = self._tensor(np.concatenate([before, knots.poses[-frames:]]))[None]
        self._offset = None
        self.life.break_off(knots, time)

    @property
    def past(self) -> NDArray[np.float32]:
        """[K, D_m] the last generated frames, without idle motion."""
        return np.asarray(self._past[0].cpu().numpy())

    def motion(self, blocks: Sequence[BlockMotion]) -> NDArray[np.float32]:
        """[N, K, D_m] motion of all blocks of a performance."""
        return np.stack([block.motion for block in blocks])

    def fork(self) -> Rollout:
        """An independent copy with the same state, to generate the following blocks in another way."""
        twin = copy.copy(self)
        twin._inner, twin._free = copy.deepcopy(self._inner), copy.deepcopy(self._free)
        self._fork_body(twin)
        return twin

    def _fork_body(self, twin: Rollout) -> None:
        """Copy the states of gate, drawer and rest controller."""
        twin._gate_state, twin._drawer = copy.deepcopy(self._gate_state), self._drawer.fork()
        twin._planner_state = copy.deepcopy(self._planner_state)
        twin.life = None if self.life is None else self.life.fork()

    def stand_as(self, other: Rollout) -> None:
        """Take over the pose, the last lexeme and the state of rest from another rollout of the same bundle."""
        self._past, self._previous, self._resting = other._past, other._previous, other._resting
        self._drawn, self._offset = other._drawn, other._offset
        if self.life is not None and other.life is not None:
            self.life.stand_as(other.life)

    def _planned(self, speech: SpeechBlock, features: BlockFeatures) -> UnitDecision | None:
        """The decision of the planner of gesture units; None without one. Its noise is keyed by the seed and the time
        of the block, so that a difference elsewhere in the recording does not change it."""
        if self._planner is None or self._planner_state is None:
            return None
        noise = Keys(self.sampling.seed).plan(speech.keyed_at, self._planner.choices)
        # Where lexemes are not drawn, phases are not either.
        temperature = float(self.sampling.temperature > 0)
        unit, self._planner_state = self._planner.step(self._planner_state, features, noise, temperature,
                                                       phrasing(self.bundle.config.selection, speech))
        return unit

    def _still(self, unit: UnitDecision | None, direction: Direction) -> NDArray[np.bool_] | None:
        """[K] frames in which the hands hold still, by the instructions or by the planner; None for none. A gesture
        that was asked for is played, whatever the phase: only silent lexemes can be held."""
        held = unit is not None and unit.holds and self.life is not None
        if held and (direction.lexeme is None or direction.lexeme in self.bundle.silent):
            return np.ones(self.bundle.frames, bool)
        return direction.still

    def _closed(self, speech: SpeechBlock, features: BlockFeatures, direction: Direction,
                still: NDArray[np.bool_] | None) -> tuple[bool, float]:
        """Whether the body rests in the block, and the gate's probability. still: [K] frames in which an instruction
        requires rest."""
        activity = self.activity if direction.activity is None else direction.activity
        closed, probability = activity == 0, math.nan
        if self._gate is not None and self._gate_state is not None:
            probability, self._gate_state = self._gate.step(self._gate_state, features)
            closed = not self._gate.opened(probability, activity)
        if self.life is not None:
            closed = self.life.hear(speech.span, probability, still, activity)
        elif still is not None:
            closed = closed or bool(still.mean() >= 0.5)
        return closed, probability

    def _scores(self, features: BlockFeatures) -> NDArray[np.float64]:
        """[S] scores of the interpreter, with classifier-free guidance by the controls: extrapolated from the scores
        without control through those with control."""
        scores, self._inner = self.interpreter.step(self._inner, features, self._previous)
        if features.control is None or "control" not in self.interpreter.needs:
            return scores
        free, self._free = self.interpreter.step(self._free, replace(features, control=None), self._previous)
        return free + self.bundle.config.selection.guidance * (scores - free)

    def _within(self, scores: NDArray[np.float64], unit: UnitDecision | None) -> NDArray[np.float64]:
        """Scores [S] plus what each lexeme is worth in the planner's phase, less a constant by which log-probabilities
        keep their sum."""
        if unit is None or self.bundle.planner is None:
            return scores
        within = scores + self.bundle.planner.bias(unit)
        return within - (np.logaddexp.reduce(within) - np.logaddexp.reduce(scores))

    def _advance(self, block: Tensor, shift: Tensor | None = None) -> NDArray[np.float32]:
        """[K, D_m] final motion of a generated block [1, K, D_m], which becomes the past of the next one; shift: [K,
        D_m] to add to it, or None."""
        # Stay within the training data: the models' input must not drift away from it, pose by pose.
        self._drawn = self._past = torch.clamp(block, self._low, self._high)
        if self.life is None:
            return np.asarray(self._past[0].cpu().numpy())
        shown = self._past if shift is None else self._past + shift
        self._past = self._tensor(self.life.step(shown[0].cpu().numpy()))[None]
        self._drawn = self._past if shift is None else self._past - shift
        return self.life.alive(self._past[0].cpu().numpy()).astype(np.float32)

    def _select(self, direction: Direction, scores: NDArray[np.float64], speech: SpeechBlock,
                allowed: NDArray[np.int64] | None = None) -> int:
        # A variation has the lexemes of the first performance, unless the block was edited.
        keys = direction.keys or Keys(self.sampling.seed)
        return select(direction.biased(scores), allowed=allowed, temperature=self.sampling.temperature,
                      top=self.sampling.top or None, noise=keys.gumbel(speech.keyed_at, len(scores)))

    def _tensor(self, values: NDArray) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=self.device)

    def _features(self, speech: SpeechBlock, control: NDArray[np.float32] | None, past: Tensor | None = None
                  ) -> BlockFeatures:
        s, config = self.bundle.statistics, self.bundle.config
        low, high = self._tensor(s.low.apply(speech.low)), self._tensor(s.high.apply(speech.high))
        if speech.foreseen:  # a model trained with dropout of the next block gets none rather than an incomplete one
            drop = torch.ones(1, dtype=torch.bool, device=self.device)
            low = without_after(low[None], drop)[0] if config.generator.after_dropout else low
            high = without_after(high[None], drop)[0] if config.interpreter.after_dropout else high
        return BlockFeatures(low, high, speech.silent[1], None if speech.text is None else self._tensor(speech.text),
                             None if control is None else self._tensor(control), past, speech.durations[:2])


class CodecRollout(Rollout):
    """Generation with RACER's codec: codes are chosen one by one and decoded together, without a generator (RACER 5.2).

    There is no style, no gate and no silence; `activity` 0 holds the resting code.
    """

    def _begin_body(self, text: bool) -> None:
        """Nothing to reset: the codec has no state."""

    def _fork_body(self, twin: Rollout) -> None:
        """Nothing to copy."""

    @torch.inference_mode()
    def step(self, speech: SpeechBlock, control: NDArray[np.float32] | None = None, direction: Direction = FREE
             ) -> BlockMotion:
        """The next code, without motion; see `Rollout.step`."""
        scores, self._inner = self.interpreter.step(self._inner, self._features(speech, control), self._previous)
        chosen = direction.lexeme
        if chosen is None:
            chosen = self._select(direction, scores, speech)
        self._previous = self.bundle.rest_lexeme(self.speaker) if self.activity == 0 else chosen
        decision = decided(speech, self._previous, scores, self.interpreter.explain(self._inner), self.sampling.keys)
        return BlockMotion(decision, self._previous, np.empty((0, 0), np.float32), np.empty(0, np.float32))

    @torch.inference_mode()
    def motion(self, blocks: Sequence[BlockMotion]) -> NDArray[np.float32]:
        """[N, K, D_m] all codes decoded together, after a resting code, so that the motion begins at rest."""
        codes = [self.bundle.rest_lexeme(self.speaker), *(block.lexeme for block in blocks)]
        codec = cast("RacerCodec", self.bundle.lexicon)
        decoded = codec.decode_tokens(torch.tensor(codes, device=self.device)[None])
        return np.asarray(decoded[0, 1:].cpu().numpy())
