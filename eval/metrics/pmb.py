"""Percentage of matched beats: is the motion in time with the sound? (RG Eq. 22)

Theory: a motion beat counts when an onset lies within delta of it, one onset for one motion beat, in order, and the
figure is the percentage of motion beats that count. As printed, the equation lets several onsets count for one motion
beat, so it can pass 100 %; one-to-one it cannot. Motion beats are those of `motion.motion_beats`: where the arms
brake hardest (mode A, the default) or where they are slowest (mode B). The paper's words fit either, so name the mode.

Unit: percent of motion beats; `above_chance` is a share. Good: high above chance, near the speaker's own. More is not
better without end: no speaker beats to every syllable.

What fools it:
- A wide delta. At 0.2 s, where the papers print it, unrelated beats already reach 95 % among onsets 0.2 to 0.5 s apart
  (0.1 s: 56 %, 0.05 s: 28 %). The figure means nothing without its chance level, that of the same motion moved against
  the same onsets; the curve over delta shows what one delta hides.
- Many onsets: the more the sound has, the higher the chance. Few motion beats: one beat that is met is 100 %.
- It sees rhythm alone: what is gestured, and how large, makes no difference.

One of two motion beats lies within 0.1 s of an onset:

    >>> pmb(np.array([1.0, 2.0]), np.array([1.05, 3.0]))
    50.0
    >>> above_chance(80.0, 50.0)
    0.6
"""

import math

import numpy as np
from numpy.typing import NDArray

from data_module.speech.onsets import merged
from data_module.types import Array

__all__ = ["above_chance", "chance", "delta_curve", "matched", "pmb"]

DELTA = 0.1
"""Seconds: the tolerance that tells most; the papers print 0.2."""
DELTAS = (0.025, 0.05, 0.075, 0.1, 0.125, 0.15, 0.175, 0.2, 0.25, 0.3)
MERGE = 0.05
"""Seconds: onsets closer than this are one event, found twice."""
SHIFTS = 200
NO_BEAT = "the motion has no beat"
"""Why a figure is NaN."""


def matched(motion_beats: Array, onsets: Array, delta: float) -> NDArray[np.int64]:
    """For each motion beat the index of its onset, -1 for none, [n]. Both rising seconds.

    Each motion beat in turn takes the earliest unused onset less than `delta` away. For intervals of one width this
    greedy rule finds as many pairs as any (a maximum matching).
    """
    pairs = np.full(len(motion_beats), -1, dtype=np.int64)
    free = 0
    for index, beat in enumerate(motion_beats):
        # An onset that lies too early for this beat is too early for all later ones.
        while free < len(onsets) and onsets[free] <= beat - delta:
            free += 1
        if free < len(onsets) and onsets[free] < beat + delta:
            pairs[index] = free
            free += 1
    return pairs


def pmb(motion_beats: Array, onsets: Array, delta: float = DELTA) -> float:
    """Percentage of motion beats that an onset matches (RG Eq. 22, one-to-one), both in seconds, in any order.

    Onsets closer than `MERGE` are merged first. NaN without motion beats, as a share of none (`NO_BEAT`); 0 without
    onsets. ValueError for times that are not finite or not [n], and for a delta that is not positive.
    """
    beats, events = rising(motion_beats), rising(onsets)
    if not (np.isfinite(delta) and delta > 0):
        raise ValueError(f"delta must be positive, not {delta}")
    if len(beats) == 0:
        return float("nan")
    return 100.0 * float(np.mean(matched(beats, merged(events, MERGE), delta) >= 0))


def chance(motion_beats: Array, onsets: Array, duration: float, delta: float = DELTA, *, seed: int = 0,
           shifts: int = SHIFTS) -> float:
    """Mean PMB of the same motion beside another stretch of speech, percent: circular shifts over `duration` seconds.

    NaN without motion beats. ValueError as in `pmb` and `circular_shifts`.
    """
    return float(np.mean([pmb((np.asarray(motion_beats) + shift) % duration, onsets, delta)
                          for shift in circular_shifts(duration, shifts, seed)]))


def circular_shifts(duration: float, count: int, seed: int) -> Array:
    """[count] seconds, drawn evenly, no closer to 0 than a second (or a tenth of the duration). ValueError for a
    duration that is not positive, or no shift at all."""
    if not (np.isfinite(duration) and duration > 0) or count < 1:
        raise ValueError(f"the duration must be positive and shifts 1 or more, not {duration} and {count}")
    # A shift near 0 is hardly a shift, and would count as chance what is synchrony.
    least = min(1.0, 0.1 * duration)
    return np.random.default_rng(seed).uniform(least, duration - least, count)


def wrapped(onsets: Array, duration: float, wanted: float) -> Array:
    """Onsets [n] of a speech of `duration` seconds as if it went round and round, up to `wanted` seconds.

    So that another's speech is as long as the motion that it is tried on.
    """
    times = np.asarray(onsets, dtype=np.float64)
    rounds = np.arange(math.ceil(wanted / duration)) * duration
    # Onsets beyond the sound's own end would come twice where it begins anew.
    every = (rounds[:, None] + times[times < duration]).ravel()
    return every[every < wanted]


def rising(seconds: Array) -> Array:
    """Times [n] in order; ValueError for times that are not finite or not [n]."""
    values = np.asarray(seconds, dtype=np.float64)
    if values.ndim != 1 or not np.isfinite(values).all():
        raise ValueError(f"times must be finite seconds, [n], not {values.shape}")
    return np.sort(values)


def above_chance(percent: float, by_chance: float) -> float:
    """(PMB - chance) / (100 - chance): 0 is chance, 1 is the best; NaN where chance leaves no room."""
    if not by_chance < 100.0:
        return float("nan")
    return (percent - by_chance) / (100.0 - by_chance)


def delta_curve(motion_beats: Array, onsets: Array) -> Array:
    """[n] PMB for each of `DELTAS` (RG Fig. 11); ValueError as in `pmb`."""
    return np.array([pmb(motion_beats, onsets, delta) for delta in DELTAS])
