"""FGD, the Frechet gesture distance: do generated gestures look, as a set, like a speaker's? (RG 7.3.2, RACER Eq. 13)

Theory: windows of motion become features (`gesture_features`); both sets of features are taken for Gaussians, and

    FGD = ||m1 - m2||^2 + tr(C1 + C2 - 2 (C1 C2)^(1/2))          (RACER Eq. 13)

is the squared Frechet distance between them. "Second moment" in the paper means covariance, and the root is that of the
matrix. Unit: squared units of a feature, so every network has its own. 0 for equal sets, less is better, and below the
floor (one half of the real clips against the other) nothing is gained.

What fools it:
- It sees a set, not a pair: motion with the wrong speech has the distance of the right one, 0 for real clips.
- It sees two moments: any set with the same mean and covariance is the same to it.
- Jitter and time's arrow. On 175 real clips (1196 windows) the papers' network puts the motion with 2 cm of jitter at
  0.8 and the motion reversed at 18, where two halves (one split) are 61 apart and the clips held at their first
  pose 155: it smooths over what no eye would miss. Raw directions see the jitter (0.7, against 0.5 between halves).
- The number of samples. Two samples of one Gaussian are not at 0: for 32 features of variance 1 they are at about 5.9
  with 100 windows each, and more where windows overlap. The floor shows what that is for the clips at hand.
- Below `ENOUGH` windows a feature the covariance is hardly known, and below one it is singular: the distance is still a
  number, but not one to print. `Figure.doubt` then says so.
- Window length. One system gets 194, 171 and 36 at windows of 30, 60 and 90 frames, so no length alone will do:
  `gesticulator score` takes two at least, and shows network, length, rate and hash beside each figure.

Two sets of features, one moved by (3, 4):

    >>> features = np.random.default_rng(0).normal(size=(50, 2))
    >>> round(distance(features, features), 6), round(distance(features, features + [3.0, 4.0]), 6)
    (0.0, 25.0)
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from data_module.types import Array
from eval import stats
from eval.stats import Interval

__all__ = ["frechet_distance", "measure"]

ENOUGH = 5
"""Windows for each feature, at least: "several times 32" for 32 features."""


@dataclass(frozen=True)
class Gaussian:
    """The two moments of features. mean: [E]; covariance: [E, E], unbiased."""

    mean: Array
    covariance: Array


@dataclass(frozen=True)
class Figure:
    """A distance and what it depends on.

    interval: the distance with its 95 % over clips, undefined when a set has fewer than two windows. needed: windows
    that each set should have.
    """

    interval: Interval
    windows: tuple[int, int]
    needed: int

    @property
    def doubt(self) -> str:
        """Why the sample does not suffice; empty where it does."""
        least = min(self.windows)
        return f"{least} windows, and {self.needed} are needed" if least < self.needed else ""


def gaussian(features: Array) -> Gaussian:
    """The moments of features [N, E], of two or more."""
    points = np.asarray(features, dtype=np.float64)
    return Gaussian(points.mean(axis=0), np.atleast_2d(np.cov(points, rowvar=False)))


def frechet_distance(a: Gaussian, b: Gaussian) -> float:
    """The squared Frechet distance between two Gaussians (RACER Eq. 13), finite for singular covariances.

    The trace of (C1 C2)^(1/2) is the sum of the singular values of C1^(1/2) C2^(1/2): nothing is inverted and no root
    of an unsymmetric matrix is taken, so nothing need be added to a diagonal. ValueError for widths that differ.
    """
    # For symmetric A, B the eigenvalues of AB are the squares of the singular values of A^(1/2) B^(1/2).
    shared = np.linalg.svd(_root(a.covariance) @ _root(b.covariance), compute_uv=False).sum()
    apart = float(((a.mean - b.mean) ** 2).sum())
    # Rounding can leave the difference of equal covariances a hair below 0.
    return apart + max(float(np.trace(a.covariance) + np.trace(b.covariance) - 2.0 * shared), 0.0)


def distance(first: Array, second: Array) -> float:
    """FGD between two sets of features [N, E] and [M, E] (RACER Eq. 13)."""
    return frechet_distance(gaussian(first), gaussian(second))


def of_clips(first: Sequence[Array], second: Sequence[Array]) -> float:
    """FGD between the features [n, E] of clips, all windows together; NaN for fewer than two windows on a side."""
    sides = _joined(first), _joined(second)
    return distance(*sides) if min(map(len, sides)) > 1 else math.nan


def measure(generated: Sequence[Array], real: Sequence[Array], *, paired: bool = False, seed: int = 0) -> Figure:
    """FGD between the features [n, E] of generated clips and those of real ones, with its interval over clips.

    paired: clip k of both is of one speech, so both are drawn together. The interval is the basic bootstrap's (the
    distance less what redrawn sets differ from it): redrawn sets hold clips twice and are all farther apart, so the
    percentiles themselves would lie above the figure. For the same reason a figure of few windows can lie above its
    interval, which is one for the clips' population. It does not go below 0.
    """
    counts = (sum(map(len, generated)), sum(map(len, real)))
    if paired and len(generated) != len(real):
        raise ValueError(f"{len(generated)} generated clips cannot be paired with {len(real)} real ones")
    # By the width of the features, which clips too short for a window have as well.
    needed = ENOUGH * max((clip.shape[1] for clip in (*generated, *real)), default=1)
    if min(counts) < 2:
        return Figure(Interval.undefined(), counts, needed)

    # Paired clips are of one speech: redrawing them apart would widen the interval by what speeches differ.
    sizes = [len(generated)] if paired else [len(generated), len(real)]
    interval = stats.of_set(lambda *chosen: of_clips([generated[k] for k in chosen[0]], [real[k] for k in chosen[-1]]),
                            *sizes, seed=seed, least=0.0)
    return Figure(interval, counts, needed)


def of_chosen(first: Sequence[Array], second: Sequence[Array]) -> Callable[[stats.Indices], float]:
    """`of_clips` for the clips with these numbers, of features [n, E] of the same clips on both sides."""
    return lambda chosen: of_clips([first[k] for k in chosen], [second[k] for k in chosen])


def _root(covariance: Array) -> Array:
    """The symmetric root of a symmetric matrix without negative eigenvalues (but for rounding)."""
    values, axes = np.linalg.eigh(covariance)
    root: Array = (axes * np.sqrt(values.clip(min=0.0))) @ axes.T
    return root


def _joined(clips: Sequence[Array]) -> Array:
    """The windows of all clips, [N, E]; a clip too short for a window has none, of no width."""
    return np.concatenate([clip for clip in clips if len(clip)] or [np.zeros((0, 1))])
