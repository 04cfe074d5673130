"""Association between clusters of sound and lexemes (RG 7.4.1, Figure 14).

Theory: blocks of speech are put into clusters by one level of the audio features (k-means), and each block has the
lexeme of its motion. If the clusters tell something about the lexeme, its entropy given the cluster is lower. The paper
shows two clusters in a picture and says that high-level clusters hold few lexemes and low-level ones most.

What fools it: fifty clusters and fifty lexemes have 2,500 cells, and with a few blocks in each even unrelated labels
have a low entropy. So every figure stands beside that of the same lexemes, turned round within each recording by a
random number of blocks: that keeps how often each is used, by whom, and how they follow one another, and breaks only
what ties them to the sound. What counts is the gain, the second less the first. A bundle whose interpreter hears the
high level alone makes its own gestures depend on it; the performer's gestures are the harder question.

    >>> round(conditional_entropy(np.array([0, 0, 1, 1]), np.array([2, 2, 2, 5])), 4)      # half of ln 2
    0.3466
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from eval.metrics.diversity import Labels, entropy

CLUSTERS, TURNS = 50, 100
_FARTHEST = 10  # blocks: a turn by fewer leaves the lexeme near its sound


def cluster(features: NDArray[np.float32], count: int = CLUSTERS) -> Labels:
    """[n] the cluster of each block [n, d], by k-means; as many clusters as there are blocks where they are few."""
    from sklearn.cluster import KMeans

    means = KMeans(min(count, len(features)), n_init=3, random_state=0)
    return np.asarray(means.fit_predict(features), dtype=np.int64)


def conditional_entropy(clusters: Labels, lexemes: Labels) -> float:
    """H(lexeme | cluster) in nats, of labels [n] each."""
    from sklearn.metrics import mutual_info_score

    return entropy(np.bincount(lexemes)) - float(mutual_info_score(clusters, lexemes))


def turned(lexemes: Labels, rng: np.random.Generator) -> Labels:
    """The lexemes [n] of a recording turned round by a random number of blocks."""
    # Short recordings have no turn that far; any is taken there.
    least = _FARTHEST if len(lexemes) > 2 * _FARTHEST else 0
    return np.roll(lexemes, int(rng.integers(least, max(len(lexemes) - least, 1))))


def association(levels: Mapping[str, Labels], recordings: Sequence[Labels], turns: int = TURNS
                ) -> dict[str, dict[str, float]]:
    """For the clusters [n] of each level, H(lexeme | cluster) in nats beside its chance.

    recordings: the lexemes of each, [n] together. Gives for each level "entropy", "by_chance" (the mean over turns),
    "p" (share of turns with as low an entropy), and "alone", the entropy of the lexemes without any cluster.
    """
    rng, lexemes, out = np.random.default_rng(0), np.concatenate(recordings), {}
    # Turned, not shuffled: lexemes keep their order, so chance has the runs that real sequences have. The same turns
    # for all levels, so that these differ by their clusters alone.
    others = [np.concatenate([turned(own, rng) for own in recordings]) for _ in range(turns)]
    for name, clusters in levels.items():
        value = conditional_entropy(clusters, lexemes)
        chance = np.array([conditional_entropy(clusters, other) for other in others])
        out[name] = {"entropy": value, "by_chance": float(chance.mean()), "alone": entropy(np.bincount(lexemes)),
                     "p": float(1 + (chance <= value + 1e-12).sum()) / (1 + turns)}
    return out
