"""The behaviour policy biased by a learned advantage, on arrays. `interpreters.advantage` trains its critics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.layers_run import Norm, Tensors, softmax
from interpreters import base
from interpreters.cql_run import QRunState, QTrunk
from interpreters.settings import CRITICS, GAMMA, CriticConfig

__all__ = ["AdvantageInterpreter", "CriticsRunner"]


def advantages(q: NDArray[np.floating], prior: NDArray[np.floating]) -> NDArray[np.floating]:
    """A [S] from Q [J, S] and pi_b [S]: the least of the critics' Q - V, less its mean under pi_b."""
    each = q - (q * prior).sum(-1, keepdims=True)
    # The least estimate counts, because a maximum over lexemes picks out errors upwards.
    least = each.min(0)
    return np.asarray(least - (least * prior).sum())


class CriticsRunner:
    """J critics on one transformer over audio and lexemes, which value every lexeme of a block."""

    def __init__(self, config: CriticConfig, sizes: base.InterpreterSizes, tensors: Tensors) -> None:
        trunk, lexemes = tensors.within("trunk"), len(sizes.lexemes)
        self._trunk = QTrunk(config.network, sizes, trunk)
        self._norm = Norm(trunk.within("head"), config.width)
        self._reward = tensors.dense("reward", config.width, CRITICS * lexemes)
        self._future = tensors.dense("future", config.width, CRITICS * lexemes)
        self._future_scale, self._spread = tensors.take("future_scale"), tensors.take("spread")
        # The value of the state is the same for all lexemes, and the unit has no effect on a relative advantage.
        tensors.drop("value", "unit")

    def start(self, speaker: int) -> QRunState:
        return self._trunk.start(speaker)

    def step(self, state: QRunState, features: base.BlockFeatures, previous_lexeme: int, log_prior: base.Scores
             ) -> tuple[base.Scores, QRunState]:
        """[S] the advantage of each lexeme of this block in standard deviations, given log pi_b [S], and the state
        after it."""
        row, after = self._trunk.step(state, features, previous_lexeme)
        row = self._norm(row)
        q = (self._reward(row) + GAMMA * self._future_scale * self._future(row)).reshape(CRITICS, -1)
        advantage = advantages(q, softmax(log_prior.astype(np.float32)))
        return (advantage / self._spread).astype(np.float64), after


@dataclass(frozen=True)
class AdvantageState:
    """The states of prior and critics."""

    prior: Any
    critics: Any


@dataclass(frozen=True)
class AdvantageInterpreter(base.InterpreterDefaults):
    """The behaviour policy, biased by beta times the advantage. temperature: T, which `select` divides by."""

    prior: base.LexemeInterpreter
    critics: CriticsRunner
    beta: float = 1.0
    temperature: float = 1.0
    name = "advantage"

    @classmethod
    def open(cls, parts: base.InterpreterParts) -> AdvantageInterpreter:
        assert parts.prior is not None and parts.model is not None
        return cls(parts.prior, parts.model, parts.beta)

    @property
    def needs(self) -> frozenset[base.Need]:
        return base.as_interpreter(self.prior).needs

    def steered(self, beta: float | None, temperature: float) -> AdvantageInterpreter:
        return replace(self, beta=self.beta if beta is None else beta, temperature=temperature)

    def start(self, speaker: int, first_lexeme: int) -> AdvantageState:
        return AdvantageState(self.prior.start(speaker, first_lexeme), self.critics.start(speaker))

    def step(self, state: AdvantageState, features: base.BlockFeatures, previous_lexeme: int
             ) -> tuple[base.Scores, AdvantageState]:
        """Scores [S] such that softmax(scores / T) is the policy (for T = 0 those of T = 1); with beta 0 exactly those
        of the behaviour policy."""
        log_prior, prior = self.prior.step(state.prior, features, previous_lexeme)
        advantage, critics = self.critics.step(state.critics, features, previous_lexeme, log_prior)
        after = AdvantageState(prior, critics)
        if self.beta == 0:
            return log_prior, after
        # `select` divides by T: times T here, beta scales the advantage at any temperature as in the equation above.
        scores = log_prior + (self.temperature or 1.0) * self.beta * advantage
        return scores - np.logaddexp.reduce(scores), after
