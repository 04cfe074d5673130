"""Stability: is it the same take when the same sound comes again, a little quieter, resampled or compressed?

Theory: an animator who has approved a clip exports the sound again. The new motion should be the old one. Of two
motions on the common body, over the frames that both have, with d_j the distance of joint j:

- distance of the hands, cm, mean over frames.
- healed: of the times at which a wrist parts from its twin by more than 2 cm, the percentage after which they are
  together again (for 0.25 s) within so many seconds.

And of two plans: percentage of the time they have in common with another lexeme. Comparing the k-th blocks would call
all blocks other after a beat that only one of the sounds has.

Good: 0. What fools them: a system that ignores the sound is perfectly stable. They count only beside figures that say
that the motion fits the sound.

    >>> healed(np.array([False, True, True, False, False, False, False]), 1.0, hz=4)
    100.0
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.motion.phases import runs
from data_module.types import Array
from eval.metrics.eye.body import HZ, CommonBody

ALIKE = 0.02
"""Metres: hands that are nearer than this are together."""
TOGETHER = 0.25
"""Seconds for which they must be together to have come together again."""
UNIT = 5.0
"""Seconds: half of the gesture units of real speakers are shorter than 3.5 to 9.6."""
Blocks = tuple[Array, NDArray[np.int64]]
"""Edges of the blocks of a plan [N + 1], seconds, and their lexemes [N]."""


@dataclass(frozen=True)
class Difference:
    """How far two takes are apart; see the chapter. hands: mean cm; healed: %, NaN where they never part."""

    hands: float
    healed: float


def healed(apart: NDArray[np.bool_], within: float, hz: float = HZ) -> float:
    """Percentage of the partings of a mask [T] after which both are together within so many seconds, for `TOGETHER`
    seconds or to the end. A parting that the end cuts off sooner than that does not count. NaN without any."""
    together = np.zeros(len(apart), bool)
    least = round(TOGETHER * hz)
    for begin, stop in runs(~apart):
        together[begin:stop] = stop - begin >= least or stop == len(apart)
    # A short touch in passing is no coming together, so runs are taken of what lasted.
    counted = good = 0
    for begin, stop in runs(~together):
        if stop == len(apart) and stop - begin < within * hz:
            continue
        counted, good = counted + 1, good + int(stop - begin <= within * hz)
    return 100.0 * good / counted if counted else math.nan


def difference(first: CommonBody, second: CommonBody, within: float = UNIT) -> Difference:
    """Of two takes; within: seconds in which they should come together again."""
    frames = min(len(first), len(second))
    # Wrists alone: what a viewer follows, and what parts first.
    away = np.linalg.norm(first.hands[:frames] - second.hands[:frames], axis=-1)
    return Difference(100.0 * float(away.mean()), healed(away.max(axis=1) > ALIKE, within))


def other_lexemes(first: Blocks, second: Blocks) -> float:
    """Percentage of the time in common in which two plans have another lexeme; NaN without any."""
    # Between neighbouring edges of both plans neither changes its lexeme.
    edges = np.union1d(first[0], second[0])
    edges = edges[(edges >= max(first[0][0], second[0][0])) & (edges <= min(first[0][-1], second[0][-1]))]
    lengths, middles = np.diff(edges), edges[:-1] + np.diff(edges) / 2.0
    before, after = (lexemes[np.searchsorted(times, middles) - 1] for times, lexemes in (first, second))
    return 100.0 * float(lengths[before != after].sum() / lengths.sum()) if len(lengths) else math.nan
