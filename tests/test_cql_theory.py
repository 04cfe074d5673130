"""What discrete conservative Q-learning must do where the answer is known: tables instead of networks (RACER Eq. 11).

The oracle is derived here. With pi_b the share of each action in a state's data, the loss of a table Q is

    L = alpha (logsumexp Q - sum_a pi_b(a) Q(a)) + sum_a pi_b(a) (Q(a) - y(a))^2 / 2
    dL/dQ(a) = alpha (softmax Q (a) - pi_b(a)) + pi_b(a) (Q(a) - y(a))

Summed over a, softmax and pi_b cancel, so at the fixed point the mean of Q over the data is the mean of y.
"""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from interpreters.cql import DecisionBatch, conservative_q_loss

Array = NDArray[np.float64]
COUNTS = (8, 6, 4, 2)
"""Of each action in the data of a state: a behaviour policy of 0.4, 0.3, 0.2 and 0.1."""
BEHAVIOUR = np.array(COUNTS) / sum(COUNTS)
REWARD = np.array([0.0, 0.05, 0.0, 0.15])
"""The best action is the rarest; a standard deviation of 0.06, as rewards have over lexemes."""


def recorded(reward: Array, states: int = 1, terminal: bool = False) -> DecisionBatch:
    """A batch [states, 20] that holds each action as often as the behaviour policy takes it."""
    action = torch.as_tensor(np.repeat(np.arange(len(COUNTS)), COUNTS)).expand(states, -1)
    one = torch.ones(action.shape, dtype=torch.float64)
    return DecisionBatch(action, torch.as_tensor(reward)[action], torch.full(action.shape, terminal),
                         torch.ones(*action.shape, len(COUNTS), dtype=torch.bool), one, one, one)


def losses(table: Tensor, next_value: Tensor, data: DecisionBatch, gamma: float) -> tuple[Tensor, Tensor]:
    """Of a table [states, S], the same for all of a state's decisions."""
    values = table[:, None].expand(*data.action.shape, -1)
    return conservative_q_loss(values, next_value[:, None].expand(data.action.shape), data, gamma)


def fixed_point(alpha: float, gamma: float, reward: Array, best: bool = True) -> Array:
    """[S] where gradient descent on the loss comes to rest in a world of one state, which follows itself; the value of
    the next decision is the best one's (`best`), or the mean of the behaviour policy."""
    table = torch.zeros(1, len(COUNTS), dtype=torch.float64, requires_grad=True)
    data, prior = recorded(reward), torch.as_tensor(BEHAVIOUR)
    for _ in range(4000):
        now = table.detach()
        after = now.max(1).values if best else now @ prior
        conservative, error = losses(table, after, data, gamma)
        (gradient,) = torch.autograd.grad(alpha * conservative + error, table)
        with torch.no_grad():
            table -= 2.0 * gradient / max(1.0, alpha)
    return table.detach().numpy()[0]


@pytest.mark.parametrize("alpha", [0.0, 0.3, 1.0, 4.0])
def test_loss_and_gradient_are_the_derived_ones(alpha: float) -> None:
    rng = np.random.default_rng(3)
    q, reward, after, gamma = rng.normal(size=4), rng.normal(size=4), 0.7, 0.9
    table = torch.tensor(q[None], requires_grad=True)
    conservative, error = losses(table, torch.tensor([after], dtype=torch.float64), recorded(reward), gamma)
    y = reward + gamma * after
    apart = q - y
    assert float(error.detach()) == pytest.approx((BEHAVIOUR * apart ** 2 / 2).sum())
    assert float(conservative.detach()) == pytest.approx(np.log(np.exp(q).sum()) - (BEHAVIOUR * q).sum())
    (gradient,) = torch.autograd.grad(alpha * conservative + error, table)
    soft = np.exp(q) / np.exp(q).sum()
    np.testing.assert_allclose(gradient.numpy()[0], alpha * (soft - BEHAVIOUR) + BEHAVIOUR * apart, atol=1e-12)


@pytest.mark.parametrize(("alpha", "gamma"), [(1.0, 0.9), (1.0, 0.5), (0.1, 0.9), (4.0, 0.8)])
def test_values_are_inflated_by_the_gap_that_is_bootstrapped(alpha: float, gamma: float) -> None:
    """E Q = (r + gamma g) / (1 - gamma) with g = max Q - E Q: gamma g / (1 - gamma) too much."""
    q = fixed_point(alpha, gamma, REWARD)
    mean, earned = float(BEHAVIOUR @ q), float(BEHAVIOUR @ REWARD)
    gap = float(q.max()) - mean
    assert gap > 0.02
    assert mean == pytest.approx((earned + gamma * gap) / (1 - gamma), rel=1e-6)
    # By the mean of the behaviour policy in the place of the maximum nothing is inflated.
    assert float(BEHAVIOUR @ fixed_point(alpha, gamma, REWARD, best=False)) == pytest.approx(earned / (1 - gamma),
                                                                                             rel=1e-6)


def test_at_alpha_1_rewards_of_this_size_change_no_choice() -> None:
    """The head that classifies drowns the value; with a hundredth of alpha the best action is found, as by DQN."""
    gamma = 0.9
    q = fixed_point(1.0, gamma, REWARD)
    assert int(q.argmax()) == int(BEHAVIOUR.argmax()) == 0
    # What it ranks by is the log-odds of the behaviour, and hardly the reward.
    assert np.corrcoef(q, np.log(BEHAVIOUR))[0, 1] > 0.95
    assert int(fixed_point(0.01, gamma, REWARD).argmax()) == int(REWARD.argmax()) == 3
    np.testing.assert_allclose(fixed_point(0.0, gamma, REWARD), REWARD + gamma * REWARD.max() / (1 - gamma), atol=1e-3)
