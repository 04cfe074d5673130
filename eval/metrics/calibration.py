"""Probabilities of an event held against whether it happened: do they rank, and do they mean what they say?

Theory: the area under the ROC curve (AUC) is the chance that an event has a higher score than a non-event, a tie
counting half; 0.5 is blind. The calibration error is the mean gap between what was said and what happened over bins of
equal width, weighted by what they hold; the Brier score is the mean squared difference. What fools them: an event that
nearly always happens makes both errors small for whoever says so; set the Brier score beside that of the base rate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score

from data_module.types import Array

BINS = 10
Flags = NDArray[np.bool_]


def auc(active: Flags, scores: Array, weights: Array | None = None) -> float:
    """Area under the ROC curve for [n] truths and scores; NaN where only one kind is there."""
    kept = np.ones(len(active), bool) if weights is None else weights > 0
    if len(np.unique(active[kept])) < 2:
        return float("nan")
    return float(roc_auc_score(active, scores, sample_weight=weights))


def calibration(active: Flags, probability: Array, bins: int = BINS) -> dict[str, dict[str, float]]:
    """How many of [n], what was said on average and how often it happened, by bin ("0.1 to 0.2") that holds any."""
    own = np.minimum((probability * bins).astype(int), bins - 1)
    return {f"{i / bins:.1f} to {(i + 1) / bins:.1f}": {
        "blocks": int((own == i).sum()), "said": float(probability[own == i].mean()),
        "happened": float(active[own == i].mean())} for i in np.unique(own).tolist()}


def calibration_error(active: Flags, probability: Array, weights: Array | None = None, bins: int = BINS) -> float:
    """Mean gap between what was said and what happened over the bins, weighted by what they hold."""
    weight = np.ones(len(active)) if weights is None else weights
    own = np.minimum((probability * bins).astype(int), bins - 1)
    return float(np.abs(np.bincount(own, weight * (probability - active))).sum() / weight.sum())


def brier(active: Flags, probability: Array | float, weights: Array | None = None) -> float:
    """Mean squared difference between probability and truth."""
    return float(np.average((probability - active.astype(np.float64)) ** 2, weights=weights))
