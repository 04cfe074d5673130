"""Angles within what a joint allows, and speeds within what its motor does, over time."""

from __future__ import annotations

import numpy as np

from data_module.types import Array

MARGIN = 1e-4
"""Radians (0.006 degrees) that angles keep from a limit, so that rounding never puts one beyond it."""
SPEED_SHARE = 0.5
"""Share of a motor's speed that is used. People who speak seldom ask for a third of it; what asks for more is mostly
where two ways of holding an arm meet, and a robot should pass there with its strength to spare."""


def held(angles: Array, low: Array, high: Array, most: Array, fps: float) -> Array:
    """Angles [T, n] that stay within low to high [n] (radians), and whose steps stay within `SPEED_SHARE` of most [n]
    (radians per second)."""
    return slowed(np.clip(angles, low + MARGIN, high - MARGIN), SPEED_SHARE * most / fps)


def slowed(values: Array, step: Array) -> Array:
    """The nearest track of values [T, n] that changes by no more than step [n] from frame to frame.

    No faster track lies below the lower one of a(s) + step |t - s|, nor above the upper one of a(s) - step |t - s|,
    over all s; halfway between them is the track whose greatest distance from a is least. It starts to move before a
    jump and is as late after it, so it lags nowhere on the whole; where a is slow enough, it is a itself.
    """
    ramp = np.arange(len(values))[:, None] * step

    def reach(track: Array) -> Array:
        ahead = np.minimum.accumulate(track - ramp) + ramp
        back = np.minimum.accumulate((track + ramp)[::-1])[::-1] - ramp
        return np.minimum(ahead, back)

    return (reach(values) - reach(-values)) / 2.0
