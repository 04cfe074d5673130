"""Does it rest where nothing is said, does it live there, and does it gesture as much as it is asked to?

The sounds are made for it (`sounds`): voices with pauses of known lengths set into their own, voices without any, a
voice 46 dB too low in noise, noise alone, silence alone. Speeds are those of the wrists as seen from the hips, m/s, the
mean of both where nothing else is said; a real pause is one of a second or more, found as the system finds it.

- Settled: speed from half a second into a pause on, up to 2.5 s; shown only, as short pauses belong to the next
  preparation. At rest: from 2.5 s on to a second before the voice returns, over that in speech.
- Waxing and waning: variation of hand speed over windows of 4 s in speech whose pauses were cut out.
- Life: the longest freeze of the head; the share of frames in which a hand does not move at all.
- Waking: the peaks of acceleration and speed around the ends of long pauses, beside those of the corpus' seconds.
- Twitches: runs in which a hand exceeds 0.3 m/s (smoothed over 50 ms) for less than 0.15 s, a minute.
- Activity: share of the time in speech in which the lexeme is not a silent one, and in which a hand moves.

What fools it: a motion that is frozen throughout rests well; `seen` and the share of time in gesture refuse it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from data_module.errors import InputError
from data_module.speech.audio import SAMPLE_RATE
from data_module.types import Array, Motion, Speech
from eval import stats
from eval.acceptance.motion.bounds import UNBROKEN
from eval.acceptance.motion.sounds import faint, heard_of, made, noise, pauses_in, spread_out, unbroken, with_pauses
from eval.claim import ANY, Verdict, at_least, at_most, judged, skipped
from eval.metrics.eye import common_body, hands, together, trunk
from eval.metrics.eye.body import HZ, CommonBody
from eval.renderings import TAKE, AcceptanceVoice, BundleSystem, Rendering
from eval.stats import Interval
from eval.table import Cell, Column, Table

SETTLED_FROM, RESTS_FROM, PREPARES = 0.5, 2.5, 1.0
"""Seconds into a pause, and before its end, when a hand may begin to move."""
SETTLED, AT_REST = 0.12, 0.25
"""m/s in silence and in noise; share of the speed in speech in a long pause."""
_LEAST = 0.2
"""Seconds of rest from which on a mean speed says something."""
LONG = 2.0
"""Seconds: waking is looked at after pauses of this length."""
WAKE = (-0.2, 0.8)
"""Seconds around the end of a pause."""
USUAL, WORST = 95.0, 90.0
"""Percentiles: of the corpus' seconds, and of the wakes."""
FREEZE, EXACT = 1.0, 1e-6
"""Seconds of the head; m/s below which a hand does not move at all."""
TWITCH = 0.15
"""Seconds: a movement that is over so soon is none."""
TWITCHES = 1.5
"""Times those of the same voice as it was recorded."""
NOISE = -40.0
"""Level of noise alone, dBFS."""
ALONE = 20.0
"""Seconds of noise and of silence alone."""
ACTIVITIES = (0.0, 0.25, 0.5, 0.75, 1.0)
RANK, SPAN = 0.9, 0.5
"""Spearman's correlation of activity and share; how far the share must rise from 0 to 1."""
HEARD, ASKED = 40.0, 30.0
"""Seconds of a voice that pauses are set into, and that is played at every activity."""
VOICES = 4
Flags = NDArray[np.bool_]


# ----------------------------------------------------------------------------------------------------------- figures

@dataclass(frozen=True)
class Rested:
    """A rendering beside its sound. speed: [T - 1] mean of both hands, fastest: [T - 1] of either, m/s at 60 Hz;
    pauses: [n, 2] s."""

    body: CommonBody
    speed: Array
    fastest: Array
    pauses: Array

    @classmethod
    def of(cls, motion: Motion, speech: Speech) -> Rested:
        """Measured."""
        body = common_body(motion)
        speed = body.hand_speed
        return cls(body, speed.mean(axis=1), speed.max(axis=1), pauses_in(speech))

    def between(self, start: float, stop: float) -> Array:
        """The speeds from one time to another, s."""
        return self.speed[max(0, round(start * HZ)):max(0, round(stop * HZ))]

    def in_speech(self) -> float:
        """Mean speed outside real pauses, m/s."""
        quiet = np.zeros(len(self.speed), bool)
        for start, stop in self.pauses:
            quiet[round(start * HZ):round(stop * HZ)] = True
        return stats.mean(self.speed[~quiet])

    def settled(self) -> list[tuple[float, float]]:
        """For each real pause its length and the mean speed from half a second into it on."""
        return [(stop - start, stats.mean(self.between(start + SETTLED_FROM, min(stop, start + RESTS_FROM))))
                for start, stop in self.pauses]

    def at_rest(self) -> float:
        """Mean speed from 2.5 s into pauses on, but for the last second, over that in speech; NaN where there is
        none."""
        late = [self.between(start + RESTS_FROM, stop - PREPARES) for start, stop in self.pauses
                if stop - start > RESTS_FROM + _LEAST + PREPARES]
        talking = self.in_speech()
        return stats.mean(np.concatenate(late)) / talking if late and talking > 0 else float("nan")

    def wakes(self) -> Array:
        """[n, 2] the peak acceleration (m/s2) and speed (m/s) around the end of each long pause."""
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
    fast = trunk.smoothed_speed(body.hands) > hands.MOVES
    turns = np.diff(np.pad(fast, ((1, 1), (0, 0))).astype(np.int8), axis=0).T
    short = sum(int((np.flatnonzero(own < 0) - np.flatnonzero(own > 0) < TWITCH * HZ).sum()) for own in turns)
    return 60.0 * short / body.duration


def exact_rest(body: CommonBody) -> float:
    """Percentage of frames in which some hand does not move at all."""
    return 100.0 * float((body.hand_speed < EXACT).any(axis=1).mean())


def head_freeze(body: CommonBody) -> float:
    """Seconds of the longest freeze of the head."""
    return trunk.longest(trunk.smoothed_speed(body.points["Head"][:, None])[:, 0] < trunk.STILL)


# ----------------------------------------------------------------------------------------------------------- clauses

def pause_clauses(rested: Sequence[Rested], groups: Sequence[str]) -> list[Verdict]:
    """Settling, rest and life in voices with pauses."""
    each = [(length, speed, group) for own, group in zip(rested, groups, strict=True)
            for length, speed in own.settled()]
    values, owners = [speed for _, speed, _ in each], [group for _, _, group in each]
    told = "; ".join(f"{low:g} to {high:g} s: {stats.mean(np.array([s for n, s, _ in each if low <= n < high])):.2f}"
                     for low, high in ((1.0, 1.8), (1.8, 3.0), (3.0, 9.0)))
    ratios = [own.at_rest() for own in rested]
    return [
        judged("hands from .5 to 2.5 s into a pause, m/s", stats.mean_interval(values, groups=owners), ANY,
               reason=f"{len(each)} pauses; by length, {told}"),
        judged("hands from 2.5 s into a pause on to 1 s before its end, over their speed in speech",
               stats.mean_interval(ratios, groups=list(groups)), at_most(AT_REST)),
        *life_clauses([own.body for own in rested], groups, "with pauses")]


def life_clauses(bodies: Sequence[CommonBody], groups: Sequence[str], where: str) -> list[Verdict]:
    """The longest freeze of the head of all, and hands that stop."""
    freezes, exact = [head_freeze(body) for body in bodies], [exact_rest(body) for body in bodies]
    each = stats.mean_interval(freezes, groups=list(groups))
    worst = Interval(max(freezes), float("nan"), float("nan"), each.n)
    return [judged(f"longest freeze of the head, {where}, s", worst, at_most(FREEZE),
                   reason=f"of all; on average {each.text()}"),
            judged(f"frames in which a hand does not move at all, {where}, %",
                   stats.mean_interval(exact, groups=list(groups)), at_most(0.0))]


def unbroken_clause(bodies: Sequence[CommonBody], groups: Sequence[str]) -> Verdict:
    """Activity rises and falls also in speech without pauses."""
    values = [together.variation(together.hand_speeds(body).mean(axis=1), np.ones(len(body), bool))
              for body in bodies]
    return judged("variation over 4 s, speech without pauses", stats.mean_interval(values, groups=list(groups)),
                  UNBROKEN)


def waking_clauses(wakes: Array, usual: Array | None) -> list[Verdict]:
    """Peaks around the ends of long pauses [n, 2] beside those of the corpus' seconds [m, 2]."""
    out = []
    for column, told in enumerate(("acceleration, m/s2", "speed, m/s")):
        name = f"waking, peak {told}"
        if len(wakes) == 0:
            out.append(skipped(name, "no long pause was found"))
            continue
        def figure(chosen: Array, own: Array = wakes[:, column]) -> float:
            return float(np.percentile(own[chosen], WORST))

        value = stats.of_set(figure, len(wakes), basic=False)
        limit = None if usual is None or not len(usual) else float(np.percentile(usual[:, column], USUAL))
        out.append(judged(name, value, ANY if limit is None else at_most(limit), reason=(
            f"{WORST:g} % of {len(wakes)} wakes; bound: {USUAL:g} % of the corpus' seconds")))
    return out


def quiet_clauses(name: str, rested: Sequence[Rested]) -> list[Verdict]:
    """Nothing is said: the hands rest, and do not move now and then."""
    speed = [stats.mean(own.between(1.0, own.body.duration)) for own in rested]
    moving = [100.0 * float((own.fastest[round(HZ):] > hands.MOVES).mean()) for own in rested]
    return [judged(f"hands in {name}, m/s", stats.mean_interval(speed), at_most(SETTLED)),
            judged(f"time in which a hand moves in {name}, %", stats.mean_interval(moving), at_most(1.0)),
            *life_clauses([own.body for own in rested], [str(k) for k in range(len(rested))], f"in {name}")]


def faint_clause(low: Sequence[Rested], clean: Sequence[Rested]) -> Verdict:
    """A faint voice in noise makes no more twitches than the same voice as it was."""
    there, here = ([twitches(own.body) for own in each] for each in (low, clean))
    usual = stats.mean(np.array(here))
    return judged("twitches a minute, voice at -46 dB in noise", stats.mean_interval(there),
                  at_most(TWITCHES * max(usual, 1.0)), digits=1,
                  reason=f"bound: {TWITCHES:g} times the {usual:.1f} of the same voice at its own level")


def activity_clauses(shares: Array, moving: Array) -> list[Verdict]:
    """Shares [activities, voices] of the time in speech with a gesture's lexeme, and with a hand that moves, for rising
    `ACTIVITIES`."""
    out = []
    for told, values in (("a lexeme that is not silent", shares), ("a hand that moves", moving)):
        ranks = [_rank(column) for column in values.T]
        name = f"activity and time in speech with {told}"
        shown = ", ".join(f"{activity:g}: {row.mean():.2f}" for activity, row in zip(ACTIVITIES, values, strict=True))
        out.append(judged(f"{name}, rank correlation", stats.mean_interval(ranks), at_least(RANK),
                          reason=shown))
        lexemes = values is shares
        out.append(judged(f"{name}, rise from 0 to 1", stats.mean_interval(values[-1] - values[0]),
                          at_least(SPAN) if lexemes else ANY))
    return out


def _rank(values: Array) -> float:
    """Spearman's correlation with the activities; 0 where nothing changes."""
    return 0.0 if np.ptp(values) < 1e-9 else float(spearmanr(ACTIVITIES, values).statistic)


def shares_of(rendering: Rendering, silent: NDArray[np.int64], spoken: Flags) -> tuple[float, float]:
    """Shares of the time of spoken blocks [N]: with a lexeme that is not silent, and with a hand over 0.3 m/s."""
    assert rendering.edges is not None
    lasting = np.diff(rendering.edges) * spoken
    gesturing = ~np.isin(rendering.lexemes, silent)
    fastest = common_body(rendering.motion).hand_speed.max(axis=1)
    at = np.clip(np.searchsorted(rendering.edges, np.arange(len(fastest)) / HZ, side="right") - 1, 0, len(spoken) - 1)
    talking = fastest[spoken[at]]
    moving = stats.mean((talking > hands.MOVES).astype(float))
    return float((lasting * gesturing).sum() / max(lasting.sum(), 1e-9)), moving


# ------------------------------------------------------------------------------------------------------------- group

def run(ours: BundleSystem, voices: Sequence[AcceptanceVoice], renderings: int) -> tuple[list[Verdict], list[Table]]:
    """Everything of this group: the first voices of those at hand, two seeds each."""
    chosen, seeds = spread_out(voices, VOICES), range(min(2, renderings))
    paused = [made(voice, "with pauses", with_pauses(heard_of(voice, HEARD))) for voice in chosen]
    played = [(voice, Rested.of(ours.render(voice, seed).motion, voice.speech)) for voice in paused for seed in seeds]
    groups = [voice.group for voice, _ in played]
    clauses = pause_clauses([own for _, own in played], groups)
    usual = [seconds_of(voice.own) for voice in voices if voice.own is not None and voice.place != TAKE]
    clauses += waking_clauses(np.concatenate([own.wakes() for _, own in played]),
                              np.concatenate(usual) if usual else None)

    first = chosen[0]
    alone = {"silence": Speech(np.zeros(round(ALONE * SAMPLE_RATE), np.float32), SAMPLE_RATE),
             "noise": Speech(noise(ALONE, NOISE, SAMPLE_RATE).astype(np.float32), SAMPLE_RATE)}
    for name, speech in alone.items():
        sound = made(first, name, speech)
        clauses += quiet_clauses(name, [Rested.of(ours.render(sound, seed).motion, speech) for seed in seeds])
    low, clean = (made(first, name, speech) for name, speech in (
        ("faint", faint(heard_of(first, HEARD))), ("clean", heard_of(first, HEARD))))
    clauses.append(unbroken_clause([
        common_body(ours.render(sound, seed).motion) for sound in (
            made(voice, "without pauses", unbroken(heard_of(voice, HEARD))) for voice in chosen) for seed in seeds],
        groups))
    clauses.append(faint_clause(*([Rested.of(ours.render(sound, seed).motion, sound.speech) for seed in seeds]
                                  for sound in (low, clean))))
    return [*clauses, *_activity(ours, chosen)], [_described(played)]


def _activity(ours: BundleSystem, voices: Sequence[AcceptanceVoice]) -> list[Verdict]:
    sounds = [made(voice, "asked", heard_of(voice, ASKED)) for voice in voices]
    found = np.empty((2, len(ACTIVITIES), len(sounds)))
    for (row, activity), (column, sound) in itertools.product(enumerate(ACTIVITIES), enumerate(sounds)):
        try:
            own = ours.render(sound, 0, activity=activity)
        except InputError as error:
            return [judged("activity is heard", 0.0, at_least(1.0), digits=0, reason=str(error))]
        found[:, row, column] = shares_of(own, ours.bundle.silent, ~own.silent)
    return activity_clauses(found[0], found[1])


def _described(played: Sequence[tuple[AcceptanceVoice, Rested]]) -> Table:
    """Every voice with pauses by itself."""
    columns = {"pauses": Column("real pauses"), "speech": Column("speed in speech", "m/s"),
               "settled": Column("from .5 s into pauses", "m/s"), "rest": Column("from 2.5 s, over speech"),
               "freeze": Column("longest head freeze", "s")}
    rows: dict[str, dict[str, Cell]] = {
        f"{voice.name}, rendering {k + 1}": {
            "pauses": len(own.pauses), "speech": own.in_speech(), "rest": own.at_rest(),
            "settled": stats.mean(np.array([speed for _, speed in own.settled()])), "freeze": head_freeze(own.body)}
        for k, (voice, own) in enumerate(played)}
    return Table("Voices with pauses", columns, rows, "voice")
