"""The group `motion`: does it read as a person? The bundle beside itself without the sound, and beside real motion.

Everything is a mean over renderings: of the real take's voice with several seeds, and of every voice of the test split.
Real motion is the take itself, and the corpus: the test split's own motion. The figures are those of `eval.metrics.eye`
and two that one recording has too few pauses and too little pitch for, pooled and held against chance:

- First movement: the share of pauses in which a hand starts before the voice returns (`eval.metrics.eye.units.leads`),
  and the share of circular shifts of the motions in which at least as many do. A hand that never waits is early, too,
  and chance says how often.
- Pitch with trunk: the correlation of pitch and trunk speed at once (`eval.metrics.eye.pitch`), and the share of
  exchanges of the sounds among the recordings that do as well.

A motion that is laid under another recording's sound is at chance in both. What fools them: of a corpus whose links
between speech and motion were planted by rules they tell that a model has learned the rules, not that people do so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from data_module.blocks import cut
from data_module.types import Array, Motion
from eval.acceptance.bounds import Measured, Results
from eval.metrics.eye import ReferenceSpace, common_body, pitch
from eval.metrics.eye.pitch import Coupling
from eval.metrics.eye.sample import CORPUS, EyeSample
from eval.metrics.eye.units import Leads, leads
from eval.renderings import TEST, AcceptanceVoice, BundleSystem
from eval.stats import Interval

OURS, SPEAKERS, WITHOUT_SOUND, ROLLED_SOUND = "ours", "speakers", "statistical", "sound rolled"
"""`WITHOUT_SOUND`: the bundle with an interpreter that ignores the sound; `ROLLED_SOUND`: the bundle with the sound
`eval.baselines.controls.ROLLED` blocks late, on the same blocks."""
ON_TAKE, ON_TEST = "BEAT voice", "test split"
"""Sets of stimuli: the voice of the real take, and those of the store's test split."""

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


def timing_figures(timed: Sequence[Timed]) -> dict[str, Measured]:
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
        out[PITCH_P] = Measured(Interval.exact(p, len(timed)), f"r {coupled.best:.3f}")
    return out


def coupling(timed: Sequence[Timed]) -> Coupling | None:
    """Of those with a voice that has pitch; None without any."""
    voiced = [clip for clip in timed if clip.voiced]
    return pitch.coupling([clip.pitch for clip in voiced], [clip.speed for clip in voiced], SHIFTS) if voiced else None


def own_motion(voices: Sequence[AcceptanceVoice]) -> EyeSample:
    """The motion of the speakers themselves, with seams where a system would cut; a real take has no seams."""
    sample = EyeSample()
    for voice in voices:
        if voice.own is not None:
            # Nothing was joined in a real take; a corpus is judged at the seams that a system would have made.
            edges = cut(voice.speech).edges if voice.place == TEST else None
            sample.add(voice.own, voice.heard, edges, group=voice.group or voice.name)
    return sample


def rendered(system: BundleSystem, voices: Sequence[AcceptanceVoice], renderings: int, **options: Any
             ) -> tuple[EyeSample, list[Timed]]:
    """The bundle on the real take's voice with every seed, or on each voice of the test split with the first: what two
    recordings share at one seed is to be seen."""
    sample, timed = EyeSample(), []
    for voice in voices:
        for seed in range(1 if voice.place == TEST else renderings):
            rendering = system.render(voice, seed, **options)
            # The interval draws the renderings of one group of voices together.
            sample.add(rendering.motion, voice.heard, rendering.edges, group=voice.group or voice.name)
            timed.append(Timed.of(rendering.motion, voice))
    return sample, timed


def measure(system: BundleSystem, voices: Sequence[AcceptanceVoice], renderings: int, space: ReferenceSpace | None
            ) -> dict[str, Results]:
    """The figures of the bundle, of the bundle without the sound and with it rolled, and of the speakers themselves."""
    takes, tests = ([voice for voice in voices if (voice.place == TEST) == test] for test in (False, True))
    figures = own_motion(tests).figures(space) if tests else {}
    beside = {(figure, CORPUS): Measured(value) for figure, value in figures.items()}
    known = [name for name in (WITHOUT_SOUND,) if name in system.bundle.interpreters]
    results: dict[str, Results] = {name: dict(beside) for name in (OURS, *known, ROLLED_SOUND, SPEAKERS)}
    for on, chosen in ((ON_TAKE, takes), (ON_TEST, tests)):
        if not chosen:
            continue
        samples = {OURS: rendered(system, chosen, renderings),
                   **{name: rendered(system, chosen, renderings, interpreter=name) for name in known},
                   ROLLED_SOUND: rendered(system, chosen, renderings, rolled=True),
                   SPEAKERS: (own_motion(chosen),
                              [Timed.of(voice.own, voice) for voice in chosen if voice.own is not None])}
        for name, (sample, timed) in samples.items():
            results[name] |= {(figure, on): Measured(value) for figure, value in sample.figures(space).items()}
            results[name] |= {(figure, on): measured for figure, measured in timing_figures(timed).items()}
    return results
