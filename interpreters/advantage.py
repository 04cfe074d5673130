"""A behaviour policy biased by a separately learned advantage (after RACER 4.3).

In conservative Q-learning one head is both a classifier of the data's actions and their value, and the classifier
dominates (docs/racer.md). Here the behaviour policy pi_b is the frozen supervised interpreter, and critics learn the
value of each lexeme relative to the others. The policy is

    pi(a | s) proportional to pi_b(a | s)^(1/T) exp(beta A(s, a)),        A = Q - V,  V = sum_a pi_b(a | s) Q(s, a)

where beta limits the distance from the data; beta 0 is the behaviour policy itself. It solves
max E[A] - KL(pi | pi_b) / beta (Peters 2010; AWAC, Nair 2020) when a lexeme is sampled: no policy is trained.

There is no bootstrapping and no maximum. The reward model gives the reward of every lexeme in each state; the effect of
a lexeme on later rewards is measured by substituting it and leaving the rest unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from data_module.layers import masked_mean
from interpreters.base import InterpreterSizes
from interpreters.cql import QNetwork
from interpreters.settings import CRITICS, GAMMA, CriticConfig
from interpreters.transformer import begin_small

__all__ = ["Critics"]

VALUE = 0.3
"""Weight of the error of the state's value, which does not affect the choice."""
_MOMENTUM = 0.02
"""Weight of a batch in the running spread of the advantages, which averages about fifty batches."""


@dataclass(frozen=True)
class CriticValues:
    """The estimates of J critics for states [...], in units of `Critics.unit`. reward, future: [..., J, S] the
    immediate reward of each lexeme and the rewards of the blocks after it (up to a constant of the state); value: [...,
    J] the return of the state under the data's policy."""

    reward: Tensor
    future: Tensor
    value: Tensor

    def q(self) -> Tensor:
        """[..., J, S] Q up to a constant of the state."""
        return self.reward + GAMMA * self.future


def advantages(q: Tensor, log_prior: Tensor) -> Tensor:
    """A [..., S] from Q [..., J, S] and log pi_b [..., S]: the least of the critics' Q - V, less its mean under pi_b.
    """
    prior = log_prior.softmax(-1)
    each = q - (q * prior.unsqueeze(-2)).sum(-1, keepdim=True)
    # The least estimate counts, because a maximum over lexemes picks out errors upwards.
    least = each.amin(-2)
    return least - (least * prior).sum(-1, keepdim=True)


class Critics(nn.Module):
    """J critics on one transformer over audio and lexemes (RACER Fig. 1), which value every lexeme of a block."""

    unit: Tensor
    spread: Tensor
    future_scale: Tensor
    value_scale: Tensor
    value_mean: Tensor

    def __init__(self, config: CriticConfig, frames: int, audio_width: int, lexemes: int, speakers: int) -> None:
        """frames: K; audio_width: d; lexemes: S; speakers: P."""
        super().__init__()
        self.config, self.lexemes = config, lexemes
        # All critics share the transformer: it costs most, and their heads differ enough to disagree.
        self.trunk = QNetwork(config.network, frames, audio_width, lexemes, speakers)
        # The trunk ends in features; the three linear heads below read them.
        self.trunk.head = nn.LayerNorm(config.width)  # type: ignore[assignment]
        self.reward = nn.Linear(config.width, CRITICS * lexemes)
        self.future = nn.Linear(config.width, CRITICS * lexemes)
        self.value = nn.Linear(config.width, CRITICS)
        for head in (self.reward, self.future, self.value):
            head.apply(begin_small)
        self.register_buffer("unit", torch.ones(()))  # of the values, in rewards
        self.register_buffer("spread", torch.ones(()))  # standard deviation of A under pi_b, in units
        # Scales of the heads, whose outputs have unit size: returns vary forty times as much as rewards of lexemes.
        self.register_buffer("future_scale", torch.ones(()))
        self.register_buffer("value_scale", torch.ones(()))
        self.register_buffer("value_mean", torch.zeros(()))

    @classmethod
    def build(cls, settings: CriticConfig, sizes: InterpreterSizes) -> Critics:
        return cls(settings, sizes.frames, sizes.high, len(sizes.lexemes), sizes.speakers)

    @property
    def weights(self) -> dict[str, float]:
        return {"reward": 1.0, "future": 1.0, "value": VALUE}

    def _of(self, features: Tensor) -> CriticValues:
        shape = (CRITICS, self.lexemes)
        return CriticValues(self.reward(features).unflatten(-1, shape),
                            self.future(features).unflatten(-1, shape) * self.future_scale,
                            self.value(features) * self.value_scale + self.value_mean)

    @torch.no_grad()
    def scale_to(self, unit: float, gained: Tensor, returns: Tensor) -> None:
        """Set the units from a data set: of rewards, and in this unit the deviation of the gains of swaps [...] (NaN if
        not tried) and the mean and deviation of the returns [...]."""
        tried = gained[~torch.isnan(gained)]
        self.unit.fill_(unit)
        self.future_scale.fill_(float(tried.square().mean().sqrt().clamp_min(1e-3)) if len(tried) else 1.0)
        self.value_mean.copy_(returns.mean())
        self.value_scale.copy_(returns.std().clamp_min(1e-3))

    def values(self, previous: Tensor, audio: Tensor, speaker: Tensor, silent: Tensor) -> CriticValues:
        return self._of(self.trunk.values(previous, audio, speaker, silent))

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Squared errors of reward, future and value, each critic on its recordings, unweighted.

        Rewards are relative to their mean under pi_b: the part that is the same for all lexemes belongs to the value,
        and is so large that nothing else would be learned. Future and value are in their standard deviations.

        batch: previous, action, silent, valid [B, T], audio [B, T, 3K, d], speaker one-hot [B, P]; every [B, T, S] the
        reward of each lexeme; log_prior [B, T, S]; return [B, T] the discounted sum of rewards from here on; swap
        [B, T, k] lexemes substituted for the action, and gained [B, T, k] the change in the rewards of the later
        blocks, NaN if not tried; heard [B, J] 1 if the critic learns from the recording.
        """
        values = self.values(batch["previous"], batch["audio"], batch["speaker"], batch["silent"])
        valid = batch["valid"].unsqueeze(-1) * batch["heard"].unsqueeze(1)  # [B, T, J]
        prior = batch["log_prior"].softmax(-1)
        # Half uniform, half by probability, because unlikely lexemes are rarely needed.
        weight = 0.5 / self.lexemes + 0.5 * prior
        target = advantages(batch["every"].unsqueeze(-2), batch["log_prior"]).unsqueeze(-2)
        mean = (values.reward * prior.unsqueeze(-2)).sum(-1, keepdim=True)
        error = (values.reward - mean - target).square() * weight.unsqueeze(-2)
        # Substitutions are measured for a part of the decisions only; NaN marks the rest.
        tried = ~torch.isnan(batch["gained"])
        taken = values.future.gather(-1, _each(batch["action"].unsqueeze(-1), values.future))
        other = values.future.gather(-1, _each(batch["swap"], values.future))
        missed = ((other - taken - batch["gained"].nan_to_num().unsqueeze(-2)) / self.future_scale).square()
        missed = missed * tried.unsqueeze(-2)
        with torch.no_grad():
            spread = self.advantage(values, batch["log_prior"]).square() * prior
            now = masked_mean(spread.sum(-1), batch["valid"]).sqrt()
            if self.training:
                # The first steps replace the initial spread at once; later ones follow slowly.
                self.spread.lerp_(now, _MOMENTUM if progress > _MOMENTUM else 1.0)
        share = tried.float().mean().clamp_min(1e-3)
        return {"reward": masked_mean(error.sum(-1), valid),
                "future": masked_mean(missed.sum(-1), valid) / share / tried.shape[-1],
                "value": masked_mean(((values.value - batch["return"].unsqueeze(-1)) / self.value_scale).square(),
                                     valid)}

    def advantage(self, values: CriticValues, log_prior: Tensor) -> Tensor:
        """A [..., S] in units of `unit`."""
        return advantages(values.q(), log_prior)

def _each(lexemes: Tensor, values: Tensor) -> Tensor:
    """Lexemes [B, T, k] for each of J critics, [B, T, J, k]."""
    return lexemes.unsqueeze(-2).expand(*values.shape[:-1], lexemes.shape[-1])
