"""The displacement of an arm's pose by its last movements, which intensity scales.

With x_j the arm's pose at knot j (exponential maps, radians), v_j = |x_j - x_{j-1}| / (t_j - t_{j-1}) its speed, and
w_j = u(v_j) (x_j - x_{j-1}) the fast part of its movement, the displacement is

    S_k = sum over j <= k of c((l_k - l_j) / L + (t_k - t_j) / T) w_j,    l_j = |w_1| + ... + |w_j|

u rises smoothly from 0 to 1 between two speeds, and c(a) = (1 + cos(pi a)) / 2 falls from 1 at 0 to 0 at 1. This leaky
sum forgets with the length of the path rather than with time: while an arm is slow or holds, S hardly changes. So
adding a share of S makes strokes larger and leaves slow movement slow. S is causal, and its memory ends `REMEMBERED`
seconds back.

`LARGE` counts fast movement over two or three strokes: the extent of gestures. `FINE` counts nearly all movement over a
fraction of a stroke: the small movements on top.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from gesticulator.body.life import smooth_step

REMEMBERED = 20.0
"""T, seconds after which a movement is forgotten in any case: a displacement of 10 cm decays by 5 mm per second."""
_STORED = 640.0
"""Seconds of knots in memory: a stream goes back by 600 at most, and needs `REMEMBERED` before that."""

_GRAIN = 2.0 ** -36
"""Radians, to which the ways between knots are rounded: far less than a tenth of a degree per hour."""
_TOGETHER = 16
"""Knots whose sums are computed together: as many as share most of the movements that they remember."""


@dataclass(frozen=True)
class StrokeScale:
    """The movements that count. slow, fast: speeds of an arm between which u rises from 0 to 1, rad/s (1 rad/s is about
    0.4 m/s of the hand); path: L, radians."""

    slow: float
    fast: float
    path: float


LARGE, FINE = StrokeScale(2.0, 4.0, 4.0), StrokeScale(0.0, 2.0, 1.0)


class _KnotRows(NamedTuple):
    """The knots in memory: times [M] seconds, paths [M] l_j, moved [M, D] w_j, poses [M, D] x_j."""

    times: Array
    paths: Array
    moved: Array
    poses: Array


class StrokeMemory:
    """Computes S of an arm, knot by knot."""

    def __init__(self, columns: NDArray[np.int64], scale: StrokeScale) -> None:
        """columns: [D] of the arm in a pose."""
        self._columns, self._scale = columns, scale
        none = np.zeros((0, len(columns)))
        self._rows = _KnotRows(np.zeros(0), np.zeros(0), none, none)

    def push(self, times: Array, poses: Array) -> None:
        """Add poses [K, 3 J] at rising seconds [K]. Knots in memory that are not earlier than these are replaced."""
        rows, arm = self._rows, poses[:, self._columns]
        # A stream goes back when it is interrupted: what was generated after that moment is replaced.
        known = int(np.searchsorted(rows.times, times[0]))
        old = int(np.searchsorted(rows.times[:known], times[-1] - _STORED))
        before, since, path = (rows.poses[known - 1], rows.times[known - 1], rows.paths[known - 1]) if known \
            else (arm[0], times[0] - 1.0, 0.0)
        steps = np.diff(arm, axis=0, prepend=before[None])
        speeds = np.linalg.norm(steps, axis=1) / np.diff(times, prepend=since)
        moved = steps * smooth_step((speeds - self._scale.slow) / (self._scale.fast - self._scale.slow))[:, None]
        # Sums of multiples of a power of two are exact, so a path does not depend on where the memory begins.
        ways = np.round(np.linalg.norm(moved, axis=1) / _GRAIN) * _GRAIN
        paths = np.cumsum(np.concatenate([[path], ways]))[1:]
        self._rows = _KnotRows(*(np.concatenate([earlier[old:known], new]) for earlier, new in zip(
            rows, (times, paths, moved, arm), strict=True)))

    def at(self, times: Array) -> Array:
        """[K, D] S at rising times [K] of knots in memory."""
        knots = np.searchsorted(self._rows.times, times)
        return np.concatenate([self._sums(knots[at:at + _TOGETHER]) for at in range(0, len(knots), _TOGETHER)])

    def averaged(self, times: Array, span: float, value: Callable[[Array], Array]) -> Array:
        """[M] the mean of a value of the arm's poses over the `span` seconds before each of the rising times [M], which
        counts the middle of the span most; the value itself at the first knot. value: [K, D] poses -> [K]."""
        rows = self._rows
        # One more, from which the width of the first that counts is measured.
        first = max(int(np.searchsorted(rows.times, times[0] - span)) - 1, 0)
        knots, values = rows.times[first:], value(rows.poses[first:])
        widths = np.diff(knots, prepend=knots[:1])
        out = np.empty(len(times))
        for at, now in enumerate(times):
            # A window without corners: with a box, a stroke would leave the mean with a jump of its speed.
            inside = slice(int(np.searchsorted(knots, now - span)), int(np.searchsorted(knots, now, side="right")))
            weights = widths[inside] * np.sin(np.pi * (now - knots[inside]) / span) ** 2
            total = float(weights.sum())
            out[at] = weights @ values[inside] / total if total > 0.0 else values[inside][-1]
        return out

    def _sums(self, knots: NDArray[np.int64]) -> Array:
        """[K, D] S at rising knots [K]."""
        rows, first = self._rows, int(knots[0])
        begin = int(np.searchsorted(rows.times, rows.times[first] - REMEMBERED))
        # What has been forgotten at the first of the knots has been at the others.
        counts = self._ages(knots[:1], slice(begin, first + 1))[0] < 1.0
        since = slice(begin + int(np.argmax(counts)), int(knots[-1]) + 1)
        weights = 0.5 + 0.5 * np.cos(np.pi * np.minimum(self._ages(knots, since), 1.0))
        weights[np.arange(since.start, since.stop) > knots[:, None]] = 0.0
        # Summed knot by knot, so that movements with a weight of 0 do not change a bit: products of matrices would.
        total: Array = np.add.reduce(weights[:, :, None] * rows.moved[since], axis=1)
        return total

    def _ages(self, knots: NDArray[np.int64], since: slice) -> Array:
        """[K, M] the arguments of c for movements [M] at knots [K], which fall along M; 1 and more is forgotten."""
        rows, knots = self._rows, knots[:, None]
        paths: Array = rows.paths[knots] - rows.paths[since]
        return paths / self._scale.path + (rows.times[knots] - rows.times[since]) / REMEMBERED
