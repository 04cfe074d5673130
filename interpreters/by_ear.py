"""Classifier-free guidance by the audio: extrapolate an interpreter's scores away from those without audio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from interpreters.base import BlockFeatures, Interpreter, InterpreterDefaults, Need, Scores


class HearsOrNot(Interpreter, Protocol):
    """An interpreter that was trained with audio dropout."""

    def step_with_and_without_sound(self, states: tuple[Any, Any], features: BlockFeatures, previous_lexeme: int
                                    ) -> list[tuple[Scores, Any]]:
        """The result of `step` for the first state, and for the second with zeros as audio."""
        ...


@dataclass(frozen=True)
class InterpreterByEar(InterpreterDefaults):
    """s + g (s - s without audio), normalised, for scores s that are log-probabilities. inner: the guided interpreter;
    guidance: g."""

    inner: HearsOrNot
    guidance: float

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.inner.name

    @property
    def needs(self) -> frozenset[Need]:
        return self.inner.needs

    def start(self, speaker: int, first_lexeme: int) -> tuple[Any, Any]:
        return self.inner.start(speaker, first_lexeme), self.inner.start(speaker, first_lexeme)

    def step(self, state: tuple[Any, Any], features: BlockFeatures, previous_lexeme: int
             ) -> tuple[Scores, tuple[Any, Any]]:
        (audible, with_audio), (deaf, without) = self.inner.step_with_and_without_sound(state, features,
                                                                                        previous_lexeme)
        scores = audible + self.guidance * (audible - deaf)
        return scores - np.logaddexp.reduce(scores), (with_audio, without)
