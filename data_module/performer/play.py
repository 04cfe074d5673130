"""A plan becomes motion: two arms and a body, joined without seams, in time with the plan.

Each arm is a track of log rotations against rest. It follows one target at a time (hanging, the home pose in front of
the body, a stroke's clip); when the target changes, what is left of the old motion (its place, velocity and
acceleration against the new target) dies away by a quintic. The motion is made, its beats are measured on the hands,
the strokes are shifted by what is missing, and it is made again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from data_module.motion import rotation
from data_module.motion.motion_beats import acting_speed, beats_of_speed
from data_module.performer import plan as planning
from data_module.performer.hands import Manner, waiting_levels
from data_module.performer.inertialisation import quintic_offset
from data_module.performer.living_fingers import living_fingers
from data_module.performer.plan import BRAKE, Casting, Habits, Planned
from data_module.performer.strokes import LEFT, RIGHT, SIDES, PerformerBody, StrokeSet
from data_module.performer.styles import NEUTRAL, StyleTrack
from data_module.performer.trunk import Segment, idle_arms, kept_ahead, postures, spread, sway, trunk_track
from data_module.performer.types import Played, Spoken
from data_module.truth import PlayedStroke
from data_module.types import Array, Motion

FPS = 60.0
"""Frames per second of the finished motion: twice that of the clips, so that a brake can be moved by half a frame."""

# How the motion is fitted to its plan.
_PASSES = 6
"""Times at most that the motion is made to bring the brakes to their beats; each costs a rendering of both arms."""
_ROUNDS = 4
"""Times at most that strokes which cannot be put in time are left out and the others fitted again."""
_DETOURS = 2
"""Times at most that the arms are led around the body, each time with a new fit."""
_CLEAR = 0.1
"""Share of the way to the home pose; an arm that needs to be led by less is left as it is."""
_REACHING = 4
"""Joints of an arm, from the shoulder to the hand, that place the hand; the fingers do not."""
_MISS = 0.35
"""Seconds around a planned beat in which its brake is looked for: less than the shortest gap between strokes."""
_CLEARLY = 1.2
"""Half standard deviations of the arm's deceleration (see `_brakes`) below which a brake is faint and accented more."""
_ACCURATE = 0.008
"""Seconds: half a frame, and no try moves a beat that is closer."""
_TOLERANCE = 0.018
"""Seconds: about one frame; a stroke that still misses by more is left out."""
_ACCENT = 0.12
"""Share by which the excursion of a beat is raised before it falls on the beat, at first."""
_MOST_ACCENT = 0.48
"""The same at most, after the steps of `_tuned`: half as far again would throw the arm up."""
_FARTHEST = 0.15
"""Seconds that the clip's own beat may be moved to meet the planned one, so that its preparation keeps its shape."""
_FADE_SHARE = 0.65
"""Share of the preparation in which the old motion dies away, so that the last third is the clip's own."""

# When the arms go up and down.
_RAISE = 0.7
"""Seconds in which an arm goes up before the first word of a run of phrases."""
_DROP = 1.0
"""Seconds in which it goes down after the last, slower than it goes up."""
_HANGING_LEVEL = 0.1
"""Share of the home pose at which the arm that takes no part hangs, so that its elbow is not quite straight."""
_SYMPATHY = 0.4
"""Share of the other arm's motion that a hanging arm follows."""

# Small beats between strokes.
_MICRO = 0.42
"""Share by which the excursion of an arm is raised for a small beat on an ordinary syllable."""
_FALL = 0.22
"""Seconds in which a raised arm falls; it brakes, and has its beat, at the share `BRAKE` of them."""
_BEFORE_SMALL = 0.18
"""Seconds in which it rises before."""
_SMALL_GAP = 0.36
"""Seconds between small beats at least: about a rise and a fall."""
_LEAST_SMALL = -0.3
"""Prominence from which a syllable gets a small beat, where no manner says otherwise."""
_SMALL_OF_STYLE = np.array([0.5, 0.3])
"""Log of the size of small movements, by amplitude and tempo."""
_NOD_GAIN = 1.3
"""Times a performer's nods on a real person's trunk: what was laid under the speech is not tied to it."""

# Where an arm may be.
_HIPS_SHARE = 0.4
"""Share of a clip's own turn of the hips that is played: the feet stand still here."""
_MIRRORED = np.array([1.0, -1.0, -1.0])
"""Signs of log rotations in a mirror at x = 0."""
TORSO_RADIUS = 0.115
"""Metres of the capsule that stands for the torso: half the depth of an adult's chest."""
HEAD_RADIUS = 0.105
"""Metres of the sphere that stands for the head, hair counted."""
_BEHIND = 0.08
"""Metres that an elbow may be behind its shoulder."""
_HIGH, _HIGH_SHARE = 0.10, 0.3
"""Metres above the shoulder from which a hand counts as too high, and the share of the rest that counts as trespass."""
_FULL_TRESPASS = 0.06
"""Metres inside the body at which an arm is led to the home pose altogether."""


_Levels = tuple[list[tuple[float, float]], list[tuple[float, float]]]


@dataclass(frozen=True)
class _Event:
    """From `time` on an arm follows a stroke (its index), or holds a share of the home pose (`level`; 0 is rest).

    fade: seconds in which the old motion dies away; for a stroke, its preparation.
    """

    time: float
    fade: float
    stroke: int = -1
    level: float = 0.0


@dataclass(frozen=True)
class _Tuning:
    """What changes from pass to pass, per stroke.

    beats: seconds that the clip's beat is put at. accents: how far the arm is raised before it falls on the beat.
    fades: share of the preparation in which the old motion dies away. slow: where that, not the clip, makes the beat.
    """

    beats: Array
    accents: Array
    fades: Array
    slow: NDArray[np.bool_]

    def of(self, mask: NDArray[np.bool_]) -> _Tuning:
        """That of the strokes where `mask` holds."""
        return _Tuning(self.beats[mask], self.accents[mask], self.fades[mask], self.slow[mask])

    def where(self, mask: NDArray[np.bool_], other: _Tuning) -> _Tuning:
        """Its own values where `mask` holds, those of `other` elsewhere."""
        return _Tuning(np.where(mask, self.beats, other.beats), np.where(mask, self.accents, other.accents),
                       np.where(mask, self.fades, other.fades), np.where(mask, self.slow, other.slow))


@dataclass(frozen=True)
class _Score:
    """Everything that stays the same from pass to pass.

    events: per arm. micro: [2, T] how far each arm's excursion is raised, 1 is not at all. drift: [2, T, A * 3].
    trunk: [T, B, 3] log rotations of hips to head. hanging: [2, T] share of the other arm's motion that an arm takes
    part in while it hangs. leads: [2, T] share by which an arm is led to the home pose, to keep it out of the body.
    chest: place and rotation of the joint that carries the shoulders. runs, levels: what the events were made of; drop:
    seconds in which an arm comes to rest.
    made: targets that need not be computed again.
    """

    figure: PerformerBody
    planned: tuple[Planned, ...]
    events: tuple[tuple[_Event, ...], tuple[_Event, ...]]
    micro: Array
    drift: Array
    trunk: Array
    hanging: Array
    leads: Array
    chest: tuple[Array, Array]
    runs: list[tuple[float, float]]
    levels: _Levels
    drop: float
    frames: int
    made: dict[tuple[object, ...], Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Staging:
    """What a talk is performed with beside strokes: a manner, real people's trunks, and a style."""

    manner: Manner
    segments: tuple[Segment, ...]
    style: StyleTrack = NEUTRAL


def perform(spoken: Spoken, performer: str, strokes: StrokeSet, rng: np.random.Generator,
            split: str = "train", staging: Staging | None = None) -> Played:
    """Play `spoken` with the body and the strokes of `performer`: 60 fps on her own skeleton, with its truth.

    With `staging` the hands act apart and the trunk is a real person's; without it both hands play every phrase and the
    trunk sways by formula.

    The performance depends on the arguments and the state of `rng` alone. In the split "test" the strokes kept for it
    are played among the others. InputError when the performer is unknown.
    """
    casting = planning.cast(spoken, performer, staging.manner, staging.style, rng) if staging else None
    planned = planning.plan(spoken, performer, strokes, rng, split, casting)
    segments = staging.segments if staging else ()
    score = _score(strokes.figures[performer], planned, spoken, planning.habits_of(performer), (casting, segments), rng)
    tuning = _first_tuning(planned)
    for _ in range(_DETOURS):
        score, tuning, arms = _rehearse(score, tuning)
        trespass = _leads(score, arms)
        if trespass.max() <= _CLEAR:
            break
        score = replace(score, leads=np.maximum(score.leads, trespass))
    else:
        score, tuning, _ = _rehearse(score, tuning)
    return Played(_assemble(score, _render(score, tuning)), tuple(_truth(p) for p in score.planned), performer)


def _rehearse(score: _Score, tuning: _Tuning) -> tuple[_Score, _Tuning, Array]:
    """The score without the strokes whose beat cannot be put where it belongs, how to play it, and the arms so far."""
    for turn in range(_ROUNDS):
        arms, tuning, missing = _on_time(score, tuning)
        good = np.abs(missing) <= _TOLERANCE
        if good.all() or turn == _ROUNDS - 1:
            break
        good &= ~_echoes(score.planned, good)
        kept = tuple(p for p, fine in zip(score.planned, good, strict=True) if fine)
        score = replace(score, planned=kept, events=_both_events(kept, score.runs, score.levels, score.drop))
        tuning = tuning.of(good)
    return score, tuning, arms


def _echoes(planned: tuple[Planned, ...], good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which strokes would repeat the clip of the one before, once those that are not good are left out."""
    out = np.zeros(len(planned), dtype=bool)
    last = ""
    for k, p in enumerate(planned):
        if good[k]:
            out[k] = p.stroke.base == last
            last = p.stroke.base
    return out


def _first_tuning(planned: tuple[Planned, ...]) -> _Tuning:
    accents = [_ACCENT * (1.0 if p.stroke.lexeme.startswith("Beat") else 0.6) for p in planned]
    return _Tuning(np.array([p.beat for p in planned]), np.array(accents), np.full(len(planned), _FADE_SHARE),
                   np.zeros(len(planned), dtype=bool))


def _on_time(score: _Score, tuning: _Tuning) -> tuple[Array, _Tuning, Array]:
    """Both arms, [2, T, 12], made again until their brakes fall where they were planned.

    Also what they were made with, and what each stroke still misses by in seconds. A stroke that brakes late is moved
    earlier, and the other way round. One that still misses is accented more; one that brakes early, because the way
    to the clip is longer than the clip's own, takes all its preparation for it.
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
    """How far each brake moved per second that it was told to move, from the last two tries (the secant), in bounds."""
    if before is None:
        return np.ones(len(preparation))
    told = np.where(now[0].slow, (now[0].fades - before[0].fades) * preparation, now[0].beats - before[0].beats)
    known = (np.abs(told) > 0.004) & (now[0].slow == before[0].slow) & np.isfinite(now[1]) & np.isfinite(before[1])
    moved = np.where(known, np.where(known, now[1], 0.0) - np.where(known, before[1], 0.0), 0.0)
    return np.where(known, np.clip(moved / np.where(known, told, 1.0), 0.5, 1.6), 1.0)


def _tuned(tuning: _Tuning, missing: Array, faint: NDArray[np.bool_], answer: Array, planned: Array,
           preparation: Array) -> _Tuning:
    """The next try, from what the last one missed by (seconds, late is positive; infinite where nothing brakes)."""
    beats, accents, fades = tuning.beats, tuning.accents, tuning.fades
    found = np.isfinite(missing)
    known = np.where(found, missing, 0.0)
    step = np.where(np.abs(known) > _ACCURATE, known, 0.0) / answer
    slow = tuning.slow | (known < -_FARTHEST) | ((known < -0.02) & (beats > planned + 0.9 * _FARTHEST))
    fades = np.where(slow, np.clip(np.where(tuning.slow, fades - step / preparation, 1.0 / BRAKE), 0.8, 2.0), fades)
    beats = np.where(slow, planned, np.clip(beats - step, planned - _FARTHEST, planned + _FARTHEST))
    more = np.where(faint, 0.12, np.where(np.abs(known) > 0.015, 0.06, 0.0))
    return _Tuning(beats, np.minimum(accents + more, _MOST_ACCENT), fades, slow)


def _truth(p: Planned) -> PlayedStroke:
    s = p.stroke
    return PlayedStroke(s.lexeme, s.clip, s.hand, p.start, p.beat, p.hold_end, p.end, p.syllable, p.gain, s.held_out)


# --- What stays the same from pass to pass


def _score(figure: PerformerBody, planned: tuple[Planned, ...], spoken: Spoken, habits: Habits,
           staged: tuple[Casting | None, tuple[Segment, ...]], rng: np.random.Generator) -> _Score:
    casting, segments = staged
    manner = casting.manner if casting else None
    frames = max(2, round(spoken.speech.duration * FPS))
    runs = planning.runs_of(spoken.phrases)
    levels = _levels_apart(spoken, runs, casting, rng) if casting else _levels(spoken, runs, habits, rng)
    drop = manner.drop if manner else _DROP
    events = _both_events(planned, runs, levels, drop)
    lively = np.stack([_lively(arm, frames) for arm in events])
    speaking = lively.max(axis=0)
    wander = manner.drift if manner else 1.0
    drift = np.stack([_drift(figure, lively[side], wander, frames, rng) for side in (LEFT, RIGHT)])
    if manner and segments:
        joints = min(drift.shape[-1], 12)
        fidgets = idle_arms(segments, frames, rng)
        drift[..., :joints] += (1.0 - lively)[..., None] * fidgets[..., :joints]
    size = _style_of(casting, frames)
    drift *= size[:, None]
    least = manner.small_beats if manner else _LEAST_SMALL
    micro = size * np.stack([_micro(side, spoken, planned, least, frames, rng) for side in (LEFT, RIGHT)])
    if manner and segments:
        trunk = _living_trunk(figure, planned, spoken, segments, (speaking, manner.trunk, habits), rng)
    else:
        trunk = _trunk(figure, planned, spoken, habits, speaking, frames, rng)
    sympathy = manner.sympathy if manner else _SYMPATHY
    hanging = sympathy * np.stack([_hanging(arm, frames) for arm in events])
    return _Score(figure, planned, events, micro, drift, trunk, hanging, np.zeros((2, frames)),
                  _carried(figure, trunk), runs, levels, drop, frames)


def _style_of(casting: Casting | None, frames: int) -> Array:
    """[T] what a style multiplies the arms' wandering and small beats by."""
    if casting is None:
        return np.ones(frames)
    return np.exp(casting.style.at(np.arange(frames) / FPS) @ _SMALL_OF_STYLE)


def _levels_apart(spoken: Spoken, runs: list[tuple[float, float]], casting: Casting,
                  rng: np.random.Generator) -> _Levels:
    """Per arm [(time, share of home)] of hands that act apart."""
    vigour = planning.drives(spoken)
    starts = np.array([s.vowel for s in spoken.syllables])
    drives = []
    for phrase in casting.hands:
        inside = (starts >= phrase.start) & (starts < phrase.end)
        drives.append(float(vigour[inside].mean()) if inside.any() else 0.0)
    return waiting_levels(casting.hands, drives, [start for start, _ in runs], _RAISE, casting.manner, rng)


def _levels(spoken: Spoken, runs: list[tuple[float, float]], habits: Habits,
            rng: np.random.Generator) -> _Levels:
    """Per arm [(time, share of home)]: how high it waits in each phrase; now and then one hangs."""
    out: _Levels = ([], [])
    weak = LEFT if habits.hands[RIGHT] > habits.hands[LEFT] else RIGHT
    vigour = planning.drives(spoken)
    starts = np.array([s.vowel for s in spoken.syllables])
    for start, end in runs:
        phrases = [p for p in spoken.phrases if start <= p.start < end]
        for k, phrase in enumerate(phrases):
            inside = (starts >= phrase.start) & (starts < phrase.end)
            drive = float(vigour[inside].mean()) if inside.any() else 0.0
            hanging = rng.random() < habits.hanging
            side_hanging = weak if rng.random() < 0.7 else 1 - weak
            draws = rng.uniform(0.8, 1.1, 2) * np.exp(0.15 * drive)
            if k and rng.random() < 0.4:
                continue
            for side in (LEFT, RIGHT):
                level = _HANGING_LEVEL if hanging and side == side_hanging else float(draws[side])
                out[side].append((start - _RAISE if k == 0 else phrase.start - 0.3, level))
    return out


def _both_events(planned: tuple[Planned, ...], runs: list[tuple[float, float]],
                 levels: _Levels, drop: float) -> tuple[tuple[_Event, ...], tuple[_Event, ...]]:
    left, right = (_events(side, planned, runs, levels[side], drop) for side in (LEFT, RIGHT))
    return left, right


def _events(side: int, planned: tuple[Planned, ...], runs: list[tuple[float, float]],
            levels: list[tuple[float, float]], drop: float) -> tuple[_Event, ...]:
    """The targets of one arm in order of time."""
    own = [(k, p) for k, p in enumerate(planned) if side in p.stroke.sides]
    changes = np.array([time for time, _ in levels])

    def level_at(time: float) -> float:
        before = np.flatnonzero(changes <= time + 1e-9)
        return levels[before[-1]][1] if len(before) else 0.0

    events = [_Event(0.0, 0.1)]
    spans = [(p.start, p.hold_end) for _, p in own]
    for time, level in levels:
        if not any(a - 0.35 <= time < b for a, b in spans):
            events.append(_Event(max(time, 0.0), _RAISE if time > 0.05 else 0.5, level=level))
    for k, p in own:
        events.append(_Event(p.start, p.beat - p.start, stroke=k))
        events.append(_Event(p.hold_end, max(p.end - p.hold_end, 0.5), level=level_at(p.hold_end)))
    for _, end in runs:
        late = max([b for a, b in spans if a < end + 0.4], default=0.0)
        events.append(_Event(max(end + 0.25, late + 0.02), drop))
    starts = {p.start for _, p in own}
    events.sort(key=lambda e: (e.time, e.stroke >= 0))
    return tuple(e for e in events if e.stroke >= 0 or e.time not in starts)


def _hanging(events: tuple[_Event, ...], frames: int) -> Array:
    """[T] 1 where the arm hangs through a phrase, 0 elsewhere, with soft edges."""
    out = np.zeros(frames)
    for event, following in zip(events, (*events[1:], None), strict=True):
        if event.stroke < 0 and 0 < event.level <= _HANGING_LEVEL:
            out[_frame(event.time):_frame(following.time) if following else frames] = 1.0
    return gaussian_filter1d(out, 0.2 * FPS, mode="nearest")


def _lively(events: tuple[_Event, ...], frames: int) -> Array:
    """[T] 0 where the arm is at rest, 1 where it is not, with soft edges."""
    out = np.zeros(frames)
    for event, following in zip(events, (*events[1:], None), strict=True):
        if event.stroke >= 0 or event.level > 0:
            out[_frame(event.time):_frame(following.time) if following else frames] = 1.0
    return gaussian_filter1d(out, 0.25 * FPS, mode="nearest")


def _frame(time: float) -> int:
    return max(0, int(np.ceil(time * FPS - 1e-6)))


def _wander(frames: int, channels: int, period: float, rng: np.random.Generator) -> Array:
    """Smooth noise [T, channels] of unit standard deviation that changes within about `period` seconds.

    Independent knots joined by a cubic: cheap, and free of the slow trend a low-pass filter leaves.
    """
    knots = int(np.ceil(frames / FPS / (period / 4.0))) + 4
    values = gaussian_filter1d(rng.normal(size=(knots, channels)), 1.0, axis=0)
    times = (np.arange(knots) - 1.0) * period / 4.0
    curve = PchipInterpolator(times, values)(np.arange(frames) / FPS)
    return curve / 0.52


def _drift(figure: PerformerBody, lively: Array, wander: float, frames: int, rng: np.random.Generator) -> Array:
    """[T, A * 3] the arm's own slow wandering: degrees while it is up, a trace of it at rest."""
    joints = len(figure.arms[0])
    share = np.zeros((joints, 3))
    share[:4] = np.radians([[1.5] * 3, [7.5] * 3, [11.5] * 3, [8.0] * 3])
    share[4:] = np.radians(2.0)
    slow = _wander(frames, joints * 3, 1.5, rng)
    idle = _wander(frames, joints * 3, 4.0, rng)
    return (wander * slow * (0.02 + 0.98 * lively)[:, None] + idle * 0.03) * share.ravel()


def _pulse(times: Array, start: float, end: float) -> Array:
    """Minimum-jerk step from 0 to 1 between two times."""
    s = np.clip((times - start) / (end - start), 0.0, 1.0)
    return s ** 3 * (10.0 - 15.0 * s + 6.0 * s * s)


def _add_bump(track: Array, peak: float, stop: float, size: float, before: float = _BEFORE_SMALL) -> None:
    """Add to track [T] a bump that rises for `before` seconds until `peak` and falls until `stop`."""
    first, last = max(0, _frame(peak - before) - 1), min(len(track), _frame(stop) + 2)
    if first >= last:
        return
    times = np.arange(first, last) / FPS
    track[first:last] += size * (_pulse(times, peak - before, peak) - _pulse(times, peak, stop))


def _micro(side: int, spoken: Spoken, planned: tuple[Planned, ...], least: float, frames: int,
           rng: np.random.Generator) -> Array:
    """[T] small beats at syllables that no stroke of this arm takes: the arm is raised before and falls on them."""
    track = np.zeros(frames)
    # A small beat takes _BEFORE_SMALL seconds to rise: none of it may touch a stroke's own beat.
    spans = [(p.start - 0.05, p.beat + 0.15 + _FALL + _BEFORE_SMALL) for p in planned if side in p.stroke.sides]
    strength = planning.drives(spoken)
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


# --- The body


def _trunk(figure: PerformerBody, planned: tuple[Planned, ...], spoken: Spoken, habits: Habits, speaking: Array,
           frames: int, rng: np.random.Generator) -> Array:
    """[T, B, 3] log rotations of hips, spine, neck and head: sway, breath, nods, and the clips' own small motion."""
    names = [figure.skeleton.names[j] for j in figure.trunk]
    slow = gaussian_filter1d(speaking, 0.4 * FPS, mode="nearest")
    scale = (0.06 + 0.94 * slow)[:, None]
    yaw = _wander(frames, 1, 5.5, rng)[:, 0] * scale[:, 0] * np.radians(habits.sway)
    out = np.zeros((frames, len(names), 3))
    spines = [k for k, name in enumerate(names) if name.startswith("Spine")]
    skull = [k for k, name in enumerate(names) if name.startswith(("Neck", "Head"))]
    out[:, 0, 1] = 0.2 * yaw
    out[:, 0, [0, 2]] = _wander(frames, 2, 4.5, rng) * scale * np.radians(0.6)
    bend = _wander(frames, 3 * len(spines), 3.5, rng).reshape(frames, -1, 3) * scale[..., None]
    out[:, spines] = bend * np.radians([1.5, 1.0, 1.2])
    out[:, spines, 1] += 0.8 / len(spines) * yaw[:, None]
    out[:, spines[-1], 0] += _breath(frames)
    turns = _wander(frames, 3 * len(skull), 2.4, rng).reshape(frames, -1, 3) * scale[..., None]
    out[:, skull] = turns * np.radians([1.8, 2.6, 1.5])
    # The eyes stay with the listener: the head turns back half of what the torso turns.
    out[:, skull, 1] -= 0.5 / len(skull) * yaw[:, None]
    out[:, skull, 0] += (_nods(spoken, habits, frames, rng) / len(skull))[:, None]
    _add_clips(out, planned)
    return out


def _living_trunk(figure: PerformerBody, planned: tuple[Planned, ...], spoken: Spoken, segments: tuple[Segment, ...],
                  life: tuple[Array, float, Habits], rng: np.random.Generator) -> Array:
    """[T, B, 3] log rotations of hips, spine, neck and head: a real person's, with postures, nods and breath."""
    speaking, gain, habits = life
    frames = len(speaking)
    names = [figure.skeleton.names[j] for j in figure.trunk]
    spines = [k for k, name in enumerate(names) if name.startswith("Spine")]
    skull = [k for k, name in enumerate(names) if name.startswith(("Neck", "Head"))]
    hips, spine, head = spread(trunk_track(segments, spoken, speaking, gain, rng), (1, len(spines), len(skull)))
    posture = postures(frames, rng)
    out = np.zeros((frames, len(names), 3))
    out[:, 0] = hips
    out[:, spines] = (spine + posture[:, 0] / len(spines))[:, None]
    out[:, skull] = (head + posture[:, 1] / len(skull))[:, None]
    out[:, skull, 0] += (_NOD_GAIN * _nods(spoken, habits, frames, rng) / len(skull))[:, None]
    out[:, spines[-1], 0] += _breath(frames)
    out[:, spines] += (sway(frames, rng) * (1.0 - 0.7 * speaking)[:, None] / len(spines))[:, None]
    _add_clips(out, planned)
    out[..., 1] *= kept_ahead(out[..., 1].sum(axis=1))
    return out


def _breath(frames: int) -> Array:
    """[T] radians: the chest rises and falls about fifteen times a minute."""
    return np.radians(0.5) * np.sin(2.0 * np.pi * np.arange(frames) / FPS / 3.9)


def _nods(spoken: Spoken, habits: Habits, frames: int, rng: np.random.Generator) -> Array:
    """[T] radians forward: the head dips on stressed syllables."""
    track = np.zeros(frames)
    draws = rng.random((2, len(spoken.syllables)))
    for i, syllable in enumerate(spoken.syllables):
        if syllable.prominence > 0.3 and draws[0, i] < 0.6:
            size = np.radians(habits.nod) * (0.6 + 0.9 * draws[1, i])
            _add_bump(track, syllable.vowel + 0.03, syllable.vowel + 0.4, float(size), before=0.24)
    return track


def _add_clips(trunk: Array, planned: tuple[Planned, ...]) -> None:
    """Add the torso's motion of each clip, faded in and out with its stroke."""
    for p in planned:
        first, last = _frame(p.start), min(len(trunk), _frame(p.end))
        if last - first < 4:
            continue
        times = np.arange(first, last) / FPS
        window = _pulse(times, p.start, p.beat) * (1.0 - _pulse(times, min(p.hold_end, p.end - 0.2), p.end))
        inside = p.stroke.trunk_at(_clip_time(p, p.beat, times)) - p.stroke.trunk_at(np.array([p.stroke.start]))
        own = inside.reshape(len(times), -1, 3)
        # Some clips turn on the spot; here the feet stand still, so the hips take part less.
        own[:, 0] *= _HIPS_SHARE
        trunk[first:last] += window[:, None, None] * own


# --- The arms


def _clip_time(p: Planned, beat: float, times: Array) -> Array:
    """Seconds in the clip for seconds of the performance [M]: a monotone cubic through start, beat, hold end, end."""
    s = p.stroke
    hold_end = max(p.hold_end, beat + 0.05)
    end = max(p.end, hold_end + (s.end - s.hold_end) / 1.4)
    return monotone_cubic(np.array([p.start, beat, hold_end, end]), np.array([s.start, s.beat, s.hold_end, s.end]),
                          times)


def monotone_cubic(x: Array, y: Array, at: Array) -> Array:
    """A rising cubic through knots x [K], y [K], at places [M]; straight on beyond the ends.

    The tangent at an inner knot is the harmonic mean of the slopes beside it (Fritsch and Butland 1984), which keeps
    the curve from turning back.
    """
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
    """[2, T, joints * 3] both arms, as many joints from the shoulder on as asked for (all when not told)."""
    arms = np.stack([_arm(score, side, tuning, joints) for side in (LEFT, RIGHT)])
    # The arm that hangs follows the other one a little, in the mirror.
    follow = np.stack([_mirrored(arms[RIGHT]) * score.hanging[LEFT][:, None],
                       _mirrored(arms[LEFT]) * score.hanging[RIGHT][:, None]])
    arms = arms + follow
    arms[..., :12] *= 1.0 + score.micro[..., None]
    arms += score.drift[..., :arms.shape[-1]]
    arms[..., :12] += score.leads[..., None] * (score.figure.home.reshape(2, 1, -1)[..., :12] - arms[..., :12])
    return arms


def _mirrored(arm: Array) -> Array:
    """Log rotations [T, A * 3] of an arm as the other arm has them in the mirror."""
    return (arm.reshape(len(arm), -1, 3) * _MIRRORED).reshape(len(arm), -1)


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
        # Two frames before the change tell the new target's own velocity there.
        around = np.concatenate([(first - np.array([3.0, 2.0, 1.0])) / FPS, times])
        target = _target(score, side, event, tuning, around, home)
        fade = event.fade * (tuning.fades[event.stroke] if event.stroke >= 0 else 1.0)
        target[3:] = target[3:] + quintic_offset(out[max(0, first - 3):first], target[:3], times, fade, FPS)
        out[first:last] = target[3:]
    return out


def _target(score: _Score, side: int, event: _Event, tuning: _Tuning, times: Array, home: Array) -> Array:
    """[M, A * 3] where an event wants the arm at `times`."""
    if event.stroke < 0:
        return np.repeat((event.level * home)[None], len(times), axis=0)
    p = score.planned[event.stroke]
    beat, accent = float(tuning.beats[event.stroke]), float(tuning.accents[event.stroke])
    key = (p.stroke.clip, p.start, side, beat, accent, home.size, len(times))
    if key not in score.made:
        score.made[key] = _followed(p, side, beat, accent, times, home)
    return score.made[key].copy()


def _followed(p: Planned, side: int, beat: float, accent: float, times: Array, home: Array) -> Array:
    """[M, A * 3] an arm that follows a stroke whose beat is put at `beat`."""
    times = times - p.lag[side]
    path = p.stroke.arm_at(side, _clip_time(p, beat, times), home.size // 3)
    # A low beat would fall from the home pose to the thigh: it is lifted into gesture space.
    held = p.stroke.arm_at(side, np.array([p.stroke.beat]), _REACHING)[0]
    reach = home[:held.size]
    up = float(held @ reach) / max(float(reach @ reach), 1e-9)
    # Fingers are told as they were: a fist played larger would be no hand.
    path[:, :held.size] = p.gain * p.uneven[side] * (path + max(0.0, 0.6 - up) * home)[:, :held.size]
    peak, stop = beat - BRAKE * _FALL, beat + (1.0 - BRAKE) * _FALL
    raised = _pulse(times, peak - 0.26, peak) - _pulse(times, peak, stop)
    path[:, :held.size] *= 1.0 + accent * raised[:, None]
    return path


# --- Where the hands are


def _turned(rest: Array, logs: Array) -> Array:
    """Local rotations [T, 4] of a joint from its rest [4] and log rotations [T, 3]."""
    return rotation.multiply(rest[None], rotation.from_exponential_map(logs))


def _carried(figure: PerformerBody, trunk: Array) -> tuple[Array, Array]:
    """Place [T, 3] and world rotation [T, 4] of the joint that both shoulders hang on, in the facing frame."""
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
    """[strokes] seconds by which the acting arms brake later than planned (infinite: nowhere near), and if faintly."""
    chains = [_chain(score, arms, side) for side in (LEFT, RIGHT)]
    moving = [np.stack([chain["Hand"], chain["ForeArm"]], axis=1) for chain in chains]
    acting = {"left": moving[0], "right": moving[1], "both": np.concatenate(moving, axis=1)}
    found = {name: _brakes(positions) for name, positions in acting.items()}
    near = [_nearest(p.beat, *found[p.stroke.hand]) for p in score.planned]
    return np.array([miss for miss, _ in near]), np.array([depth < _CLEARLY for _, depth in near], dtype=bool)


def _brakes(positions: Array) -> tuple[Array, Array]:
    """Motion beats in seconds of joints [T, n, 3], and how hard each brakes against half the standard deviation."""
    speed = acting_speed(positions, FPS)
    times = beats_of_speed(speed, FPS)
    slope = -np.gradient(speed) * FPS
    return times, np.interp(times * FPS, np.arange(len(speed)), slope) / max(0.5 * float(slope.std()), 1e-6)


def _nearest(beat: float, times: Array, depths: Array) -> tuple[float, float]:
    """How late the strongest brake near a beat is, and how strong; one farther away counts less."""
    near = np.flatnonzero(np.abs(times - beat) < _MISS)
    if not len(near):
        return np.inf, 0.0
    best = near[(depths[near] * np.exp(-((times[near] - beat) / 0.12) ** 2)).argmax()]
    return float(times[best] - beat), float(depths[best])


def _inside(point: Array, low: Array, high: Array, radius: float) -> Array:
    """[T] how deep points [T, 3] lie inside a capsule between two points [T, 3], metres, 0 outside."""
    axis = high - low
    share = np.clip(np.sum((point - low) * axis, axis=-1) / np.sum(axis * axis, axis=-1), 0.0, 1.0)
    return np.maximum(0.0, radius - np.linalg.norm(point - low - share[:, None] * axis, axis=-1))


def _leads(score: _Score, arms: Array) -> Array:
    """[2, T] how far to lead each arm to the home pose, so that it stays out of the body and before the back."""
    chains = [_chain(score, arms, side) for side in (LEFT, RIGHT)]
    depth = np.stack([_trespass(score, chains, side) for side in (LEFT, RIGHT)])
    near = maximum_filter1d(np.clip(depth / _FULL_TRESPASS, 0.0, 1.0), round(0.3 * FPS) | 1, axis=1)
    return gaussian_filter1d(near, 0.08 * FPS, axis=1, mode="nearest")


def _trespass(score: _Score, chains: list[dict[str, Array]], side: int) -> Array:
    """[T] metres by which an arm is where it should not be: hand in torso or head or far up, elbow at the back."""
    own, other = chains[side], chains[1 - side]
    chest, hips = score.chest[0], np.zeros_like(score.chest[0])
    head = own["Arm"] * 0.5 + other["Arm"] * 0.5 + np.array([0.0, 0.27, 0.06])
    across = (own["Arm"] - other["Arm"]) * (1.0 if side == LEFT else -1.0)
    forward = np.cross(across, np.array([0.0, 1.0, 0.0]))
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    behind = np.sum((own["Arm"] - own["ForeArm"]) * forward, axis=-1) - _BEHIND
    # Hands above the shoulders are seldom seen in speech; arms thrown up come from a large clip played larger.
    high = _HIGH_SHARE * (own["Hand"][:, 1] - own["Arm"][:, 1] - _HIGH)
    return np.maximum.reduce([_inside(own["Hand"], hips, chest, TORSO_RADIUS + 0.01),
                              _inside(own["Hand"], head, head + np.array([0.0, 0.01, 0.0]), HEAD_RADIUS + 0.05),
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
        logs = np.concatenate([logs[:, :_REACHING], living_fingers(logs[:, _REACHING:], side)], axis=1)
        for k, joint in enumerate(figure.arms[side]):
            rotations[:, joint] = _turned(figure.rest[joint], logs[:, k])
    # The feet stay where they are: the legs take back what the hips turn, and the hips turn about their sockets.
    still = rotation.multiply(rotation.conjugate(rotations[:, 0]), figure.rest[0][None])
    legs = [joint for joint, name in enumerate(skeleton.names) if name.endswith("UpLeg")]
    root = np.repeat(figure.root[None], score.frames, axis=0)
    if legs:
        rotations[:, legs] = rotation.multiply(still[:, None], figure.rest[legs])
        sockets = skeleton.offsets[legs].mean(axis=0)
        root = root + rotation.rotate(figure.rest[0], sockets) - rotation.rotate(rotations[:, 0], sockets)
    return Motion(skeleton, rotation.continuous(rotation.normalise(rotations)), root, FPS)
