"""Behaviour policy and advantage, apart: lexemes as people choose them, drawn to what they are worth (after RACER 4.3).

Conservative Q-learning has one head be both: a classifier of what people do and a value of what that is worth, and the
classifier drowns the value (docs/racer.md). Here the behaviour policy pi_b is the supervised interpreter, frozen, and
critics learn what each lexeme is worth beside the others. The policy is

    pi(a | s) proportional to pi_b(a | s)^(1/T) exp(beta A(s, a)),        A = Q - V,  V = sum_a pi_b(a | s) Q(s, a)

which never leaves the data further than beta says; beta 0 is the behaviour policy itself. It is the solution of
max E[A] - KL(pi | pi_b) / beta (Peters 2010; AWAC, Nair 2020), taken when a lexeme is drawn: no policy is trained.

Nothing is bootstrapped and no maximum is taken. Of each state every lexeme's reward is known, since a reward model can
be asked; and what a lexeme does to the rewards after it is found by putting it there and leaving the rest as it was.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from data_module.layers import masked_mean
from interpreters.base import (
    BlockFeatures,
    Explanation,
    InterpreterDefaults,
    InterpreterParts,
    InterpreterSizes,
    LexemeInterpreter,
    Need,
    Scores,
    as_interpreter,
)
from interpreters.cql import QNetwork, QState
from interpreters.settings import CriticConfig
from interpreters.transformer import begin_small

__all__ = ["AdvantageInterpreter", "Critics"]

_MOMENTUM = 0.02
"""Share of a batch in the running spread of the advantages: the last fifty batches count."""


@dataclass(frozen=True)
class CriticValues:
    """What J critics say of states [...], in units of `Critics.unit`.

    reward, future: [..., J, S] what each lexeme earns now, and what the blocks after it earn for it (up to a constant
    of the state); value: [..., J] what the state earns in all under the data's policy.
    """

    reward: Tensor
    future: Tensor
    value: Tensor

    def q(self, gamma: float) -> Tensor:
        """[..., J, S] Q up to a constant of the state."""
        return self.reward + gamma * self.future


def advantages(q: Tensor, log_prior: Tensor) -> Tensor:
    """A [..., S] from Q [..., J, S] and log pi_b [..., S]: the least of the critics' Q - V, told from its own mean.

    Its mean under pi_b is 0: how a state is worth changes no choice.
    """
    prior = log_prior.softmax(-1)
    each = q - (q * prior.unsqueeze(-2)).sum(-1, keepdim=True)
    least = each.amin(-2)
    return least - (least * prior).sum(-1, keepdim=True)


class Critics(nn.Module):
    """J critics on one transformer over audio and lexemes (RACER Fig. 1): what every lexeme of a block is worth."""

    unit: Tensor
    spread: Tensor
    future_scale: Tensor
    value_scale: Tensor
    value_mean: Tensor

    def __init__(self, config: CriticConfig, frames: int, audio_width: int, lexemes: int, speakers: int) -> None:
        """frames: K; audio_width: d; lexemes: S; speakers: P."""
        super().__init__()
        self.config, self.lexemes = config, lexemes
        self.trunk = QNetwork(config.network, frames, audio_width, lexemes, speakers)
        self.trunk.head = nn.LayerNorm(config.width)  # type: ignore[assignment]
        self.reward = nn.Linear(config.width, config.critics * lexemes)
        self.future = nn.Linear(config.width, config.critics * lexemes)
        self.value = nn.Linear(config.width, config.critics)
        for head in (self.reward, self.future, self.value):
            head.apply(begin_small)
        self.register_buffer("unit", torch.ones(()))  # of the values, in rewards
        self.register_buffer("spread", torch.ones(()))  # standard deviation of A under pi_b, in units
        # What heads of unit size are told in: returns differ by forty units where lexemes differ by one.
        self.register_buffer("future_scale", torch.ones(()))
        self.register_buffer("value_scale", torch.ones(()))
        self.register_buffer("value_mean", torch.zeros(()))

    @classmethod
    def build(cls, settings: CriticConfig, sizes: InterpreterSizes) -> Critics:
        """Untrained ones of these sizes."""
        return cls(settings, sizes.frames, sizes.high, len(sizes.lexemes), sizes.speakers)

    @property
    def weights(self) -> dict[str, float]:
        """Loss weights, keyed like `losses`."""
        return {"reward": 1.0, "future": 1.0, "value": self.config.value}

    def _of(self, features: Tensor) -> CriticValues:
        shape = (self.config.critics, self.lexemes)
        return CriticValues(self.reward(features).unflatten(-1, shape),
                            self.future(features).unflatten(-1, shape) * self.future_scale,
                            self.value(features) * self.value_scale + self.value_mean)

    @torch.no_grad()
    def scale_to(self, unit: float, gained: Tensor, returns: Tensor) -> None:
        """Take the units of a data set: of rewards, and in these the deviation of what swaps gain [...] (NaN where
        nothing was tried) and the mean and deviation of the returns [...]."""
        tried = gained[~torch.isnan(gained)]
        self.unit.fill_(unit)
        self.future_scale.fill_(float(tried.square().mean().sqrt().clamp_min(1e-3)) if len(tried) else 1.0)
        self.value_mean.copy_(returns.mean())
        self.value_scale.copy_(returns.std().clamp_min(1e-3))

    def values(self, previous: Tensor, audio: Tensor, speaker: Tensor, silent: Tensor) -> CriticValues:
        """Of each of M decisions; the arguments are those of `QNetwork.values`."""
        return self._of(self.trunk.values(previous, audio, speaker, silent))

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Squared errors of reward, future and value, each critic on the recordings that are its own, unweighted.

        Rewards are told from their mean under pi_b: what a state earns whatever is done is the value's to learn, and is
        so much more that nothing else would be learned beside it. Future and value are in deviations of their own.

        batch: previous, action, silent, valid [B, T], audio [B, T, 3K, d], speaker one-hot [B, P]; every [B, T, S] the
        reward of each lexeme; log_prior [B, T, S]; return [B, T] the discounted sum of rewards from here on; swap
        [B, T, k] lexemes that were put in the place of the action, and gained [B, T, k] what the blocks after it then
        earned more, NaN where nothing was tried; heard [B, J] 1 where a critic learns from the recording.
        """
        from data_module.parallel import batch_mean  # only training asks for it

        found = self.values(batch["previous"], batch["audio"], batch["speaker"], batch["silent"])
        valid = batch["valid"].unsqueeze(-1) * batch["heard"].unsqueeze(1)  # [B, T, J]
        prior = batch["log_prior"].softmax(-1)
        # Half for every lexeme alike, half for those that are likely: the others are seldom asked about.
        weight = 0.5 / self.lexemes + 0.5 * prior
        told = advantages(batch["every"].unsqueeze(-2), batch["log_prior"]).unsqueeze(-2)
        own_mean = (found.reward * prior.unsqueeze(-2)).sum(-1, keepdim=True)
        error = (found.reward - own_mean - told).square() * weight.unsqueeze(-2)
        tried = ~torch.isnan(batch["gained"])
        own = found.future.gather(-1, _each(batch["action"].unsqueeze(-1), found.future))
        other = found.future.gather(-1, _each(batch["swap"], found.future))
        missed = ((other - own - batch["gained"].nan_to_num().unsqueeze(-2)) / self.future_scale).square()
        missed = missed * tried.unsqueeze(-2)
        with torch.no_grad():
            spread = self.advantage(found, batch["log_prior"]).square() * prior
            now = masked_mean(spread.sum(-1), batch["valid"]).sqrt()
            self.spread.lerp_(now, _MOMENTUM if progress > _MOMENTUM else 1.0)
        share = batch_mean(tried.float()).clamp_min(1e-3)
        return {"reward": masked_mean(error.sum(-1), valid),
                "future": masked_mean(missed.sum(-1), valid) / share / tried.shape[-1],
                "value": masked_mean(((found.value - batch["return"].unsqueeze(-1)) / self.value_scale).square(),
                                     valid)}

    def advantage(self, found: CriticValues, log_prior: Tensor) -> Tensor:
        """A [..., S] in units."""
        return advantages(found.q(self.config.gamma), log_prior)

    @torch.inference_mode()
    def step(self, state: QState, features: BlockFeatures, previous_lexeme: int) -> tuple[CriticValues, QState]:
        """What the critics say of this block, and the state after it."""
        scores, after = self.trunk.step(state, features, previous_lexeme)
        return self._of(torch.as_tensor(scores, dtype=torch.float32, device=self.unit.device)), after


def _each(lexemes: Tensor, values: Tensor) -> Tensor:
    """Lexemes [B, T, k] for each of J critics, [B, T, J, k]."""
    return lexemes.unsqueeze(-2).expand(*values.shape[:-1], lexemes.shape[-1])


@dataclass(frozen=True)
class AdvantageState:
    """The states of both, and of the last block: log pi_b [S] and beta's multiplicand, A in standard deviations [S]."""

    prior: Any
    critics: QState
    log_prior: NDArray[np.float64] | None = None
    advantage: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class AdvantageInterpreter(InterpreterDefaults):
    """The behaviour policy, drawn to what lexemes are worth by beta. temperature: T, which `select` divides by."""

    prior: LexemeInterpreter
    critics: Critics
    beta: float = 1.0
    temperature: float = 1.0
    name = "advantage"
    steerable = True

    @classmethod
    def open(cls, parts: InterpreterParts) -> AdvantageInterpreter:
        """See `InterpreterDefaults.open`."""
        assert parts.prior is not None and isinstance(parts.model, Critics)
        return cls(parts.prior, parts.model, parts.beta)

    @property
    def needs(self) -> frozenset[Need]:
        """See `Interpreter.needs`: what the behaviour policy reads, as the critics hear alone."""
        return as_interpreter(self.prior).needs

    def steered(self, beta: float | None, temperature: float) -> AdvantageInterpreter:
        """The same with another beta (None: its own), for lexemes that are sampled at this temperature."""
        return replace(self, beta=self.beta if beta is None else beta, temperature=temperature)

    def start(self, speaker: int, first_lexeme: int) -> AdvantageState:
        """The state before the first block."""
        return AdvantageState(self.prior.start(speaker, first_lexeme), self.critics.trunk.start(speaker, first_lexeme))

    def explain(self, state: AdvantageState) -> Explanation | None:
        """See `Interpreter.explain`."""
        if state.log_prior is None or state.advantage is None:
            return None
        return Explanation(state.log_prior, state.advantage)

    def step(self, state: AdvantageState, features: BlockFeatures, previous_lexeme: int
             ) -> tuple[Scores, AdvantageState]:
        """Scores [S] of which softmax(scores / T) is the policy (at T = 0 those of T = 1); with beta 0 exactly the
        behaviour policy's own."""
        log_prior, prior = self.prior.step(state.prior, features, previous_lexeme)
        found, critics = self.critics.step(state.critics, features, previous_lexeme)
        worth = (self.critics.advantage(found, torch.as_tensor(log_prior, dtype=torch.float32)) / self.critics.spread
                 ).double().cpu().numpy()
        after = AdvantageState(prior, critics, log_prior, worth)
        if self.beta == 0:
            return log_prior, after
        scores = log_prior + (self.temperature or 1.0) * self.beta * worth
        return scores - np.logaddexp.reduce(scores), after
