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
from collections.abc import Sequence
from dataclasses import dataclass

from data_module.types import Array, Motion
from eval.acceptance.bounds import Measured
from eval.metrics.eye import common_body, pitch
from eval.metrics.eye.pitch import Coupling
from eval.metrics.eye.units import Leads, leads
from eval.renderings import AcceptanceVoice
from eval.stats import Interval

SHIFTS = 200
"""Circular shifts of a motion, and exchanges of the sounds."""
FEWEST = 5
"""Recordings without which an exchange of their sounds is too often none."""
FIRST_P, PITCH_P = "first_p", "pitch_p"


@dataclass(frozen=True)
class Timed:
    """A rendering beside its sound. speed: of the trunk, for `pitch.lagged`."""

    name: str
    first: Leads
    pitch: Array
    speed: Array

    @classmethod
    def of(cls, motion: Motion, voice: AcceptanceVoice) -> Timed:
        """Measured."""
        body = common_body(motion)
        return cls(voice.name, leads(body, voice.heard, SHIFTS), voice.pitch, pitch.trunk_speed(body))

    @property
    def voiced(self) -> bool:
        """True if enough is voiced for a correlation with no lag."""
        return math.isfinite(float(pitch.lagged(self.pitch, self.speed)[pitch.LAGS == 0][0]))


def figures(timed: Sequence[Timed]) -> dict[str, Measured]:
    """p of the first movement, undefined for renderings of a single voice, and of pitch with trunk, undefined for fewer
    than `FEWEST`."""
    if not timed:
        return {}
    # The same voice several times is one draw of its sound: p-values need different voices.
    pooled, voices = Leads.pooled([clip.first for clip in timed]), len({clip.name for clip in timed})
    coupled, count = coupling(timed), len(pooled.seconds)
    first = Interval.exact(pooled.p if voices > 1 else math.nan, count)
    shares = [Interval.exact(share, count).text(0) for share in (pooled.before, pooled.chance)]
    out = {FIRST_P: Measured(first, f"{shares[0]} % of {count}, shifted {shares[1]} %"), PITCH_P: Measured()}
    if coupled is not None:
        # Of few voices most exchanges are the identity for some, and the test cannot reject.
        p = coupled.p if voices >= FEWEST and len(coupled.chance) else math.nan
        out[PITCH_P] = Measured(Interval.exact(p, len(timed)), f"r {coupled.best:.3f} at {coupled.lag:.2f} s")
    return out


def coupling(timed: Sequence[Timed]) -> Coupling | None:
    """Of those with a voice that has pitch; None without any."""
    voiced = [clip for clip in timed if clip.voiced]
    return pitch.coupling([clip.pitch for clip in voiced], [clip.speed for clip in voiced], SHIFTS) if voiced else None
