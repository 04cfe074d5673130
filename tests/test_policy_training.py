"""RACER's rows: what each kind learns from, that training repeats, and what it is judged by."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from untrained import with_policies

from data_module.store import Store
from eval.ablate import racer as training
from eval.ablate.actor_critic import ActorCritic
from eval.ablate.racer import RacerRows
from eval.ablate.rows import ROWS
from eval.ablate.run import RgRows
from eval.context import EvalContext
from interpreters.cql import ConservativeQ
from interpreters.episodes import BEHAVIOURS, Episode, Episodes

PRESET = ("cql.width=8", "cql.layers=3", "cql.heads=2", "cql.decisions=6", "cql.copy_every=2",
          "schedules.cql.steps=4", "schedules.cql.batch=4")


def test_another_reward_is_brought_to_the_scale_of_the_data() -> None:
    rng = np.random.default_rng(0)
    count, size = 40, 5
    actions = rng.integers(size, size=count)
    silent, terminal = np.zeros(count, bool), np.zeros(count, bool)
    one = Episode(0, 0, np.arange(count), actions, np.zeros(count, np.int8),
                  rng.normal(0.6, 0.1, count).astype(np.float32), silent, terminal)
    table = torch.as_tensor(-rng.random((count, size)) * 30, dtype=torch.float32)
    scaled = training.rescaled(table, Episodes([one]))
    own = scaled.numpy()[np.arange(count), actions][1:]
    assert own.mean() == pytest.approx(one.reward[1:].mean(), abs=1e-5)
    assert own.std() == pytest.approx(one.reward[1:].std(), abs=1e-5)
    assert torch.equal(scaled.argsort(1), table.argsort(1)), "no order changes"


def test_a_scale_multiplies_the_rewards_of_either_kind(context: RacerRows) -> None:
    for name in ("cql", "distance"):
        plain, scaled = (training.rewarded(racer, context.config(f"racer-{name}")).episodes for racer in (
            context, dataclasses.replace(context, scale=20.0)))
        for one, other in zip(plain, scaled, strict=True):
            np.testing.assert_allclose(other.reward, 20 * one.reward, rtol=1e-6)
    assert ROWS["racer-scale=20, alpha=0.1"].scale == ROWS["racer-distance, scale=20, alpha=0.1"].scale == 20


@pytest.fixture(scope="module")
def context(tiny_store: Path, tmp_path_factory: pytest.TempPathFactory) -> RacerRows:
    work, store = tmp_path_factory.mktemp("racer"), Store.open(tiny_store)
    here = EvalContext.over(store, with_policies(store, work), work, 2, progress=False)
    return RacerRows.of(here, RgRows(here), PRESET)


def weights(module: torch.nn.Module) -> Tensor:
    return torch.cat([parameter.detach().flatten() for parameter in module.parameters()])


def test_what_acts_keeps_to_the_silent_mask(context: RacerRows) -> None:
    network = context.untrained("racer-cql", 1).eval()
    blocks = torch.as_tensor(np.flatnonzero(~context.corpus.silent)[:64])[:, None]
    for quiet in (False, True):
        seen = {"block": blocks, "previous": torch.zeros(len(blocks), 1, dtype=torch.int64),
                "silent": torch.full((len(blocks), 1), quiet), "speaker": torch.zeros(len(blocks), dtype=torch.int64)}
        rng = np.random.default_rng(0)
        with torch.no_grad():
            anything, best, drawn = (choose(seen) for choose in (
                training.epsilon_greedy(network, context.corpus, 1.0, rng),
                training.epsilon_greedy(network, context.corpus, 0.0, rng),
                training.sampled(network, context.corpus, rng)))
            values = training.latest(network, context.corpus, seen)
        for chosen in (anything, best, drawn):
            assert chosen.shape == (len(blocks),)
            assert not quiet or np.isin(chosen.numpy(), context.bundle.silent).all()
        assert torch.equal(best, network.choose(values, seen["silent"][:, 0]))
        assert quiet or len(anything.unique()) > len(best.unique())


def test_each_kind_learns_from_its_own(context: RacerRows) -> None:
    def batch_of(name: str) -> dict[str, Tensor]:
        row, config = ROWS[f"racer-{name}"], context.config(f"racer-{name}")
        model, make_batch = training.TRAININGS[row.train](context, config, context.untrained(f"racer-{name}", 1), 1)
        assert isinstance(model, ActorCritic if row.train == "actor-critic" else ConservativeQ)
        model.before_step(0)
        got, again = (make_batch(np.random.default_rng(5), 4) for _ in range(2))
        assert all(torch.equal(value, again[key]) for key, value in got.items())
        return got

    batch = {name: batch_of(name) for name in ("cql", "literal", "distance", "dqn", "actor-critic")}
    assert (batch["literal"]["behaviour"] == 0).all()
    for name in ("dqn", "actor-critic"):
        assert (batch[name]["behaviour"] == BEHAVIOURS.index("sampled")).all() and (batch[name]["cloned"] == 0).all()
    assert torch.equal(batch["cql"]["action"], batch["distance"]["action"]), "the same was done, it is paid otherwise"
    assert not torch.equal(batch["cql"]["reward"], batch["distance"]["reward"])
    of = {name: training.rewarded(context, context.config(f"racer-{name}")) for name in ("cql", "distance")}
    rewards = [np.concatenate([episode.reward[1:] for episode in episodes.episodes]) for episodes in of.values()]
    assert rewards[0].mean() == pytest.approx(rewards[1].mean(), abs=1e-4)
    assert rewards[0].std() == pytest.approx(rewards[1].std(), abs=1e-4)


def test_the_actor_begins_as_the_supervised_network(context: RacerRows) -> None:
    supervised = training.trained(context, "racer-supervised", 1)
    model, _ = training.actor_critic(context, context.config("racer-actor-critic"),
                                     context.untrained("racer-cql", 1), 1)
    assert isinstance(model, ActorCritic)
    assert torch.equal(weights(model.actor), weights(supervised))


@pytest.mark.parametrize("name", ["racer-cql", "racer-dqn", "racer-actor-critic"])
def test_training_repeats(context: RacerRows, name: str) -> None:
    first = training.trained(context, name, 1)
    assert training.trained(context, name, 1) is first, "once"
    again = training.trained(dataclasses.replace(context), name, 1)
    assert again is not first and torch.equal(weights(first), weights(again))
    assert not torch.equal(weights(first), weights(training.trained(context, name, 2)))
