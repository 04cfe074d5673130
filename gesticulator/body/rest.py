"""Rest: when the hands rest, and how they go to rest and leave it.

Three decisions, each made from the past and what is known of the next block (no further look-ahead):

1. Is this a pause to rest in? `Pauses` turns quiet frames into frames of rest: only a silence of a second or more
   counts, because in shorter ones people finish a gesture and prepare the next, and only lasting speech ends it, so
   that clicks do not wake the body.
2. Is this phrase gestured? `Phrases` selects, among the runs of speech between pauses, a share `activity` of the time,
   preferring those that the gate scores highest.
3. What does the body do? `Rest` stops it smoothly, holds for `HOLD` seconds, then retracts the hands to the resting
   pose at the pace of a gesture; on waking, the generated motion is joined to the position and
   velocity last shown. Idle motion is added: faintly in speech, fully where the head would freeze.

The stop from pose x with velocity v takes T seconds along the cubic that ends at x + v T / 3 with velocity 0, so that
the speed falls as v (1 - t / T)^2. A hand that is already coming down continues down: its cubic ends at rest, or
2 v T / 3 on the way there.
"""

from __future__ import annotations

import copy
import math
from bisect import bisect_left, bisect_right, insort
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.motion.kinematics import positions_of_some
from data_module.motion.representation import Representation
from data_module.types import Array
from gesticulator.body.life import HEAD, SIDES, LifeLayer, uniform
from gesticulator.bundle.features import Flags, Span, Statistics

REAL = 1.0
"""Least silence, seconds, in which the body rests. Real speakers move a hand in 61 to 84 % of the time of their shorter
pauses, at half the speed around them or more."""
SEEN = 0.8
"""Least duration of a silence that still continues at the end of what is known, seconds."""
WAKES = 0.2
"""Least duration of sound that ends a pause, seconds: clicks and lip noises do not."""
LEAD = 0.4
"""Seconds before the voice at which the body wakes: the preparation of a gesture precedes its word."""
HOLD = 0.7
"""Seconds from the start of the rest until the hands retract: they stop, and hold the end of their gesture."""
SINKING = 0.4
"""Greatest speed of a hand on its way to rest, m/s: a retraction, a little slower than the gestures (a hand's mean
speed in speech is 0.34 to 0.45 m/s)."""
BREAKS_OFF = 0.18
"""Duration of the stop after an interruption, seconds: within 0.3 s of the word, including motion already generated."""
STILL_HOLD, STILL_SINKING = 1.6, 0.065
"""The same seconds and greatest speed where the hands are asked to hold still."""
HELD_MOVES, HELD_RETURNS, _HELD_EASES = 0.22, 0.8, 0.3
"""Share of the generated movement that a held hand makes, and seconds in which that fades and sets in: a hand that a
person holds drifts by one to three centimetres."""
LETS_DOWN, HANGS = 0.24, 1.15
"""Seconds after an interrupting word at which the hands start down, still slow at 0.3 s, and at which they hang: as
late as a limit of 1.2 s allows after smoothing, because a raised hand has 0.4 m to travel."""
LONGEST_PHRASE = 3.0
"""Seconds of speech without a pause after which a new phrase begins (mean in recorded talks: 2.6 s)."""

LONGEST_STOP, _SHORTEST_STOP = 0.42, 0.22
"""Range of the duration of a stop, seconds."""
_STOP_WITHIN = 0.12
"""Stopping distance of a hand, metres, if the shortest stop allows it."""
_RETRACTS = 0.42
"""Seconds in which a hand already moving to rest arrives there, or stops as near as `_FARTHEST` allows."""
_REACH = 0.66
"""Distance as a share of speed x time for a hand whose speed falls as 1 - (t / T)^2, without accelerating first."""
_FARTHEST = 0.2
"""Greatest distance that such a hand still travels, metres."""
_TOWARDS = 0.3, 0.8
"""Cosines between a hand's velocity and its direction to rest: below the first it is not coming down, above the second
it is."""
_LEAST_FADE = 0.2
"""Least duration of a join, seconds; if a block has less left, the body wakes in the next."""
_ALWAYS = -1e3
"""Start time of the initial rest, seconds: long enough ago to be complete."""
_REPAY = 6.0
"""Surplus or deficit of gestured speech that decides the next phrase for certain, seconds."""
_TRUSTED = 4.0
"""Number of phrases after which the gate's ranking counts as much as the random number."""
_PATH = 9
"""Places on the way to rest at which the speed of the hands is measured."""
_SINKS_IN = 2.0
"""Seconds in which the head goes to rest."""


# ---------------------------------------------------------------------------------------------------- pauses

class Pauses:
    """Frames of rest from quiet frames, block by block. resting: whether the body rests before the first block."""

    def __init__(self, resting: bool = True) -> None:
        self._resting = resting
        self._quiet_for = 0.0

    def step(self, span: Span) -> Flags:
        """[K] whether the body rests in each frame of the block."""
        count = len(span.quiet)
        quiet, steps = span.quiet, np.full(count, span.duration / count)
        if span.ahead is not None:
            quiet = np.concatenate([quiet, span.ahead])
            steps = np.concatenate([steps, np.full(len(span.ahead), span.ahead_duration / len(span.ahead))])
        rests = self._rests(quiet, steps, open_end=span.ahead is not None)
        resting = rests[:count].copy()
        # Frames of silence at the end of the block: they count for a pause that continues in the next.
        trailing = span.quiet[::-1].argmin() if not span.quiet.all() else count
        self._resting = bool(resting[-1])
        if self._resting:
            self._quiet_for = 0.0
        else:
            self._quiet_for = (self._quiet_for if trailing == count else 0.0) + trailing * span.duration / count
        wakes = np.flatnonzero(rests[:-1] & ~rests[1:]) + 1
        for k in wakes:  # wake a little before the voice
            before = np.cumsum(steps[:k][::-1])[::-1] <= LEAD + 1e-9
            resting[np.flatnonzero(before[:count])] = False
        return resting

    def _rests(self, quiet: Flags, steps: Array, open_end: bool) -> Flags:
        """open_end: more sound may follow; at the end of a recording only silence follows."""
        turns = np.flatnonzero(np.diff(quiet)) + 1
        bounds = [0, *turns.tolist(), len(quiet)]
        resting, out = self._resting, np.zeros(len(quiet), bool)
        for first, last in zip(bounds[:-1], bounds[1:], strict=True):
            # 1e-9: sums of frame durations must not miss a threshold by rounding.
            length = float(steps[first:last].sum()) + 1e-9
            goes_on = last == len(quiet)
            if quiet[first]:
                if first == 0:
                    length += self._quiet_for
                real = length >= REAL or (goes_on and (not open_end or length >= SEEN))
                resting = resting or real
            elif length >= WAKES:
                resting = False
            # Runs that are too short keep the state of the run before: hysteresis.
            out[first:last] = resting
        return out


class Phrases:
    """Selects which phrases are gestured, so that a share `activity` of speech time is.

    A phrase gets a number q in (0, 1): the rank of the gate's probability at its first block among those of earlier
    phrases, mixed with a random number keyed by the seed and the phrase's start. It is gestured if q >= 1 - a, with a =
    activity + (activity x speech so far - gestured so far) / `_REPAY`. Activity 0 is none and 1 is all.
    """

    def __init__(self, activity: float, seed: int) -> None:
        self.activity, self.seed = activity, seed
        self._ranked: list[float] = []
        self._spoken = self._gestured = self._phrase = 0.0
        self._speaks, self._open = False, False

    def fork(self) -> Phrases:
        twin = copy.copy(self)
        twin._ranked = list(self._ranked)
        return twin

    def step(self, span: Span, rests: Flags, score: float) -> bool:
        """Whether the speech in this block is gestured; what holds for the phrase that its last speech belongs to.

        rests: [K] of `Pauses`; score: the gate's probability, NaN where there is no gate.
        """
        speech = span.duration * float((~rests).mean())
        if speech == 0:
            self._speaks = False
            return False
        if not self._speaks or rests[0] or self._phrase >= LONGEST_PHRASE:
            self._open, self._phrase = self._begins(span.start, score), 0.0
        self._speaks = not rests[-1]
        self._phrase += speech
        self._spoken += speech
        self._gestured += speech * self._open
        return self._open

    def _begins(self, start: float, score: float) -> bool:
        # In milliseconds: the block's start on the clock of the audio.
        chance = float(uniform(self.seed, 1 << 20, np.array([round(start * 1000)]))[0])
        rank, weight = chance, 0.0
        # Without a gate the choice is random alone.
        if not math.isnan(score):
            if self._ranked:
                below, at_most = bisect_left(self._ranked, score), bisect_right(self._ranked, score)
                rank = (below + (at_most - below) * chance) / len(self._ranked)
                # A rank among few phrases says little: trust grows as n / (n + 4).
                weight = len(self._ranked) / (len(self._ranked) + _TRUSTED)
            insort(self._ranked, score)
        q = weight * rank + (1.0 - weight) * chance
        if self.activity in (0.0, 1.0):
            return self.activity == 1.0
        return q >= 1.0 - self.activity - (self.activity * self._spoken - self._gestured) / _REPAY


# ---------------------------------------------------------------------------------------------------- the body

@dataclass
class _Stop:
    """A path into rest: from a pose with a velocity at `begin` seconds to a stop, and from there to the resting pose.

    stops_in: [D] seconds for each dimension; hold: seconds before it sinks; sinks_in: seconds.
    """

    begin: float
    pose: Array
    velocity: Array
    stopped: Array
    stops_in: Array
    rest: Array
    sinks_in: float
    hold: float

    def at(self, time: Array | float) -> Array:
        """[D] at a time in seconds, or [K, D] at times [K, 1]."""
        s = np.minimum((time - self.begin) / self.stops_in, 1.0)
        stopped = _hermite(s, self.pose, self.velocity * self.stops_in, self.stopped)
        u = np.minimum(np.maximum((time - self.begin - self.hold) / self.sinks_in, 0.0), 1.0)
        return stopped + u * u * (3.0 - 2.0 * u) * (self.rest - stopped)


def _hermite(s: Array | float, start: Array, slope: Array, end: Array) -> Array:
    """The cubic from `start` with the given slope to `end` with slope 0, at parameter s in 0 to 1."""
    return (2 * s**3 - 3 * s**2 + 1) * start + (s**3 - 2 * s**2 + s) * slope + (3 * s**2 - 2 * s**3) * end


@dataclass
class _Join:
    """Offset added to a generated block after waking: it removes the jump and fades to zero by the block's end."""

    begin: float
    end: float
    offset: Array
    velocity: Array

    def at(self, time: float) -> Array:
        length = self.end - self.begin
        return _hermite((time - self.begin) / length, self.offset, self.velocity * length, np.zeros_like(self.offset))


class RestingPart:
    """Dimensions of the pose that rest and wake together, in units in which all are near 1."""

    def __init__(self, rest: Array, bounds: Array, hands: _Hands | None) -> None:
        """rest: [D] the resting pose; bounds: [2, D] smallest and largest values; hands: whose speed is limited."""
        self.rest, self.bounds, self._hands = rest, bounds, hands
        self._stop: _Stop | None = _Stop(_ALWAYS, rest, np.zeros_like(rest), rest, np.ones_like(rest), rest, 1.0, HOLD)
        self._join: _Join | None = None
        self._last = [(-1.0, rest), (0.0, rest)]
        self._drift = np.zeros_like(rest)

    def step(self, times: Array, generated: Array, rests: Flags, hold_still: bool = False, moves: float = 0.0) -> Array:
        """[K, D] a generated block [K, D] at `times` [K] with rest applied in the frames `rests` [K].
        hold_still: a rest that begins in this block was asked for, so the hands hold still instead of retracting;
        moves: the share of the generated movement that is still made at rest."""
        if self._stop is None and not rests.any():  # most blocks of speech; a join ends with its block
            self._last = [*self._last, *zip(times.tolist(), generated, strict=True)][-2:]
            return generated
        if self._stop is not None and rests.all() and not moves and not self._drift.any():  # most blocks of a pause
            out = self._stop.at(times[:, None]) + self._drift
            self._last = [*self._last, *zip(times.tolist(), out, strict=True)][-2:]
            return out
        out = np.empty_like(generated)
        for k, time in enumerate(times):
            if rests[k] and self._stop is None:
                self._stop, self._join, self._drift = self._stopping(hold_still), None, np.zeros_like(self.rest)
            elif not rests[k] and self._stop is not None and (k == 0 or times[-1] - self._last[1][0] >= _LEAST_FADE):
                # A generator that uses its past starts from the frame before; one that ignores it is extrapolated.
                before = generated[k - 1] if k else 2.0 * generated[0] - generated[1]
                now, pose = self._last[1]
                # The join removes the difference in position and in velocity, so the motion is once continuously
                # differentiable.
                jump = self._velocity() - (generated[k] - before) / (float(time) - now)
                self._join, self._stop = _Join(now, float(times[-1]), pose - before, jump), None
            if self._stop is not None:
                now, pose = self._last[1]
                eased = moves * min((time - self._stop.begin) / _HELD_EASES, 1.0)
                # It fades, so that what is held stays about where it stopped.
                self._drift = (math.exp((now - time) / HELD_RETURNS) * self._drift
                               + eased * (generated[k] - (generated[k - 1] if k else pose)))
                out[k] = self._stop.at(float(time)) + self._drift
            else:
                out[k] = generated[k] if self._join is None else generated[k] + self._join.at(float(time))
            self._last = [self._last[1], (float(time), out[k])]
        self._join = None
        return out

    def break_off(self, last: list[tuple[float, Array]], word: float) -> None:
        """Stop and go to rest at once from the last two times and poses (later motion is discarded). word: time of the
        interruption in seconds, a little earlier."""
        self._last, self._join, self._drift = last, None, np.zeros_like(self.rest)
        now, pose = last[1]
        # The speed falls as v (1 - t / T)^2, whose integral is v T / 3.
        stopped = np.clip(pose + self._velocity() * BREAKS_OFF / 3.0, *self.bounds)
        self._stop = _Stop(now, pose, self._velocity(), stopped, np.full(len(pose), BREAKS_OFF), self.rest,
                           HANGS - LETS_DOWN, max(word + LETS_DOWN - now, 0.0))

    def _velocity(self) -> Array:
        (before, earlier), (now, later) = self._last
        return (later - earlier) / (now - before)

    def _stopping(self, hold_still: bool) -> _Stop:
        now, pose = self._last[1]
        velocity = self._velocity()
        hold, fastest = (STILL_HOLD, STILL_SINKING) if hold_still else (HOLD, SINKING)
        stops_in, sinks_in = np.full(len(pose), LONGEST_STOP), _SINKS_IN
        stopped = pose + velocity * stops_in / 3.0
        if self._hands is not None:
            stopped, stops_in = self._hands.stop(pose, velocity, self.rest)
        stopped = np.clip(stopped, *self.bounds)
        if self._hands is not None:
            sinks_in = self._hands.sink_seconds(stopped, self.rest, fastest)
        return _Stop(now, pose, velocity, stopped, stops_in, self.rest, sinks_in, hold)


class _Hands:
    """The hands, the right first, by the dimensions of the arms: where they are and how they rest."""

    def __init__(self, representation: Representation, statistics: Statistics, speaker: int, columns: NDArray[np.int64]
                 ) -> None:
        """columns: the dimensions of the arms among those of the pose."""
        self._representation, self._statistics, self._speaker = representation, statistics, speaker
        self._columns = columns
        skeleton = representation.motion(statistics.rest_pose[speaker][None], 1.0).skeleton
        self._joints = [skeleton.index(side + "Hand") for side in SIDES]
        names = [skeleton.names[column // 3] for column in columns]
        # Of each side the dimensions of arm and fingers.
        self._arms = [np.flatnonzero([name.startswith(side) for name in names]) for side in SIDES]

    def places(self, features: Array) -> Array:
        """[M, 2, 3] metres for features [M, D] of the arms."""
        # Trunk and head keep their resting pose: what is asked is how the hands move on the trunk.
        poses = np.repeat(self._statistics.rest_pose[self._speaker][None], len(features), axis=0)
        whole = self._statistics.normalise(poses, self._speaker)
        whole[:, self._columns] = features
        motion = self._representation.motion(self._statistics.denormalise(whole, self._speaker), 1.0)
        return positions_of_some(motion, self._joints)

    def stop(self, pose: Array, velocity: Array, rest: Array) -> tuple[Array, Array]:
        """The pose where the body stops [D] and the durations in seconds [D], from a pose with a velocity."""
        tiny = 1e-3
        now, then, end = self.places(np.stack([pose, pose + velocity * tiny, rest]))
        # Velocity of the hands by a finite difference: the chain from angles to places is not linear.
        moves, ahead = (then - now) / tiny, end - now
        speeds, ways = np.linalg.norm(moves, axis=-1), np.linalg.norm(ahead, axis=-1)
        # The cubic covers v T / 3: the faster the hand, the less time it gets.
        seconds = np.full(len(pose), np.clip(3.0 * _STOP_WITHIN / max(float(speeds.max()), 1e-6), _SHORTEST_STOP,
                                             LONGEST_STOP))
        stopped = pose + velocity * seconds / 3.0
        for side, columns in enumerate(self._arms):
            cosine = float(moves[side] @ ahead[side]) / max(float(speeds[side] * ways[side]), 1e-9)
            # 0 to 1: how surely the hand is on its way to rest.
            comes = min(max((cosine - _TOWARDS[0]) / (_TOWARDS[1] - _TOWARDS[0]), 0.0), 1.0)
            goes = min(_REACH * float(speeds[side]) * _RETRACTS, _FARTHEST)
            near = min(goes / max(float(ways[side]), 1e-9), 1.0)
            there = pose[columns] + near * (rest[columns] - pose[columns])
            stopped[columns] += comes * (there - stopped[columns])
            seconds[columns] += comes * (_RETRACTS - seconds[columns])
        return stopped, seconds

    def sink_seconds(self, pose: Array, rest: Array, fastest: float) -> float:
        """Duration in seconds of the straight path from a pose to rest such that no hand exceeds `fastest` m/s."""
        share = np.linspace(0.0, 1.0, _PATH)[:, None]
        steps = np.linalg.norm(np.diff(self.places(pose + share * (rest - pose)), axis=0), axis=-1)
        # The smooth step peaks at 1.5 times its mean speed.
        return max(1.5 * float(steps.max()) * (_PATH - 1) / fastest, 1.0)


@dataclass(frozen=True)
class RestKnots:
    """The last frames shown, from which `Rest` continues: times [M] seconds, poses [M, D_m] without idle motion, and
    gains [M, 3, 2] of the idle motion of head, trunk and arms with their slopes."""

    times: Array
    poses: NDArray[np.float32]
    gains: Array


class Rest:
    """Rest and idle motion of one performance, block by block.

    For each block call `analyse`, which returns whether the hands rest for most of it; then `step` with the generated
    block, which returns the block that becomes the generator's past; then `alive`, which returns the block to show.
    """

    def __init__(self, statistics: Statistics, representation: Representation, speaker: int, activity: float, seed: int
                 ) -> None:
        """representation: of exponential maps; activity: share of speech time that is gestured; seed: of the choice of
        phrases and of the idle motion."""
        self.speaker = speaker
        # They rest apart: in a phrase without gestures the head still moves, and where hands hold, the trunk does.
        rest_pose = statistics.rest_pose[speaker]
        names = representation.motion(rest_pose[None], 1.0).skeleton.names
        turned, armed = (np.repeat([name.startswith(part) for name in names], 3) for part in (HEAD, SIDES))
        arms = np.flatnonzero(armed)
        rest = statistics.normalise(rest_pose, speaker)
        hands = _Hands(representation, statistics, speaker, arms)
        self._parts = [(columns, RestingPart(rest[columns], statistics.bounds[:, columns], moves))
                       for columns, moves in ((np.flatnonzero(turned), None), (np.flatnonzero(~turned & ~armed), None),
                                              (arms, hands))]
        self._life = LifeLayer(seed, statistics, representation, speaker, [columns for columns, _ in self._parts])
        self._pauses, self._phrases = Pauses(), Phrases(activity, seed)
        self._rests: list[Flags] = []
        self._asked, self._moves = False, 0.0
        self._span: Span | None = None

    def fork(self) -> Rest:
        """A copy that continues independently."""
        twin = copy.copy(self)
        twin._life = copy.copy(self._life)
        twin._parts = [(columns, copy.copy(part)) for columns, part in self._parts]
        twin._pauses, twin._phrases = copy.copy(self._pauses), self._phrases.fork()
        return twin

    def begins_at_rest(self, span: Span) -> bool:
        """Whether a performance that begins with this block begins with a pause, or may begin without gestures."""
        return self._phrases.activity < 1.0 or bool(Pauses(resting=False).step(span)[0])

    def begin_in(self, pose: Array) -> None:
        """Begin in a pose [D_m] instead of at rest."""
        self._pauses = Pauses(resting=False)
        for columns, part in self._parts:
            part._stop, part._last = None, [(-1.0, pose[columns]), (0.0, pose[columns])]
        self._life.go_back(np.zeros((len(self._parts), 2)), pose)

    def stand_as(self, other: Rest) -> None:
        """Take over position and velocity of the body from another performance by the same speaker."""
        self._parts = other.fork()._parts
        self._life.stand_as(other._life)

    def analyse(self, span: Span, score: float = math.nan, still: Flags | None = None, held: bool = False) -> bool:
        """Analyse a block; True if the hands rest for half of it or more. score: the gate's probability; still: [K]
        frames in which the hands must rest; held: they hold a gesture there, and so are not quite still."""
        pause = self._pauses.step(span)
        gestured = self._phrases.step(span, pause, score)
        self._span = span
        # In a phrase that is not gestured the hands rest as in a pause.
        hands = pause if gestured else np.ones_like(pause)
        self._rests = [pause, hands, hands if still is None else hands | still]
        self._asked = still is not None and bool(still.any())
        self._moves = HELD_MOVES if held and not hands.any() else 0.0
        return bool(self._rests[-1].mean() >= 0.5)

    @property
    def rests_wholly(self) -> bool:
        """Whether the body rests in every frame of the last block, so that a generated block would not be shown."""
        return all(bool(rests.all()) for rests in self._rests)

    def rest(self, span: Span) -> None:
        """Instead of `analyse`, for a block without sound: rest throughout."""
        # A new `Pauses` starts at rest, as after a long silence.
        self._pauses, self._span, self._asked, self._moves = Pauses(), span, False, 0.0
        # Nothing is heard, so nothing is decided: a phrase begins anew afterwards.
        self._rests = [np.ones(len(span.quiet), bool)] * len(self._parts)

    def break_off(self, shown: RestKnots, word: float) -> None:
        """Go back to the last frames shown and go to rest from there; word: see `RestingPart.break_off`."""
        for columns, part in self._parts:
            part.break_off([(float(time), pose[columns].astype(np.float64))
                            for time, pose in zip(shown.times[-2:], shown.poses[-2:], strict=True)], word)
        self._life.go_back(shown.gains[-1], shown.poses[-1])

    @property
    def times(self) -> Array:
        """[K] seconds, of the frames of the last block."""
        assert self._span is not None, "analyse comes first"
        return self._span.times

    @property
    def gains(self) -> Array:
        """[K, 3, 2] gains of the idle motion in each frame of the last block, see `RestKnots`."""
        return self._life.gains

    def step(self, generated: NDArray[np.floating]) -> Array:
        """[K, D_m] a generated block [K, D_m] with rest applied, both normalised, without idle motion."""
        assert self._span is not None, "analyse comes first"
        out = np.empty_like(generated, dtype=np.float64)
        for (columns, part), rests in zip(self._parts, self._rests, strict=True):
            out[:, columns] = part.step(self._span.times, generated[:, columns].astype(np.float64), rests,
                                        self._asked, self._moves)
        return out

    def alive(self, block: NDArray[np.floating]) -> Array:
        """[K, D_m] the block of `step` with idle motion added."""
        assert self._span is not None, "analyse comes first"
        return self._life(block, self._span, self._rests)
