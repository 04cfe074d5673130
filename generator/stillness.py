"""Stillness and strokes: what of a generated movement an arm makes.

People's hands are nearly still or quick; what is generated moves at an even speed. So an arm makes the share k of a
generated movement dg of its pose, and catches up with what it stayed behind by, d, on the way of quick movements:

    d <- exp(-a q |dh| / c) d + (k - 1) dg,   k = a (k_0 + (1 - k_0) q)

|dh| is the way of its hand, q rises from 0 to 1 with the hand's speed, and a with an activity that waxes and wanes over
seconds: in calm times people make small beats about one pose. Where the hands set out, d is 0 again.
"""

from __future__ import annotations

import numpy as np

from data_module.layers_run import Floats
from data_module.types import Array

HOME = {"RightArm": (4.0, -9.0, -3.0), "RightForeArm": (0.0, 7.0, 0.0), "LeftArm": (4.0, 9.0, 3.0),
        "LeftForeArm": (0.0, -7.0, 0.0)}
"""Degrees from a generated joint to the shown one, exponential maps: in the corpus hands are lower and nearer to each
other than those of people who talk."""
HELD = 0.4
"""a of a hold: people's held hands still drift by one to three centimetres."""
_QUICK, _LEAST = (0.12, 0.41), 0.65
"""Speeds of a hand where q is 0 and 1, m/s; and k_0."""
_ACTIVITY = (-0.8, 0.3), (0.6, 1.2)
"""Activity in deviations, and a: at or below the first, at or above the second."""
_CATCHES_UP = 0.25
"""c, metres."""


def share_at(activity: float) -> float:
    """a at an activity, deviations."""
    return np.interp(activity, *_ACTIVITY)


def left_behind(before: Floats, steps: Floats, ways: Array, seconds: float, shares: tuple[float, float], arms: Floats
                ) -> Floats:
    """[K, D_m] d in each frame of a block, from d before it. steps: [K, D_m] dg of each frame; ways: [K, 2] |dh|,
    metres; seconds: of the block; shares: a at its start and end; arms: [2, D_m] 1 in the columns of that arm."""
    quick = np.interp(ways * (len(steps) / seconds), _QUICK, (0.0, 1.0))
    share = np.linspace(*shares, len(steps) + 1)[1:, None]
    keeps = np.exp(-share * quick * ways / _CATCHES_UP) @ arms
    missed = (share * (_LEAST + (1.0 - _LEAST) * quick) - 1.0) @ arms * steps
    out = np.empty_like(steps)
    for k in range(len(steps)):
        out[k] = before = keeps[k] * before + missed[k]
    return out
