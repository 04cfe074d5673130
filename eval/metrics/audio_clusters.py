"""Association between clusters of sound and lexemes (RG 7.4.1, Figure 14).

Theory: blocks of speech are put into clusters by one level of the audio features (k-means), and each block has the
lexeme of its motion. If the clusters tell something about the lexeme, the lexemes within a cluster are fewer: the
entropy of the lexeme given the cluster, H(lexeme | cluster), is lower. The paper shows two clusters in a picture and
says that high-level clusters hold few lexemes and low-level ones most.

What fools it: fifty clusters and fifty lexemes have 2,500 cells, and with a few blocks in each even unrelated labels
have a low entropy. So every figure stands beside that of the same lexemes, turned round within each recording by a
random number of blocks: that keeps how often each is used, by whom, and how they follow one another, and breaks only
what ties them to the sound. What counts is the gain, the second less the first. A bundle whose interpreter hears the
high level alone makes its own gestures depend on it; the performer's gestures are the harder question.

    >>> float(conditional_entropy(np.array([[4.0, 0.0], [0.0, 4.0]]))), float(conditional_entropy(np.ones((1, 1))))
    (0.0, 0.0)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from eval import stats
from eval.metrics.diversity import entropy
from eval.stats import Interval

CLUSTERS, DRAWS, TURNS = 50, 300, 100
_AVERAGED = 10  # of the turns: those that the baseline of a bootstrap draw is the mean of
_FARTHEST = 10  # blocks: a turn by fewer leaves the lexeme near its sound
Labels = NDArray[np.int64]


def cluster(features: NDArray[np.floating], count: int = CLUSTERS, seed: int = 0) -> Labels:
    """[n] the cluster of each block [n, d], by k-means; as many clusters as there are blocks where they are few."""
    from sklearn.cluster import KMeans

    means = KMeans(min(count, len(features)), n_init=3, random_state=seed)
    return np.asarray(means.fit_predict(np.asarray(features, dtype=np.float32)), dtype=np.int64)


def conditional_entropy(table: Array) -> Array:
    """H(column | row) in nats of tables of counts [..., rows, columns]."""
    def summed(counts: Array) -> Array:
        return (counts * np.log(np.where(counts > 0, counts, 1.0))).sum(axis=-1)

    rows = table.sum(axis=-1)
    flat = table.reshape(*table.shape[:-2], -1)
    return np.asarray((summed(rows) - summed(flat)) / rows.sum(axis=-1))


def turned(labels: Labels, recording: Labels, rng: np.random.Generator) -> Labels:
    """Labels [n] turned round within each recording [n] by a random number of blocks."""
    out = labels.copy()
    for number in np.unique(recording):
        at = np.flatnonzero(recording == number)
        # Short recordings have no turn that far; any is taken there.
        least = _FARTHEST if len(at) > 2 * _FARTHEST else 0
        out[at] = np.roll(labels[at], int(rng.integers(least, max(len(at) - least, 1))))
    return out


def _tables(clusters: Labels, lexemes: Labels, group: Labels) -> Array:
    """[G, clusters, lexemes] counts."""
    shape = (int(group.max()) + 1, int(clusters.max()) + 1, int(lexemes.max()) + 1)
    return np.bincount(np.ravel_multi_index((group, clusters, lexemes), shape), minlength=int(np.prod(shape))
                       ).reshape(shape).astype(np.float64)


def association(levels: Mapping[str, Labels], lexemes: Labels, recording: Labels, group: Labels, *, draws: int = DRAWS,
                turns: int = TURNS, seed: int = 0) -> dict[str, Any]:
    """H(lexeme | cluster) for the clusters of each level, beside its chance, and the gain with intervals over groups.

    levels: clusters [n] of each block by name; lexemes, recording, group: [n], group from 0. Gives for each level
    "entropy", "by_chance", "gain" (chance less entropy) and "p" (share of turns with as low an entropy); and under
    "gain_differences" the gain of each later level less that of each earlier one, on the same draws. Nats. The entropy
    itself has no interval: a draw repeats groups, so its entropies, and those by chance, are lower than of all groups.
    """
    rng = np.random.default_rng(seed)
    groups = int(group.max()) + 1
    # The first row of weights is the data as it is, the others are the bootstrap's draws of groups.
    weights = np.stack([np.ones(groups), *(np.bincount(rng.integers(groups, size=groups), minlength=groups)
                                           for _ in range(draws))]).astype(np.float64)
    # Turned, not shuffled: lexemes keep their order, so chance has the runs that real sequences have.
    shuffled = [turned(lexemes, recording, rng) for _ in range(turns)]
    out: dict[str, Any] = {}
    gains: dict[str, Array] = {}
    for name, clusters in levels.items():
        values = _drawn_entropy(weights, clusters, lexemes, group)
        # Chance is drawn with the same weights, so that what a draw does to both cancels in the gain.
        chance = np.mean([_drawn_entropy(weights, clusters, other, group) for other in shuffled[:_AVERAGED]], axis=0)
        every = [float(conditional_entropy(_tables(clusters, other, group).sum(axis=0))) for other in shuffled]
        gains[name] = chance - values
        out[name] = {"entropy": float(values[0]), "by_chance": float(np.mean(every)),
                     "gain": _interval(gains[name], groups),
                     "p": (1 + sum(value <= values[0] for value in every)) / (1 + turns)}
    names = list(levels)
    out["gain_differences"] = {f"{b} - {a}": _interval(gains[b] - gains[a], groups)
                               for i, a in enumerate(names) for b in names[i + 1:]}
    out["blocks"], out["lexeme_entropy"] = len(lexemes), entropy(np.bincount(lexemes))
    return out


def _drawn_entropy(weights: Array, clusters: Labels, lexemes: Labels, group: Labels) -> Array:
    """[draws] H(lexeme | cluster), each group counted as often as the draw has it."""
    tables = _tables(clusters, lexemes, group)
    return np.array([float(conditional_entropy(np.tensordot(row, tables, axes=1))) for row in weights])


def _interval(values: Array, groups: int) -> Interval:
    """The first value, of everything, with the interval of the others, the draws."""
    return stats.limits(float(values[0]), values[1:], groups)
