"""Guidance by ear: an interpreter's scores taken further in the direction in which sound moves them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from interpreters.base import BlockFeatures, LexemeInterpreter, Scores


@dataclass(frozen=True)
class InterpreterByEar:
    """s + g (s - s without sound), normalised: classifier-free guidance of scores that are log-probabilities.

    inner: an interpreter that was taught with sound left out now and then (zeros); guidance: g.
    """

    inner: LexemeInterpreter
    guidance: float

    def start(self, speaker: int, first_lexeme: int) -> tuple[Any, Any]:
        """The states before the first block, of the one that hears and of the one that does not."""
        return self.inner.start(speaker, first_lexeme), self.inner.start(speaker, first_lexeme)

    def step(self, state: tuple[Any, Any], features: BlockFeatures, previous_lexeme: int
             ) -> tuple[Scores, tuple[Any, Any]]:
        """Log-probabilities [S] of this block's lexeme."""
        heard, hearing = self.inner.step(state[0], features, previous_lexeme)
        silence = replace(features, high=torch.zeros_like(features.high))
        unheard, deaf = self.inner.step(state[1], silence, previous_lexeme)
        scores = heard + self.guidance * (heard - unheard)
        return scores - np.logaddexp.reduce(scores), (hearing, deaf)
