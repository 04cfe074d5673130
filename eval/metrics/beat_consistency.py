"""Beat consistency: does some movement of some joint end near each onset? (BEAT, EMAGE; Bailando; HA2G)

Theory: each onset of the sound looks for the motion beat nearest to it, at a distance of d seconds, and

    score = mean over onsets of exp(-d^2 / (2 sigma^2)),

1 when each onset has a motion beat upon it. The field has several of this form, under one name, with other beats and
other sigmas, so their values do not compare. Here it is BEAT's (Liu et al. 2022; as EMAGE computes it): a joint's beats
are the minima of its speed that are the least within seven frames at 30 fps on either side, where it is not at rest
(over 0.1 of its mean speed); sigma 0.3 s; the mean over the joints of the upper body.

Better is higher, or so they say. What fools them, and why this chapter is no judge:
- More motion beats can only help: nothing is lost by a beat where there is no onset. Jitter gives each joint a minimum
  every few frames, near any onset. PMB asks from the other side, one onset for one motion beat.
- sigma 0.3 s is as wide as a syllable: motion that has nothing to do with the speech is near its best. So each score
  is given with that of the same beats moved in time against the onsets (`chance`), and the mismatch test.
- On a real take (BEAT, 64 s at 15 fps, in pieces of 10 s) BEAT's score is 0.72, moved in time 0.70, played backwards
  0.74, with 2 cm of jitter 0.83: jitter wins.

    >>> round(onset_score(np.array([1.0, 2.0]), np.array([1.0, 2.3])), 6)     # one onset is met, one a sigma away
    0.803265
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_module.motion.kinematics import positions_of, resample
from data_module.motion.skeletons import facing, upper_body
from data_module.types import Array, Motion
from eval.metrics.pmb import circular_shifts, rising

__all__ = ["consistency"]

FPS = 30.0
"""Frames a second at which the rules of BEAT are told."""
ORDER = 7
"""Frames on either side that a minimum is the least of."""
SIGMA = 0.3
"""Seconds."""
MOVING = 0.1
"""Of a joint's mean speed: a slower minimum is a rest, not a beat."""
SHIFTS = 50


def onset_score(motion_beats: Array, onsets: Array, sigma: float = SIGMA) -> float:
    """Mean over onsets [m] of exp(-d^2 / (2 sigma^2)), d seconds to the nearest of the motion beats [n].

    NaN without onsets, as a mean over none; 0 without motion beats (each onset waits in vain). ValueError for times
    that are not finite or not [n].
    """
    # Sorted for `searchsorted` below: a circular shift leaves the beats out of order.
    beats, times = rising(motion_beats), rising(onsets)
    if len(times) == 0:
        return float("nan")
    if len(beats) == 0:
        return 0.0
    after = np.searchsorted(beats, times)
    nearest = np.minimum(np.abs(times - beats[np.maximum(after - 1, 0)]),
                         np.abs(beats[np.minimum(after, len(beats) - 1)] - times))
    return float(np.exp(-nearest ** 2 / (2.0 * sigma ** 2)).mean())


def mean_score(joints: Sequence[Array], onsets: Array, sigma: float = SIGMA) -> float:
    """The mean over joints of `onset_score`; joints: the beats of each. NaN for no joint or no onset."""
    return float(np.mean([onset_score(beats, onsets, sigma) for beats in joints])) if len(joints) else float("nan")


def joint_beats(speeds: Array, fps: float = FPS, order: int = ORDER) -> list[Array]:
    """For each joint the seconds of its beats, from speeds [T, J] in m/s: strict minima within `order` frames of
    either side, that lie above `MOVING` times the joint's mean speed. A joint that never moves has none.

    Near an end of the clip, as in the public code, a minimum is the least of those frames that there are; the first
    and the last frame are none. ValueError for speeds of another shape or not finite, or an fps that is not positive.
    """
    from scipy.signal import argrelextrema

    table = np.asarray(speeds, dtype=np.float64)
    if table.ndim != 2 or not np.isfinite(table).all() or not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"speeds must be finite, [T, J], and fps positive, not {table.shape} and {fps}")
    beats = []
    for column in table.T:
        least = argrelextrema(column, np.less, order=order, mode="clip")[0] if len(column) else np.zeros(0, int)
        # A minimum of a hand that rests is noise, and BEAT leaves it out.
        rest = MOVING * column.mean() if len(column) else 0.0
        # Speed t is that between frames t and t + 1.
        beats.append((least[column[least] > rest] + 0.5) / fps)
    return beats


def motion_joint_beats(motion: Motion) -> list[Array]:
    """The beats of each joint of a motion of the 16-joint character, by BEAT's rules, at `FPS`.

    Seen from the facing hips; joints that keep their place there (the root, what hangs on it) and those that the
    source lacks do not count.
    """
    motion = upper_body(motion)
    # ORDER is in frames of 30 fps: at another rate it would be another rule.
    sampled = resample(motion, FPS)
    if len(sampled) < 2:
        return []
    counts = [k for k, name in enumerate(motion.skeleton.names) if k and name not in motion.absent]
    places = positions_of(facing(sampled))[:, counts]
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=-1) * FPS
    # A joint that keeps its place has only minima of rounding errors.
    return joint_beats(speeds[:, speeds.mean(axis=0) > 1e-6])


def consistency(joints: Sequence[Array], onsets: Array, duration: float, sigma: float = SIGMA, *, seed: int = 0
                ) -> tuple[float, float]:
    """Score and chance, 0 to 1, of the beats of joints against onsets (both in seconds, 0 to `duration`); NaN without a
    joint that moves or an onset.

    chance: the mean over `circular_shifts` of all beats together. ValueError as in `onset_score`, and for a duration
    that is not positive.
    """
    moved = [mean_score([(beats + shift) % duration for beats in joints], onsets, sigma)
             for shift in circular_shifts(duration, SHIFTS, seed)]
    return mean_score(joints, onsets, sigma), float(np.mean(moved))
