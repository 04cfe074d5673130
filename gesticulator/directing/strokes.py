"""What of an arm's pose the last movements brought: the part that intensity makes larger or smaller.

With x_j the arm's pose at knot j (exponential maps, radians), v_j = |x_j - x_{j-1}| / (t_j - t_{j-1}) its speed there,
and w_j = u(v_j) (x_j - x_{j-1}) the movement that counts, the part that movements brought is

    S_k = sum over j <= k of c((l_k - l_j) / L + (t_k - t_j) / T) w_j,    l_j = |w_1| + ... + |w_j|

u rises smoothly from 0 to 1 between two speeds, and c(a) = (1 + cos(pi a)) / 2 falls from 1 at 0 to 0 at 1. It is a
leaky sum that forgets with the way that is gone and hardly with time: while an arm is slow or holds, S stays as it is,
so who adds a share of S makes strokes larger and leaves slow parts as slow as they were. Nothing is known of what is to
come, and nothing is remembered of what lies `REMEMBERED` seconds back.

`LARGE` counts fast movement alone, over two or three strokes: how far gestures go. `FINE` counts nearly everything,
over a fraction of a stroke: the small movements that ride on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array

REMEMBERED = 20.0
"""Seconds T after which a movement is forgotten in any case: by 5 mm a second where it brought 10 cm."""
_KEPT = 640.0
"""Seconds of knots that are kept: a stream goes back by 600 at most, and `REMEMBERED` lie before that."""


@dataclass(frozen=True)
class StrokeScale:
    """Which movements count. slow, fast: rad/s of a whole arm up to which none counts and from which all does (0.4 m/s
    of a hand are about 1 rad/s); way: radians L after which one is forgotten."""

    slow: float
    fast: float
    way: float


LARGE, FINE = StrokeScale(2.0, 4.0, 4.0), StrokeScale(0.0, 2.0, 1.0)


@dataclass
class _KnotRows:
    """Of the knots that are kept: times [M], ways [M] l_j, moved [M, D] w_j."""

    times: Array
    ways: Array
    moved: Array


class StrokeMemory:
    """S of some dimensions, knot by knot."""

    def __init__(self, columns: NDArray[np.int64], scale: StrokeScale) -> None:
        """columns: [D] of a pose that move together."""
        self._columns, self._scale = columns, scale
        self._rows = _KnotRows(np.zeros(0), np.zeros(0), np.zeros((0, len(columns))))
        self._poses = np.zeros((0, len(columns)))

    def push(self, times: Array, poses: Array) -> None:
        """The next poses [K, 3 J] at rising seconds [K]; where they are not later than the last, what came from the
        first of them on is forgotten."""
        known = int(np.searchsorted(self._rows.times, times[0]))
        old = int(np.searchsorted(self._rows.times[:known], times[-1] - _KEPT))
        rows, own = self._rows, poses[:, self._columns]
        before = self._poses[known - 1:known] if known else own[:1]
        since = rows.times[known - 1] if known else times[0] - 1.0
        steps = np.diff(np.concatenate([before, own]), axis=0)
        speeds = np.linalg.norm(steps, axis=1) / np.diff(np.concatenate([[since], times]))
        moved = steps * smooth_step((speeds - self._scale.slow) / (self._scale.fast - self._scale.slow))[:, None]
        gone = rows.ways[known - 1] if known else 0.0
        # Added one after the other, so that the sizes of the pieces change no bit.
        ways = np.cumsum(np.concatenate([[gone], np.linalg.norm(moved, axis=1)]))[1:]
        kept = slice(old, known)
        self._rows = _KnotRows(*(np.concatenate([was[kept], now]) for was, now in (
            (rows.times, times), (rows.ways, ways), (rows.moved, moved))))
        self._poses = np.concatenate([self._poses[kept], own])

    def at(self, times: Array) -> Array:
        """[K, D] S at times [K] of knots or between two (on the straight line); zero before the first."""
        rows = self._rows
        right = np.clip(np.searchsorted(rows.times, times), 0, len(rows.times) - 1)
        left = np.maximum(right - 1, 0)
        width = np.maximum(rows.times[right] - rows.times[left], 1e-9)
        share = np.clip((times - rows.times[left]) / width, 0.0, 1.0)
        knots = np.unique(np.concatenate([left[share < 1.0], right]))
        sums = np.stack([self._sum(int(knot)) for knot in knots])
        # Where `left` is not among the knots its share is nothing.
        early, late = (sums[np.minimum(np.searchsorted(knots, ends), len(knots) - 1)] for ends in (left, right))
        return np.where((share == 1.0)[:, None], late, early + share[:, None] * (late - early))

    def _sum(self, knot: int) -> Array:
        rows, now = self._rows, self._rows.times[knot]
        own = slice(int(np.searchsorted(rows.times, now - REMEMBERED)), knot + 1)
        age = (rows.ways[knot] - rows.ways[own]) / self._scale.way + (now - rows.times[own]) / REMEMBERED
        total: Array = (0.5 + 0.5 * np.cos(np.pi * np.minimum(age, 1.0))) @ rows.moved[own]
        return total


def smooth_step(s: Array) -> Array:
    """3 s^2 - 2 s^3 of s cut to 0 to 1."""
    u: Array = np.clip(s, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)
