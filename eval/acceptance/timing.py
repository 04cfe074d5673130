"""How a motion goes with its sound, pooled over recordings and held against chance.

One recording has too few pauses and too little pitch to tell. So of all voices together:

- First movement: the share of pauses in which a hand starts before the voice returns (`eval.metrics.eye.units.leads`),
  and the share of circular shifts of the motions in which at least as many do. A hand that never waits is early, too,
  and chance says how often.
- Pitch with trunk: the correlation of pitch and trunk speed at once (`eval.metrics.eye.pitch`), and the share of
  exchanges of the sounds among the recordings that do as well.

A motion that is laid under another recording's sound is at chance in all of them. What fools them: of a corpus whose
links between speech and motion were planted by rules they tell that a model has learned the rules, not that people do
so; read the real take beside them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from data_module.types import Array, Motion
from eval import stats
from eval.metrics.eye import common_body, pitch
from eval.metrics.eye.pitch import Coupling
from eval.metrics.eye.units import Leads, leads
from eval.renderings import AcceptanceVoice
from eval.stats import Interval
from eval.table import Cell, Column, Table

SHIFTS = 200
"""Circular shifts of a motion, and exchanges of the sounds."""
FEWEST = 5
"""Recordings without which an exchange of their sounds is too often none."""
FIRST, FIRST_CHANCE, FIRST_P = "first_before", "first_chance", "first_p"
PITCH, PITCH_CHANCE, PITCH_LAG, PITCH_P = "pitch_trunk", "pitch_chance", "pitch_lag", "pitch_p"
TITLES = {FIRST: "first movement before the voice, pooled, %", FIRST_CHANCE: "the same under circular shifts, %",
          FIRST_P: "first movement against circular shifts, p", PITCH: "pitch with trunk speed at once, r",
          PITCH_CHANCE: "the same, 95 % of exchanged sounds, r", PITCH_LAG: "lag of the best r, s",
          PITCH_P: "pitch with trunk speed against exchanged sounds, p"}
DIGITS = {FIRST: 0, FIRST_CHANCE: 0, FIRST_P: 3, PITCH: 3, PITCH_CHANCE: 3, PITCH_LAG: 2, PITCH_P: 3}


@dataclass(frozen=True)
class Timed:
    """A rendering beside its sound. speed: of the trunk, for `pitch.lagged`."""

    name: str
    first: Leads
    pitch: Array
    speed: Array

    @classmethod
    def of(cls, motion: Motion, said: AcceptanceVoice) -> Timed:
        """Measured."""
        body = common_body(motion)
        return cls(said.name, leads(body, said.heard, SHIFTS), said.pitch, pitch.trunk_speed(body))

    @property
    def at_once(self) -> float:
        """Correlation of pitch and trunk speed with no lag; NaN where too little is voiced."""
        return float(pitch.lagged(self.pitch, self.speed)[pitch.LAGS == 0][0])


PAIRED: Mapping[str, Callable[[Timed], float]] = {
    "pitch with trunk speed, no lag, r": lambda clip: clip.at_once,
    "first movement before the voice, % above chance": lambda clip: clip.first.before - clip.first.chance}


def figures(timed: Sequence[Timed]) -> dict[str, Interval]:
    """The rows of `TITLES`. p-values are undefined for renderings of a single voice, that of pitch for fewer than
    `FEWEST`."""
    # The same voice several times is one draw of its sound: p-values need different voices.
    pooled, voices = Leads.pooled([clip.first for clip in timed]), len({clip.name for clip in timed})
    count = len(pooled.seconds)
    coupled = coupling(timed)
    first = {FIRST: pooled.before, FIRST_CHANCE: pooled.chance, FIRST_P: pooled.p if voices > 1 else math.nan}
    out = {name: Interval.exact(value, count) for name, value in first.items()}
    if coupled is not None:
        # Of few voices most exchanges are the identity for some, and the test cannot reject.
        exchanged = float(np.percentile(coupled.chance, 95)) if voices >= FEWEST and len(coupled.chance) else math.nan
        out |= {name: Interval.exact(value, len(timed)) for name, value in (
            (PITCH, coupled.best), (PITCH_LAG, coupled.lag), (PITCH_CHANCE, exchanged),
            (PITCH_P, coupled.p if math.isfinite(exchanged) else math.nan))}
    return out


def coupling(timed: Sequence[Timed]) -> Coupling | None:
    """Of those with a voice that has pitch; None without any."""
    voiced = [clip for clip in timed if math.isfinite(clip.at_once)]
    return pitch.coupling([clip.pitch for clip in voiced], [clip.speed for clip in voiced], SHIFTS) if voiced else None


def paired_table(timed: Mapping[str, Sequence[Timed]], name: str) -> Table:
    """One system beside every other one, recording by recording, systems that ignore the sound among them. Systems
    that have other renderings are left out."""
    first = timed[name]
    others = [other for other, clips in timed.items()
              if other != name and [clip.name for clip in clips] == [clip.name for clip in first]]
    rows: dict[str, dict[str, Cell]] = {}
    for row, of in PAIRED.items():
        values = [of(clip) for clip in first]
        rows[row] = {name: stats.mean_interval(values)}
        rows[row] |= {other: stats.paired(values, [of(clip) for clip in timed[other]]) for other in others}
    columns = {name: Column(name, digits=2), **{other: Column(f"{name} less {other}", digits=2) for other in others}}
    return Table("Timing, recording by recording", columns, rows, "figure",
                 ["Means over recordings, differences paired by recording, with bootstrap 95 % intervals. Of a corpus "
                  "whose links were planted by rules they show what was learned of the rules."])
