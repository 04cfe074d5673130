"""Fresh starts: each stroke is prepared anew, and what was before is forgotten.

People decide stroke by stroke: a preparation begins where the hand happens to be, but what is prepared does not depend
on how the hand came there. So where the planner lets the hands set out (a preparation begins, or a stroke that was not
prepared), the block is generated as the first of a performance, from a pose h that is keyed by seed and time, at rest.
What is shown is the generated motion g plus an offset that fades from the difference of the pose p and the velocity v
last shown (inertialisation, as in games):

    x(t) = g(t) + (p - h) a(s) + v T b(s),   s = (t - t_0) / T,
    a(s) = 1 - s^3 (10 - 15 s + 6 s^2),   b(s) = s - 6 s^3 + 8 s^4 - 3 s^5

a and b have no jump in value, speed or acceleration at either end. Two performances of nearly the same sound that
parted are one again T seconds after the hands set out next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from data_module.types import Array
from gesticulator.body.life import SIDES, eased
from gesticulator.drawing.keys import Keys

FADES = 0.6
"""T, seconds: as long as a preparation takes."""
_LOWEST, _HIGHEST = 0.55, -0.45
"""How far towards the resting pose an arm's first pose may be, as a share of the way from the mean pose."""


class FirstPoses:
    """The poses h of one performance, from which preparations are generated."""

    def __init__(self, keys: Keys, names: Sequence[str], rest: Array) -> None:
        """names: of the J joints; rest: [D_m] the normalised resting pose, three numbers a joint; 0 is the mean
        pose."""
        self._keys, self._rest = keys, rest
        self._arms = [np.repeat([name.startswith(side) for name in names], 3) for side in SIDES]

    def at(self, time: float) -> Array:
        """[D_m] h of a preparation that begins at `time` seconds, normalised. Each arm is somewhere between the mean
        and the resting pose, or a little above the mean pose."""
        pose = np.zeros_like(self._rest)
        for columns, chance in zip(self._arms, self._keys.uniform(time, len(self._arms)), strict=True):
            pose[columns] = (_HIGHEST + (_LOWEST - _HIGHEST) * chance) * self._rest[columns]
        return pose.astype(np.float32)


@dataclass(frozen=True)
class Offset:
    """The fading offset from `begin` seconds. pose: [D_m] p - h; velocity: [D_m] v, a second."""

    begin: float
    pose: Tensor
    velocity: Tensor

    def at(self, times: Array) -> Tensor:
        """[K, D_m] at times [K], seconds."""
        s = np.clip((np.asarray(times) - self.begin) / FADES, 0.0, 1.0)
        sinks, coasts = 1.0 - eased(s), FADES * (s - 6.0 * s**3 + 8.0 * s**4 - 3.0 * s**5)
        weights = torch.as_tensor(np.stack([sinks, coasts]), dtype=self.pose.dtype, device=self.pose.device)
        return weights[0][:, None] * self.pose + weights[1][:, None] * self.velocity

    def over(self, time: float) -> bool:
        """Whether it has faded at `time` seconds."""
        return time >= self.begin + FADES
