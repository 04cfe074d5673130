"""Does a score rank? Retrieval among rivals, and the place of what was really done among all that could have been.

Theory: a score of pairs [n, n] should find each row's own column among its rivals; a score of actions [n, S] should be
high for the action of the performer. Both are given beside what blind guessing has. Good: high retrieval, a low rank.
What fools them: ties, which count as lost in retrieval and share their ranks among actions, so that a constant finds
nothing and has the rank of chance; and rivals that anything tells apart, such as the voice.

    >>> true_rank(np.array([[0.1, 0.4, 0.2]]), np.array([2])).tolist()
    [2.0]
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array

FIRST = (1, 5)
Mask = NDArray[np.bool_]
Integers = NDArray[np.int64]


def places(scores: Array, rivals: Mask) -> Integers:
    """[n] the place of each row's own column (1 the first) among itself and its rivals, both [n, n]; ties are lost."""
    rivals = rivals & ~np.eye(len(rivals), dtype=bool)
    beaten = (scores < np.diagonal(scores)[:, None]) & rivals
    return np.asarray(1 + rivals.sum(axis=1) - beaten.sum(axis=1), dtype=np.int64)


def retrieval(scores: Array, rivals: Mask) -> dict[str, Array]:
    """Percent of hits for each window [n], NaN for one without a rival; scores [n, n]: motion (rows) against audio.

    motion_r1, motion_r5: audio sought for a motion; audio_r1, audio_r5: motion sought for an audio; chance_r1,
    chance_r5: blind guessing. rivals: [n, n], symmetric.
    """
    count = (rivals & ~np.eye(len(rivals), dtype=bool)).sum(axis=1)
    out = {}
    for first in FIRST:
        for name, table in (("motion", scores), ("audio", scores.T)):
            out[f"{name}_r{first}"] = np.where(count > 0, 100.0 * (places(table, rivals) <= first), np.nan)
        out[f"chance_r{first}"] = np.where(count > 0, 100.0 * np.minimum(1.0, first / (count + 1)), np.nan)
    return out


def true_rank(rewards: Array, true: Integers) -> Array:
    """[n] the rank of the true action among rewards [n, S], 1 the highest; chance is (S + 1) / 2.

    Equal rewards share the mean of their ranks.
    """
    own = np.take_along_axis(rewards, true[:, None], axis=1)
    return np.asarray(1.0 + (rewards > own).sum(axis=1) + ((rewards == own).sum(axis=1) - 1) / 2.0)


def share_of_range(rewards: Array, true: Integers) -> tuple[Array, Array]:
    """[n] where the reward of the true action lies between the least (0) and the most (1), and where the mean of all
    actions does, which is what guessing has; rewards: [n, S]. NaN where all actions have one reward."""
    least, most = rewards.min(axis=1), rewards.max(axis=1)
    own = np.take_along_axis(rewards, true[:, None], axis=1)[:, 0]
    width = np.where(most > least, most - least, np.nan)
    return (own - least) / width, (rewards.mean(axis=1) - least) / width


def spreads(rewards: Array) -> tuple[float, float]:
    """Standard deviations of rewards [n, S] of one recording: over actions (root mean square over states), and over
    states (of the mean over actions). The second is what no choice of one action can change. NaN for one state."""
    if len(rewards) < 2:
        return float("nan"), float("nan")
    return float(np.sqrt(rewards.var(axis=1).mean())), float(rewards.mean(axis=1).std())


def agreement(first: Array, second: Array) -> Array:
    """[n] Pearson correlation over actions of two models' rewards [n, S]; NaN where either is constant."""
    one, other = (rows - rows.mean(axis=1, keepdims=True) for rows in (first, second))
    norm = np.sqrt((one ** 2).sum(axis=1) * (other ** 2).sum(axis=1))
    return np.divide((one * other).sum(axis=1), norm, out=np.full(len(first), np.nan), where=norm > 0)
