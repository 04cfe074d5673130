"""Two hinges that point something: the angles over time, where one frame alone does not tell them.

A hinge pans about the vertical, a second one tilts what it carries: a camera on its mount, an upper arm on a shoulder,
a forearm on an elbow. Let p = (a, b, h) be a unit direction, (a, b) its part in the plane of panning. Then

    (a, b) = cos(tilt) (cos pan, sin pan),     h = sin(tilt).

Each direction has two answers, and near the pole (h = 1: an arm along the hinge, a straight elbow) a small way of p is
a long way of pan: whatever passes the pole on the wrong side would have to turn half around in no time. Frame by frame
that cannot be settled. So the pan of all frames is chosen together, by dynamic programming over a grid of angles: with
e(t, pan) how far p(t) is from what can be reached at that pan, it is the one with the least

    sum over t of  e(t, pan_t)^2  +  m (1 - cos(pan_t - liked_t))  +  l fps^2 (pan_t - pan_(t-1))^2

and then taken off the grid by steps of least squares. It goes straight through the pole where it must, and misses p
there by a few degrees for some frames.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solveh_banded

from data_module.types import Array

_GRID = np.radians(3.0)
"""Radians between the angles that are tried."""
_SMOOTH = 2e-5
"""l, seconds squared: turning half around within 0.2 s costs as much as 6 degrees off the way in that time."""
_LIKED = 2e-3
"""m: the liked angle counts as much as 2.5 degrees off the way, so where the direction tells the angle it counts
little."""
_POLISH = 3
"""Steps of least squares after the grid."""
_CHUNK = 2048
"""Frames whose costs are held at once."""
_Limits = tuple[float, float]


def tilt_at(pan: Array, way: Array, limits: _Limits) -> Array:
    """[...] the tilt within limits that points nearest to way [..., 3] at a pan [...]."""
    level = way[..., 0] * np.cos(pan) + way[..., 1] * np.sin(pan)
    middle = sum(limits) / 2.0
    # The angle that is nearest to the middle of the limits, so that the nearer end is taken where it is beyond them.
    return np.clip(middle + _turned(np.arctan2(way[..., 2], level) - middle), *limits)


def pan_over_time(way: Array, liked: Array, fps: float, pan: _Limits, tilt: _Limits) -> Array:
    """[T] the pan of each frame. way: [T, 3] unit directions; liked: [T] radians, what is taken where a direction does
    not tell; pan, tilt: limits, radians, less than a turn apart."""
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
    """[T, N] what each pan of the grid costs in each frame, apart from how it is reached."""
    best = tilt_at(grid, way[:, None], tilt)
    level = way[:, :1] * np.cos(grid) + way[:, 1:2] * np.sin(grid)
    missed = 2.0 - 2.0 * (np.cos(best) * level + np.sin(best) * way[:, 2:])
    return np.asarray(missed + _LIKED * (1.0 - np.cos(grid - liked[:, None])))


def _polished(pan: Array, way: Array, liked: Array, fps: float, tilt: _Limits) -> Array:
    """[T] the pan off the grid: least squares towards each frame's own answers, as far as they are near."""
    exact, level = np.arctan2(way[:, 1], way[:, 0]), np.hypot(way[:, 0], way[:, 1])
    between = _SMOOTH * fps ** 2
    for _ in range(_POLISH if len(pan) > 1 else 0):
        halves = np.round((pan - exact) / np.pi)  # odd: the answer beyond the pole
        answer = exact + halves * np.pi
        tilted = np.arctan2(way[:, 2], np.where(halves % 2 == 0, level, -level))
        turned = _turned(tilted - sum(tilt) / 2.0)
        reached = np.abs(turned) <= (tilt[1] - tilt[0]) / 2.0 + 1e-9
        told = np.where(reached, (level * np.cos(pan - answer)) ** 2, 0.0)
        likes = _LIKED / 2.0 * np.maximum(np.cos(pan - liked), 0.0) + 1e-12
        bands = np.zeros((2, len(pan)))
        bands[0] = told + likes + 2.0 * between
        bands[0, [0, -1]] -= between
        bands[1, :-1] = -between
        pan = solveh_banded(bands, told * answer + likes * (pan + _turned(liked - pan)), lower=True)
    return np.asarray(pan)


def _turned(angle: Array) -> Array:
    """The same angle from -pi to pi."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
