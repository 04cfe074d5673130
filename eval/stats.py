"""Intervals: how far a figure would move if other clips had been drawn. All of `eval` draws and formats here.

Theory: the bootstrap (Efron 1979): draw as many clips with replacement as there are, compute the figure, repeat; the
2.5th and 97.5th percentiles bound a mean. Clips, not blocks, are drawn, because blocks of one clip are alike; clips of
one group (speaker, sentence) are drawn together where `groups` names them. Where a figure has two sources of chance,
few training seeds and clips, see `eval.crossed`; raters and clips, of which there are many, are both drawn at once
(Owen 2007). A figure of a set, such as a distance between distributions, is biased upwards in redrawn sets, which hold
clips twice: its interval is the basic bootstrap's, twice the figure less the percentiles.

What fools it: fewer than about ten clips make the interval too narrow, and one clip has none: it is then drawn each
time, and the width of 0 means nothing. Clips of one speaker, or cut from one recording, are alike and count as fewer.
It tells of other clips only: another seed of training moves a figure too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_module.types import Array

__all__ = ["Interval", "mean_interval", "paired"]

DRAWS = 2000
"""Redrawn sets for a mean: the third digit of the bounds is then still."""
SET_DRAWS = 200
"""Redrawn sets for a figure that costs much more than a mean."""
LEVEL = (2.5, 97.5)
"""Percentiles of a 95 % interval."""

Indices = NDArray[np.int64]
Groups = Sequence[str] | Indices


@dataclass(frozen=True)
class Interval:
    """A mean over `n` clips and its 95 % interval; NaN where nothing is defined (`n` is then 0)."""

    mean: float
    low: float
    high: float
    n: int

    @classmethod
    def undefined(cls, n: int = 0) -> Interval:
        """Nothing is known."""
        return cls(math.nan, math.nan, math.nan, n)

    @classmethod
    def exact(cls, value: float, n: int) -> Interval:
        """A figure without bounds."""
        return cls(value, math.nan, math.nan, n)

    @classmethod
    def from_dict(cls, held: Mapping[str, Any]) -> Interval:
        """The inverse of `to_dict`; null counts as undefined."""
        mean, low, high = (math.nan if held[key] is None else float(held[key]) for key in ("mean", "low", "high"))
        return cls(mean, low, high, int(held["n"]))

    def to_dict(self) -> dict[str, float]:
        """For JSON."""
        return asdict(self)

    def text(self, digits: int = 2, sign: bool = False) -> str:
        """"1.23 [1.10, 1.40]"; without bounds, or of one clip, the mean alone, and "-" where it is undefined."""
        if not math.isfinite(self.mean):
            return "-"
        shown = f"{self.mean:{'+' if sign else ''}.{digits}f}"
        bounded = math.isfinite(self.low) and math.isfinite(self.high) and not (self.n == 1 and self.low == self.high)
        return f"{shown} [{self.low:.{digits}f}, {self.high:.{digits}f}]" if bounded else shown

    def times(self, factor: float) -> Interval:
        """Times a positive number."""
        return Interval(self.mean * factor, self.low * factor, self.high * factor, self.n)

    def above(self, limit: float = 0.0) -> bool:
        """True if the whole interval lies above the limit."""
        return self.low > limit

    def below(self, limit: float = 0.0) -> bool:
        """True if the whole interval lies below the limit."""
        return self.high < limit


# --------------------------------------------------------------------------------------------------------------- means

def mean_interval(values: ArrayLike, weights: ArrayLike | None = None, *, groups: Groups | None = None,
                  seed: int = 0, draws: int = DRAWS) -> Interval:
    """Mean and 95 % bootstrap interval of one value per clip [n]; NaN values, and clips of no weight, are left out.

    weights: [n], such as the blocks of each clip, for a mean over blocks with clips as the unit that is drawn. groups:
    [n] names or numbers; clips of one name are drawn together, and `n` of the result counts the groups. ValueError for
    other shapes, infinite values, and weights that are negative or not finite.
    """
    value = np.asarray(values, dtype=np.float64)
    weight = np.ones_like(value) if weights is None else np.asarray(weights, dtype=np.float64)
    if value.ndim != 1 or weight.shape != value.shape or (groups is not None and len(groups) != len(value)):
        raise ValueError(f"values, weights and groups must be [n], not {value.shape} and {weight.shape}")
    if np.isinf(value).any() or not (np.isfinite(weight).all() and (weight >= 0).all()):
        raise ValueError("values must not be infinite, and weights must be finite and 0 or more")
    defined = ~np.isnan(value) & (weight > 0)
    value, weight = value[defined], weight[defined]
    total, mass = value * weight, weight
    if groups is not None:
        _, member = np.unique(np.asarray(groups)[defined], return_inverse=True)
        total, mass = (np.bincount(member, part).astype(np.float64) for part in (total, mass))
    if len(value) == 0:
        return Interval.undefined()
    # Sums over groups are redrawn, not clips: a group is drawn with all of its clips or not at all.
    index = np.random.default_rng(seed).integers(len(mass), size=(draws, len(mass)))
    means = total[index].sum(1) / mass[index].sum(1)
    return limits(float(total.sum() / mass.sum()), means, len(mass))


def paired(first: ArrayLike, second: ArrayLike, *, seed: int = 0) -> Interval:
    """The mean of first less second, clip by clip [n] (see `mean_interval`)."""
    return mean_interval(np.asarray(first, dtype=np.float64) - np.asarray(second, dtype=np.float64), seed=seed)


def crossed_means(values: Array, seed: int = 0, draws: int = DRAWS) -> Array:
    """[draws, K] means of each system of values [R, C, K] when raters R and clips C are both drawn anew; NaN: missing.

    Systems are averaged over the same draw, so their differences are paired.
    """
    # Counts instead of indices: a draw of raters and clips is then a product of three arrays.
    rng = np.random.default_rng(seed)
    times = [rng.multinomial(n, np.full(n, 1 / n), size=draws).astype(np.float64) for n in values.shape[:2]]
    there = np.isfinite(values)
    total, count = (np.einsum("dr,rck,dc->dk", times[0], part, times[1], optimize=True)
                    for part in (np.where(there, values, 0.0), there.astype(np.float64)))
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


# ----------------------------------------------------------------------------------------------------- figures of sets

def limits(got: float, drawn: ArrayLike, n: int, *, basic: bool = False, least: float = -math.inf) -> Interval:
    """A figure with the 95 % interval that its redrawn values [draws] give; those that are undefined are left out.

    basic: the basic bootstrap's interval instead of the percentiles. least: no bound lies below it.
    """
    values = np.asarray(drawn, dtype=np.float64)
    values = values[np.isfinite(values)]
    # Redrawn sets may be undefined where the set itself is not: they are left out, the figure stays.
    if len(values) == 0 or not math.isfinite(got):
        return Interval.exact(got, n)
    low, high = (float(value) for value in np.percentile(values, LEVEL))
    if basic:
        # The figure less the deviations of the redrawn ones, so the bounds change places.
        low, high = 2.0 * got - high, 2.0 * got - low
    return Interval(got, max(low, least), max(high, least), n)


def resamples(rng: np.random.Generator, counts: Sequence[int], draws: int) -> Iterator[tuple[Indices, ...]]:
    """`draws` times a redrawn set of each count, as indices [count] with replacement."""
    for _ in range(draws):
        yield tuple(rng.integers(count, size=count) for count in counts)


def of_set(figure: Callable[..., float], *counts: int, seed: int = 0, draws: int = SET_DRAWS, basic: bool = True,
           least: float = -math.inf) -> Interval:
    """A figure of a set of clips with its interval (see `limits`); one clip alone has no bounds.

    figure: of the clips with these indices; it takes one array for each of `counts`, sets that are drawn apart.
    """
    # The figure of the set as it is, not the mean of the redrawn ones, which is biased.
    got = figure(*(np.arange(count) for count in counts))
    if min(counts) < 2:
        return Interval.exact(got, min(counts))
    drawn = [figure(*indices) for indices in resamples(np.random.default_rng(seed), counts, draws)]
    return limits(got, drawn, min(counts), basic=basic, least=least)


def mean(values: Array) -> float:
    """The mean of those that are finite; NaN where none is."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else math.nan


def jackknife(of: Callable[[Indices], float], count: int) -> Array:
    """[n] pseudo-values n f(all) - (n - 1) f(all but k): what clip k adds to a figure of a set (Tukey 1958).

    of: the figure of the clips with these numbers. Their mean is the figure less the greater part of its bias, and
    their spread is the figure's, as if it were a mean.
    """
    every = np.arange(count)
    whole = of(every)
    if count < 2:
        return np.full(count, whole)
    return np.array([count * whole - (count - 1) * of(np.delete(every, left)) for left in every])
