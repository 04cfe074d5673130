"""Recorded speech as an environment: what it shows, what it pays and when it ends."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from eval.ablate.simulator import Choose, Replay, Simulator, collect
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


def test_what_is_seen_is_what_was_recorded(simulator: Simulator) -> None:
    seen = simulator.begin(np.array([0, 1]), np.array([3, 0]), 10)
    assert seen.block.tolist() == [4, 21] and seen.speaker.tolist() == [0, 1] and seen.live.all()
    assert seen.previous.tolist() == [takes()[0].lexemes[3], takes()[1].lexemes[0]]
    seen, *_ = simulator.step(torch.tensor([2, 4]))
    assert seen.block.tolist() == [5, 22] and seen.previous.tolist() == [2, 4]
    assert seen.silent.tolist() == [takes()[0].silent[5], takes()[1].silent[2]]


def test_rewards_are_those_of_the_table_on_the_same_history(simulator: Simulator, table: RewardTable) -> None:
    start = 6
    acted = np.random.default_rng(4).integers(SIZE, size=8)
    history = np.concatenate([takes()[0].lexemes[:start + 1], acted])
    wanted = table.sequence(torch.as_tensor(history), torch.arange(len(history)))[start + 1:]
    simulator.begin(np.array([0]), np.array([start]), 8)
    got = torch.cat([simulator.step(torch.tensor([action]))[1] for action in acted])
    torch.testing.assert_close(got, wanted)
    other = takes()[0].lexemes[start + 1:start + 9]
    assert not torch.allclose(got, table.sequence(torch.as_tensor(np.concatenate(
        [takes()[0].lexemes[:start + 1], other])), torch.arange(len(history)))[start + 1:])


def test_the_end_of_a_recording_is_terminal_and_the_horizon_truncates(simulator: Simulator) -> None:
    # 4, 5 and 6 are the last blocks of the second recording; the first has far to go.
    simulator.begin(np.array([0, 1, 1]), np.array([0, 3, 2]), 4)
    ends = []
    for _ in range(4):
        seen, reward, terminal = simulator.step(torch.zeros(3, dtype=torch.int64))
        ends.append((terminal.tolist(), seen.live.tolist()))
    no = [False] * 3
    assert ends[:2] == [(no, [True] * 3)] * 2
    assert ends[2] == ([False, True, False], [True, False, True])
    assert ends[3] == ([False, False, True], no), "the horizon ends the first episode, its recording goes on"
    assert reward[1] == 0 and (reward[[0, 2]] != 0).all()
    assert seen.block[0] == 5  # what one bootstraps from
    with pytest.raises(ValueError, match="reset"):
        simulator.step(torch.zeros(3, dtype=torch.int64))


def test_an_episode_begins_where_something_follows(simulator: Simulator) -> None:
    with pytest.raises(ValueError, match="before the last block"):
        simulator.begin(np.array([1]), np.array([6]), 4)
    with pytest.raises(ValueError):
        simulator.reset(np.random.default_rng(0), 2, 0)
    with pytest.raises(ValueError):
        Simulator(takes()[2:], simulator.score, WINDOW)
    starts = torch.unique(simulator.reset(np.random.default_rng(0), 500, 5).block)
    assert starts.tolist() == [*range(1, 16), 21, 22]


def test_what_was_collected_is_laid_out_as_the_data(simulator: Simulator, table: RewardTable) -> None:
    online, offline = (collect(simulator, at_random(0), np.random.default_rng(0), 16, 9),
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


def test_who_acts_is_shown_the_history_and_no_more(simulator: Simulator) -> None:
    widths, kept = [], []

    def choose(seen: dict[str, Tensor]) -> Tensor:
        widths.append({key: value.shape for key, value in seen.items()})
        kept.append(seen["previous"])
        return torch.full((3,), len(widths) % SIZE)

    batch = collect(simulator, choose, np.random.default_rng(0), 3, 4)
    assert [width["block"] for width in widths] == [(3, i) for i in range(1, 5)]
    assert all(width["speaker"] == (3,) for width in widths)
    assert torch.equal(kept[-1], batch["previous"][:, :4])


def test_the_ring_gives_the_layout_of_the_data(simulator: Simulator, table: RewardTable) -> None:
    memory = Replay(10)
    memory.add(collect(simulator, at_random(0), np.random.default_rng(0), 4, 6))
    memory.add(data(table).windows(np.random.default_rng(0), 4, 6))  # either may go in
    drawn, offline = memory.windows(np.random.default_rng(1), 7), data(table).windows(np.random.default_rng(1), 7, 6)
    assert {key: (value.dtype, value.shape) for key, value in drawn.items()} == {
        key: (value.dtype, value.shape) for key, value in offline.items()}
    again = memory.windows(np.random.default_rng(1), 7)
    assert all(torch.equal(drawn[key], again[key]) for key in drawn)
    with pytest.raises(ValueError, match="another layout"):
        memory.add(data(table).windows(np.random.default_rng(0), 4, 5))
