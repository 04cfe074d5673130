"""Intervals: how far a mean over clips would move if other clips had been drawn.

Theory: the percentile bootstrap (Efron 1979): draw as many clips with replacement as there are, take the mean, repeat;
the 2.5th and 97.5th percentiles bound it. Clips, not blocks, are drawn, because blocks of one clip are alike. Unit:
that of the values; a narrow interval is good only where the mean is.

What fools it: fewer than about ten clips make the interval too narrow, and one clip has none: it is then drawn each
time, and the width of 0 means nothing. Clips of one speaker, or cut from one recording, are alike and count as fewer.
It tells of other clips only: another seed of training moves a figure too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from data_module.types import Array

DRAWS = 2000


@dataclass(frozen=True)
class Interval:
    """A mean over `clips` clips and its 95 % interval; NaN where nothing is defined (`clips` is then 0)."""

    mean: float
    low: float
    high: float
    clips: int

    def to_dict(self) -> dict[str, float]:
        """For JSON."""
        return {"mean": self.mean, "low": self.low, "high": self.high, "clips": self.clips}


def interval(values: ArrayLike, weights: ArrayLike | None = None, *, seed: int = 0, draws: int = DRAWS) -> Interval:
    """Mean and 95 % bootstrap interval of one value per clip [n]; NaN values, and clips of no weight, are left out.

    weights: [n], such as the blocks of each clip, for a mean over blocks with clips as the unit that is drawn.
    ValueError for other shapes, infinite values, and weights that are negative or not finite.
    """
    own = np.asarray(values, dtype=np.float64)
    weight = np.ones_like(own) if weights is None else np.asarray(weights, dtype=np.float64)
    if own.ndim != 1 or weight.shape != own.shape:
        raise ValueError(f"values and weights must be [n], not {own.shape} and {weight.shape}")
    if np.isinf(own).any() or not (np.isfinite(weight).all() and (weight >= 0).all()):
        raise ValueError("values must not be infinite, and weights must be finite and 0 or more")
    kept = ~np.isnan(own) & (weight > 0)
    own, weight = own[kept], weight[kept]
    if len(own) == 0:
        return Interval(float("nan"), float("nan"), float("nan"), 0)
    index = np.random.default_rng(seed).integers(len(own), size=(draws, len(own)))
    means = (own[index] * weight[index]).sum(1) / weight[index].sum(1)
    low, high = np.percentile(means, [2.5, 97.5])
    return Interval(float((own * weight).sum() / weight.sum()), float(low), float(high), len(own))


def pseudo_values(of: Callable[[list[int]], float], count: int) -> Array:
    """[n] n f(all) - (n - 1) f(all but k): what clip k adds to a figure of a set (Tukey's jackknife).

    of: the figure of the clips with these numbers. Their mean is the figure less the greater part of its bias, and
    their spread is the figure's, as if it were a mean.
    """
    every = list(range(count))
    whole = of(every)
    if count < 2:
        return np.full(count, whole)
    return np.array([count * whole - (count - 1) * of([k for k in every if k != left]) for left in every])
