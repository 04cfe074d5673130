"""Render a plan as motion: two arms and a trunk, joined without seams, in time with the plan.

Each arm is a track of log rotations against rest. It follows one target at a time (hanging, the home pose in front of
the body, a stroke's clip); when the target changes, the offset in pose, velocity and acceleration fades by a quintic.
The motion is rendered, its beats are measured on the hands, the strokes are shifted by their timing errors, and the
motion is rendered again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from data_module.motion import rotation
from data_module.motion.kinematics import minimum_jerk
from data_module.motion.motion_beats import acting_speed, beats_of_speed
from data_module.types import Array, Motion
from gesticulator_performer import plan as planning
from gesticulator_performer import trunk as living
from gesticulator_performer.joints import FPS, MIRROR, SIDES, TORSO_RADIUS, capsule_depth
from gesticulator_performer.plan import BRAKE, Casting, Habits, Levels, Manner, PhraseHands, Planned, waiting_levels
from gesticulator_performer.strokes import LEFT, RIGHT, PerformerBody, StrokeSet
from gesticulator_performer.syllables import Spoken
from gesticulator_performer.trunk import Segment
from gesticulator_performer.voices import NEUTRAL, StyleTrack

# Fitting the motion to its plan.
# Most renderings of both arms that bring the measured beats to the planned ones.
_PASSES = 6
# Most rounds in which strokes that cannot be put in time are left out and the others fitted again.
_ROUNDS = 4
# Most times that the arms are led around the body, each followed by a new fit.
_DETOURS = 2
# Share of the way to the home pose below which an arm is not led.
_CLEAR = 0.1
# Joints of an arm, from the shoulder to the hand, that place the hand; the fingers do not.
_REACHING = 4
# Window around a planned beat, seconds, in which the measured beat is searched: less than the least gap of strokes.
_MISS = 0.35
# Deceleration, in half standard deviations (see `_brakes`), below which a beat is faint and gets a larger accent.
_CLEARLY = 1.2
# Timing error, seconds (half a frame), below which a beat is not moved.
_ACCURATE = 0.008
# Timing error, seconds (about one frame), above which a stroke is left out in the end.
_TOLERANCE = 0.018
# The same of a stroke with a meaning, whose shape tells more than its beat.
_MEANT_TOLERANCE = 0.1
# First share by which the excursion is raised before a beat.
_ACCENT = 0.08
# Largest such share after the steps of `_tuned`: more of it makes hands tremble.
_MOST_ACCENT = 0.3
# Seconds by which the clip's beat may be moved to meet the planned one, so that its preparation keeps its shape.
_FARTHEST = 0.15
# Share of the preparation in which the offset of the old motion fades, so that the last third is the clip's own.
_FADE_SHARE = 0.65

# Raising and dropping the arms.
# Seconds in which an arm is raised before the first word of a run of phrases.
_RAISE = 0.7
# Share of the home pose at which an idle arm hangs, so that its elbow is not quite straight.
_HANGING_LEVEL = 0.1

# Small beats between strokes.
# Share by which the excursion of an arm is raised for a small beat on an ordinary syllable.
_MICRO = 0.42
# Seconds in which a raised arm falls; its beat is at the share `BRAKE` of them.
_FALL = 0.32
# Seconds in which it rises before.
_BEFORE_SMALL = 0.3
# Least seconds between small beats: about a rise and a fall.
_SMALL_GAP = 0.62
# Log of the size of small movements, by amplitude and tempo.
_SMALL_OF_STYLE = np.array([0.5, 0.3])
# Bends of spine and head with a stroke of gain 1: forward, turned and tilted to the side of the hand, radians.
_WITH_STROKE = np.radians([[1.6, 1.2, 0.8], [2.2, 2.6, 1.0]])
# Factor on the drift of raised arms in pauses.
_QUIETER = 0.35
# Factor on the wrists' bends of the clips, which are larger than those of people who talk.
_WRISTS = 0.58
# Factor on drift and small beats of an arm in a take from a script, whose shape tells what it means; seconds in which
# that ends after the hold.
_SCRIPTED_DRIFT, _CALMED = 0.25, 0.3
# Seconds of a take's clip that pass while its last pose is held for longer.
_FROZEN = 0.02
# Factor on the nods over a real person's trunk, whose own head motion is not tied to this speech.
_NOD_GAIN = 1.3

# Limits of the arms.
# Share of a clip's turn of the hips that is played, because the feet stand still here.
_HIPS_SHARE = 0.4

HEAD_RADIUS = 0.105
"""Radius of the sphere for the head with hair, metres."""
# Metres that an elbow may be behind its shoulder.
_BEHIND = 0.08
# Metres above the shoulder beyond which a hand is too high, and the share of the excess that counts as depth.
_HIGH, _HIGH_SHARE = 0.10, 0.3
# Depth inside the body, metres, at which an arm is led to the home pose altogether.
_FULL_TRESPASS = 0.06


@dataclass(frozen=True)
class _Event:
    """From `time` on an arm follows a stroke (by index), or holds a share of the home pose (`level`; 0 is rest). fade:
    seconds in which the offset of the old motion fades; for a stroke, its preparation."""

    time: float
    fade: float
    stroke: int = -1
    level: float = 0.0


class _Tuning(NamedTuple):
    """The parameters of each stroke that change from pass to pass. beats: seconds at which the clip's beat is put.
    accents: share by which the arm is raised before the beat. fades: share of the preparation in which the old motion
    fades. slow: the beat is tuned by the fade, not the clip."""

    beats: Array
    accents: Array
    fades: Array
    slow: NDArray[np.bool_]

    def of(self, mask: NDArray[np.bool_]) -> _Tuning:
        return self._make(track[mask] for track in self)

    def where(self, mask: NDArray[np.bool_], other: _Tuning) -> _Tuning:
        return self._make(np.where(mask, *tracks) for tracks in zip(self, other, strict=True))


@dataclass(frozen=True)
class _Score:
    """Everything that stays the same from pass to pass.

    events: per arm. micro: [2, T] share by which each arm's excursion is raised. drift: [2, T, A * 3].
    trunk: [T, B, 3] log rotations of hips to head. hanging: [2, T] share of the other arm's motion that an arm follows
    while it hangs. leads: [2, T] share by which an arm is led to the home pose, to keep it out of the body.
    chest: position and rotation of the joint that carries the shoulders. runs, levels: sources of the events; drop:
    seconds in which an arm comes to rest; damping: seconds of the low pass of the arms. targets: cache of `_target`.
    """

    figure: PerformerBody
    planned: tuple[Planned, ...]
    events: tuple[tuple[_Event, ...], ...]
    micro: Array
    drift: Array
    trunk: Array
    hanging: Array
    leads: Array
    chest: tuple[Array, Array]
    runs: list[tuple[float, float]]
    levels: Levels
    drop: float
    damping: float
    frames: int
    targets: dict[tuple[object, ...], Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Played:
    """A finished performance: motion on the performer's own skeleton at 60 fps (fingers included), and its strokes."""

    motion: Motion
    strokes: tuple[Planned, ...]


@dataclass(frozen=True)
class Staging:
    """The manner of a talk, the trunks of real people to perform it with, and its style."""

    manner: Manner
    segments: tuple[Segment, ...]
    style: StyleTrack = NEUTRAL


def perform(spoken: Spoken, performer: str, strokes: StrokeSet, staging: Staging, rng: np.random.Generator,
            split: str = "train") -> Played:
    """Perform `spoken` with the body and the strokes of `performer`: 60 fps on the performer's skeleton.

    The hands act independently, and the trunk is a real person's. The result depends on the arguments and the state of
    `rng` alone. Held-out strokes are played in the split "test" only.
    """
    casting = planning.cast(spoken, performer, staging.manner, staging.style, rng)
    planned = planning.plan(spoken, performer, strokes, casting, rng, split)
    score = _score(strokes.figures[performer], planned, spoken, casting.habits_of(performer),
                   (casting, staging.segments), rng)
    accents = [_ACCENT * (1.0 if p.stroke.lexeme.startswith("Beat") else 0.6) for p in planned]
    tuning = _Tuning(np.array([p.beat for p in planned]), np.array(accents), np.full(len(planned), _FADE_SHARE),
                     np.zeros(len(planned), dtype=bool))
    for turn in range(_DETOURS + 1):
        score, tuning, arms = _rehearse(score, tuning)
        trespass = _leads(score, arms)
        if trespass.max() <= _CLEAR or turn == _DETOURS:
            break
        score = replace(score, leads=np.maximum(score.leads, trespass))
    return Played(_assemble(score, _render(score, tuning)), score.planned)


def _rehearse(score: _Score, tuning: _Tuning) -> tuple[_Score, _Tuning, Array]:
    """The score without the strokes that cannot be put in time, its tuning, and the rendered arms."""
    for turn in range(_ROUNDS):
        arms, tuning, missing = _on_time(score, tuning)
        good = np.abs(missing) <= [_MEANT_TOLERANCE if p.meaning else _TOLERANCE for p in score.planned]
        if good.all() or turn == _ROUNDS - 1:
            break
        good &= ~_echoes(score.planned, good)
        timely = tuple(p for p, fine in zip(score.planned, good, strict=True) if fine)
        score = replace(score, planned=timely, events=tuple(
            _events(side, timely, score.runs, score.levels[side], score.drop) for side in (LEFT, RIGHT)))
        tuning = tuning.of(good)
    return score, tuning, arms


def _echoes(planned: tuple[Planned, ...], good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Strokes that would repeat the clip of the stroke before them once those not in `good` are left out."""
    out = np.zeros(len(planned), dtype=bool)
    last = ""
    for k, p in enumerate(planned):
        if good[k]:
            out[k] = p.stroke.base == last
            last = p.stroke.base
    return out


def _on_time(score: _Score, tuning: _Tuning) -> tuple[Array, _Tuning, Array]:
    """Both arms, [2, T, 12], rendered until the measured beats are where they were planned; the tuning, and the timing
    error of each stroke in seconds.

    A late stroke is moved earlier and an early one later. A stroke that still misses gets a larger accent; one that is
    early because the way to the clip is longer than the clip's own uses all its preparation to get there.
    """
    planned = np.array([p.beat for p in score.planned])
    preparation = planned - np.array([p.start for p in score.planned])
    best, least = tuning, np.full(len(planned), np.inf)
    before: tuple[_Tuning, Array] | None = None
    for _ in range(_PASSES):
        arms = _render(score, tuning, _REACHING)
        missing, faint = _misses(score, arms)
        better = np.abs(missing) < np.abs(least)
        best, least = best.where(~better, tuning), np.where(better, missing, least)
        if not ((np.abs(missing) > _ACCURATE) | faint).any():
            return arms, tuning, missing
        now = (tuning, missing)
        tuning = _tuned(tuning, missing, faint, _answer(now, before, preparation), planned, preparation)
        before = now
    arms = _render(score, best, _REACHING)
    return arms, best, _misses(score, arms)[0]


def _answer(now: tuple[_Tuning, Array], before: tuple[_Tuning, Array] | None, preparation: Array) -> Array:
    """Movement of each measured beat per second of shift, from the last two passes (secant), clipped to 0.5 .. 1.6."""
    if before is None:
        return np.ones(len(preparation))
    shift = np.where(now[0].slow, (now[0].fades - before[0].fades) * preparation, now[0].beats - before[0].beats)
    known = (np.abs(shift) > 0.004) & (now[0].slow == before[0].slow) & np.isfinite(now[1]) & np.isfinite(before[1])
    moved = np.where(known, np.where(known, now[1], 0.0) - np.where(known, before[1], 0.0), 0.0)
    return np.where(known, np.clip(moved / np.where(known, shift, 1.0), 0.5, 1.6), 1.0)


def _tuned(tuning: _Tuning, missing: Array, faint: NDArray[np.bool_], answer: Array, planned: Array,
           preparation: Array) -> _Tuning:
    """The tuning of the next pass. missing: timing errors in seconds, positive if late, infinite without a beat."""
    beats, accents, fades = tuning.beats, tuning.accents, tuning.fades
    known = np.where(np.isfinite(missing), missing, 0.0)
    step = np.where(np.abs(known) > _ACCURATE, known, 0.0) / answer
    slow = tuning.slow | (known < -_FARTHEST) | ((known < -0.02) & (beats > planned + 0.9 * _FARTHEST))
    fades = np.where(slow, np.clip(np.where(tuning.slow, fades - step / preparation, 1.0 / BRAKE), 0.8, 2.0), fades)
    beats = np.where(slow, planned, np.clip(beats - step, planned - _FARTHEST, planned + _FARTHEST))
    more = np.where(faint, 0.12, np.where(np.abs(known) > 0.015, 0.06, 0.0))
    return _Tuning(beats, np.minimum(accents + more, _MOST_ACCENT), fades, slow)


# --- The score: constant from pass to pass


def _score(figure: PerformerBody, planned: tuple[Planned, ...], spoken: Spoken, habits: Habits,
           staged: tuple[Casting, tuple[Segment, ...]], rng: np.random.Generator) -> _Score:
    casting, segments = staged
    manner = casting.manner
    frames = max(2, round(spoken.speech.duration * FPS))
    runs = planning.runs_of(spoken.phrases)
    levels = waiting_levels(casting.hands, _mean_drives(spoken, casting.hands), [start for start, _ in runs], _RAISE,
                            manner, rng)
    events = tuple(_events(side, planned, runs, levels[side], manner.drop) for side in (LEFT, RIGHT))
    lively = np.stack([_active(arm, frames, lambda event: event.stroke >= 0 or event.level > 0, 0.25)
                       for arm in events])
    speaking = lively.max(axis=0)
    moving = lively * _in_speech(spoken, frames)
    drift = np.stack([_drift(figure, moving[side], manner.drift, frames, rng) for side in (LEFT, RIGHT)])
    joints = min(drift.shape[-1], 12)
    drift[..., :joints] += (1.0 - lively)[..., None] * living.idle_arms(segments, frames, rng)[..., :joints]
    size = np.exp(casting.style.at(np.arange(frames) / FPS) @ _SMALL_OF_STYLE)
    calm = _calm(planned, frames)
    drift *= size[:, None]
    carried = living.carriage(figure, spoken.phrases, spoken.syllables, frames, FPS)
    drift += lively[..., None] * carried.reshape(drift.shape)
    drift *= calm[..., None]
    wanted = manner.small_beats, planning.drives(spoken)
    micro = size * calm * np.stack([_micro(side, spoken, planned, wanted, frames, rng) for side in (LEFT, RIGHT)])
    trunk = _living_trunk(figure, planned, spoken, segments, (speaking, manner.trunk, habits), rng)
    hanging = manner.sympathy * np.stack([
        _active(arm, frames, lambda event: event.stroke < 0 < event.level <= _HANGING_LEVEL, 0.2) for arm in events])
    return _Score(figure, planned, events, micro, drift, trunk, hanging, np.zeros((2, frames)),
                  _carried(figure, trunk), runs, levels, manner.drop, habits.damping, frames)


def _calm(planned: tuple[Planned, ...], frames: int) -> Array:
    """[2, T] factor on drift and small beats of each arm: less than 1 in takes from scripts."""
    out = np.ones((2, frames))
    for p in planned:
        if p.stroke.scripted:
            first, last = _frame(p.start), min(frames, _frame(p.hold_end + _CALMED))
            times = np.arange(first, last) / FPS
            ready = p.start + _FADE_SHARE * (p.beat - p.start)
            inside = _pulse(times, p.start, ready) * (1.0 - _pulse(times, p.hold_end, p.hold_end + _CALMED))
            for side in p.stroke.sides:
                out[side, first:last] *= 1.0 - (1.0 - _SCRIPTED_DRIFT) * inside
    return out


def _in_speech(spoken: Spoken, frames: int) -> Array:
    """[T] 1 in phrases, `_QUIETER` in pauses, with soft edges."""
    out = np.full(frames, _QUIETER)
    for phrase in spoken.phrases:
        out[_frame(phrase.start - 0.15):_frame(phrase.end)] = 1.0
    return gaussian_filter1d(out, 0.15 * FPS, mode="nearest")


def _mean_drives(spoken: Spoken, phrases: Sequence[PhraseHands]) -> list[float]:
    """The mean vigour of the syllables of each phrase, 0 for a phrase without any."""
    vigour = planning.drives(spoken)
    starts = np.array([s.vowel for s in spoken.syllables])
    inside = [(starts >= phrase.start) & (starts < phrase.end) for phrase in phrases]
    return [float(vigour[rows].mean()) if rows.any() else 0.0 for rows in inside]


def _events(side: int, planned: tuple[Planned, ...], runs: list[tuple[float, float]],
            levels: list[tuple[float, float]], drop: float) -> tuple[_Event, ...]:
    strokes = [(k, p) for k, p in enumerate(planned) if side in p.stroke.sides]
    changes = np.array([time for time, _ in levels])

    def level_at(time: float) -> float:
        before = np.flatnonzero(changes <= time + 1e-9)
        return levels[before[-1]][1] if len(before) else 0.0

    events = [_Event(0.0, 0.1)]
    spans = [(p.start, p.hold_end) for _, p in strokes]
    for time, level in levels:
        if not any(a - 0.35 <= time < b for a, b in spans):
            events.append(_Event(max(time, 0.0), _RAISE if time > 0.05 else 0.5, level=level))
    for k, p in strokes:
        events.append(_Event(p.start, p.beat - p.start, stroke=k))
        events.append(_Event(p.hold_end, max(p.end - p.hold_end, 0.5), level=level_at(p.hold_end)))
    for _, end in runs:
        late = max([b for a, b in spans if a < end + 0.4], default=0.0)
        events.append(_Event(max(end + 0.25, late + 0.02), drop))
    starts = {p.start for _, p in strokes}
    events.sort(key=lambda e: (e.time, e.stroke >= 0))
    return tuple(e for e in events if e.stroke >= 0 or e.time not in starts)


def _active(events: tuple[_Event, ...], frames: int, counts: Callable[[_Event], bool], blur: float) -> Array:
    """[T] 1 while an event that `counts` lasts, 0 elsewhere, with edges blurred over `blur` seconds."""
    out = np.zeros(frames)
    for event, following in zip(events, (*events[1:], None), strict=True):
        if counts(event):
            out[_frame(event.time):_frame(following.time) if following else frames] = 1.0
    return gaussian_filter1d(out, blur * FPS, mode="nearest")


def _frame(time: float) -> int:
    return max(0, int(np.ceil(time * FPS - 1e-6)))


def _wander(frames: int, channels: int, period: float, rng: np.random.Generator) -> Array:
    """Smooth noise [T, channels] of unit standard deviation that changes within about `period` seconds: independent
    knots joined by a cubic spline, which is cheap and free of the slow trend that a low-pass filter leaves."""
    knots = int(np.ceil(frames / FPS / (period / 4.0))) + 4
    values = gaussian_filter1d(rng.normal(size=(knots, channels)), 1.0, axis=0)
    times = (np.arange(knots) - 1.0) * period / 4.0
    curve = CubicSpline(times, values)(np.arange(frames) / FPS)
    return curve / 0.52


def _drift(figure: PerformerBody, lively: Array, wander: float, frames: int, rng: np.random.Generator) -> Array:
    """[T, A * 3] slow drift of an arm: some degrees while it is raised, a trace of it at rest."""
    joints = len(figure.arms[0])
    share = np.zeros((joints, 3))
    share[:4] = np.radians([[1.5] * 3, [7.5] * 3, [11.5] * 3, [8.0] * 3])
    share[4:] = np.radians(2.0)
    slow = _wander(frames, joints * 3, 1.5, rng)
    idle = _wander(frames, joints * 3, 4.0, rng)
    return (wander * slow * (0.02 + 0.98 * lively)[:, None] + idle * 0.03) * share.ravel()


def _pulse(times: Array, start: float, end: float) -> Array:
    return minimum_jerk(np.clip((times - start) / (end - start), 0.0, 1.0))


def _add_bump(track: Array, peak: float, stop: float, size: float, before: float = _BEFORE_SMALL) -> None:
    """Add to track [T] a bump that rises for `before` seconds until `peak` and falls until `stop`."""
    first, last = max(0, _frame(peak - before) - 1), min(len(track), _frame(stop) + 2)
    if first >= last:
        return
    times = np.arange(first, last) / FPS
    track[first:last] += size * (_pulse(times, peak - before, peak) - _pulse(times, peak, stop))


def _micro(side: int, spoken: Spoken, planned: tuple[Planned, ...], wanted: tuple[float, Array], frames: int,
           rng: np.random.Generator) -> Array:
    """[T] small beats on syllables without a stroke of this arm: the arm is raised before them and falls on them.
    wanted: the least prominence of a syllable that gets one, and the vigour of each syllable."""
    least, strength = wanted
    track = np.zeros(frames)
    # A small beat takes _BEFORE_SMALL seconds to rise: none of it may touch a stroke's beat.
    spans = [(p.start - 0.05, p.beat + 0.15 + _FALL + _BEFORE_SMALL) for p in planned if side in p.stroke.sides]
    draws = rng.normal(0.0, 1.0, (2, len(spoken.syllables)))
    last = -1.0
    for i, syllable in enumerate(spoken.syllables):
        at = syllable.vowel + 0.025 * draws[0, i]
        free = not any(a < at < b for a, b in spans)
        if free and at - last > _SMALL_GAP and syllable.prominence > least:
            size = _MICRO * float(np.clip(0.7 + 0.3 * syllable.prominence + 0.35 * strength[i] + 0.2 * draws[1, i],
                                          0.25, 1.5))
            _add_bump(track, at - BRAKE * _FALL, at + (1.0 - BRAKE) * _FALL, size)
            last = at
    return track


# --- The trunk


def _living_trunk(figure: PerformerBody, planned: tuple[Planned, ...], spoken: Spoken, segments: tuple[Segment, ...],
                  life: tuple[Array, float, Habits], rng: np.random.Generator) -> Array:
    """[T, B, 3] log rotations of hips, spine, neck and head: a real person's, with postures, nods and breath."""
    speaking, gain, habits = life
    frames = len(speaking)
    names = [figure.skeleton.names[j] for j in figure.trunk]
    spines = [k for k, name in enumerate(names) if name.startswith("Spine")]
    skull = [k for k, name in enumerate(names) if name.startswith(("Neck", "Head"))]
    track = living.trunk_track(segments, spoken, speaking, gain, rng)
    track = living.with_activity(track, _activity(planned, frames))
    hips, spine, head = living.spread(track, (1, len(spines), len(skull)))
    posture = living.postures(frames, rng)
    out = np.zeros((frames, len(figure.trunk), 3))
    out[:, 0] = hips
    out[:, spines] = (spine + posture[:, 0] / len(spines))[:, None]
    out[:, skull] = (head + posture[:, 1] / len(skull))[:, None]
    out[:, skull, 0] += (_NOD_GAIN * _nods(spoken, habits, frames, rng) / len(skull))[:, None]
    # The chest rises and falls about fifteen times a minute.
    out[:, spines[-1], 0] += np.radians(0.5) * np.sin(2.0 * np.pi * np.arange(frames) / FPS / 3.9)
    out[:, spines] += (living.sway(frames, rng) * (1.0 - 0.7 * speaking)[:, None] / len(spines))[:, None]
    out[:, spines] += (living.pitch_accents(spoken.syllables, frames, rng) / len(spines))[:, None]
    _add_bends_with_strokes(out, planned, (spines, skull), rng)
    _add_clips(out, planned)
    out[..., 1] *= living.yaw_scale(out[..., 1].sum(axis=1))
    return out


def _nods(spoken: Spoken, habits: Habits, frames: int, rng: np.random.Generator) -> Array:
    """[T] radians forward: the head dips on stressed syllables."""
    track = np.zeros(frames)
    draws = rng.random((2, len(spoken.syllables)))
    for i, syllable in enumerate(spoken.syllables):
        if syllable.prominence > 0.3 and draws[0, i] < 0.6:
            size = np.radians(habits.nod) * (0.6 + 0.9 * draws[1, i])
            _add_bump(track, syllable.vowel + 0.03, syllable.vowel + 0.4, float(size), before=0.24)
    return track


def _activity(planned: tuple[Planned, ...], frames: int) -> Array:
    """[T] 1 while a hand moves in a stroke, 0 elsewhere, with soft edges."""
    out = np.zeros(frames)
    for p in planned:
        out[_frame(p.start):_frame(p.beat + 0.15)] = 1.0
        out[_frame(p.hold_end):_frame(p.end)] = 0.7
    return gaussian_filter1d(out, 0.12 * FPS, mode="nearest")


def _add_bends_with_strokes(trunk: Array, planned: tuple[Planned, ...], parts: tuple[list[int], list[int]],
                            rng: np.random.Generator) -> None:
    """The chest leans into each stroke and the head goes with it, to the side of the acting hand."""
    draws = np.exp(rng.normal(0.0, 0.35, (len(planned), 2)))
    sides = rng.choice([-1.0, 1.0], len(planned))
    for p, draw, other in zip(planned, draws, sides, strict=True):
        side = other if len(p.stroke.sides) == 2 else 1.0 if p.stroke.sides == (LEFT,) else -1.0
        first, last = _frame(p.start), min(len(trunk), _frame(p.end))
        times = np.arange(first, last) / FPS
        window = p.gain * (_pulse(times, p.start, p.beat + 0.08) - _pulse(times, min(p.hold_end, p.end - 0.2), p.end))
        for joints, bend, size in zip(parts, _WITH_STROKE, draw, strict=True):
            turn = size * bend * np.array([1.0, side, -side]) / len(joints)
            trunk[first:last, joints] += (window[:, None] * turn)[:, None]


def _add_clips(trunk: Array, planned: tuple[Planned, ...]) -> None:
    for p in planned:
        first, last = _frame(p.start), min(len(trunk), _frame(p.end))
        if last - first < 4:
            continue
        times = np.arange(first, last) / FPS
        window = _pulse(times, p.start, p.beat) * (1.0 - _pulse(times, min(p.hold_end, p.end - 0.2), p.end))
        inside = p.stroke.trunk_at(_clip_time(p, p.beat, times)) - p.stroke.trunk_at(np.array([p.stroke.start]))
        logs = inside.reshape(len(times), -1, 3)
        # Some clips turn on the spot; here the feet stand still, so the hips turn less.
        logs[:, 0] *= _HIPS_SHARE
        trunk[first:last] += window[:, None, None] * logs


# --- The arms


def _clip_time(p: Planned, beat: float, times: Array) -> Array:
    """Seconds in the clip for seconds of the performance [M]: a monotone cubic through start, beat, hold end, end."""
    s = p.stroke
    hold_end = max(p.hold_end, beat + 0.05)
    end = max(p.end, hold_end + (s.end - s.hold_end) / 1.4)
    if s.scripted:
        return _drawn_time(p, beat, (hold_end, end), times)
    return monotone_cubic(np.array([p.start, beat, hold_end, end]), np.array([s.start, s.beat, s.hold_end, s.end]),
                          times)


def _drawn_time(p: Planned, beat: float, ends: tuple[float, float], times: Array) -> Array:
    """The same of a take from a script: what is repeated in its hold keeps its tempo, and a longer hold stands still.
    ends: of the hold and of the retraction."""
    s, (hold_end, end) = p.stroke, ends
    held = beat + s.hold_end - s.beat
    if hold_end < held + 0.05:
        x, y = [p.start, beat, hold_end, end], [s.start, s.beat, min(s.hold_end, s.beat + hold_end - beat), s.end]
    else:
        x = [p.start, beat, held, hold_end, end]
        y = [s.start, s.beat, s.hold_end - _FROZEN, s.hold_end, s.end]
    return monotone_cubic(np.array(x), np.array(y), times)


def monotone_cubic(x: Array, y: Array, at: Array) -> Array:
    """A rising cubic through knots x [K], y [K], evaluated at [M]; linear beyond the ends. The tangent at an inner knot
    is the harmonic mean of the slopes beside it (Fritsch and Butland 1984), which keeps the curve monotone."""
    slopes = np.diff(y) / np.diff(x)
    tangents = np.concatenate([slopes[:1], 2.0 / (1.0 / slopes[:-1] + 1.0 / slopes[1:]), slopes[-1:]])
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    width = x[k + 1] - x[k]
    s = (at - x[k]) / width
    inside = np.clip(s, 0.0, 1.0)
    s2, s3 = inside ** 2, inside ** 3
    curve = (y[k] * (2.0 * s3 - 3.0 * s2 + 1.0) + y[k + 1] * (3.0 * s2 - 2.0 * s3)
             + width * (tangents[k] * (s3 - 2.0 * s2 + inside) + tangents[k + 1] * (s3 - s2)))
    return curve + (s - inside) * width * np.where(s < 0.0, tangents[0], tangents[-1])


def _render(score: _Score, tuning: _Tuning, joints: int | None = None) -> Array:
    """[2, T, joints * 3] both arms, the first `joints` from the shoulder on (all by default)."""
    arms = np.stack([_arm(score, side, tuning, joints) for side in (LEFT, RIGHT)])
    # A hanging arm follows the mirror image of the other one a little.
    other = (arms[::-1].reshape(*arms.shape[:2], -1, 3) * MIRROR).reshape(arms.shape)
    arms = arms + other * score.hanging[..., None]
    arms[..., :12] *= 1.0 + score.micro[..., None]
    arms += score.drift[..., :arms.shape[-1]]
    arms = gaussian_filter1d(arms, score.damping * FPS, axis=1, mode="nearest")
    arms[..., :12] += score.leads[..., None] * (score.figure.home.reshape(2, 1, -1)[..., :12] - arms[..., :12])
    return arms


def _arm(score: _Score, side: int, tuning: _Tuning, joints: int | None) -> Array:
    figure, events = score.figure, score.events[side]
    home = figure.home[side][:joints].ravel()
    out = np.zeros((score.frames, home.size))
    for event, following in zip(events, (*events[1:], None), strict=True):
        first = _frame(event.time)
        last = min(score.frames, _frame(following.time)) if following else score.frames
        if first >= last:
            continue
        times = np.arange(first, last) / FPS
        # The frames before the change give the velocity and acceleration of the new target there.
        around = np.concatenate([(first - np.array([3.0, 2.0, 1.0])) / FPS, times])
        target = _target(score, side, event, tuning, around, home)
        fade = event.fade * (tuning.fades[event.stroke] if event.stroke >= 0 else 1.0)
        target[3:] = target[3:] + living.quintic_offset(out[max(0, first - 3):first], target[:3], times, fade, FPS)
        out[first:last] = target[3:]
    return out


def _target(score: _Score, side: int, event: _Event, tuning: _Tuning, times: Array, home: Array) -> Array:
    """[M, A * 3] the log rotations that an event asks of the arm at `times`."""
    if event.stroke < 0:
        return np.repeat((event.level * home)[None], len(times), axis=0)
    p = score.planned[event.stroke]
    beat, accent = float(tuning.beats[event.stroke]), float(tuning.accents[event.stroke])
    key = (p.stroke.clip, p.start, side, beat, accent, home.size, len(times))
    if key not in score.targets:
        score.targets[key] = _followed(p, side, beat, accent, times, home)
    return score.targets[key].copy()


def _followed(p: Planned, side: int, beat: float, accent: float, times: Array, home: Array) -> Array:
    """[M, A * 3] log rotations of an arm that follows a stroke with its beat at `beat`."""
    times = times - p.lag[side]
    path = p.stroke.arm_at(side, _clip_time(p, beat, times), home.size // 3)
    if p.stroke.scripted:
        return path
    # A low beat would fall from the home pose to the thigh: it is lifted into gesture space.
    held = p.stroke.arm_at(side, np.array([p.stroke.beat]), _REACHING)[0]
    reach = home[:held.size]
    up = float(held @ reach) / max(float(reach @ reach), 1e-9)
    # Fingers keep their size: a fist scaled up would not be a hand.
    path[:, held.size - 3:held.size] *= _WRISTS
    path[:, :held.size] = p.gain * p.uneven[side] * (path + max(0.0, 0.6 - up) * home)[:, :held.size]
    peak, stop = beat - BRAKE * _FALL, beat + (1.0 - BRAKE) * _FALL
    raised = _pulse(times, peak - 0.36, peak) - _pulse(times, peak, stop)
    path[:, :held.size] *= 1.0 + accent * raised[:, None]
    return path


# --- Positions of the hands


def _turned(rest: Array, logs: Array) -> Array:
    """Local rotations [T, 4] of a joint from its rest [4] and log rotations [T, 3]."""
    return rotation.multiply(rest[None], rotation.from_exponential_map(logs))


def _carried(figure: PerformerBody, trunk: Array) -> tuple[Array, Array]:
    """Position [T, 3] and world rotation [T, 4] of the parent of both shoulders, in the facing frame."""
    carrier = figure.skeleton.parents[figure.arms[LEFT][0]]
    place = np.zeros((len(trunk), 3))
    world = rotation.remove_yaw(_turned(figure.rest[0], trunk[:, 0]))
    for k, joint in list(enumerate(figure.trunk))[1:figure.trunk.index(carrier) + 1]:
        place = place + rotation.rotate(world, figure.skeleton.offsets[joint])
        world = rotation.multiply(world, _turned(figure.rest[joint], trunk[:, k]))
    return place, world


def _chain(score: _Score, arms: Array, side: int) -> dict[str, Array]:
    """Positions [T, 3] of shoulder, arm, forearm and hand of a side, the hips at the origin, in the facing frame."""
    figure = score.figure
    place, world = score.chest
    out: dict[str, Array] = {}
    for k, joint in enumerate(figure.arms[side][:_REACHING]):
        place = place + rotation.rotate(world, figure.skeleton.offsets[joint])
        out[figure.skeleton.names[joint].removeprefix(SIDES[side])] = place
        if k < _REACHING - 1:
            world = rotation.multiply(world, _turned(figure.rest[joint], arms[side][:, 3 * k:3 * k + 3]))
    return out


def _misses(score: _Score, arms: Array) -> tuple[Array, NDArray[np.bool_]]:
    """[strokes] seconds by which the acting arms decelerate later than planned (infinite: not within `_MISS`), and
    whether faintly."""
    chains = [_chain(score, arms, side) for side in (LEFT, RIGHT)]
    moving = [np.stack([chain["Hand"], chain["ForeArm"]], axis=1) for chain in chains]
    acting = {"left": moving[0], "right": moving[1], "both": np.concatenate(moving, axis=1)}
    brakes = {name: _brakes(positions) for name, positions in acting.items()}
    # The apex of a take from a script is where its marks say, and nothing has to be found.
    near = [(0.0, np.inf) if p.stroke.scripted else _nearest(p.beat, *brakes[p.stroke.hand]) for p in score.planned]
    return np.array([miss for miss, _ in near]), np.array([depth < _CLEARLY for _, depth in near], dtype=bool)


def _brakes(positions: Array) -> tuple[Array, Array]:
    """Motion beats in seconds of joints [T, n, 3], and the deceleration at each over half its standard deviation."""
    speed = acting_speed(positions, FPS)
    times = beats_of_speed(speed, FPS)
    slope = -np.gradient(speed) * FPS
    return times, np.interp(times * FPS, np.arange(len(speed)), slope) / max(0.5 * float(slope.std()), 1e-6)


def _nearest(beat: float, times: Array, depths: Array) -> tuple[float, float]:
    """Delay and strength of the strongest deceleration near a beat, weighted by closeness."""
    near = np.flatnonzero(np.abs(times - beat) < _MISS)
    if not len(near):
        return np.inf, 0.0
    best = near[(depths[near] * np.exp(-((times[near] - beat) / 0.12) ** 2)).argmax()]
    return float(times[best] - beat), float(depths[best])


def _leads(score: _Score, arms: Array) -> Array:
    """[2, T] share by which to lead each arm to the home pose, so that it stays out of the body and in front."""
    chains = [_chain(score, arms, side) for side in (LEFT, RIGHT)]
    depth = np.stack([_trespass(score, chains, side) for side in (LEFT, RIGHT)])
    near = maximum_filter1d(np.clip(depth / _FULL_TRESPASS, 0.0, 1.0), round(0.3 * FPS) | 1, axis=1)
    return gaussian_filter1d(near, 0.08 * FPS, axis=1, mode="nearest")


def _trespass(score: _Score, chains: list[dict[str, Array]], side: int) -> Array:
    """[T] metres by which an arm leaves its space: hand inside torso or head or too high, elbow behind the back."""
    arm, other = chains[side], chains[1 - side]
    chest, hips = score.chest[0], np.zeros_like(score.chest[0])
    head = arm["Arm"] * 0.5 + other["Arm"] * 0.5 + np.array([0.0, 0.27, 0.06])
    across = (arm["Arm"] - other["Arm"]) * (1.0 if side == LEFT else -1.0)
    forward = np.cross(across, np.array([0.0, 1.0, 0.0]))
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    behind = np.sum((arm["Arm"] - arm["ForeArm"]) * forward, axis=-1) - _BEHIND
    # Hands above the shoulders are rare in speech; they come from a large clip that is scaled up.
    high = _HIGH_SHARE * (arm["Hand"][:, 1] - arm["Arm"][:, 1] - _HIGH)
    return np.maximum.reduce([capsule_depth(arm["Hand"], hips, chest, TORSO_RADIUS + 0.01),
                              capsule_depth(arm["Hand"], head, head + np.array([0.0, 0.01, 0.0]), HEAD_RADIUS + 0.05),
                              np.maximum(behind, 0.0), np.maximum(high, 0.0)])


# --- The finished motion


def _assemble(score: _Score, arms: Array) -> Motion:
    figure = score.figure
    skeleton = figure.skeleton
    rotations = np.repeat(figure.rest[None], score.frames, axis=0)
    for k, joint in enumerate(figure.trunk):
        rotations[:, joint] = _turned(figure.rest[joint], score.trunk[:, k])
    for side in (LEFT, RIGHT):
        logs = arms[side].reshape(score.frames, -1, 3)
        logs = np.concatenate([logs[:, :_REACHING], living.living_fingers(logs[:, _REACHING:], side)], axis=1)
        for k, joint in enumerate(figure.arms[side]):
            rotations[:, joint] = _turned(figure.rest[joint], logs[:, k])
    # The feet stay in place: the legs undo the turn of the hips, and the hips turn about the hip sockets.
    still = rotation.multiply(rotation.conjugate(rotations[:, 0]), figure.rest[0][None])
    legs = [joint for joint, name in enumerate(skeleton.names) if name.endswith("UpLeg")]
    root = np.repeat(figure.root[None], score.frames, axis=0)
    if legs:
        rotations[:, legs] = rotation.multiply(still[:, None], figure.rest[legs])
        sockets = skeleton.offsets[legs].mean(axis=0)
        root = root + rotation.rotate(figure.rest[0], sockets) - rotation.rotate(rotations[:, 0], sockets)
    return Motion(skeleton, rotation.continuous(rotation.normalise(rotations)), root, FPS)
