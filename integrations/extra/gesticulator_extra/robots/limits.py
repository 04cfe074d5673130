"""Limits angles and speeds over time."""

from __future__ import annotations

import numpy as np

from data_module.types import Array

MARGIN = 1e-4
"""Distance from a limit that rounding cannot cross, radians (0.006 degrees)."""
SPEED_SHARE = 0.5
"""Largest share of a motor's speed used. Speakers seldom need a third of it; faster motion mostly occurs where two
solutions for an arm meet, and should keep a reserve."""


def held(angles: Array, low: Array, high: Array, most: Array, fps: float) -> Array:
    """Angles [T, n] limited to low..high [n] (radians), with speeds within `SPEED_SHARE` of `most` [n] (radians per
    second)."""
    return slowed(np.clip(angles, low + MARGIN, high - MARGIN), SPEED_SHARE * most / fps)


def slowed(values: Array, step: Array) -> Array:
    """The nearest track to values [T, n] that changes by at most step [n] per frame.

    Every such track lies above the lower envelope of a(s) + step |t - s| and below the upper envelope of
    a(s) - step |t - s| over all s; the track halfway between minimises the greatest distance from a. It starts before a
    jump and ends as much after it, so it has no lag on average; where a is slow enough, it equals a.
    """
    ramp = np.arange(len(values))[:, None] * step

    def reach(track: Array) -> Array:
        ahead = np.minimum.accumulate(track - ramp) + ramp
        back = np.minimum.accumulate((track + ramp)[::-1])[::-1] - ramp
        return np.minimum(ahead, back)

    return (reach(values) - reach(-values)) / 2.0
