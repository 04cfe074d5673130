"""The Q-network and conservative Q-learning: lexemes chosen by their expected return (RACER 4.3, Eq. 9 to 12).

A decision is a block. Its state is the history of audio and actions, s_i = (a_0..a_{i-1}, u_1..u_i); its action is a
lexeme; its reward measures how well gesture and speech match. The network is trained on recorded decisions only; the
conservative term prevents overestimated values of lexemes that do not occur in the data.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from data_module.layers import BlockLinear, freeze, masked_mean
from interpreters.base import InterpreterSizes
from interpreters.settings import QConfig
from interpreters.transformer import INITIAL, Head, Layer, begin_small, sliding, two_stream_mask

__all__ = ["ConservativeQ", "QNetwork", "conservative_q_loss"]

DROPOUT = 0.1
"""As in the paper (RACER 5.2)."""


class QNetwork(nn.Module):
    """Q(s_i, .) over the lexicon for each decision i: a transformer over audio and actions (RACER Fig. 1, Eq. 12)."""

    when_silent: Tensor

    def __init__(self, config: QConfig, frames: int, audio_width: int, lexemes: int, speakers: int,
                 silent: Sequence[int] = ()) -> None:
        """frames: K; audio_width: d; lexemes: S; speakers: P; silent: the lexemes allowed in a silent block (none:
        all). ValueError for inconsistent sizes."""
        super().__init__()
        if any(not 0 <= index < lexemes for index in silent):
            raise ValueError(f"silent lexemes {list(silent)} lie outside a lexicon of {lexemes}")
        self.config, self.frames, self.lexemes, self.speakers = config, frames, lexemes, speakers
        self.encode_audio = BlockLinear(frames, audio_width, config.audio_features, config.audio_blocks,
                                        config.audio_bottleneck)
        # One more input than audio and speaker: whether the block is silent.
        width = frames * config.audio_features + (speakers if config.use_speaker else 0) + 1
        self.audio_token = nn.Linear(width, config.width)
        self.action_token = nn.Embedding(lexemes, config.width)
        self.positions = nn.Parameter(torch.randn(2, config.decisions, config.width) * INITIAL)
        self.dropout = nn.Dropout(DROPOUT)
        self.layers = nn.ModuleList(Layer(config.width, config.heads, DROPOUT) for _ in range(config.layers))
        # Values are linear in the last features: no bound, unlike probabilities.
        self.head = Head(config.width, lexemes)
        self.apply(begin_small)
        # A lexicon without silent lexemes must not leave a silent block without any action.
        allowed = [index in set(silent) or not len(silent) for index in range(lexemes)]
        self.register_buffer("when_silent", torch.tensor(allowed), persistent=False)

    @classmethod
    def build(cls, settings: QConfig, sizes: InterpreterSizes) -> QNetwork:
        return cls(settings, sizes.frames, sizes.high, len(sizes.lexemes), sizes.speakers, sizes.silent)

    def allowed(self, silent: Tensor) -> Tensor:
        """A(s): the allowed lexemes, bool [..., S], for blocks that are silent or not [...]. Only silent lexemes in
        silence, all lexemes elsewhere; all everywhere if the lexicon has no silent ones. Used by the choice, the
        logsumexp of the loss and the maximum of the target."""
        return ~silent.bool().unsqueeze(-1) | self.when_silent

    def tokens(self, previous: Tensor, audio: Tensor, speaker: Tensor, silent: Tensor) -> Tensor:
        """The two streams [U; A], [B, 2, M, C], without positions. previous: [B, M] the lexeme before each decision;
        audio: [B, M, 3K, d] the window of the block that is decided on; speaker: one-hot [B, P]; silent: [B, M] whether
        that block is a silence."""
        parts = [self.encode_audio(audio).flatten(-2), silent.to(audio).unsqueeze(-1)]
        if self.config.use_speaker:
            parts.append(speaker.to(audio)[:, None].expand(-1, audio.shape[1], -1))
        return torch.stack([self.audio_token(torch.cat(parts, dim=-1)), self.action_token(previous)], dim=1)

    def through(self, tokens: Tensor, layers: Iterable[nn.Module]) -> Tensor:
        """Tokens that have their positions, [B, 2, T', C], through some layers."""
        steps, x = tokens.shape[2], tokens.flatten(1, 2)
        mask = two_stream_mask(steps, tokens.device)
        for layer in layers:
            x = layer(x, mask)
        return x.unflatten(1, (2, steps))

    def placed(self, tokens: Tensor) -> Tensor:
        """Tokens [B, 2, T', C] with the learned embedding of their stream and position added (RACER: 2 x T' x C)."""
        return self.dropout(tokens + self.positions[:, :tokens.shape[2]])

    def read(self, tokens: Tensor) -> Tensor:
        """Q values [B, T', S] of one window of tokens [B, 2, T', C], T' <= T, taken from the action half."""
        return self.head(self.through(self.placed(tokens), self.layers)[:, 1])

    def values(self, previous: Tensor, audio: Tensor, speaker: Tensor, silent: Tensor) -> Tensor:
        """Q(s_i, .) [B, M, S] for each of M decisions; the arguments are those of `tokens`. Decisions past the first T
        use a sliding window, exactly as in `step`."""
        return sliding(self.tokens(previous, audio, speaker, silent), self.config.decisions, self.read)

    def choose(self, values: Tensor, silent: Tensor) -> Tensor:
        return values.masked_fill(~self.allowed(silent), -torch.inf).argmax(-1)

def data_nll(values: Tensor, action: Tensor, allowed: Tensor) -> Tensor:
    """log sum_a exp Q(s, a) - Q(s, a_data), [...], the first bracket of RACER Eq. 11. values, allowed: [..., S];
    action: [...]. It is the cross-entropy of softmax(Q) over the allowed actions. 0 if the data's action is not
    allowed, because its value is not in the sum and would grow without bound."""
    taken = action.unsqueeze(-1)
    # Only allowed actions compete: pressing down the values of others would have no effect on a choice.
    everything = values.masked_fill(~allowed, -torch.inf).logsumexp(-1)
    known = allowed.gather(-1, taken).squeeze(-1)
    return (everything - values.gather(-1, taken).squeeze(-1)) * known


def backed_up(reward: Tensor, terminal: Tensor, next_value: Tensor, gamma: float) -> Tensor:
    """y = r + gamma V(s'), and r alone at the end of a take, [...] (RACER Eq. 10, or Eq. 2 with a maximum as V)."""
    return reward + gamma * next_value.masked_fill(terminal.bool(), 0.0)


@dataclass(frozen=True)
class DecisionBatch:
    """Actions and their outcomes, [B, T] each except `allowed`. action: lexemes; reward; terminal: nothing follows;
    allowed: bool [B, T, S], A(s); valid: steps that exist; known: steps whose next value is known; cloned: weight of
    the data's action, lower if it is not a person's."""

    action: Tensor
    reward: Tensor
    terminal: Tensor
    allowed: Tensor
    valid: Tensor
    known: Tensor
    cloned: Tensor


def conservative_q_loss(values: Tensor, next_value: Tensor, done: DecisionBatch, gamma: float) -> tuple[Tensor, Tensor]:
    """The terms of RACER Eq. 11, unweighted: E[log sum_a exp Q(s, a) - Q(s, a_data)] and E[(Q(s, a_data) - y)^2] / 2.
    values: [B, T, S] Q(s, .); next_value: [B, T] max_a' of the target at s'. The first mean is over valid steps, the
    second over those of them whose next value is known."""
    conservative = data_nll(values, done.action, done.allowed)
    chosen = values.gather(-1, done.action.unsqueeze(-1)).squeeze(-1)
    # No gradient through the target: it is a label, though it moves with the weights.
    target = backed_up(done.reward, done.terminal, next_value, gamma).detach()
    error = 0.5 * (chosen - target).square()
    return masked_mean(done.cloned * conservative, done.valid), masked_mean(error, done.valid * done.known)


@contextmanager
def without_dropout(module: nn.Module) -> Iterator[None]:
    was = module.training
    module.eval()
    try:
        yield
    finally:
        module.train(was)


def next_known(batch: dict[str, Tensor]) -> Tensor:
    """[B, T] 1 for steps whose next value is known: nothing follows (terminal), or the next block is in the batch. The
    last step before a cut is not the end of a take; without a next block it cannot be bootstrapped."""
    return (batch["terminal"][:, :-1].bool() | batch["valid"][:, 1:].bool()).float()


DECISIONS = ("previous", "audio", "silent", "action", "reward", "terminal", "valid", "cloned")
"""The fields of a batch for each decision, [B, T + 1, ...]."""


class ConservativeQ(nn.Module):
    """Conservative Q-learning of a Q-network: the online network and a delayed target (RACER Eq. 11). With `temporal` 0
    it is supervised learning, with `conservative` 0 it is DQN, offline or online by the batches."""

    def __init__(self, online: QNetwork) -> None:
        super().__init__()
        self.config, self.online = online.config, online
        # A delayed copy: regression on targets of the network itself would chase its own changes (Mnih 2015).
        self.target = copy.deepcopy(online)
        freeze(self.target)

    @property
    def weights(self) -> dict[str, float]:
        if not self.config.temporal:
            return {"conservative": self.config.conservative}
        return {"conservative": self.config.conservative, "temporal_difference": self.config.temporal}

    def train(self, mode: bool = True) -> ConservativeQ:
        super().train(mode)
        self.online.train(mode)
        # The target never has dropout: the maximum over actions would turn its noise into a bias upwards.
        self.target.eval()
        return self

    def copy_target(self) -> None:
        self.target.load_state_dict(self.online.state_dict())

    def before_step(self, step: int) -> None:
        if step % self.config.copy_every == 0:
            self.copy_target()

    @torch.no_grad()
    def next_values(self, batch: dict[str, Tensor]) -> Tensor:
        """max_a' Q(s', a') [B, T] by the target, over the actions allowed in s'. The window of the last state ends one
        step later, as in a stream, so that its position is a trained one. With `double`, the online network selects the
        action."""
        states = batch["previous"], batch["audio"], batch["speaker"], batch["silent"]
        values = self.target.values(*states)[:, 1:]
        judge = values
        # Selected by one network and valued by the other, an action that one of them overestimates does not raise the
        # target (Double DQN, van Hasselt 2016).
        if self.config.double:
            with without_dropout(self.online):
                judge = self.online.values(*states)[:, 1:]
        best = self.online.choose(judge, batch["silent"][:, 1:])
        return values.gather(-1, best.unsqueeze(-1)).squeeze(-1)

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """The conservative term and the temporal difference (absent if its weight is 0), unweighted.

        batch: previous, action, reward, terminal, valid, silent, cloned [B, T + 1], audio [B, T + 1, 3K, d], speaker
        one-hot [B, P]. The last decision is for bootstrapping only, because a window cut from a longer take does not
        end it. Before `warm_up` of the run (progress, 0 to 1) there is the conservative term only.
        """
        # The last position serves as s' of the one before it only.
        now = {key: batch[key][:, :-1] for key in DECISIONS}
        values = self.online.values(now["previous"], now["audio"], batch["speaker"], now["silent"])
        learns = bool(self.config.temporal) and progress >= self.config.warm_up
        conservative, difference = conservative_q_loss(
            values, self.next_values(batch) if learns else torch.zeros_like(now["reward"]),
            DecisionBatch(now["action"], now["reward"], now["terminal"], self.online.allowed(now["silent"]),
                          now["valid"], next_known(batch), now["cloned"]), self.config.gamma)
        terms = {"conservative": conservative}
        return {**terms, "temporal_difference": difference} if learns else terms
