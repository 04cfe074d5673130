"""The actor-critic variant of RACER's ablation (RACER 5.5, Table 2), by the recipe of Bailando's actor-critic.

The actor is a Q-network whose values are used as logits. The critic is a second copy of its last layers on the shared
trunk and estimates the value of a state under the actor. They learn in turns.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from data_module.layers import freeze, masked_mean
from interpreters.cql import DROPOUT, QNetwork, backed_up, data_nll, next_known
from interpreters.transformer import Head, Layer, begin_small, sliding

BRANCH = 3
"""Last layers that actor and critic do not share."""
TURN = 5
"""Steps for which one of them learns, before it is the other's turn."""


class ActorCritic(nn.Module):
    """pi(a | s) and V(s) on a shared trunk, which stays as supervised learning left it. Dropout is off throughout."""

    def __init__(self, actor: QNetwork, gamma: float = 0.99) -> None:
        """actor: the network that becomes the policy; a small one may have fewer layers than `BRANCH`. gamma: the
        discount; Bailando has 1, which would not compare with the other rows."""
        super().__init__()
        self.actor, self.gamma, sizes = actor, gamma, actor.config
        # A test's network may have no layer to share.
        branch = min(BRANCH, sizes.layers)
        self.shared = sizes.layers - branch
        self.critic = nn.ModuleList(Layer(sizes.width, sizes.heads, DROPOUT) for _ in range(branch))
        self.value = Head(sizes.width, 1)
        # Small first weights, as the network's own layers begin.
        self.critic.apply(begin_small)
        self.value.apply(begin_small)
        self.turn = "actor"
        freeze(actor)
        for part in (actor.layers[self.shared:], actor.head):
            part.requires_grad_(True)
        self.train()

    @property
    def weights(self) -> dict[str, float]:
        return {"actor": 1.0, "critic": 1.0}

    def train(self, mode: bool = True) -> ActorCritic:
        """Set the flag `training`, but keep dropout off."""
        super().train(False)
        self.training = mode
        return self

    def begin_as(self, supervised: QNetwork) -> None:
        """Copy the weights of a network of the same sizes, trained with cross-entropy alone, to the trunk, the actor
        and the critic's layers."""
        self.actor.load_state_dict(supervised.state_dict())
        for critic, actor in zip(self.critic, self.actor.layers[self.shared:], strict=True):
            critic.load_state_dict(actor.state_dict())

    def before_step(self, step: int) -> None:
        # In turns, as in Bailando: while one learns the other stands still.
        self.turn = "actor" if step % (2 * TURN) < TURN else "critic"

    def _read(self, tokens: Tensor) -> Tensor:
        """Logits and the state's value [B, T', S + 1] of one window of tokens [B, 2, T', C]."""
        trunk = self.actor.through(self.actor.placed(tokens), self.actor.layers[:self.shared])
        acted = self.actor.through(trunk, self.actor.layers[self.shared:])
        judged = self.actor.through(trunk, self.critic)
        return torch.cat([self.actor.head(acted[:, 1]), self.value(judged[:, 1])], dim=-1)

    def logits_and_value(self, previous: Tensor, audio: Tensor, speaker: Tensor, silent: Tensor
                         ) -> tuple[Tensor, Tensor]:
        """Logits [B, M, S] of the actor and V(s) [B, M] of the critic; the arguments are those of `QNetwork.values`."""
        tokens = self.actor.tokens(previous, audio, speaker, silent)
        # One pass for both heads, since they share the trunk.
        both = sliding(tokens, self.actor.config.decisions, self._read)
        return both[..., :-1], both[..., -1]

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Cross-entropy x TD error for the actor, half the squared TD error for the critic (batch: as for CQL). delta =
        r + gamma V(s') - V(s). Only the term of the current turn has a gradient, and there is none through the value of
        the next state. The actor's policy is over the allowed lexemes only."""
        logits, value = self.logits_and_value(batch["previous"], batch["audio"], batch["speaker"], batch["silent"])
        action, reward, terminal, valid = (batch[key][:, :-1] for key in ("action", "reward", "terminal", "valid"))
        # The critic's own target must not move with the gradient: only its estimate does.
        error = backed_up(reward, terminal, value[:, 1:].detach(), self.gamma) - value[:, :-1]
        nll = data_nll(logits[:, :-1], action, self.actor.allowed(batch["silent"][:, :-1]))
        counted = valid * next_known(batch)
        terms = {"actor": masked_mean(nll * error.detach(), counted),
                 "critic": masked_mean(0.5 * error.square(), counted)}
        return {key: term if key == self.turn else term.detach() for key, term in terms.items()}
