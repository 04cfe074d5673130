"""Stability: is it the same take when the same sound comes again, a little quieter, resampled or compressed?

Theory: an animator who has approved a clip exports the sound again. The new motion should be the old one. Of two
motions on the common body, over the frames that both have, with d_j the distance of joint j:

- distance of the joints (head, shoulders, elbows, wrists), and of the hands alone, cm, mean over frames.
- hands apart: percentage of frames in which a wrist is more than 2 cm from its twin.
- apart from: seconds at which they part for the first time.
- healed: of the times at which they part, the percentage after which they are together again (for 0.25 s) within so
  many seconds.
- correlation of the hands' mean speeds.

And of two plans: percentage of the time they have in common with another lexeme. Comparing the k-th blocks would call
all blocks other after a beat that only one of the sounds has.

Good: 0. What fools them: a system that ignores the sound is perfectly stable. They count only beside figures that say
that the motion fits the sound.

    >>> healed(np.array([False, True, True, False, False, False, False]), 1.0, hz=4)
    100.0
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from eval.metrics.eye.body import HZ, CommonBody
from eval.metrics.eye.hands import correlation
from eval.metrics.eye.together import hand_speeds
from eval.stats import runs

ALIKE = 0.02
"""Metres: hands that are nearer than this are together."""
TOGETHER = 0.25
"""Seconds for which they must be together to have come together again."""
UNIT = 5.0
"""Seconds: half of the gesture units of real speakers are shorter than 3.5 to 9.6."""
_JOINTS = ("Head", "LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "LeftHand", "RightHand")


Blocks = tuple[Array, NDArray[np.int64]]
"""Edges of the blocks of a plan [N + 1], seconds, and their lexemes [N]."""


@dataclass(frozen=True)
class Difference:
    """How far two takes are apart; see the chapter. joints, hands: mean cm; apart: % of time; first: seconds, NaN for
    never; healed: %, NaN where they never part; speed: correlation."""

    joints: float
    hands: float
    apart: float
    first: float
    healed: float
    speed: float


def healed(apart: NDArray[np.bool_], within: float, hz: float = HZ) -> float:
    """Percentage of the partings of a mask [T] after which both are together within so many seconds, for `TOGETHER`
    seconds or to the end. A parting that the end cuts off sooner than that does not count. NaN without any."""
    together = np.zeros(len(apart), bool)
    least = round(TOGETHER * hz)
    for begin, stop in runs(~apart).tolist():
        together[begin:stop] = stop - begin >= least or stop == len(apart)
    # A short touch in passing is no coming together, so runs are taken of what lasted.
    counted = good = 0
    for begin, stop in runs(~together).tolist():
        if stop == len(apart) and stop - begin < within * hz:
            continue
        counted, good = counted + 1, good + int(stop - begin <= within * hz)
    return 100.0 * good / counted if counted else math.nan


def difference(first: CommonBody, second: CommonBody, within: float = UNIT) -> Difference:
    """Of two takes; within: seconds in which they should come together again."""
    frames = min(len(first), len(second))
    first, second = first.crop(0, frames), second.crop(0, frames)
    away = np.stack([np.linalg.norm(first.points[joint] - second.points[joint], axis=1) for joint in _JOINTS], axis=1)
    # The last two of `_JOINTS` are the wrists.
    apart = away[:, -2:].max(axis=1) > ALIKE
    parting = float(np.argmax(apart)) / HZ if apart.any() else math.nan
    speeds = np.stack([hand_speeds(body).mean(axis=1) for body in (first, second)], axis=1)
    return Difference(100.0 * float(away.mean()), 100.0 * float(away[:, -2:].mean()), 100.0 * float(apart.mean()),
                      parting, healed(apart, within), correlation(speeds))


def other_lexemes(first: Blocks, second: Blocks) -> float:
    """Percentage of the time in common in which two plans have another lexeme; NaN without any."""
    # Between neighbouring edges of both plans neither changes its lexeme.
    edges = np.union1d(first[0], second[0])
    edges = edges[(edges >= max(first[0][0], second[0][0])) & (edges <= min(first[0][-1], second[0][-1]))]
    lengths, middles = np.diff(edges), edges[:-1] + np.diff(edges) / 2.0
    before, after = (lexemes[np.searchsorted(times, middles) - 1] for times, lexemes in (first, second))
    return 100.0 * float(lengths[before != after].sum() / lengths.sum()) if len(lengths) else math.nan
