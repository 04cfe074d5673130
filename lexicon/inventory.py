"""Statistics of the lexicon: frequencies of the lexemes, transitions between them, and the silent lexemes."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Labels = NDArray[np.int64]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Inventory:
    """Statistics of labelled sequences. frequencies: [S] per speaker; transitions: [S, S] (from, to), rows sum to 1."""

    frequencies: dict[str, Array]
    transitions: Array


def count(sequences: Iterable[tuple[str, Labels]], size: int, smoothing: float = 0.1) -> Inventory:
    """Frequencies f^I of each speaker and the transition matrix L of RG Eq. 24, from (speaker, labels) sequences.
    `smoothing` is added to every transition count (Laplace), so that unseen transitions have a positive probability."""
    totals: dict[str, Array] = {}
    moves = np.full((size, size), smoothing, dtype=np.float64)
    for speaker, labels in sequences:
        totals[speaker] = totals.get(speaker, np.zeros(size)) + np.bincount(labels, minlength=size)
        # `add.at` counts repeated pairs, which an indexed += would count once.
        np.add.at(moves, (labels[:-1], labels[1:]), 1.0)
    frequencies = {speaker: total / max(total.sum(), 1.0) for speaker, total in totals.items()}
    return Inventory(frequencies, moves / moves.sum(axis=1, keepdims=True))


def silent_lexemes(speeds: Array, labels: Labels, silent: NDArray[np.bool_], *, slow_share: float = 0.3,
                   over: float = 2.0) -> Labels:
    """The silent lexemes, detected automatically (RG 6.4.1).

    speeds: [S] mean joint speed of each lexeme, infinite for one without blocks; labels: [N] and silent: [N] over the
    training blocks.
    A lexeme is silent if it is among the slowest `slow_share` AND occurs on silent blocks `over` times as often as
    overall. If none meets both conditions, the slow lexeme most over-represented in silence is taken, so the set is
    never empty.
    """
    size = len(speeds)
    everywhere = np.bincount(labels, minlength=size) / max(len(labels), 1)
    in_silence = np.bincount(labels[silent], minlength=size) / max(int(silent.sum()), 1)
    # How over-represented a lexeme is in silence: 1 for one that ignores the speech.
    ratio = in_silence / np.maximum(everywhere, 1e-12)
    # Interpolating between two infinite speeds gives NaN, which is handled below.
    with np.errstate(invalid="ignore"):
        limit = np.quantile(speeds, slow_share)
    if not np.isfinite(limit):  # most lexemes have no block: the slowest of those that have
        limit = np.quantile(speeds[np.isfinite(speeds)], slow_share)
    slow = np.flatnonzero(speeds <= limit)
    chosen = slow[ratio[slow] >= over]
    return chosen if len(chosen) else slow[[int(ratio[slow].argmax())]]


def nearest_silent(vectors: Array, silent: Labels) -> Labels:
    """For each lexeme [S] the silent lexeme nearest to it in latent space (RG 6.4.1); itself if none is silent."""
    if len(silent) == 0:
        return np.arange(len(vectors))
    distances = ((vectors[:, None] - vectors[None, silent]) ** 2).sum(-1)
    return silent[distances.argmin(axis=1)]
