"""The mismatch test: does a metric of synchrony prefer the right speech to another clip's?

Theory: let M[i, j] be the metric of the motion of clip i with the speech of clip j. The diagonal is the right speech.
If motion had nothing to do with its own speech, any assignment pi of speeches to motions would do as well, so the mean
of M[i, pi(i)] over all assignments (all of them for few clips, drawn ones for more) is the distribution of chance for
the mean of M[i, i], and the share of those that reach it is the p value: a permutation test, exact, paired in motion
and in speech at once. A motion that scores well with any speech, or a speech that any motion fits, moves all of the
assignments alike and so cannot help. The difference, M[i, i] less the mean of M[i, j] over j != i, is given for each
clip, with its interval.

Good: a difference above 0 with a small p. What fools it: metrics of rhythm see rhythm only, so a system that beats in
time to any loud frame passes, whatever is said. Where all speeches are of one steady rhythm no metric can tell. Clips
of one sound or text under two names are right for each other, which hides a true preference. With n clips p cannot be
below 1 / n!: three clips never reach 0.05.

    >>> mismatch(np.array([[3.0, 1.0], [1.0, 3.0]])).p_value        # one of two assignments
    0.5
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import permutation_test

from data_module.types import Array
from eval.stats import Interval, mean_interval

__all__ = ["Mismatch", "mismatch"]

DRAWS = 9999
"""Assignments drawn, where there are more than that in all."""


@dataclass(frozen=True)
class Mismatch:
    """right, wrong: means of the metric with the right and with other speeches; difference: right less wrong with its
    interval over clips; p_value: one-sided. NaN with a reason where fewer than two clips are defined."""

    right: float
    wrong: float
    difference: Interval
    p_value: float
    reason: str = ""


def wrapped(onsets: Array, duration: float, wanted: float) -> Array:
    """Onsets [n] of a speech of `duration` seconds as if it went round and round, up to `wanted` seconds.

    So that another's speech is as long as the motion that it is tried on.
    """
    if not (duration > 0 and wanted > 0):
        raise ValueError(f"durations must be positive, not {duration} and {wanted}")
    times = np.asarray(onsets, dtype=np.float64)
    rounds = np.arange(math.ceil(wanted / duration)) * duration
    # Onsets beyond the sound's own end would come twice where it begins anew.
    every = (rounds[:, None] + times[times < duration]).ravel()
    return every[every < wanted]


def mismatch(values: Array, *, seed: int = 0, draws: int = DRAWS) -> Mismatch:
    """The test on M [n, n], motion by speech, higher better. Clips with any value not finite are left out.

    ValueError for another shape.
    """
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 2 or table.shape[0] != table.shape[1]:
        raise ValueError(f"the values must be [n, n], motion by speech, not {table.shape}")
    table = _defined(table)
    n, nan = len(table), float("nan")
    if n < 2:
        return Mismatch(nan, nan, Interval(nan, nan, nan, n), nan, f"{n} clips with a value: a wrong speech takes two")
    right = np.diag(table)
    wrong = (table.sum(axis=1) - right) / (n - 1)
    # Up to seven clips every assignment is tried, and p is exact; else the right one counts as drawn, so p is never 0.
    test = permutation_test((np.arange(n),), lambda speech, axis: table[np.arange(n), speech].mean(axis=axis),
                            permutation_type="pairings", alternative="greater", n_resamples=draws, rng=seed)
    return Mismatch(float(right.mean()), float(wrong.mean()), mean_interval(right - wrong, seed=seed),
                    float(test.pvalue))


def _defined(table: Array) -> Array:
    """Without the clips whose motion or speech has no value, those that lack the most first."""
    clips = np.arange(len(table))
    while len(clips) and not np.isfinite(table[np.ix_(clips, clips)]).all():
        lacking = ~np.isfinite(table[np.ix_(clips, clips)])
        # One clip at a time: its loss may leave all others with every value.
        clips = np.delete(clips, int((lacking.sum(axis=0) + lacking.sum(axis=1)).argmax()))
    return table[np.ix_(clips, clips)]
