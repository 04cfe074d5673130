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

    >>> round(conditional_entropy(np.array([0, 0, 1, 1]), np.array([2, 2, 2, 5])), 4)      # half of ln 2
    0.3466
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from eval.metrics.diversity import entropy

CLUSTERS, TURNS = 50, 100
_FARTHEST = 10  # blocks: a turn by fewer leaves the lexeme near its sound
Labels = NDArray[np.int64]


def cluster(features: NDArray[np.floating], count: int = CLUSTERS, seed: int = 0) -> Labels:
    """[n] the cluster of each block [n, d], by k-means; as many clusters as there are blocks where they are few."""
    from sklearn.cluster import KMeans

    means = KMeans(min(count, len(features)), n_init=3, random_state=seed)
    return np.asarray(means.fit_predict(np.asarray(features, dtype=np.float32)), dtype=np.int64)


def conditional_entropy(clusters: Labels, lexemes: Labels) -> float:
    """H(lexeme | cluster) in nats, of labels [n] each."""
    from sklearn.metrics import mutual_info_score

    return entropy(np.bincount(lexemes)) - float(mutual_info_score(clusters, lexemes))


def turned(labels: Labels, recording: Labels, rng: np.random.Generator) -> Labels:
    """Labels [n] turned round within each recording [n] by a random number of blocks."""
    out = labels.copy()
    for number in np.unique(recording):
        at = np.flatnonzero(recording == number)
        # Short recordings have no turn that far; any is taken there.
        least = _FARTHEST if len(at) > 2 * _FARTHEST else 0
        out[at] = np.roll(labels[at], int(rng.integers(least, max(len(at) - least, 1))))
    return out


def association(levels: Mapping[str, Labels], lexemes: Labels, recording: Labels, *, turns: int = TURNS, seed: int = 0
                ) -> dict[str, dict[str, float]]:
    """For the clusters [n] of each level, H(lexeme | cluster) in nats beside its chance.

    lexemes, recording: [n]. Gives for each level "entropy", "by_chance" (the mean over turns), "p" (share of turns with
    as low an entropy), and "alone", the entropy of the lexemes without any cluster.
    """
    rng = np.random.default_rng(seed)
    # Turned, not shuffled: lexemes keep their order, so chance has the runs that real sequences have.
    shuffled = [turned(lexemes, recording, rng) for _ in range(turns)]
    out = {}
    # The same turns for all levels, so that these differ by their clusters alone.
    for name, clusters in levels.items():
        value = conditional_entropy(clusters, lexemes)
        chance = [conditional_entropy(clusters, other) for other in shuffled]
        out[name] = {"entropy": value, "by_chance": float(np.mean(chance)),
                     "p": (1 + sum(other <= value + 1e-12 for other in chance)) / (1 + turns),
                     "alone": entropy(np.bincount(lexemes))}
    return out
