"""Interpreters as policies: every quantity by hand, the policies on stand-ins."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from data_module.layers import freeze
from eval.ablate import policy
from eval.ablate.policy import Decisions, Policy, PolicyJudge
from eval.baselines.interpreters import Random, ReplayInterpreter
from interpreters.episodes import Demonstration
from interpreters.lstm import LstmConfig
from interpreters.reward import RewardConfig, RewardModel
from interpreters.reward_table import RewardTable

SIZE = 4


# ------------------------------------------------------------------------------------------------------- quantities

def test_the_return_is_the_mean_over_all_windows() -> None:
    rewards = np.array([1.0, 2.0, 3.0, 4.0])
    assert policy.episode_return(rewards, 2) == pytest.approx((3 + 5 + 7) / 3)
    assert policy.episode_return(rewards, 4) == 10.0
    assert math.isnan(policy.episode_return(rewards, 5))
    assert policy.episode_return(np.full(40, 0.5)) == 7.5, "15 steps"


def test_regret_asks_for_the_best_that_was_allowed() -> None:
    rewards = np.array([[0.1, 0.5, 0.9], [0.2, 0.0, 0.4]])
    allowed = np.array([[True, True, False], [True, True, True]])
    assert policy.regret(rewards, np.array([1, 0]), allowed) == pytest.approx((0.0 + 0.2) / 2)
    assert policy.regret(rewards, np.array([1, 0]), np.ones((2, 3), bool)) == pytest.approx((0.4 + 0.2) / 2)
    assert policy.regret(rewards, rewards.argmax(1), np.ones((2, 3), bool)) == 0.0


def test_returns_to_go_are_discounted_to_the_end() -> None:
    np.testing.assert_allclose(policy.return_to_go(np.array([1.0, 2.0, 4.0]), 0.5), [3.0, 4.0, 4.0])
    np.testing.assert_allclose(policy.return_to_go(np.ones(200), 0.99)[0], (1 - 0.99 ** 200) / 0.01)


def test_conservative_gaps_by_hand() -> None:
    q = np.array([[0.0, math.log(3.0), 100.0], [2.0, 2.0, 2.0]])
    allowed = np.array([[True, True, False], [True, True, True]])
    nll, gap = policy.conservative_gaps(q, np.array([0, 2]), allowed)
    assert nll == pytest.approx((math.log(4.0) + math.log(3.0)) / 2)
    assert gap == pytest.approx((math.log(3.0) + 0.0) / 2)
    # A number that is added to all values of a state changes neither.
    moved = q + np.array([[7.0], [-3.0]])
    assert policy.conservative_gaps(moved, np.array([0, 2]), allowed) == pytest.approx((nll, gap))


def test_ranks_are_compared_and_not_values() -> None:
    rising = np.array([1.0, 2.0, 3.0, 4.0])
    assert policy.rank_correlation(rising, np.exp(rising)) == pytest.approx(1.0)
    assert policy.rank_correlation(rising, -rising ** 3) == pytest.approx(-1.0)
    # rho = 1 - 6 sum d^2 / (n (n^2 - 1)), d = 0, 1, 1, 0.
    assert policy.rank_correlation(rising, np.array([1.0, 3.0, 2.0, 4.0])) == pytest.approx(1 - 12 / 60)
    assert math.isnan(policy.rank_correlation(rising, np.ones(4)))
    assert math.isnan(policy.rank_correlation(rising[:1], rising[:1]))


def test_silence_counts_silent_blocks_only() -> None:
    lexemes, silent = np.array([0, 1, 2, 2, 3]), np.array([False, True, True, True, False])
    assert policy.silent_share(lexemes, silent, np.array([2, 3])) == pytest.approx(200 / 3)
    assert math.isnan(policy.silent_share(lexemes, np.zeros(5, bool), np.array([2])))


def test_what_is_allowed_is_never_nothing() -> None:
    silent = np.array([False, True])
    assert policy.allowed_lexemes(silent, np.array([1, 3]), SIZE).tolist() == [[True] * 4, [False, True, False, True]]
    assert policy.allowed_lexemes(silent, np.array([], dtype=np.int64), SIZE).all()


# --------------------------------------------------------------------------------------------------------- policies

def decisions(lexemes: list[int], silent: list[int] | None = None) -> Decisions:
    """One recording with these lexemes, silent at these blocks; lexemes 2 and 3 are silent ones."""
    count = len(lexemes)
    quiet = np.isin(np.arange(count), silent or [])
    corpus = SimpleNamespace(
        low=torch.zeros(count, 3, 1), high=torch.zeros(count, 3, 1), silent=quiet, recording=np.zeros(count, int),
        speaker_of=np.zeros(1, int), before=lambda blocks: (torch.zeros(len(blocks), 3, 1), torch.ones(len(blocks), 2)))
    take = Demonstration(5, 0, np.arange(count), np.array(lexemes), quiet)
    return Decisions(corpus, [take], np.array([2, 3]), True, SIZE)  # type: ignore[arg-type]


class Next:
    """The number after the previous lexeme's, and the silence of the block where it is asked to tell."""

    def start(self, speaker: int, first_lexeme: int) -> list[int]:
        return [first_lexeme]

    def step(self, state: list[int], features: Any, previous_lexeme: int) -> tuple[np.ndarray, list[int]]:
        scores = np.zeros(SIZE)
        scores[(previous_lexeme + 1) % SIZE] = 1.0
        return scores, [*state, previous_lexeme]


def test_a_policy_lives_on_its_own_past_or_on_the_performers() -> None:
    own = decisions([0, 0, 3, 1, 1])
    free, scores = policy.walk(Policy(Next()), own, own.takes[0])
    assert free.tolist() == [0, 1, 2, 3, 0] and scores.argmax(1).tolist() == [1, 2, 3, 0]
    forced, _ = policy.walk(Policy(Next()), own, own.takes[0], teacher=True)
    assert forced.tolist() == [0, 1, 1, 0, 2], "each after the performer's"
    assert own.takes[0].lexemes.tolist() == [0, 0, 3, 1, 1]


def test_silence_leaves_silent_lexemes() -> None:
    own = decisions([0, 0, 3, 1, 1], silent=[1, 4])
    free, _ = policy.walk(Policy(Next()), own, own.takes[0])
    assert free.tolist() == [0, 2, 3, 0, 2]
    unmasked = dataclasses.replace(own, masked=False)
    assert policy.walk(Policy(Next()), unmasked, own.takes[0])[0].tolist() == [0, 1, 2, 3, 0]


def test_draws_repeat_and_differ_between_recordings() -> None:
    own = decisions([0] * 60, silent=list(range(30, 60)))
    chooser = Policy(Random(SIZE), 1.0)
    first, again = (policy.walk(chooser, own, own.takes[0])[0] for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert set(first[:30]) == {0, 1, 2, 3} and set(first[30:]) == {2, 3}
    other = dataclasses.replace(own.takes[0], recording=6)
    assert not np.array_equal(first, policy.walk(chooser, own, other)[0])


def test_what_is_told_is_played_in_turn() -> None:
    told = ReplayInterpreter([np.array([3, 1]), np.array([2])], SIZE)
    state = told.start(0, 0)
    played = []
    for _ in range(2):
        scores, state = told.step(state, None, 0)  # type: ignore[arg-type]
        played.append(int(scores.argmax()))
    scores, _ = told.step(told.start(0, 0), None, 0)  # type: ignore[arg-type]
    assert [*played, int(scores.argmax())] == [3, 1, 2]


def reward_of(own: Decisions, window: int = 3) -> RewardTable:
    torch.manual_seed(0)
    count = len(own.takes[0].blocks)
    model = RewardModel(RewardConfig(width=8, projection=4, window=window, dropout=0.0), 2, 3, 2)
    return RewardTable(freeze(model), torch.randn(count, 2, 2), torch.zeros(count), torch.randn(SIZE, 2, 3))  # type: ignore[arg-type]


class ByTable:
    """An lstm whose probabilities are those of a table [S, S], by the lexeme before."""

    config = LstmConfig()
    speakers = 1

    def __init__(self, table: np.ndarray) -> None:
        self.table = torch.as_tensor(table).log()

    def scores(self, previous: Tensor, audio: Tensor, speaker: Tensor, hidden: None = None, text: None = None,
               pose: None = None) -> tuple[Tensor, None]:
        assert audio.shape[:2] == previous.shape and speaker.shape == (1, 1)
        return self.table[previous], None


def test_the_behaviour_is_that_of_the_lstm_among_what_is_allowed() -> None:
    table = np.array([[0.1, 0.2, 0.3, 0.4], [0.005, 0.595, 0.3, 0.1], [0.25] * 4, [0.25] * 4])
    own = decisions([0, 1, 0, 2], silent=[3])
    got = policy.behaviour(ByTable(table), own, own.takes[0], own.takes[0].lexemes)  # type: ignore[arg-type]
    np.testing.assert_allclose(got, [0.2, 0.005, 0.3 / 0.7])
    assert (got < policy.RARE).tolist() == [False, True, False]


def test_values_of_a_take_by_hand() -> None:
    own = decisions([0, 1, 0, 2], silent=[3])
    free, forced = np.array([0, 1, 1, 2]), np.array([0, 1, 3, 3])
    table = np.array([[0.1, 0.2, 0.3, 0.4], [0.8, 0.001, 0.199, 0.0], [0.25] * 4, [0.25] * 4])
    judge = PolicyJudge(own, {"": reward_of(own)}, ByTable(table), [np.array([0, 1, 2])])  # type: ignore[arg-type]
    values = judge.lexeme_values(own.takes[0], free, forced)
    assert values["accuracy"] == pytest.approx(200 / 3) and values["teacher_forced"] == pytest.approx(100 / 3)
    assert values["lexeme_diversity"] == pytest.approx(-(2 / 3 * math.log(2 / 3) + 1 / 3 * math.log(1 / 3)))
    assert values["longest_run"] == 2 and values["distinct_2"] == 1.0
    assert values["rare"] == pytest.approx(100 / 3), "1 after 1"
    assert values["unseen_bigrams"] == pytest.approx(100 / 3), "1 1 was never seen"
    assert values["silent"] == 100.0
    each = policy.every_reward(reward_of(own), own.takes[0], free)
    assert values["cosine"] == pytest.approx(each[[0, 1, 2], [1, 1, 2]].mean()) and math.isnan(values["return"])


class Knows:
    """Q values that are the discounted returns of always moving on by one, plus a constant."""

    def __init__(self, returns: np.ndarray, more: float) -> None:
        self.returns, self.more = returns, more

    def start(self, speaker: int, first_lexeme: int) -> int:
        return 0

    def step(self, state: int, features: Any, previous_lexeme: int) -> tuple[np.ndarray, int]:
        scores = np.full(SIZE, self.returns[state] + self.more - 1.0)
        scores[(previous_lexeme + 1) % SIZE] += 1.0
        return scores, state + 1


def test_values_that_know_the_return_are_calibrated() -> None:
    own = decisions([0, 1, 2, 3, 0, 1, 2, 3])  # what the policy does too
    rewards, take = reward_of(own), own.takes[0]
    got = policy.taken(policy.every_reward(rewards, take, take.lexemes), take.lexemes[1:])
    returns = policy.return_to_go(got, 0.9)
    for more in (0.0, 2.5):
        judge = PolicyJudge(own, {}, None, [])  # type: ignore[arg-type]
        free, forced = (policy.walk(Policy(Knows(returns, more)), own, take, teacher) for teacher in (False, True))
        q = judge.score_values(take, free, forced, rewards, 0.9)
        assert q["calibration"] == pytest.approx(more) and q["spearman"] == pytest.approx(1.0)
        assert q["gap"] == pytest.approx(0.0) and q["nll"] == pytest.approx(math.log(math.e + 3) - 1)
    assert math.isnan(judge.score_values(take, free, forced, None, 0.9)["calibration"]), "logits"


def test_accuracy_of_known_interpreters() -> None:
    own = decisions([0, 1, 2, 3, 0, 0, 2, 3])  # after each lexeme the next one, but for the second 0 and the 2
    right = [1, 1, 1, 1, 0, 0, 1]
    assert policy.accuracy(Next(), own, own.takes[0], teacher=True) == pytest.approx(100 * sum(right) / 7)
    free = [1, 2, 3, 0, 1, 2, 3]
    assert policy.accuracy(Next(), own, own.takes[0], teacher=False) == pytest.approx(
        100 * np.mean(np.array(free) == own.takes[0].lexemes[1:]))
