"""Returns to a home pose, at which a performance forgets what was before.

People bring their hands home between gesture units, every 3 to 10 seconds. Here the body returns to a home pose at
times T_n some seconds apart (`selection.returns`), keyed by the seed, along

    x(t) (1 - w) + h_n w,   w = s^3 (10 - 15 s + 6 s^2),   s = (t - T_n + `TAKES`) / `TAKES`

and the first block that begins after T_n is generated as the first of a performance, from h_n at rest. So it depends
on the sound from there on and on keyed random numbers, not on earlier poses and choices: two performances of nearly
the same sound that parted come together again.

The home poses differ: each arm is somewhere between the mean pose of the speaker and the resting pose, or a little
above the mean pose, again keyed by the seed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from gesticulator.body.life import SIDES, eased, uniform

_EARLY = 0.12
"""Share of the mean time between returns by which one may be early or late."""
_FIRST = 2.0
"""Seconds before which there is no return."""
TAKES = 0.9
"""Seconds of a return."""
_LOWEST, _HIGHEST = 0.55, -0.45
"""How far towards the resting pose an arm's home may be, as a share of the way from the mean pose."""
_CHANNEL = 1 << 22
"""The first channel of `life.mixed`; two are used for the times, and one for each arm."""


class Returns:
    """Times and poses of one performance's returns."""

    def __init__(self, seed: int, every: float, names: Sequence[str], rest: Array) -> None:
        """every: mean seconds between returns; names: of the J joints; rest: [D_m] the normalised resting pose, three
        numbers a joint; 0 is the mean pose."""
        self._seed, self._every, self._rest = seed, every, rest
        self._arms = [np.repeat([name.startswith(side) for name in names], 3) for side in SIDES]

    def unit(self, time: float) -> int:
        """The number n > 0 of the first return after `time` seconds: T_n > time."""
        n = max(int(time / self._every) - 1, 1)
        while self._time(n) <= max(time, _FIRST):
            n += 1
        return n

    def share(self, n: int, times: Array) -> Array:
        """[K] w of return n at `times` [K], seconds; 1 after it."""
        return eased((times - self._time(n) + TAKES) / TAKES)

    def home(self, n: int) -> NDArray[np.float32]:
        """[D_m] h_n, normalised."""
        pose = np.zeros_like(self._rest)
        for side, columns in enumerate(self._arms):
            pose[columns] = (_HIGHEST + (_LOWEST - _HIGHEST) * self._chance(2 + side, n)) * self._rest[columns]
        return pose.astype(np.float32)

    def _time(self, n: int) -> float:
        """T_n, seconds."""
        return self._every * (n - self._chance(0, 0) + _EARLY * (2.0 * self._chance(1, n) - 1.0))

    def _chance(self, channel: int, number: int) -> float:
        return float(uniform(self._seed, _CHANNEL + channel, np.array([number]))[0])
