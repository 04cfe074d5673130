"""Independent hands: which hand plays each phrase, and what the idle one does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_module.types import Array
from gesticulator_performer.strokes import LEFT, RIGHT
from gesticulator_performer.types import Phrase

HANG, LOW, STAY = "hang", "low", "stay"
HANGING_LEVEL = 0.04
"""Level, as a share of the home pose, of a hand that hangs while the other one acts."""
# Probability that a raised hand keeps its level when the next phrase begins.
_STAY_UP = 0.4
# Seconds before a phrase at which a hand starts to move, and their standard deviation.
_EARLY, _JITTER = 0.3, 0.13
# Length in seconds of the pauses in which the hands may sink before the next phrase.
_FALL_GAP = (0.45, 1.7)
# Weights of strokes of the left hand, the right hand and both, by the acting hands.
_WEIGHTS = {(LEFT,): (1.0, 0.03, 0.10), (RIGHT,): (0.03, 1.0, 0.10), (LEFT, RIGHT): (0.12, 0.12, 1.0)}
# Lag of one hand in a two-handed stroke, seconds, and the standard deviation of the log ratio of the two gains.
_LAG, _UNEVEN = (0.03, 0.08), 0.13


@dataclass(frozen=True)
class Manner:
    """The manner of a performance, drawn per talk so that two talks of a performer differ.

    both: probability that a phrase is played with both hands; dominant: share of the other phrases that the preferred
    hand plays; switch: probability that the next phrase is drawn anew; hanging: probability that the idle hand hangs;
    falling: probability that hands sink in a short pause; gain, hold, drift: factors on the excursion, the holds and
    the drift of the arms; small_beats: least prominence of a free syllable that gets a small beat; eagerness: added to
    the performer's; sympathy: share of the acting hand's motion that the hanging hand follows; trunk: factor on the
    trunk's motion; drop: seconds in which the arms come to rest.
    """

    both: float
    dominant: float
    switch: float
    hanging: float
    falling: float
    gain: float
    hold: float
    drift: float
    small_beats: float
    eagerness: float
    trunk: float
    sympathy: float = 0.08
    drop: float = 1.7


@dataclass(frozen=True)
class PhraseHands:
    """The sides that act from `start` to `end` (seconds), and what the idle one does."""

    start: float
    end: float
    acting: tuple[int, ...]
    idle: str


def draw_manner(rng: np.random.Generator) -> Manner:
    return Manner(both=rng.uniform(0.7, 0.95), dominant=rng.uniform(0.55, 0.8), switch=rng.uniform(0.35, 0.7),
                  hanging=rng.uniform(0.05, 0.25), falling=rng.uniform(0.05, 0.3),
                  gain=float(np.clip(1.65 * np.exp(rng.normal(0.0, 0.07)), 1.4, 1.85)), hold=rng.uniform(1.1, 1.7),
                  drift=rng.uniform(1.2, 2.0), small_beats=rng.uniform(1.4, 2.2), eagerness=rng.uniform(0.0, 0.7),
                  trunk=float(np.exp(rng.normal(0.0, 0.15))))


STEADY = Manner(both=0.85, dominant=0.67, switch=0.5, hanging=0.12, falling=0.15, gain=1.5, hold=1.3, drift=1.45,
                small_beats=0.2, eagerness=0.1, trunk=1.0)
"""The fixed manner of a talk with an audible style: nothing but the style varies."""


def hands_of_phrases(phrases: Sequence[Phrase], manner: Manner, preferred: int,
                     rng: np.random.Generator) -> tuple[PhraseHands, ...]:
    shares = ((1.0 - manner.both) * manner.dominant, (1.0 - manner.both) * (1.0 - manner.dominant), manner.both)
    choices = ((preferred,), (1 - preferred,), (LEFT, RIGHT))
    out: list[PhraseHands] = []
    for phrase in sorted(phrases, key=lambda p: p.start):
        if not out or rng.random() < manner.switch:
            acting = choices[int(rng.choice(3, p=shares))]
        idle = HANG if rng.random() < manner.hanging else LOW if rng.random() < 0.5 else STAY
        out.append(PhraseHands(phrase.start, phrase.end, acting, idle))
    return tuple(out)


def weights_at(hands: Sequence[PhraseHands], time: float) -> tuple[float, float, float]:
    """Weights of left-hand, right-hand and two-handed strokes at a time; a stroke may start before its phrase."""
    for phrase in hands:
        if phrase.start - 0.4 <= time < phrase.end:
            return _WEIGHTS[phrase.acting]
    return _WEIGHTS[LEFT, RIGHT]


Levels = tuple[list[tuple[float, float]], list[tuple[float, float]]]
"""Per arm [(seconds, share of the home pose)]."""


def waiting_levels(hands: Sequence[PhraseHands], drives: Sequence[float], run_starts: Sequence[float],
                   raise_time: float, manner: Manner, rng: np.random.Generator) -> Levels:
    """Per arm [(time, share of the home pose)]: the height at which it waits in each phrase. drives: the vigour of each
    phrase. run_starts: seconds at which speech begins after a long pause; the hands rise `raise_time` before it."""
    out: Levels = ([], [])
    for k, (phrase, drive) in enumerate(zip(hands, drives, strict=True)):
        first = any(abs(phrase.start - start) < 0.05 for start in run_starts)
        for side in (LEFT, RIGHT):
            time = phrase.start - (raise_time if first else _EARLY) + float(rng.normal(0.0, _JITTER))
            level = _level(phrase, side, drive, bool(out[side]) and not first, out[side], rng)
            if level is not None:
                out[side].append((time, level))
        gap = hands[k + 1].start - phrase.end if k + 1 < len(hands) else 0.0
        if _FALL_GAP[0] < gap < _FALL_GAP[1] and rng.random() < manner.falling:
            for side in (LEFT, RIGHT):
                if rng.random() < 0.7:
                    out[side].append((phrase.end + 0.05 + float(rng.uniform(0.0, 0.2)), HANGING_LEVEL))
    for levels in out:
        levels.sort()
    return out


def _level(phrase: PhraseHands, side: int, drive: float, going_on: bool, levels: list[tuple[float, float]],
           rng: np.random.Generator) -> float | None:
    """The level that an arm takes for a phrase; None to stay at the last of its `levels`."""
    if side in phrase.acting:
        if going_on and levels[-1][1] > 0.4 and rng.random() < _STAY_UP:
            return None
        return float(rng.uniform(0.6, 1.15) * np.exp(0.2 * drive))
    if phrase.idle == HANG or not levels:
        return HANGING_LEVEL
    return float(rng.uniform(0.25, 0.55)) if phrase.idle == LOW else None


def unevenness(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Lag [count, 2] seconds and gain [count, 2] of the left and the right hand in two-handed strokes."""
    lag, gain = np.zeros((count, 2)), np.ones((count, 2))
    later, rows = rng.integers(0, 2, count), np.arange(count)
    lag[rows, later] = rng.uniform(*_LAG, count)
    ratio = np.exp(rng.normal(0.0, _UNEVEN, count))
    gain[rows, later], gain[rows, 1 - later] = 1.0 / ratio, ratio
    return lag, gain
