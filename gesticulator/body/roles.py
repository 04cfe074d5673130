"""Which arm gestures, and around which posture.

People gesture with one hand for some seconds while the other hangs or waits, or with both together, and come back to
one posture between strokes. A generator that samples both arms block by block has neither: each arm wanders through
places of its own. So the arms that are shown are the generated ones seen through a *role*, which changes every few
seconds.

With x the deviation of an arm from the speaker's mean pose, m that of the other arm, mirrored, and p the resting pose
(all in deviations of each joint), and a role of four numbers (`Role`):

    y = x + follows (1 - min(s, s')) (m - x)              both hands together
    y' = y - q l (1 - s) p                                half-way down is no place to stay
    k = OUTER - (OUTER - INNER) exp(-(r / NEAR)^2)        small deviations shrink, large ones grow
    z = -raised (1 - s) p + (s + (1 - s) gestures k) y'
    shown = z + hangs (p + SWAY (y' - p) - z)

where r is the root mean square of y, l how far it is lowered, 0 to 1 towards p, s = 3 l^2 - 2 l^3, and s' that of the
other arm; in the upper arm `raised` is less (`UPPER_ARM`). At rest, l = 1 for both, every role shows the resting pose.
All is a function of the pose and of seed, voice and time, so files, streams and edited plans agree; the generator never
sees it.

The numbers were chosen on the twelve sounds of the GENEA 2020 study at five seeds and by raters who saw pictures
without names (docs/results.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_module.motion.kinematics import minimum_jerk
from data_module.types import Array
from gesticulator.body.life import SIDES, VOICE_BITS, normal, smooth_step
from gesticulator.bundle.features import Statistics

PERIOD, JITTER = 6.5, 0.4
"""Seconds of a role on average, and by which share of it a change comes early or late."""
CHANGES = 1.0
"""Seconds in which one role passes into the next."""
ONE_HANDED, DOMINANT, HANGING = 0.5, 0.7, 0.75
"""Probability that one hand gestures alone; that it is the performance's dominant one; that the other hangs by then."""
FOLLOWS = 0.75
"""How far the other hand follows the dominant one where both gesture."""
WAITS = 0.35
"""Share of its movement that a hand which waits still makes."""
RAISED, RAISES = 0.5, 0.25
"""By how much a posture is above the mean pose, as a share of the way from there to the resting pose, and its standard
deviation between roles."""
LOWEST, HIGHEST = 0.1, 1.6
"""Least and greatest of these shares."""
UPPER_ARM = 0.45
"""Share of `raised` that the upper arm takes: the elbow makes a posture, and elbows stay near the body."""
INNER, OUTER, NEAR = 0.4, 1.15, 0.6
"""Factors on small and on large deviations, and where one passes into the other."""
LIFTS = 0.25
"""What is added to `raised` for a requested hand height of one standard deviation over the mean."""
SWAY = 0.12
"""Share of its movement that a hanging arm still makes."""
_UP_AGAIN = 0.6
"""q, how much of a small step down is taken back."""
_CHANNEL = (1 << 32) - 64
"""The channels of `life.normal` of the roles: below those of `sampling.loop`, above those of the idle motion."""
_MIRRORED = np.array([1.0, -1.0, -1.0])
"""A turn about a vector [x, y, z], seen in a mirror across the body's plane of symmetry."""


class Role(NamedTuple):
    """What both arms do, right and left: each [2]. gestures: the share of the generated movement that is shown;
    follows: how far the arm follows the other; hangs: 1 hangs down; raised: how far its posture is above the mean."""

    gestures: Array
    follows: Array
    hangs: Array
    raised: Array

    def towards(self, other: Role, share: float) -> Role:
        """The role between this one (share 0) and another (1)."""
        return Role(*((1.0 - share) * mine + share * its for mine, its in zip(self, other, strict=True)))


AS_GENERATED = Role(np.ones(2), np.zeros(2), np.zeros(2), np.full(2, RAISED))
"""Where a movement was requested, it is shown by the arm that makes it."""


@lru_cache(maxsize=256)
def _drawn(seed: int, channel: int, period: int) -> tuple[float, Role]:
    """When the role of a period begins, in periods, and the role."""
    begins, single, dominant, hanging, right, left = normal(seed, channel, 8 * period + np.arange(6))
    early, alone, mostly, low = (0.5 * math.erfc(-float(number) / math.sqrt(2.0))
                                 for number in (begins, single, dominant, hanging))
    leads = int(normal(seed, channel, np.array([-1]))[0] > 0.0)
    if alone < ONE_HANDED and mostly >= DOMINANT:
        leads = 1 - leads
    other = np.eye(2)[1 - leads]
    raised = np.clip(RAISED + RAISES * np.array([right, left]), LOWEST, HIGHEST)
    begin = period + JITTER * (2.0 * early - 1.0)
    if alone < ONE_HANDED:
        return begin, Role(1.0 - (1.0 - WAITS) * other, np.zeros(2), other * float(low < HANGING), raised)
    return begin, Role(np.ones(2), FOLLOWS * other, np.zeros(2), raised)


def role_at(seed: int, variation: int, time: float, voice: int = 0) -> Role:
    """The role at `time` seconds."""
    channel = _CHANNEL + variation + (voice << VOICE_BITS)
    period = math.floor(time / PERIOD)
    # A boundary is less than half a period early or late.
    while _drawn(seed, channel, period + 1)[0] * PERIOD <= time:
        period += 1
    while _drawn(seed, channel, period)[0] * PERIOD > time:
        period -= 1
    begin, role = _drawn(seed, channel, period)
    passed = (time - begin * PERIOD) / CHANGES
    if passed >= 1.0:  # most of the time
        return role
    return _drawn(seed, channel, period - 1)[1].towards(role, float(minimum_jerk(np.array(passed))))


@dataclass(frozen=True)
class Roles:
    """The roles of a performance, a value: `for_block` gives that of the next block. voice: as of
    `sampling.loop.Keys`; fixed: the role that is shown instead of the drawn one, or None; before: the role shown when
    that last changed, at `since` seconds."""

    seed: int
    variation: int
    voice: int = 0
    fixed: Role | None = None
    before: Role | None = None
    since: float = -math.inf

    def at(self, time: float) -> Role:
        """The role that is shown at `time` seconds."""
        role = self.fixed or role_at(self.seed, self.variation, time, self.voice)
        if self.before is None or time >= self.since + CHANGES:
            return role
        return self.before.towards(role, float(minimum_jerk(np.array((time - self.since) / CHANGES))))

    def for_block(self, start: float, requested: bool, held: bool) -> Roles:
        """The roles from a block on that begins at `start` seconds. requested: its movement was, so its arms are shown
        as they are generated; held: the hands hold or rest there, so nothing changes."""
        fixed: Role | None = None
        if requested:
            fixed = AS_GENERATED
        elif held:
            # Whatever is shown when the hold begins.
            fixed = self.at(start) if self.fixed is None or self.fixed is AS_GENERATED else self.fixed
        if fixed is self.fixed:
            return self
        return replace(self, fixed=fixed, before=self.at(start), since=start)


def shown(roles: Roles, statistics: Statistics, speaker: int, names: Sequence[str], times: Array, block: Array,
          height: Array | float = 0.0) -> Array:
    """[K, D_m] a block of normalised motion [K, D_m] at `times` [K], its arms in their roles. names: of the J joints,
    three numbers each; height: [K] the requested height of the hands in standard deviations over the mean, 0 without a
    request."""
    both, upper = _arms(tuple(names))
    # [2, K, D] of both arms at once.
    resting = statistics.normalise(statistics.rest_pose[speaker], speaker)[both][:, None]
    scale, mean = statistics.deviation[both][:, None], statistics.mean_pose[speaker][both][:, None]
    gestures, follows, hangs, raised = (part.T[..., None] for part in np.swapaxes(
        [roles.at(time) for time in times.tolist()], 0, 1))
    raised = raised + LIFTS * np.broadcast_to(height, len(block))[:, None]
    arms = np.swapaxes(block[:, both], 0, 1).astype(np.float64)
    at_rest = smooth_step(_lowered(arms, resting)).min(axis=0)
    others = (arms * scale + mean)[::-1]
    mirrored = (others * np.tile(_MIRRORED, both.shape[1] // 3) - mean) / scale
    arms = arms + follows * (1.0 - at_rest) * (mirrored - arms)
    low = _lowered(arms, resting)
    sunk = smooth_step(low)
    moved = arms - _UP_AGAIN * low * (1.0 - sunk) * resting
    size = (arms ** 2).mean(axis=-1, keepdims=True)
    factor = OUTER - (OUTER - INNER) * np.exp(-size / NEAR ** 2)
    lift = raised * (1.0 - sunk) * np.where(upper, UPPER_ARM, 1.0)
    posture = -lift * resting + (sunk + (1.0 - sunk) * gestures * factor) * moved
    hanging = resting + SWAY * (moved - resting)
    out = block.astype(np.float64)
    out[:, both] = np.swapaxes(posture + hangs * (hanging - posture), 0, 1)
    return out


@lru_cache
def _arms(names: tuple[str, ...]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """[2, D] the columns of both arms, and which of them are of the upper arm [2, 1, D]."""
    both = np.array([np.flatnonzero(np.repeat([name.startswith(side) for name in names], 3)) for side in SIDES])
    upper = np.repeat([name.endswith("Arm") and not name.endswith("ForeArm") for name in names], 3)
    return both, upper[both][:, None]


def _lowered(arms: Array, rest: Array) -> Array:
    """[2, K, 1] how far each arm [2, K, D] is on its way from the mean pose to the resting pose [2, 1, D], 0 to 1."""
    return np.asarray(np.clip(arms @ np.swapaxes(rest, 1, 2) / np.vecdot(rest, rest)[..., None], 0.0, 1.0))
