"""Guidance by ear: an interpreter's scores taken further in the direction in which sound moves them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from interpreters.base import BlockFeatures, Interpreter, InterpreterDefaults, Need, Scores


class HearsOrNot(Interpreter, Protocol):
    """An interpreter that was taught with sound left out now and then (zeros)."""

    def step_with_and_without_sound(self, states: tuple[Any, Any], features: BlockFeatures, previous_lexeme: int
                                    ) -> list[tuple[Scores, Any]]:
        """What `step` gives of the first state, and of the second where the sound is left out (zeros)."""
        ...


@dataclass(frozen=True)
class InterpreterByEar(InterpreterDefaults):
    """s + g (s - s without sound), normalised: classifier-free guidance of scores that are log-probabilities.

    inner: the interpreter that is guided; guidance: g.
    """

    inner: HearsOrNot
    guidance: float

    @property
    def name(self) -> str:  # type: ignore[override]
        """The name of the one that is guided."""
        return self.inner.name

    @property
    def needs(self) -> frozenset[Need]:
        """See `Interpreter.needs`."""
        return self.inner.needs

    def start(self, speaker: int, first_lexeme: int) -> tuple[Any, Any]:
        """The states before the first block, of the one that hears and of the one that does not."""
        return self.inner.start(speaker, first_lexeme), self.inner.start(speaker, first_lexeme)

    def step(self, state: tuple[Any, Any], features: BlockFeatures, previous_lexeme: int
             ) -> tuple[Scores, tuple[Any, Any]]:
        """Log-probabilities [S] of this block's lexeme."""
        (heard, hearing), (unheard, deaf) = self.inner.step_with_and_without_sound(state, features, previous_lexeme)
        scores = heard + self.guidance * (heard - unheard)
        return scores - np.logaddexp.reduce(scores), (hearing, deaf)
