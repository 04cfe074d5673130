"""Random numbers that are keyed by seed, variation and media time.

No generator of random numbers runs along: each number is a function of its keys, so a file, a stream and an edited plan
sample alike, and so do two recordings that differ somewhere else. The numbers change gradually with time: with g_k
independent and standard normal, one for each 0.1 s of media time,

    z(t) = cos(a) g_k + sin(a) g_{k + 1},   k = floor(t / 0.1),   a = (t / 0.1 - k) pi / 2,

which is standard normal at every t, independent for blocks that begin 0.2 s or more apart, and nearly the same
(r = .99) for one that begins 10 ms later because a beat was detected later.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from gesticulator.body.life import normal

_MILLISECONDS = 100
"""Milliseconds between independent numbers: half of the shortest block."""
_MOTION, _CHOICE = 0, 1
_POSE, _PLAN, _ACTIVITY = 1 << 20, (1 << 20) + 1, (1 << 20) + 2
"""Kinds of numbers: of the motion, of the choice of lexemes, of first poses, of the planner and of activity."""
_WAXES = 3000
"""Milliseconds between independent numbers of activity: people's gestures wax and wane over a few seconds."""
_CHANNELS = 1 << 32
"""The first channel of `life.mixed` here; the idle motion and the choice of phrases use lower ones."""


@dataclass(frozen=True)
class Keys:
    """Keys of the random numbers of blocks, besides their time: seed and variation of the performance."""

    seed: int
    variation: int = 0

    def noise(self, time: float, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Standard normal noise of the motion of the block that begins at `time` seconds, of this shape."""
        # Row by row, so that the first candidate is the same for any number of them.
        return self._normal(_MOTION, time, shape[0] * shape[1]).reshape(shape).astype(np.float32)

    def gumbel(self, time: float, count: int) -> Array:
        """[count] standard Gumbel noise, one for each lexeme, for the choice in the block that begins at `time`
        seconds. The arg max of log p_n + G_n has the distribution p (the Gumbel-max trick), and a small change of p
        rarely changes it."""
        return _gumbel(self._normal(_CHOICE, time, count))

    def plan(self, time: float, count: int) -> Array:
        """[count] standard Gumbel noise for the decision of the planner of gesture units."""
        return _gumbel(self._normal(_PLAN, time, count))

    def uniform(self, time: float, count: int) -> Array:
        """[count] numbers in (0, 1) for the preparation that begins at `time` seconds."""
        from scipy.special import ndtr

        return np.asarray(ndtr(self._normal(_POSE, time, count)))

    def activity(self, time: float) -> float:
        """A standard normal number that changes over seconds: how lively the gestures are at `time`."""
        return float(self._normal(_ACTIVITY, time, 1, _WAXES)[0])

    def _normal(self, kind: int, time: float, count: int, apart: int = _MILLISECONDS) -> Array:
        """[count] standard normal numbers at a time in seconds; times within a millisecond are the same. apart:
        milliseconds between independent numbers."""
        cell, rest = divmod(round(time * 1000), apart)
        numbers = cell * count + np.arange(2 * count)
        both = normal(self.seed, _CHANNELS + 2 * self.variation + kind, numbers)
        angle = 0.5 * pi * rest / apart
        return cos(angle) * both[:count] + sin(angle) * both[count:]


def _gumbel(normal_numbers: Array) -> Array:
    from scipy.special import log_ndtr

    return np.asarray(-np.log(-log_ndtr(normal_numbers)))
