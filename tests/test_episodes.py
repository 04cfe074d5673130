"""The offline data set of the Q-network: who acted, what it earned, and the windows that are cut from it."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from interpreters.base import BlockFeatures, LexemeInterpreter, Scores
from interpreters.episodes import (
    BEHAVIOURS,
    BehaviourPolicies,
    Demonstration,
    EpisodeConfig,
    Episodes,
    SilentLexemes,
    _episode,
    build,
    distance_rewards,
    looked_up,
    perturbed_chances,
)
from interpreters.reward import RewardConfig, RewardModel
from interpreters.reward_table import RewardTable
from interpreters.statistical import StatisticalInterpreter

SIZE = 6
SILENT = SilentLexemes(np.array([0, 3]), np.array([0, 0, 3, 3, 3, 0]))
VECTORS = np.arange(SIZE, dtype=np.float64)[:, None] ** 1.1
TRUTH, SAMPLED, STATISTICAL, PERTURBED = range(4)
LITERAL = EpisodeConfig(truth=1.0, sampled=0.0, statistical=0.0, perturbed=0.0)


class Scripted:
    """Always the same scores, whatever it hears; it remembers what it was told of the past."""

    def __init__(self, scores: Scores) -> None:
        self.scores = scores
        self.told: list[list[int]] = []

    def start(self, speaker: int, first_lexeme: int) -> list[int]:
        self.told.append([])
        return self.told[-1]

    def step(self, state: list[int], features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, list[int]]:
        state.append(previous_lexeme)
        return self.scores, state


def takes(lengths: tuple[int, ...] = (40, 31, 55), seed: int = 0) -> list[Demonstration]:
    rng = np.random.default_rng(seed)
    begins = np.cumsum(lengths) - lengths
    return [Demonstration(number, number % 2, np.arange(begin, begin + length), rng.integers(SIZE, size=length),
                 rng.random(length) < 0.3)
            for number, (begin, length) in enumerate(zip(begins, lengths, strict=True))]


def features(block: int) -> BlockFeatures:
    return BlockFeatures(np.full((3, 2), float(block), np.float32), np.zeros((3, 2), np.float32))


def earned(lexemes: Tensor, blocks: Tensor) -> Tensor:
    """Every step earns its block number plus a hundredth of its lexeme: windows are told apart by it."""
    return blocks + lexemes / 100


def behaving() -> dict[str, LexemeInterpreter]:
    rng = np.random.default_rng(1)
    moves = rng.random((SIZE, SIZE))
    return {"sampled": Scripted(np.log([0.05, 0.15, 0.2, 0.1, 0.3, 0.2])),
            "statistical": StatisticalInterpreter(np.full((2, SIZE), 1 / SIZE), moves / moves.sum(1, keepdims=True))}


def made(config: EpisodeConfig | None = None, *, seed: int = 0, silent: SilentLexemes = SILENT,
         of: list[Demonstration] | None = None) -> Episodes:
    return build(takes() if of is None else of, config or EpisodeConfig(), earned, silent=silent, vectors=VECTORS,
                 policies=BehaviourPolicies(behaving(), features), seed=seed)


def joined(episodes: Episodes, name: str) -> NDArray:
    return np.concatenate([getattr(episode, name) for episode in episodes.episodes])


def own_kind(data: Episodes) -> list[int]:
    return [int(episode.behaviour[-1]) for episode in data.episodes]


# Who acts

def test_the_shares_of_the_mixture_are_those_asked_for() -> None:
    config = EpisodeConfig()
    counts = np.zeros(4)
    for episode, kind in zip((data := made(config)).episodes, own_kind(data), strict=True):
        counts[kind] += len(episode.blocks) - (1 if kind == TRUTH else config.prefix)
    total = sum(len(take.blocks) - 1 for take in takes()) / config.truth
    for name, count in zip(BEHAVIOURS, counts, strict=True):
        assert abs(count - config.shares[name] * total) <= 0.5 + 1e-9, name


def test_the_literal_paper_is_the_ground_truth_only() -> None:
    data = build(takes(), LITERAL, earned, silent=SILENT, vectors=VECTORS)
    assert len(data) == 3 and (joined(data, "behaviour") == TRUTH).all()
    expected = np.concatenate([SILENT.relabel(take) for take in takes()])
    np.testing.assert_array_equal(joined(data, "actions"), expected)


def test_the_same_seed_gives_the_same_actions_and_another_seed_others() -> None:
    one, same, other = (np.concatenate([episode.actions for episode in made(seed=seed).episodes]) for seed in (3, 3, 4))
    assert np.array_equal(one, same) and not np.array_equal(one, other)


def test_a_share_that_changes_leaves_the_other_behaviours_as_they_were() -> None:
    one, other = made(), made(EpisodeConfig(sampled=0.0, statistical=0.25))
    pick = [[e for e, kind in zip(data.episodes, own_kind(data), strict=True) if kind == PERTURBED]
            for data in (one, other)]
    assert len(pick[0]) == len(pick[1]) > 0
    np.testing.assert_array_equal(pick[0][0].actions, pick[1][0].actions)


@pytest.mark.parametrize("prefix", [1, 8])
def test_the_prefix_is_kept_true(prefix: int) -> None:
    data = made(EpisodeConfig(truth=0.25, sampled=0.25, statistical=0.25, perturbed=0.25, prefix=prefix))
    assert set(own_kind(data)) == {0, 1, 2, 3}
    changed = 0
    for episode in data.episodes:
        true = SILENT.relabel(takes()[episode.recording])[:len(episode.actions)]
        np.testing.assert_array_equal(episode.actions[:prefix], true[:prefix])
        assert (episode.behaviour[:prefix] == TRUTH).all()
        changed += int((episode.actions[prefix:] != true[prefix:]).sum())
    assert changed > 20


def test_silent_blocks_hold_silent_lexemes_whoever_acts() -> None:
    data = made(EpisodeConfig(truth=0.25, sampled=0.25, statistical=0.25, perturbed=0.25))
    for kind in range(4):
        own = [episode for episode, k in zip(data.episodes, own_kind(data), strict=True) if k == kind]
        silent = np.concatenate([episode.silent for episode in own])
        actions = np.concatenate([episode.actions for episode in own])
        assert silent.any() and np.isin(actions[silent], SILENT.indices).all(), BEHAVIOURS[kind]
        assert not np.isin(actions[~silent], SILENT.indices).all(), BEHAVIOURS[kind]


def test_the_draws_follow_that_probability() -> None:
    data = made(EpisodeConfig(truth=0.02, sampled=0.98, statistical=0.0, perturbed=0.0))
    own = (joined(data, "behaviour") == SAMPLED) & ~joined(data, "silent")
    shares = np.bincount(joined(data, "actions")[own], minlength=SIZE) / own.sum()
    np.testing.assert_allclose(shares, [0.05, 0.15, 0.2, 0.1, 0.3, 0.2], atol=0.03)


def test_a_behaviour_hears_its_own_past() -> None:
    system = Scripted(np.zeros(SIZE))
    data = build(takes(), EpisodeConfig(truth=0.5, sampled=0.5, statistical=0, perturbed=0), earned, silent=SILENT,
                 vectors=VECTORS, policies=BehaviourPolicies({"sampled": system}, features))
    rolled = [episode for episode, kind in zip(data.episodes, own_kind(data), strict=True) if kind == SAMPLED]
    assert [list(episode.actions[:-1]) for episode in rolled] == system.told


def test_a_share_without_its_interpreter_is_refused() -> None:
    with pytest.raises(ValueError, match="sampled"):
        build(takes(), EpisodeConfig(), earned, silent=SILENT, vectors=VECTORS)


def test_a_prefix_longer_than_every_recording_is_refused() -> None:
    with pytest.raises(InputError, match="prefix"):
        made(EpisodeConfig(prefix=60))


# Perturbation

ORDER = np.array([np.argsort(np.abs(VECTORS[:, 0] - own), kind="stable") for own in VECTORS[:, 0]])


def test_a_replaced_lexeme_is_a_near_one_or_any() -> None:
    # 5 is the last on the line: 4, 3 and 2 are its nearest three. One lexeme in five is replaced.
    chances = perturbed_chances(5, ORDER, None)
    np.testing.assert_allclose(chances, [0.02, 0.02, *[0.02 + 0.1 / 3] * 3, 0.8])
    # in silence the nearest are among the silent, and the truth stays possible
    np.testing.assert_allclose(perturbed_chances(3, ORDER, SILENT.indices), [0.2, 0, 0, 0.8, 0, 0])
    np.testing.assert_allclose(perturbed_chances(3, ORDER, np.array([3])), np.eye(SIZE)[3])


# Rewards

def test_a_reward_table_serves_as_it_is() -> None:
    torch.manual_seed(0)
    model = RewardModel(RewardConfig(width=8, projection=4, window=4), 3, 5, 2).eval()
    table = RewardTable(model, torch.randn(126, 3, 2), torch.randn(SIZE, 3, 5))
    data = build(takes(), LITERAL, table.sequence, silent=SILENT, vectors=VECTORS)
    episode = data.episodes[1]
    at = torch.arange(6, 10)
    by_hand = table.rewards(torch.as_tensor(episode.actions)[None, at], torch.as_tensor(episode.blocks)[None, at],
                            torch.ones(1, 4, dtype=torch.bool))
    assert episode.reward[9] == pytest.approx(float(by_hand), abs=1e-5)


def test_distance_rewards_by_hand() -> None:
    decoded = torch.tensor([[[0.0, 0.0], [0.0, 0.0]], [[1.0, 2.0], [3.0, 4.0]]])
    true = torch.tensor([[[1.0, 0.0], [0.0, -1.0]], [[1.0, 2.0], [3.0, 0.0]], [[1.0, 2.0], [3.0, 4.0]]])
    table = distance_rewards(decoded, true)
    torch.testing.assert_close(table, torch.tensor([[-0.5, -2.5], [-1.5, -1.0], [-2.5, 0.0]]))
    picked = looked_up(table)(torch.tensor([1, 0]), torch.tensor([2, 1]))
    torch.testing.assert_close(picked, torch.tensor([0.0, -1.5]))


# Windows

def test_windows_fit_together() -> None:
    data = made()
    batch = data.windows(np.random.default_rng(0), 64, 5)
    assert {key: tuple(value.shape) for key, value in batch.items()} == {
        **dict.fromkeys(("block", "previous", "action", "reward", "terminal", "valid", "silent", "behaviour", "cloned"),
                        (64, 6)), "speaker": (64,)}
    torch.testing.assert_close(batch["previous"][:, 1:], batch["action"][:, :-1])
    real = batch["valid"] > 0
    torch.testing.assert_close(batch["reward"][real], (batch["block"] + batch["action"] / 100).float()[real])
    steps = (batch["block"].diff(dim=1) == 1)[real[:, 1:]]
    assert steps.all()


def test_a_cut_is_a_truncation_and_the_end_is_terminal() -> None:
    data = build(takes((12,)), LITERAL, earned, silent=SILENT, vectors=VECTORS)
    batch = data.cut(np.zeros(3, np.int64), np.array([0, 6, 7]), 4)
    expected = torch.zeros(3, 5, dtype=torch.bool)
    expected[2, 3] = True  # blocks 8, 9, 10, 11: the last decision is the last of the recording
    assert torch.equal(batch["terminal"][:, :4], expected[:, :4])
    torch.testing.assert_close(batch["valid"], torch.tensor([[1.0] * 5, [1.0] * 5, [1.0] * 4 + [0.0]]))
    assert batch["block"][0].tolist() == [1, 2, 3, 4, 5] and batch["block"][2].tolist() == [8, 9, 10, 11, 11]
    take = takes((12,))[0]
    assert not _episode(take, take.lexemes[:11], 0, LITERAL, earned).terminal.any(), "the recording goes on"
    # Block 11 in the second window stands where one bootstraps from; whoever looks past it stops there.
    assert batch["terminal"][1].tolist() == [False, False, False, False, True]


def test_padding_stands_at_the_end_and_holds_nothing() -> None:
    data = build(takes((3,)), LITERAL, earned, silent=SILENT, vectors=VECTORS)
    batch = data.windows(np.random.default_rng(0), 2, 6)
    assert batch["valid"][0].tolist() == [1, 1, 0, 0, 0, 0, 0]
    assert batch["terminal"][0].tolist() == [False, True, *[False] * 5]
    for key in ("reward", "cloned"):
        assert (batch[key][:, 2:] == 0).all() and (batch[key][:, :2] != 0).all()


def test_only_the_truth_is_cloned() -> None:
    data = made(EpisodeConfig(truth=0.25, sampled=0.25, statistical=0.25, perturbed=0.25))
    batch = data.windows(np.random.default_rng(0), 200, 5)
    assert torch.equal(batch["cloned"] > 0, (batch["valid"] > 0) & (batch["behaviour"] == TRUTH))


@pytest.mark.parametrize("wrong", [{"truth": 0.9}, {"truth": 0.75, "sampled": -0.1}, {"reward": "applause"},
                                   {"prefix": 0}])
def test_settings_that_make_no_sense_are_refused(wrong: dict) -> None:
    with pytest.raises(InputError, match="episodes"):
        EpisodeConfig(**wrong)
