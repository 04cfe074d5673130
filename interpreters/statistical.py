"""The statistical interpreter: lexemes from a speaker's frequencies, independent of the speech (RG 7.4.6, Eq. 24)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from interpreters.base import BlockFeatures, InterpreterDefaults, Need, Scores

__all__ = ["StatisticalInterpreter"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StatisticalState:
    """Counts [S] of the lexemes so far, and the target frequencies [S] of the speaker."""

    counts: Array
    target: Array


class StatisticalInterpreter(InterpreterDefaults):
    """f* = softmax(f^I - f_t) L, the distribution of the next lexeme (RG Eq. 24)."""

    name = "statistical"
    needs: frozenset[Need] = frozenset()

    def __init__(self, frequencies: Array, transitions: Array) -> None:
        """frequencies: [speakers, S] f^I; transitions: [S, S] L, rows from, each summing to 1."""
        # Tolerant: rows are stored with rounded numbers.
        if not np.allclose(transitions.sum(1), 1.0, atol=1e-3):
            raise ValueError("the rows of the transition matrix must sum to 1")
        self.frequencies, self.transitions = frequencies, transitions

    def start(self, speaker: int, first_lexeme: int) -> StatisticalState:
        return StatisticalState(np.zeros(len(self.transitions)), self.frequencies[speaker])

    def distribution(self, state: StatisticalState) -> Array:
        """[S] probabilities of the next lexeme."""
        # Before the first lexeme there is nothing to divide by.
        frequencies = state.counts / max(state.counts.sum(), 1.0)
        lift = state.target - frequencies
        # Less the maximum, so that exp cannot overflow; the softmax is the same.
        weights = np.exp(lift - lift.max())
        weights /= weights.sum()
        return weights @ self.transitions

    def step(self, state: StatisticalState, features: BlockFeatures, previous_lexeme: int
             ) -> tuple[Scores, StatisticalState]:
        """Log-probabilities [S], independent of the speech. `previous_lexeme` is added to the counts."""
        # A copy: states are values, which a variation of a block may go back to.
        counts = state.counts.copy()
        counts[previous_lexeme] += 1
        after = StatisticalState(counts, state.target)
        # Clamped: log 0 would be -inf, and differences of scores NaN.
        return np.log(np.maximum(self.distribution(after), 1e-300)), after
