"""Recorded speech as an environment: what it shows, what it pays and when it ends."""

import numpy as np
import pytest
import torch
from torch import Tensor

from eval.ablate.simulator import Choose, Replay, Simulator
from interpreters.episodes import Demonstration, EpisodeConfig, Episodes, SilentLexemes, build
from interpreters.reward import RewardConfig, RewardModel
from interpreters.reward_table import RewardTable

SIZE, WINDOW, LENGTHS = 5, 4, (20, 7, 1)


def takes() -> list[Demonstration]:
    rng = np.random.default_rng(0)
    begins = np.cumsum(LENGTHS) - LENGTHS
    return [Demonstration(number, number, np.arange(begin, begin + length), rng.integers(SIZE, size=length),
                 rng.random(length) < 0.4) for number, (begin, length) in enumerate(zip(begins, LENGTHS, strict=True))]


@pytest.fixture(scope="module")
def table() -> RewardTable:
    torch.manual_seed(0)
    model = RewardModel(RewardConfig(width=8, projection=4, window=WINDOW), 3, 6, 2).eval()
    return RewardTable(model, torch.randn(28, 3, 2), torch.randn(SIZE, 3, 6))


@pytest.fixture
def simulator(table: RewardTable) -> Simulator:
    return Simulator(takes(), table.rewards, WINDOW)


def truth() -> Tensor:
    return torch.as_tensor(np.concatenate([take.lexemes for take in takes()]))


def data(table: RewardTable) -> Episodes:
    none = SilentLexemes(np.array([], dtype=np.int64), np.arange(SIZE))
    config = EpisodeConfig(truth=1.0, sampled=0.0, statistical=0.0, perturbed=0.0)
    return build(takes(), config, table.sequence, silent=none, vectors=np.eye(SIZE))


def at_random(seed: int) -> Choose:
    rng = np.random.default_rng(seed)
    return lambda seen: torch.as_tensor(rng.integers(SIZE, size=len(seen["speaker"])))


def acting(actions: list[list[int]]) -> Choose:
    """Take these lexemes [T][B], whatever is seen."""
    left = iter(actions)
    return lambda seen: torch.tensor(next(left))


def test_what_is_seen_is_what_was_recorded(simulator: Simulator) -> None:
    batch = simulator.act(acting([[2, 4]]), np.array([0, 1]), np.array([3, 0]), 1)
    assert batch["block"].tolist() == [[4, 5], [21, 22]] and batch["speaker"].tolist() == [0, 1]
    assert batch["previous"].tolist() == [[takes()[0].lexemes[3], 2], [takes()[1].lexemes[0], 4]]
    assert batch["silent"].tolist() == [takes()[0].silent[4:6].tolist(), takes()[1].silent[1:3].tolist()]


def test_rewards_are_those_of_the_table_on_the_same_history(simulator: Simulator, table: RewardTable) -> None:
    # From the middle, and from the first block, where windows are truncated on the left.
    for number, start, count in ((0, 6, 8), (1, 0, 2)):
        recorded, begin = takes()[number].lexemes, sum(LENGTHS[:number])
        acted = np.random.default_rng(4).integers(SIZE, size=count)
        history = np.concatenate([recorded[:start + 1], acted])
        wanted = table.sequence(torch.as_tensor(history), begin + torch.arange(len(history)))[start + 1:]
        batch = simulator.act(acting(acted[:, None].tolist()), np.array([number]), np.array([start]), count)
        torch.testing.assert_close(batch["reward"][0, :count], wanted)


def test_the_end_of_a_recording_is_terminal_and_the_horizon_truncates(simulator: Simulator) -> None:
    # 4, 5 and 6 are the last blocks of the second recording; the first has far to go.
    batch = simulator.act(lambda seen: torch.zeros(3), np.array([0, 1, 1]), np.array([0, 3, 2]), 4)
    assert batch["terminal"].int().tolist() == [[0, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 1, 0]]
    assert batch["valid"].int().tolist() == [[1] * 5, [1, 1, 1, 0, 0], [1, 1, 1, 1, 0]]
    assert (batch["reward"][1, 3:] == 0).all() and (batch["reward"][[0, 2], 3] != 0).all()
    assert batch["block"][0, 4] == 5  # what one bootstraps from


def test_an_episode_begins_where_something_follows(simulator: Simulator) -> None:
    starts = torch.unique(simulator.collect(at_random(0), np.random.default_rng(0), 500, 5)["block"][:, 0])
    assert starts.tolist() == [*range(1, 16), 21, 22]


def test_what_was_collected_is_laid_out_as_the_data(simulator: Simulator, table: RewardTable) -> None:
    online, offline = (simulator.collect(at_random(0), np.random.default_rng(0), 16, 9),
                       data(table).windows(np.random.default_rng(0), 16, 9))
    assert {key: (value.dtype, value.shape) for key, value in online.items()} == {
        key: (value.dtype, value.shape) for key, value in offline.items()}
    # The same generator begins the same windows, so all but what was done is the same.
    for key in ("block", "silent", "valid", "terminal", "speaker"):
        assert torch.equal(online[key][..., :9], offline[key][..., :9]), key
    assert torch.equal(online["valid"], offline["valid"]) and online["terminal"].any()
    assert torch.equal(online["previous"][:, 0], truth()[online["block"][:, 0] - 1])
    taken = (online["valid"] > 0)[:, 1:]
    assert torch.equal(online["previous"][:, 1:][taken], online["action"][:, :-1][taken])
    assert (online["reward"][online["valid"] == 0] == 0).all() and (online["cloned"] == 0).all()


def test_the_newest_windows_are_remembered(simulator: Simulator, table: RewardTable) -> None:
    memory = Replay(10)
    first, second = (simulator.collect(at_random(seed), np.random.default_rng(seed), 8, 6) for seed in (0, 1))
    memory.add(first)
    memory.add(second)
    drawn = memory.windows(np.random.default_rng(1), 40)
    kept = torch.cat([first["action"], second["action"]])[-10:]
    assert torch.equal(drawn["action"].unique(dim=0), kept.unique(dim=0))
    offline = data(table).windows(np.random.default_rng(1), 40, 6)
    assert {key: (value.dtype, value.shape) for key, value in drawn.items()} == {
        key: (value.dtype, value.shape) for key, value in offline.items()}
