"""Does it rest where nothing is said, is it alive there, and does it gesture as much as requested?

The sounds are made for it (`stimuli`): voices with pauses of known lengths set into them, voices without any, a voice
46 dB too low in noise, noise alone, silence alone. Speeds are those of the wrists relative to the hips, m/s, the
mean of both unless stated otherwise; a real pause is one of a second or more, detected as the system detects it.

- At rest: speed from 2.5 s into a pause on to a second before the voice returns, over that in speech.
- Waxing and waning: variation of hand speed over windows of 4 s in speech whose pauses were cut out.
- Life: the longest freeze of the head; the share of frames in which a hand does not move at all.
- Waking: the peaks of acceleration and speed around the ends of long pauses, beside those of the corpus' seconds.
- Twitches: runs in which a hand exceeds 0.3 m/s (smoothed over 50 ms) for less than 0.15 s, a minute.
- Activity: share of the time in speech in which the lexeme is not a silent one, and in which a hand moves.

What fools it: a motion that is frozen throughout rests well; the group `motion` and the share of time in gesture refuse
it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from data_module.errors import InputError
from data_module.speech.audio import SAMPLE_RATE
from data_module.types import Array, Motion, Speech
from eval import stats
from eval.acceptance.bounds import Measured, Results
from eval.acceptance.stimuli import derived, faint, middle_of, noise, pauses_in, unbroken, with_pauses
from eval.clip.excerpts import spread_out
from eval.metrics.eye import common_body, hands, together, trunk
from eval.metrics.eye.body import HZ, CommonBody
from eval.renderings import TAKE, AcceptanceVoice, BundleSystem, Rendering
from eval.stats import Interval

RESTS_FROM, PREPARES = 2.5, 1.0
"""Seconds into a pause, and before its end, when a hand may begin to move."""
_LEAST = 0.2
"""Seconds of rest from which on a mean speed says something."""
LONG = 2.0
"""Seconds: waking is measured after pauses of this length."""
WAKE = (-0.2, 0.8)
"""Seconds around the end of a pause."""
USUAL, WORST = 95.0, 90.0
"""Percentiles: of the corpus' seconds, and of the wakes."""
MOTIONLESS = 1e-6
"""m/s below which a hand does not move at all."""
TWITCH = 0.15
"""Seconds: a movement that is over so soon is none."""
NOISE = -40.0
"""Level of noise alone, dBFS."""
ALONE = 20.0
"""Seconds of noise and of silence alone."""
ACTIVITIES = (0.0, 0.25, 0.5, 0.75, 1.0)
PAUSED, REQUESTED = 40.0, 30.0
"""Seconds of a voice that pauses are set into, and of one that is rendered at every activity."""
VOICES = 4
PAUSES, QUIET, UNBROKEN, FAINT, CLEAN, CORPUS = (
    "with pauses", ("in silence", "in noise"), "without pauses", "faint", "clean", "corpus")
"""Sets of stimuli."""


# ----------------------------------------------------------------------------------------------------------- figures

@dataclass(frozen=True)
class Rested:
    """A rendering beside its sound. pauses: [n, 2] s."""

    body: CommonBody
    pauses: Array

    @classmethod
    def of(cls, motion: Motion, speech: Speech) -> Rested:
        """Measured."""
        return cls(common_body(motion), pauses_in(speech))

    @cached_property
    def speed(self) -> Array:
        """[T - 1] mean of both hands, m/s at 60 Hz."""
        return np.asarray(self.body.hand_speed.mean(axis=1))

    def between(self, start: float, stop: float) -> Array:
        """The speeds from one time to another, s."""
        return self.speed[max(0, round(start * HZ)):max(0, round(stop * HZ))]

    def in_speech(self) -> float:
        """Mean speed outside real pauses, m/s."""
        # Only the long gaps: between words the hands move on, and those frames belong to speech.
        quiet = np.zeros(len(self.speed), bool)
        for start, stop in self.pauses:
            quiet[round(start * HZ):round(stop * HZ)] = True
        return stats.mean(self.speed[~quiet])

    def at_rest(self) -> float:
        """Mean speed from 2.5 s into pauses on, but for the last second, over that in speech; NaN where there is
        none."""
        late = [self.between(start + RESTS_FROM, stop - PREPARES) for start, stop in self.pauses
                if stop - start > RESTS_FROM + _LEAST + PREPARES]
        talking = self.in_speech()
        # Of all pauses together: one with a second of rest weighs less than one with five.
        return stats.mean(np.concatenate(late)) / talking if late and talking > 0 else float("nan")

    def wakes(self) -> Array:
        """[n, 2] the peak acceleration (m/s2) and speed (m/s) around the end of each long pause."""
        # A pause at the end of the sound has no wake.
        ends = [stop for start, stop in self.pauses if stop - start >= LONG and stop + WAKE[1] <= self.body.duration]
        return peaks(self.body, [(stop + WAKE[0], stop + WAKE[1]) for stop in ends])


def peaks(body: CommonBody, spans: Sequence[tuple[float, float]]) -> Array:
    """[n, 2] the peak acceleration (m/s2) and speed (m/s) of either hand in each span of seconds."""
    bends = np.linalg.norm(np.diff(body.hands, 2, axis=0), axis=-1).max(axis=1) * HZ ** 2
    speed = body.hand_speed.max(axis=1)
    out = [(bends[first:last].max(initial=0.0), speed[first:last].max(initial=0.0))
           for first, last in ((max(0, round(start * HZ)), round(stop * HZ)) for start, stop in spans)]
    return np.array(out, dtype=np.float64).reshape(-1, 2)


def seconds_of(motion: Motion) -> Array:
    """[n, 2] peaks of every second of a motion."""
    body = common_body(motion)
    return peaks(body, [(float(at), at + 1.0) for at in range(int(body.duration) - 1)])


def twitches(body: CommonBody) -> float:
    """Runs over 0.3 m/s of less than 0.15 s, a minute, of both hands' smoothed speeds."""
    # Smoothed as everywhere else, so that noise of a single frame is no movement.
    fast = trunk.smoothed_speed(body.hands) > hands.MOVES
    turns = np.diff(np.pad(fast, ((1, 1), (0, 0))).astype(np.int8), axis=0).T
    short = sum(int((np.flatnonzero(hand < 0) - np.flatnonzero(hand > 0) < TWITCH * HZ).sum()) for hand in turns)
    return 60.0 * short / body.duration


# ------------------------------------------------------------------------------------------------- sets of recordings

def pause_figures(rested: Sequence[Rested], groups: Sequence[str]) -> Results:
    """Rest and life of renderings of voices with pauses; groups: one name for each rendering."""
    at_rest = stats.mean_interval([rendering.at_rest() for rendering in rested], groups=groups)
    return {("at_rest", PAUSES): Measured(at_rest),
            **life_figures([rendering.body for rendering in rested], groups, PAUSES)}


def life_figures(bodies: Sequence[CommonBody], groups: Sequence[str], on: str) -> Results:
    """The longest freeze of the head of all renderings, s, and frames in which a hand does not move at all, %."""
    freezes = [trunk.longest(trunk.smoothed_speed(body.points["Head"][:, None])[:, 0] < trunk.STILL) for body in bodies]
    stopped = [100.0 * float((body.hand_speed < MOTIONLESS).any(axis=1).mean()) for body in bodies]
    # One frozen rendering is a fault, whatever the others do, so the longest is judged.
    mean = stats.mean_interval(freezes, groups=groups)
    return {("longest_freeze", on): Measured(Interval.exact(max(freezes), mean.n), f"of all; on average {mean.text()}"),
            ("exact_rest", on): Measured(stats.mean_interval(stopped, groups=groups))}


def variation(bodies: Sequence[CommonBody], groups: Sequence[str]) -> Interval:
    """How much hand speed varies over 4 s, relative to its mean, in speech without pauses."""
    values = [together.variation(together.hand_speeds(body).mean(axis=1), np.ones(len(body), bool))
              for body in bodies]
    return stats.mean_interval(values, groups=groups)


def waking_figures(wakes: Array, usual: Array | None) -> Results:
    """Percentiles of the peaks around the ends of long pauses [n, 2], and of the corpus' seconds [m, 2]."""
    results: Results = {}
    for column, figure in enumerate(("wake_acceleration", "wake_speed")):
        def percentile(chosen: Array, peak: Array = wakes[:, column]) -> float:
            return float(np.percentile(peak[chosen], WORST))

        # The percentile interval: a percentile of a redrawn set is not biased upwards, as a distance is.
        value = stats.of_set(percentile, len(wakes), basic=False) if len(wakes) else Interval.undefined()
        results[figure, PAUSES] = Measured(value, f"{WORST:g} % of {len(wakes)} wakes, {USUAL:g} % of the corpus")
        if usual is not None and len(usual):
            limit = float(np.percentile(usual[:, column], USUAL))
            results[figure, CORPUS] = Measured(Interval.exact(limit, len(usual)))
    return results


def quiet_figures(rested: Sequence[Rested], on: str) -> Results:
    """Speed of the hands and time in which one moves, %, while nothing is said; the first second is left out."""
    # The first second is the way from the initial pose into rest.
    speed = [stats.mean(rendering.between(1.0, rendering.body.duration)) for rendering in rested]
    moving = [100.0 * float((rendering.body.hand_speed[round(HZ):].max(axis=1) > hands.MOVES).mean())
              for rendering in rested]
    return {("quiet_speed", on): Measured(stats.mean_interval(speed)),
            ("quiet_moving", on): Measured(stats.mean_interval(moving)),
            **life_figures([rendering.body for rendering in rested], [str(k) for k in range(len(rested))], on)}


def twitch_figures(faint_voice: Sequence[Rested], clean: Sequence[Rested]) -> Results:
    """Twitches a minute on a faint voice in noise, and on the same voice as it was."""
    return {("twitches", on): Measured(stats.mean_interval([twitches(rendering.body) for rendering in renderings]))
            for on, renderings in ((FAINT, faint_voice), (CLEAN, clean))}


def activity_figures(shares: Array, moving: Array) -> Results:
    """Shares [activities, voices] of the time in speech with a gesture's lexeme, and with a hand that moves, for rising
    `ACTIVITIES`: their rank correlation, and the rise from 0 to 1."""
    results: Results = {}
    for on, values in (("a lexeme that is not silent", shares), ("a hand that moves", moving)):
        shown = ", ".join(f"{activity:g}: {row.mean():.2f}" for activity, row in zip(ACTIVITIES, values, strict=True))
        results["activity_rank", on] = Measured(stats.mean_interval([_rank(column) for column in values.T]), shown)
        results["activity_rise", on] = Measured(stats.mean_interval(values[-1] - values[0]))
    return results


def _rank(values: Array) -> float:
    """Spearman's correlation with the activities; 0 where nothing changes."""
    # Ranks of equal values are undefined, and a knob without an effect must fail.
    return 0.0 if np.ptp(values) < 1e-9 else float(spearmanr(ACTIVITIES, values).statistic)


def shares_of(rendering: Rendering, silent: NDArray[np.int64], spoken: NDArray[np.bool_]) -> tuple[float, float]:
    """Shares of the time of spoken blocks [N]: with a lexeme that is not silent, and with a hand over 0.3 m/s."""
    lasting = np.diff(rendering.edges) * spoken
    gesturing = ~np.isin(rendering.lexemes, silent)
    fastest = common_body(rendering.motion).hand_speed.max(axis=1)
    # The block of every frame; frames after the last edge belong to the last block.
    at = np.clip(np.searchsorted(rendering.edges, np.arange(len(fastest)) / HZ, side="right") - 1, 0, len(spoken) - 1)
    talking = fastest[spoken[at]]
    moving = stats.mean((talking > hands.MOVES).astype(float))
    return float((lasting * gesturing).sum() / max(lasting.sum(), 1e-9)), moving


# ------------------------------------------------------------------------------------------------------------- group

def measure(system: BundleSystem, voices: Sequence[AcceptanceVoice], renderings: int) -> Results:
    """The group `rest`, on four of the voices with two seeds each."""
    chosen, seeds = spread_out(voices, VOICES), range(min(2, renderings))
    corpus = [seconds_of(voice.own) for voice in voices if voice.own is not None and voice.place != TAKE]

    def rendered(voice: AcceptanceVoice, name: str, speech: Speech) -> list[Rested]:
        sound = derived(voice, name, speech)
        return [Rested.of(system.render(sound, seed).motion, sound.speech) for seed in seeds]

    groups = [voice.group or voice.name for voice in chosen for _ in seeds]
    paused = [rendering for voice in chosen
              for rendering in rendered(voice, PAUSES, with_pauses(middle_of(voice, PAUSED)))]
    results = pause_figures(paused, groups) | waking_figures(
        np.concatenate([rendering.wakes() for rendering in paused]), np.concatenate(corpus) if corpus else None)
    # Silence and noise do not depend on a voice, so one speaker's renderings are enough.
    first = chosen[0]
    # Digital silence and hiss: the first has no level at all, the second could be taken for breath.
    silence = Speech(np.zeros(round(ALONE * SAMPLE_RATE), np.float32), SAMPLE_RATE)
    hiss = Speech(noise(ALONE, NOISE, SAMPLE_RATE).astype(np.float32), SAMPLE_RATE)
    for on, speech in zip(QUIET, (silence, hiss), strict=True):
        results |= quiet_figures(rendered(first, on, speech), on)
    whole = middle_of(first, PAUSED)
    results |= twitch_figures(rendered(first, FAINT, faint(whole)), rendered(first, CLEAN, whole))
    bodies = [rendering.body for voice in chosen
              for rendering in rendered(voice, UNBROKEN, unbroken(middle_of(voice, PAUSED)))]
    results["variation", UNBROKEN] = Measured(variation(bodies, groups))
    return results | _activity(system, chosen)


def _activity(system: BundleSystem, voices: Sequence[AcceptanceVoice]) -> Results:
    sounds = [derived(voice, "at every activity", middle_of(voice, REQUESTED)) for voice in voices]
    shares = np.empty((2, len(ACTIVITIES), len(sounds)))
    for (row, activity), (column, sound) in itertools.product(enumerate(ACTIVITIES), enumerate(sounds)):
        try:
            rendering = system.render(sound, 0, activity=activity)
        except InputError as error:
            return {("activity_works", ""): Measured(Interval.exact(0.0, 1), str(error))}
        shares[:, row, column] = shares_of(rendering, system.bundle.silent, ~rendering.silent)
    return activity_figures(shares[0], shares[1])
