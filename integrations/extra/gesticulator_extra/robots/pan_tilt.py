"""Two hinges that point something: solves for the angles of all frames together.

A hinge pans about the vertical, a second one tilts what it carries: a camera on its mount, an upper arm on a shoulder,
a forearm on an elbow. Let p = (a, b, h) be a unit direction, (a, b) its part in the plane of panning. Then

    (a, b) = cos(tilt) (cos pan, sin pan),     h = sin(tilt).

Each direction has two solutions, and near the pole (h = 1: an arm along the hinge, a straight elbow) a small change of
p is a large change of pan: passing the pole on the wrong side would require half a turn in no time. This cannot be
decided frame by frame, so the pan of all frames is chosen together by dynamic programming over a grid of angles: with
e(t, pan) the distance from p(t) to what can be reached at that pan, it minimises

    sum over t of  e(t, pan_t)^2  +  m (1 - cos(pan_t - liked_t))  +  l fps^2 (pan_t - pan_(t-1))^2

and is then refined off the grid by least squares. The result goes straight through the pole where necessary, and misses
p there by a few degrees for some frames.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solveh_banded

from data_module.types import Array

_GRID = np.radians(3.0)
"""Grid spacing, radians."""
_SMOOTH = 2e-5
"""l, seconds squared: half a turn within 0.2 s costs as much as an error of 6 degrees over that time."""
_LIKED = 2e-3
"""m: the preferred angle counts as much as an error of 2.5 degrees, so it matters little where the direction determines
the angle."""
_POLISH = 3
"""Least-squares steps after the grid search."""
_CHUNK = 2048
"""Frames whose costs are computed at a time."""
_Limits = tuple[float, float]


def tilt_at(pan: Array, way: Array, limits: _Limits) -> Array:
    """[...] the tilt within limits that points nearest to `way` [..., 3] at a pan [...]."""
    level = way[..., 0] * np.cos(pan) + way[..., 1] * np.sin(pan)
    middle = sum(limits) / 2.0
    # Wrap to the angle nearest to the middle of the limits, so that clipping selects the nearer limit.
    return np.clip(middle + _turned(np.arctan2(way[..., 2], level) - middle), *limits)


def pan_over_time(way: Array, liked: Array, fps: float, pan: _Limits, tilt: _Limits) -> Array:
    """[T] the pan of each frame. way: [T, 3] unit directions; liked: [T] preferred angles where a direction does not
    determine the pan, radians; pan, tilt: limits, radians, less than a turn apart."""
    grid = np.linspace(*pan, max(2, round((pan[1] - pan[0]) / _GRID) + 1))
    jump = _SMOOTH * fps ** 2 * (grid[:, None] - grid) ** 2
    arrived = np.zeros(len(grid))
    origins = np.zeros((len(way), len(grid)), np.int16)
    for start in range(0, len(way), _CHUNK):
        part = slice(start, start + _CHUNK)
        for frame, cost in enumerate(_costs(grid, way[part], liked[part], tilt), start):
            total = arrived + jump  # [now, before]
            origins[frame] = total.argmin(axis=1)
            arrived = total[np.arange(len(grid)), origins[frame]] + cost
    chosen = np.empty(len(way), np.int64)
    chosen[-1] = arrived.argmin()
    for frame in range(len(way) - 1, 0, -1):
        chosen[frame - 1] = origins[frame, chosen[frame]]
    return np.clip(_polished(grid[chosen], way, liked, fps, tilt), *pan)


def _costs(grid: Array, way: Array, liked: Array, tilt: _Limits) -> Array:
    """[T, N] cost of each pan of the grid in each frame, without transitions."""
    best = tilt_at(grid, way[:, None], tilt)
    level = way[:, :1] * np.cos(grid) + way[:, 1:2] * np.sin(grid)
    missed = 2.0 - 2.0 * (np.cos(best) * level + np.sin(best) * way[:, 2:])
    return np.asarray(missed + _LIKED * (1.0 - np.cos(grid - liked[:, None])))


def _polished(pan: Array, way: Array, liked: Array, fps: float, tilt: _Limits) -> Array:
    """[T] the pan refined off the grid: least squares towards each frame's solution where it is near."""
    exact, level = np.arctan2(way[:, 1], way[:, 0]), np.hypot(way[:, 0], way[:, 1])
    between = _SMOOTH * fps ** 2
    for _ in range(_POLISH if len(pan) > 1 else 0):
        halves = np.round((pan - exact) / np.pi)  # odd: the answer beyond the pole
        answer = exact + halves * np.pi
        tilted = np.arctan2(way[:, 2], np.where(halves % 2 == 0, level, -level))
        turned = _turned(tilted - sum(tilt) / 2.0)
        reached = np.abs(turned) <= (tilt[1] - tilt[0]) / 2.0 + 1e-9
        weight = np.where(reached, (level * np.cos(pan - answer)) ** 2, 0.0)
        likes = _LIKED / 2.0 * np.maximum(np.cos(pan - liked), 0.0) + 1e-12
        bands = np.zeros((2, len(pan)))
        bands[0] = weight + likes + 2.0 * between
        bands[0, [0, -1]] -= between
        bands[1, :-1] = -between
        pan = solveh_banded(bands, weight * answer + likes * (pan + _turned(liked - pan)), lower=True)
    return np.asarray(pan)


def _turned(angle: Array) -> Array:
    """The angle wrapped to -pi..pi."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
