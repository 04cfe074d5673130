"""Diversity: is the whole lexicon used, in ever new orders and ways? (RG Eq. 23, RG Table 2 and 5)

Theory: the entropy of how often each lexeme occurs says how many are in use: e to the entropy in nats is as many
lexemes as, used evenly, would have it. It is 0 for one lexeme alone and ln(N_s) for even use. The paper's logarithm has
no base; its 3.79 and 4.32 may be nats or bits. Its motion variance (RG 7.4.2) asks the same within a
lexeme: how differently is one lexeme performed? Take the distance of each motion's latent from its lexeme, then the
variance of those per lexeme, then the mean over lexemes. The longest run of one lexeme looks at their order: a loop
shows in it.

Good: near the speaker's own value, for each. More is not better: noise has the most. What fools them: lexemes drawn at
random reach ln(N_s). Entropy and variance scarcely see the order of frames or blocks: motion with another clip's
speech has the value of the right one, to the digit. Jitter raises the motion variance, as a rougher performance of each
lexeme, and may raise the entropy. Few blocks make the entropy too small, by about (lexemes used - 1) / (2 blocks) nats:
compare sets of the same number of blocks.

    >>> round(diversity([0, 0, 1, 1], size=4), 4), round(entropy([2, 2, 0, 0]), 4), longest_run([[0, 1, 1, 0]])
    (0.6931, 0.6931, 2.0)
"""

import math
from collections.abc import Sequence
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_module.types import Array

__all__ = ["diversity", "entropy", "motion_variance"]

Labels = NDArray[np.int64]


def entropy(counts: ArrayLike) -> float:
    """- sum of p_i log p_i in nats, of how often each lexeme occurs [S] (RG Eq. 23); NaN where nothing occurs."""
    times = np.asarray(counts, dtype=np.float64)
    if times.sum() <= 0:
        return float("nan")
    shares = times[times > 0] / times.sum()
    # Where one lexeme is all there is, -0.0 would be printed.
    return abs(float(-(shares * np.log(shares)).sum()))


def diversity(labels: ArrayLike, size: int) -> float:
    """- sum of p_i log p_i in nats over the `size` lexemes of the lexicon, of labels [N] (RG Eq. 23); NaN for none."""
    return entropy(np.bincount(checked_labels(labels, size), minlength=size))


def motion_variance(latents: Array, labels: ArrayLike, vectors: Array) -> float:
    """How differently each lexeme is performed, of the motions' latents [N, D] and lexeme vectors [S, D] (RG 7.4.2).

    labels: [N], the lexeme that each motion is nearest to. The variance is the unbiased one, so that rare lexemes do
    not lower the mean. In squared latent units; NaN where no lexeme occurs twice.
    """
    points, lexemes = np.asarray(latents, dtype=np.float64), np.asarray(vectors, dtype=np.float64)
    chosen = checked_labels(labels, len(lexemes))
    if points.shape != (len(chosen), lexemes.shape[1]):
        raise ValueError(f"{len(chosen)} lexemes of {lexemes.shape} do not fit latents of {points.shape}")
    if not (np.isfinite(points).all() and np.isfinite(lexemes).all()):
        raise ValueError("latents and lexemes must be finite")
    distances = np.linalg.norm(points - lexemes[chosen], axis=1)
    # A lexeme that occurs once has no variance.
    counts = np.bincount(chosen, minlength=len(lexemes))
    variances = [float(distances[chosen == lexeme].var(ddof=1)) for lexeme in np.flatnonzero(counts > 1)]
    return float(np.mean(variances)) if variances else float("nan")


def longest_run(sequences: Sequence[ArrayLike]) -> float:
    """How many blocks in a row have one lexeme, at most, in any sequence; 1: never twice. NaN without a block."""
    every = [len(list(run)) for sequence in sequences for _, run in groupby(checked_labels(sequence).tolist())]
    return float(max(every, default=math.nan))


def checked_labels(labels: ArrayLike, size: int | None = None) -> Labels:
    """Labels [N] of lexemes; ValueError unless they are whole numbers from 0 (to size - 1), in one row."""
    values = np.asarray(labels)
    if values.size == 0 and values.ndim == 1:
        return np.zeros(0, dtype=np.int64)
    if values.ndim != 1 or not np.issubdtype(values.dtype, np.integer):
        raise ValueError(f"labels must be whole numbers, [N], not {values.dtype} {values.shape}")
    if values.min() < 0 or (size is not None and values.max() >= size):
        raise ValueError(f"labels must lie in 0 to {'N_s' if size is None else size} - 1: "
                         f"{values.min()} to {values.max()}")
    return values.astype(np.int64)
