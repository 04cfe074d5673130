"""Guidance by ear: an interpreter's scores taken further in the direction in which sound moves them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interpreters.base import BlockFeatures, Scores
from interpreters.lstm import LstmInterpreter, LstmState


@dataclass(frozen=True)
class InterpreterByEar:
    """s + g (s - s without sound), normalised: classifier-free guidance of scores that are log-probabilities.

    inner: an interpreter that was taught with sound left out now and then (zeros); guidance: g.
    """

    inner: LstmInterpreter
    guidance: float

    def start(self, speaker: int, first_lexeme: int) -> tuple[LstmState, LstmState]:
        """The states before the first block, of the one that hears and of the one that does not."""
        return self.inner.start(speaker, first_lexeme), self.inner.start(speaker, first_lexeme)

    def step(self, state: tuple[LstmState, LstmState], features: BlockFeatures, previous_lexeme: int
             ) -> tuple[Scores, tuple[LstmState, LstmState]]:
        """Log-probabilities [S] of this block's lexeme."""
        (heard, hearing), (unheard, deaf) = self.inner.step_with_and_without_sound(state, features, previous_lexeme)
        scores = heard + self.guidance * (heard - unheard)
        return scores - np.logaddexp.reduce(scores), (hearing, deaf)
