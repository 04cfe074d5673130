"""Interpreters as policies: every quantity by hand, the policies on stand-ins."""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from data_module.layers import freeze
from eval.ablate import policy
from eval.ablate.policy import Decisions, lexeme_values
from eval.baselines.interpreters import ReplayInterpreter
from interpreters.episodes import Demonstration
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
    assert policy.walk(Next(), own, own.takes[0]).tolist() == [0, 1, 2, 3, 0]
    forced = policy.walk(Next(), own, own.takes[0], teacher=True)
    assert forced.tolist() == [0, 1, 1, 0, 2], "each after the performer's"
    assert own.takes[0].lexemes.tolist() == [0, 0, 3, 1, 1]


def test_silence_leaves_silent_lexemes() -> None:
    own = decisions([0, 0, 3, 1, 1], silent=[1, 4])
    assert policy.walk(Next(), own, own.takes[0]).tolist() == [0, 2, 3, 0, 2]
    free = [[True] * SIZE] * 5
    assert own.allowed(own.takes[0]).tolist() == [*free[:1], [False, False, True, True], *free[:2],
                                                  [False, False, True, True]]
    assert dataclasses.replace(own, silent=np.zeros(0, int)).allowed(own.takes[0]).tolist() == free, "never nothing"
    unmasked = dataclasses.replace(own, masked=False)
    assert policy.walk(Next(), unmasked, own.takes[0]).tolist() == [0, 1, 2, 3, 0]


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
    model = RewardModel(RewardConfig(width=8, projection=4, window=window), 2, 3, 2)
    return RewardTable(freeze(model), torch.randn(count, 2, 2), torch.randn(SIZE, 2, 3))  # type: ignore[arg-type]


def test_values_of_a_take_by_hand() -> None:
    one = decisions([0, 1, 0, 2], silent=[3])
    free, reward = np.array([0, 1, 1, 2]), reward_of(one)
    values = lexeme_values(one.takes[0], free, SIZE, {"": reward, "judge_": reward})
    assert values["accuracy"] == pytest.approx(200 / 3) and values["longest_run"] == 2
    assert values["lexeme_diversity"] == pytest.approx(-(2 / 3 * math.log(2 / 3) + 1 / 3 * math.log(1 / 3)))
    assert math.isnan(values["return"]), "three decisions are no episode"
    long = decisions([0, 1] * 8)
    each = reward_of(long).sequence_every(torch.as_tensor(long.takes[0].lexemes), torch.arange(16))[1:].numpy()
    values = lexeme_values(long.takes[0], long.takes[0].lexemes, SIZE, {"": reward_of(long)})
    assert values["return"] == pytest.approx(each[np.arange(15), [1, 0] * 7 + [1]].sum()) and values["accuracy"] == 100


def test_accuracy_of_known_interpreters() -> None:
    own = decisions([0, 1, 2, 3, 0, 0, 2, 3])  # after each lexeme the next one, but for the second 0 and the 2
    right = [1, 1, 1, 1, 0, 0, 1]
    assert policy.accuracy(Next(), own, own.takes[0], teacher=True) == pytest.approx(100 * sum(right) / 7)
    free = [1, 2, 3, 0, 1, 2, 3]
    assert policy.accuracy(Next(), own, own.takes[0], teacher=False) == pytest.approx(
        100 * np.mean(np.array(free) == own.takes[0].lexemes[1:]))
