"""The actor-critic variant: whose turn it is, who learns in it, and that it begins as what was supervised."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from eval.ablate.actor_critic import ActorCritic
from interpreters.cql import QConfig, QNetwork

FRAMES, AUDIO, SIZE, SPEAKERS, WINDOW = 3, 2, 4, 2, 5
SMALL = QConfig(width=16, heads=2, layers=4, decisions=WINDOW, audio_features=4, audio_bottleneck=0)
SILENT = (2,)


def network(seed: int = 0, **changes: object) -> QNetwork:
    torch.manual_seed(seed)
    net = QNetwork(replace(SMALL, **changes), FRAMES, AUDIO, SIZE, SPEAKERS, SILENT)  # type: ignore[arg-type]
    for parameter in net.parameters():
        parameter.data.mul_(8.0 if parameter.dim() > 1 else 1.0)
    return net.eval()


def windows(count: int = 3, seed: int = 0, steps: int = WINDOW) -> dict[str, Tensor]:
    draw = torch.Generator().manual_seed(seed)
    shape = (count, steps + 1)
    silent = torch.rand(shape, generator=draw) < 0.2
    action = torch.randint(SIZE, shape, generator=draw)
    return {"previous": torch.randint(SIZE, shape, generator=draw), "silent": silent,
            "audio": torch.randn(*shape, 3 * FRAMES, AUDIO, generator=draw),
            "speaker": functional.one_hot(torch.arange(count) % SPEAKERS, SPEAKERS).float(),
            "action": torch.where(silent, torch.full_like(action, SILENT[0]), action),
            "reward": torch.rand(shape, generator=draw), "terminal": torch.zeros(shape, dtype=torch.bool),
            "valid": torch.ones(shape), "cloned": torch.ones(shape)}


def heard(batch: dict[str, Tensor]) -> list[Tensor]:
    return [batch[key] for key in ("previous", "audio", "speaker", "silent")]


def judges_always(model: ActorCritic, worth: float) -> None:
    """Give every state the same value."""
    with torch.no_grad():
        model.value[1].weight.zero_()
        model.value[1].bias.fill_(worth)


def learns(module: nn.Module) -> bool:
    """Whether any of its weights got a gradient that is not zero."""
    return any(p.grad is not None and bool(p.grad.any()) for p in module.parameters())


def test_turns_alternate_and_depend_on_the_step_alone() -> None:
    model = ActorCritic(network())
    turns = []
    for step in range(20):
        model.before_step(step)
        turns.append(model.turn)
    assert turns == (["actor"] * 5 + ["critic"] * 5) * 2
    model.before_step(3)
    assert model.turn == "actor"


@pytest.mark.parametrize("turn", ["actor", "critic"])
def test_only_the_one_whose_turn_it_is_learns(turn: str) -> None:
    model = ActorCritic(network())
    model.before_step(0 if turn == "actor" else 5)
    terms = model.losses(windows())
    assert set(terms) == set(model.weights)
    sum((model.weights[key] * term for key, term in terms.items()), start=torch.zeros(())).backward()
    for part in (*model.actor.layers[1:], model.actor.head):
        assert learns(part) == (turn == "actor")
    for part in (*model.critic, model.value):
        assert learns(part) == (turn == "critic")
    for part in (model.actor.layers[0], model.actor.audio_token, model.actor.action_token):
        assert not learns(part) and not any(p.requires_grad for p in part.parameters())


def test_it_begins_as_the_supervised_network() -> None:
    supervised, model = network(seed=3), ActorCritic(network())
    before = model.actor.values(*heard(windows()))
    model.begin_as(supervised)
    batch = windows(steps=12)
    values = supervised.values(*heard(batch))
    torch.testing.assert_close(model.actor.values(*heard(batch)), values)
    assert not torch.allclose(before, model.actor.values(*heard(windows())))
    logits, worth = model.logits_and_value(*heard(batch))
    torch.testing.assert_close(logits, values)
    assert worth.shape == logits.shape[:2]
    for own, other in zip(model.critic, supervised.layers[1:], strict=True):
        for a, b in zip(own.parameters(), other.parameters(), strict=True):
            assert torch.equal(a, b) and a is not b
    with torch.no_grad():
        model.critic[0].feed[0].weight.add_(1.0)
        supervised.head[1].bias.add_(torch.arange(SIZE))
    torch.testing.assert_close(model.actor.values(*heard(batch)), values)  # neither critic nor giver is the actor


def test_errors_by_hand() -> None:
    model = ActorCritic(network(), gamma=0.5)
    judges_always(model, 4.0)
    batch = windows(count=1)
    batch["reward"] = torch.ones_like(batch["reward"])
    model.before_step(5)
    # delta = 1 + 0.5 x 4 - 4 = -1 everywhere; at the end of a take it is 1 - 4 = -3.
    assert float(model.losses(batch)["critic"].detach()) == pytest.approx(0.5)
    surprise = -float(model.losses(batch)["actor"].detach())
    logits = model.actor.values(*heard(batch)).masked_fill(~model.actor.allowed(batch["silent"]), -torch.inf)
    expected = functional.cross_entropy(logits[0, :WINDOW], batch["action"][0, :WINDOW])
    assert surprise == pytest.approx(float(expected.detach()), rel=1e-5)
    batch["terminal"][0, WINDOW - 1] = True
    assert float(model.losses(batch)["critic"].detach()) == pytest.approx(0.5 * (WINDOW - 1 + 9) / WINDOW)
    batch["valid"][0, 2:] = 0  # step 1 is cut off with nothing known after it, so only step 0 counts
    assert float(model.losses(batch)["critic"].detach()) == pytest.approx(0.5)
