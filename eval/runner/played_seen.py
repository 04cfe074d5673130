"""The decisions of motion as played that a viewer sees, against the performer's: starts of units, hand and size.

The decisions of each block are read off the motion (`gesticulator.training.stages.planner`), of the performer and of
each policy on the same sound. Their agreement is Cohen's kappa: 1 for the same decisions, 0 for what equal frequencies
would give by chance. Two people would not agree much either; the performer's own lexemes, played, say how far lexemes
can go. Which meaning is shown hangs on words, which no policy reads here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import cohen_kappa_score

from eval import stats
from eval.runner.played import PERFORMER, PlayedVoice
from eval.stats import Interval
from gesticulator.bundle.bundle import Bundle
from gesticulator.training.stages.planner import hands_of_blocks, units_of
from interpreters.planner import PHASES

Decisions = NDArray[np.int64]
STARTS, HAND, SIZE = "a unit starts", "hand", "size"
SEEN = (STARTS, HAND, SIZE)
_PHASE, _HAND, _SIZE = 0, 1, 2
_REST = PHASES.index("rest")


def decisions(bundle: Bundle, voice: PlayedVoice, kind: str) -> Decisions:
    """[N, 4] what each block of a motion shows, indices into the lists of `interpreters.planner`."""
    edges = np.concatenate([[0.0], np.cumsum(np.exp(voice.log_duration.double().numpy()))])
    rows = voice.motions[kind].double().numpy()
    return units_of(hands_of_blocks(rows, bundle.statistics, voice.speaker, bundle.config, edges), edges)


def seen(own: Decisions) -> dict[str, NDArray[np.int64]]:
    """[N] by the names of `SEEN`, of decisions [N, 4]."""
    acts = own[:, _PHASE] != _REST
    starts = acts & ~np.concatenate([[False], acts[:-1]])
    return {STARTS: starts.astype(np.int64), HAND: own[:, _HAND], SIZE: own[:, _SIZE]}


def kappa(first: NDArray[np.int64], second: NDArray[np.int64]) -> float:
    """Cohen's kappa of decisions [N]; NaN where both are one and the same throughout, which tells nothing."""
    if len(np.unique(np.concatenate([first, second]))) < 2:
        return float("nan")
    return float(cohen_kappa_score(first, second))


def agreement(bundle: Bundle, voices: Sequence[PlayedVoice], kinds: Sequence[str]) -> dict[str, dict[str, Interval]]:
    """By kind of motion and by decision, the mean kappa with the performer over voices."""
    values: dict[str, dict[str, list[float]]] = {kind: {name: [] for name in SEEN} for kind in kinds}
    for voice in voices:
        performer = seen(decisions(bundle, voice, PERFORMER))
        for kind in kinds:
            for name, own in seen(decisions(bundle, voice, kind)).items():
                values[kind][name].append(kappa(performer[name], own))
    group = [voice.group for voice in voices]
    return {kind: {name: stats.mean_interval(np.array(own), groups=group)
                   for name, own in each.items()} for kind, each in values.items()}
