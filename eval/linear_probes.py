"""Linear probes: what can be read off frozen features, and how well, on voices that the probe was not fitted on.

Every probe is linear, in closed form and of the same size for every row of features, so that rows compare. Figures
are one per test recording, since recordings, not frames, are what an interval draws.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from eval.level_features import LevelFeatures

DIRECTIONS = 32
"""Of the linear discriminant, where there are as many."""
PARTS, LEAST_TOKENS = 3, 5
"""Parts that a spoken word is cut in; a word of the training voices that is rarer than `LEAST_TOKENS` is no class."""
_RIDGE = 1.0
Target = Callable[[LevelFeatures], Array]


@dataclass(frozen=True)
class Tokens:
    """Words as spoken. vectors: [n, 3 C] the means over the thirds of a word's frames; words: [n]; voices: [n];
    recording: [n]."""

    vectors: Array
    words: NDArray[np.str_]
    voices: NDArray[np.str_]
    recording: NDArray[np.int64]

    def where(self, kept: NDArray[np.bool_]) -> Tokens:
        """The tokens that `kept` [n] picks."""
        return Tokens(self.vectors[kept], self.words[kept], self.voices[kept], self.recording[kept])


def tokens_of(spoken: Sequence[LevelFeatures], row: str) -> Tokens:
    """Every word of `PARTS` frames or more."""
    vectors, words, voices, recording = [], [], [], []
    for number, own in enumerate(spoken):
        at = own.word_at.ravel()
        rows = own.features[row].reshape(len(at), -1).astype(np.float64)
        heard = np.argsort(at, kind="stable")[(at < 0).sum():]
        for frames in np.split(heard, np.flatnonzero(np.diff(at[heard])) + 1):
            if len(frames) >= PARTS and own.words[at[frames[0]]]:
                vectors.append(np.concatenate([rows[part].mean(axis=0) for part in np.array_split(frames, PARTS)]))
                words.append(own.words[at[frames[0]]])
                voices.append(own.voice)
                recording.append(number)
    width = PARTS * spoken[0].features[row].shape[-1]
    return Tokens(np.array(vectors).reshape(-1, width), np.array(words, dtype=str), np.array(voices, dtype=str),
                  np.array(recording, dtype=np.int64))


@dataclass(frozen=True)
class ProbeScore:
    """A figure for each test recording [R], NaN where it has none, and its weight [R]."""

    values: Array
    weights: Array


def probe_words(train: Tokens, test: Tokens, recordings: int) -> dict[str, ProbeScore]:
    """The tasks "new_words" and "known_words" of one row; see the module."""
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

    nothing = ProbeScore(np.full(recordings, np.nan), np.zeros(recordings))
    counts = Counter(train.words.tolist())
    classes = sorted(word for word, count in counts.items() if count >= LEAST_TOKENS)
    if len(classes) < 2:
        return {"new_words": nothing, "known_words": nothing}
    fitted = train.where(np.isin(train.words, classes))
    mean, spread = fitted.vectors.mean(axis=0), np.maximum(fitted.vectors.std(axis=0), 1e-6)
    directions = min(DIRECTIONS, len(classes) - 1, len(mean))
    # Every word counts alike; otherwise the commonest would be the answer.
    probe = LinearDiscriminantAnalysis(solver="eigen", shrinkage=0.1, n_components=directions,
                                       priors=np.full(len(classes), 1.0 / len(classes)))
    probe.fit((fitted.vectors - mean) / spread, fitted.words)
    known = test.where(np.isin(test.words, classes))
    new = test.where(~np.isin(test.words, list(counts)))
    out = {"new_words": nothing, "known_words": nothing}
    if len(known.words):
        right = probe.predict((known.vectors - mean) / spread) == known.words
        _, number, often = np.unique(known.words, return_inverse=True, return_counts=True)
        out["known_words"] = _per_recording(right.astype(np.float64), 1.0 / often[number], known.recording, recordings)
    if len(new.words):
        out["new_words"] = same_word(probe.transform((new.vectors - mean) / spread), new, recordings)
    return out


def _per_recording(values: Array, weights: Array, recording: NDArray[np.int64], count: int) -> ProbeScore:
    total = np.bincount(recording, weights, minlength=count)
    summed = np.bincount(recording, weights * values, minlength=count)
    return ProbeScore(np.where(total > 0, summed / np.where(total > 0, total, 1.0), np.nan), total.astype(np.float64))


def same_word(embedded: Array, tokens: Tokens, recordings: int) -> ProbeScore:
    """AUC of the cosine of [n, d] for "the same word", over the pairs of each recording's words with other voices'.

    Weighted by how many pairs of the same word a recording has.
    """
    from sklearn.metrics import roc_auc_score

    unit = embedded / np.maximum(np.linalg.norm(embedded, axis=1, keepdims=True), 1e-12)
    values, weights = np.full(recordings, np.nan), np.zeros(recordings)
    for number in np.unique(tokens.recording).tolist():
        own = np.flatnonzero(tokens.recording == number)
        others = np.flatnonzero(tokens.voices != tokens.voices[own[0]])
        same = tokens.words[own, None] == tokens.words[None, others]
        if same.any() and not same.all():
            values[number] = roc_auc_score(same.ravel(), (unit[own] @ unit[others].T).ravel())
            weights[number] = same.sum()
    return ProbeScore(values, weights)


def probe_frames(train: Sequence[LevelFeatures], test: Sequence[LevelFeatures], row: str, target: Target) -> ProbeScore:
    """R2 of a ridge regression from a frame's features to its target [N, K], both less their mean in the recording.

    NaN frames and silent blocks are left out. The mean goes because it tells whose voice it is, which no probe can
    know of a new one. For each test recording 1 - error / variance, the variance being that of all test frames, so that
    the weighted mean over recordings is the R2 of all frames.
    """
    x, y, _ = _frames(train, row, target)
    tx, ty, recording = _frames(test, row, target)
    if len(y) < 2 or len(ty) < 2:
        return ProbeScore(np.full(len(test), np.nan), np.zeros(len(test)))
    spread = np.maximum(x.std(axis=0), 1e-6)
    x = x / spread
    slope = np.linalg.solve(x.T @ x + _RIDGE * np.eye(x.shape[1]), x.T @ y)
    error = (ty - tx / spread @ slope) ** 2
    variance = max(float((ty ** 2).mean()), 1e-12)
    return _per_recording(1.0 - error / variance, np.ones(len(error)), recording, len(test))


def _frames(spoken: Sequence[LevelFeatures], row: str, target: Target) -> tuple[Array, Array, NDArray[np.int64]]:
    """Features [n, C] and targets [n] of every frame that counts, less the recording's means; the recording [n]."""
    features, targets, recording = [], [], []
    for number, own in enumerate(spoken):
        wanted = target(own)
        kept = np.isfinite(wanted) & ~own.silent[:, None]
        if kept.any():
            rows = own.features[row][kept].astype(np.float64)
            features.append(rows - rows.mean(axis=0))
            targets.append(wanted[kept] - wanted[kept].mean())
            recording.append(np.full(len(rows), number))
    if not features:
        return np.zeros((0, spoken[0].features[row].shape[-1])), np.zeros(0), np.zeros(0, np.int64)
    return np.concatenate(features), np.concatenate(targets), np.concatenate(recording)
