"""Interpreters as policies: every quantity by hand, the policies on stand-ins, the whole table on random networks."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from untrained import PLAIN, untrained

from data_module.errors import InputError
from data_module.layers import freeze
from data_module.motion.skeletons import CHARACTER, from_vector
from data_module.store import Store
from data_module.types import Motion
from eval import policies
from eval.figures import Clip
from eval.metrics import gesture_features
from eval.policies import Anything, Ground, Policy, Told
from gesticulator import bundle as bundles
from gesticulator.prepare import prepare
from gesticulator.racer import block_audio
from interpreters.cql import QConfig, QNetwork
from interpreters.episodes import Take
from interpreters.reward import RewardConfig, RewardModel, RewardTable

SIZE = 4


# ------------------------------------------------------------------------------------------------------- quantities

def test_the_return_is_the_mean_over_all_windows() -> None:
    rewards = np.array([1.0, 2.0, 3.0, 4.0])
    assert policies.episode_return(rewards, 2) == pytest.approx((3 + 5 + 7) / 3)
    assert policies.episode_return(rewards, 4) == 10.0
    assert math.isnan(policies.episode_return(rewards, 5))
    assert policies.episode_return(np.full(40, 0.5)) == 7.5, "15 steps"


def test_regret_asks_for_the_best_that_was_allowed() -> None:
    rewards = np.array([[0.1, 0.5, 0.9], [0.2, 0.0, 0.4]])
    allowed = np.array([[True, True, False], [True, True, True]])
    assert policies.regret(rewards, np.array([1, 0]), allowed) == pytest.approx((0.0 + 0.2) / 2)
    assert policies.regret(rewards, np.array([1, 0]), np.ones((2, 3), bool)) == pytest.approx((0.4 + 0.2) / 2)
    assert policies.regret(rewards, rewards.argmax(1), np.ones((2, 3), bool)) == 0.0


def test_returns_to_go_are_discounted_to_the_end() -> None:
    np.testing.assert_allclose(policies.return_to_go(np.array([1.0, 2.0, 4.0]), 0.5), [3.0, 4.0, 4.0])
    np.testing.assert_allclose(policies.return_to_go(np.ones(200), 0.99)[0], (1 - 0.99 ** 200) / 0.01)


def test_conservative_gaps_by_hand() -> None:
    q = np.array([[0.0, math.log(3.0), 100.0], [2.0, 2.0, 2.0]])
    allowed = np.array([[True, True, False], [True, True, True]])
    nll, gap = policies.conservative_gaps(q, np.array([0, 2]), allowed)
    assert nll == pytest.approx((math.log(4.0) + math.log(3.0)) / 2)
    assert gap == pytest.approx((math.log(3.0) + 0.0) / 2)
    # A number that is added to all values of a state changes neither.
    moved = q + np.array([[7.0], [-3.0]])
    assert policies.conservative_gaps(moved, np.array([0, 2]), allowed) == pytest.approx((nll, gap))


def test_ranks_are_compared_and_not_values() -> None:
    rising = np.array([1.0, 2.0, 3.0, 4.0])
    assert policies.rank_correlation(rising, np.exp(rising)) == pytest.approx(1.0)
    assert policies.rank_correlation(rising, -rising ** 3) == pytest.approx(-1.0)
    # rho = 1 - 6 sum d^2 / (n (n^2 - 1)), d = 0, 1, 1, 0.
    assert policies.rank_correlation(rising, np.array([1.0, 3.0, 2.0, 4.0])) == pytest.approx(1 - 12 / 60)
    assert math.isnan(policies.rank_correlation(rising, np.ones(4)))
    assert math.isnan(policies.rank_correlation(rising[:1], rising[:1]))


def test_silence_counts_silent_blocks_only() -> None:
    lexemes, silent = np.array([0, 1, 2, 2, 3]), np.array([False, True, True, True, False])
    assert policies.silent_share(lexemes, silent, np.array([2, 3])) == pytest.approx(200 / 3)
    assert math.isnan(policies.silent_share(lexemes, np.zeros(5, bool), np.array([2])))


def test_what_is_allowed_is_never_nothing() -> None:
    silent = np.array([False, True])
    assert policies.allowed_lexemes(silent, np.array([1, 3]), SIZE).tolist() == [[True] * 4, [False, True, False, True]]
    assert policies.allowed_lexemes(silent, np.array([], dtype=np.int64), SIZE).all()


def test_differences_of_distances() -> None:
    rng = np.random.default_rng(0)
    real = [rng.normal(size=(30, 3)) for _ in range(5)]
    off = [clip + np.array([3.0, 0.0, 0.0]) for clip in real]
    # Two Gaussians of one covariance: the squared distance of the means. A set against itself: nothing.
    apart = policies.fgd_difference(off, real, real)
    assert apart["mean"] == pytest.approx(9.0) and apart["low"] == pytest.approx(9.0) and apart["clips"] == 5
    same = policies.fgd_difference(off, off, real)
    assert (same["mean"], same["low"], same["high"]) == (0.0, 0.0, 0.0)
    empty = [np.zeros((0, 0)), *off[1:]]
    assert policies.fgd_difference(empty, real, real)["clips"] == 4, "a clip too short for a window is left out"
    assert math.isnan(policies.fgd_difference(off[:1], real[:1], real[:1])["low"])


def moving(fps: float, seconds: float = 3.0) -> Motion:
    t = np.arange(round(seconds * fps)) / fps
    pose = np.zeros((len(t), len(CHARACTER), 3))
    pose[:, CHARACTER.index("RightForeArm"), 1] = np.sin(2 * np.pi * t)
    return from_vector(pose.reshape(len(t), -1), fps)


def test_what_is_measured_of_motion() -> None:
    speed, silent = np.array([[1.0, 3.0], [2.0, 2.0], [0.5, 0.1]]), np.array([False, False, True])
    beats = np.array([0.5, 1.0, 1.5])
    clip = Clip(beats, beats, 3.0, speed, silent, np.zeros(3))
    values = policies.motion_values(clip, moving(60.0), moving(60.0, seconds=4.0), seed=0)
    assert values["speech_speed"] == 2.0 and values["silence_speed"] == pytest.approx(0.3)
    assert values["pmb_above_chance"] == pytest.approx(100.0)
    assert values["maje"] == values["mad"] == 0.0, "the longer one is cut"
    assert policies.motion_values(clip, moving(60.0), moving(30.0), seed=0)["maje"] < 5.0, "one rate for both"
    still = dataclasses.replace(moving(60.0), rotations=np.repeat(moving(60.0).rotations[:1], 180, axis=0))
    assert policies.motion_values(clip, still, moving(60.0), seed=0)["maje"] > 1.0
    nobody = dataclasses.replace(clip, silent=np.zeros(3, bool))
    assert math.isnan(policies.motion_values(nobody, moving(60.0), moving(60.0), seed=0)["silence_speed"])


# --------------------------------------------------------------------------------------------------------- policies

def ground(lexemes: list[int], silent: list[int] | None = None) -> Ground:
    """One recording with these lexemes, silent at these blocks; lexemes 2 and 3 are silent ones."""
    count = len(lexemes)
    quiet = np.isin(np.arange(count), silent or [])
    corpus = SimpleNamespace(low=torch.zeros(count, 3, 1), high=torch.zeros(count, 3, 1), silent=quiet)
    take = Take(5, 0, np.arange(count), np.array(lexemes), quiet)
    return Ground(corpus, [take], np.array([2, 3]), True, SIZE)  # type: ignore[arg-type]


class Next:
    """The number after the previous lexeme's, and the silence of the block where it is asked to tell."""

    def start(self, speaker: int, first_lexeme: int) -> list[int]:
        return [first_lexeme]

    def step(self, state: list[int], features: Any, previous_lexeme: int) -> tuple[np.ndarray, list[int]]:
        scores = np.zeros(SIZE)
        scores[(previous_lexeme + 1) % SIZE] = 1.0
        return scores, [*state, previous_lexeme]


def test_a_policy_lives_on_its_own_past_or_on_the_performers() -> None:
    own = ground([0, 0, 3, 1, 1])
    free, scores = policies.walk(Policy(Next()), own, own.takes[0])
    assert free.tolist() == [0, 1, 2, 3, 0] and scores.argmax(1).tolist() == [1, 2, 3, 0]
    forced, _ = policies.walk(Policy(Next()), own, own.takes[0], teacher=True)
    assert forced.tolist() == [0, 1, 1, 0, 2], "each after the performer's"
    assert own.takes[0].lexemes.tolist() == [0, 0, 3, 1, 1]


def test_silence_leaves_silent_lexemes() -> None:
    own = ground([0, 0, 3, 1, 1], silent=[1, 4])
    free, _ = policies.walk(Policy(Next()), own, own.takes[0])
    assert free.tolist() == [0, 2, 3, 0, 2]
    unmasked = dataclasses.replace(own, masked=False)
    assert policies.walk(Policy(Next()), unmasked, own.takes[0])[0].tolist() == [0, 1, 2, 3, 0]


def test_draws_repeat_and_differ_between_recordings() -> None:
    own = ground([0] * 60, silent=list(range(30, 60)))
    policy = Policy(Anything(SIZE), 1.0)
    first, again = (policies.walk(policy, own, own.takes[0])[0] for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert set(first[:30]) == {0, 1, 2, 3} and set(first[30:]) == {2, 3}
    other = dataclasses.replace(own.takes[0], recording=6)
    assert not np.array_equal(first, policies.walk(policy, own, other)[0])


def test_what_is_told_is_played_in_turn() -> None:
    told = Told([np.array([3, 1]), np.array([2])], SIZE)
    state = told.start(0, 0)
    played = []
    for _ in range(2):
        scores, state = told.step(state, None, 0)  # type: ignore[arg-type]
        played.append(int(scores.argmax()))
    scores, _ = told.step(told.start(0, 0), None, 0)  # type: ignore[arg-type]
    assert [*played, int(scores.argmax())] == [3, 1, 2]


def reward_of(own: Ground, window: int = 3) -> RewardTable:
    torch.manual_seed(0)
    count = len(own.takes[0].blocks)
    model = RewardModel(RewardConfig(width=8, projection=4, window=window, dropout=0.0), 2, 3, 2)
    return RewardTable(freeze(model), torch.randn(count, 2, 2), torch.zeros(count), torch.randn(SIZE, 2, 3))  # type: ignore[arg-type]


def test_greedy_has_no_regret_and_forced_greedy_is_the_best_after_the_performer() -> None:
    own = ground([0, 1, 2, 3, 3, 1, 0, 2], silent=[3, 4])
    rewards, take = reward_of(own), own.takes[0]
    best = policies.greedy(rewards, own, take)
    each, allowed = policies.every_reward(rewards, take, best), own.allowed(take)[1:]
    assert policies.regret(each, best[1:], allowed) == pytest.approx(0.0, abs=1e-6)
    assert best[0] == 0 and set(best[3:5]) <= {2, 3}
    for lexemes in (take.lexemes, policies.walk(Policy(Next()), own, take)[0]):
        assert policies.regret(policies.every_reward(rewards, take, lexemes), lexemes[1:], allowed) > 0.01
    forced = policies.greedy(rewards, own, take, teacher=True)
    expected = np.where(allowed, policies.every_reward(rewards, take, take.lexemes), -np.inf).argmax(1)
    assert forced[1:].tolist() == expected.tolist()


class ByTable:
    """An lstm whose probabilities are those of a table [S, S], by the lexeme before."""

    speakers = 1

    def __init__(self, table: np.ndarray) -> None:
        self.table = torch.as_tensor(table).log()

    def scores(self, previous: Tensor, audio: Tensor, speaker: Tensor) -> tuple[Tensor, None]:
        assert audio.shape[:2] == previous.shape and speaker.shape == (1, 1)
        return self.table[previous], None


def test_the_behaviour_is_that_of_the_lstm_among_what_is_allowed() -> None:
    table = np.array([[0.1, 0.2, 0.3, 0.4], [0.005, 0.595, 0.3, 0.1], [0.25] * 4, [0.25] * 4])
    own = ground([0, 1, 0, 2], silent=[3])
    got = policies.behaviour(ByTable(table), own, own.takes[0], own.takes[0].lexemes)  # type: ignore[arg-type]
    np.testing.assert_allclose(got, [0.2, 0.005, 0.3 / 0.7])
    assert (got < policies.RARE).tolist() == [False, True, False]


def test_values_of_a_take_by_hand() -> None:
    own = ground([0, 1, 0, 2], silent=[3])
    chosen = policies.Chosen([np.array([0, 1, 1, 2])], [np.array([0, 1, 3, 3])])
    table = np.array([[0.1, 0.2, 0.3, 0.4], [0.8, 0.001, 0.199, 0.0], [0.25] * 4, [0.25] * 4])
    values = policies.lexeme_values(chosen, 0, own, {"": reward_of(own)}, ByTable(table),  # type: ignore[arg-type]
                                    [np.array([0, 1, 2])])
    assert values["free_running"] == pytest.approx(200 / 3) and values["teacher_forced"] == pytest.approx(100 / 3)
    assert values["diversity"] == pytest.approx(-(2 / 3 * math.log(2 / 3) + 1 / 3 * math.log(1 / 3)))
    assert values["longest_run"] == 2 and values["distinct_2"] == 1.0
    assert values["rare"] == pytest.approx(100 / 3), "1 after 1"
    assert values["unseen_bigrams"] == pytest.approx(100 / 3), "1 1 was never seen"
    assert values["silent"] == 100.0
    each = policies.every_reward(reward_of(own), own.takes[0], chosen.free[0])
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
    own = ground([0, 1, 2, 3, 0, 1, 2, 3])  # what the policy does too
    rewards, take = reward_of(own), own.takes[0]
    got = policies.taken(policies.every_reward(rewards, take, take.lexemes), take.lexemes[1:])
    returns = policies.return_to_go(got, 0.9)
    for more in (0.0, 2.5):
        q = policies.q_values(Policy(Knows(returns, more)), own, take, rewards, 0.9)
        assert q["calibration"] == pytest.approx(more) and q["spearman"] == pytest.approx(1.0)
        assert q["gap"] == pytest.approx(0.0) and q["nll"] == pytest.approx(math.log(math.e + 3) - 1)


# -------------------------------------------------------------------------------------------------------- the table

def test_means_over_blocks_and_over_recordings() -> None:
    def row(*values: float) -> dict[str, np.ndarray]:
        return {key: np.array(values) for key in policies.COLUMNS}

    rows = {"lstm": row(0.0, 10.0), "statistical": row(0.0, 0.0), "cql": row(4.0, 14.0)}
    result = policies.compared(rows, [1, 3])
    assert list(result["differences"]) == ["cql - lstm", "cql - statistical"]
    for key, column in policies.COLUMNS.items():
        assert result["rows"]["lstm"][key]["mean"] == (7.5 if column.by_blocks else 5.0)
        apart = result["differences"]["cql - lstm"][key]
        assert (apart["low"], apart["mean"], apart["high"]) == (4.0, 4.0, 4.0), "paired"


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("policies")


@pytest.fixture(scope="module")
def bundle(tiny_store: Path, work: Path) -> bundles.Bundle:
    """A bundle of the store's performers that nobody trained, reward models and Q-network included."""
    own = untrained(*PLAIN, "selection.temperature=0.7")
    store = Store.open(tiny_store)
    corpus = prepare(store, own.config, work, progress=False)
    names, frames, audio = corpus.statistics.speakers, own.config.rhythm.frames, block_audio(corpus).shape[-1]
    table = next(iter(own.inventory.frequencies.values()))
    reward, judge = (RewardModel(RewardConfig(width=16, projection=8), frames, corpus.motion.shape[-1], audio)
                     for _ in range(2))
    network = QNetwork(QConfig(width=16, heads=2, layers=1, audio_features=4, audio_bottleneck=4), frames,
                       corpus.high.shape[-1], len(own.lexicon.vectors), len(names), own.silent.tolist())
    for module in (reward, judge, network):
        freeze(module)
    return dataclasses.replace(own, statistics=corpus.statistics, inventory=dataclasses.replace(
        own.inventory, frequencies=dict.fromkeys(names, table)), q_network=network, reward=reward, reward_judge=judge)


def test_the_table_of_a_bundle_with_random_networks(tiny_store: Path, bundle: bundles.Bundle, work: Path) -> None:
    by = [gesture_features.RawFeatures(frames, count=1) for frames in (10, 20)]
    result = policies.policies(Store.open(tiny_store), bundle, work, by, limit=2, progress=False)
    rows = result["rows"]
    assert list(rows) == ["performer", "lstm", "lstm arg max", "statistical", "cql", "commonest", "random", "greedy"]
    assert all(set(row) == set(policies.COLUMNS) for row in rows.values())
    assert rows["performer"]["free_running"]["mean"] == rows["performer"]["teacher_forced"]["mean"] == 100.0
    assert rows["greedy"]["regret"]["mean"] == pytest.approx(0.0, abs=1e-5)
    assert rows["greedy"]["judge_regret"]["mean"] > 0 < rows["random"]["regret"]["mean"]
    assert rows["commonest"]["diversity"]["mean"] < rows["random"]["diversity"]["mean"]
    assert all(row["silent"]["mean"] == 100.0 for row in rows.values())
    assert rows["lstm"]["diversity"] != rows["lstm arg max"]["diversity"], "one draws"
    assert len({row["maje"]["mean"] for row in rows.values()}) == len(rows), "other lexemes, other motion"
    apart = result["differences"]["cql - lstm"]["cosine"]["mean"]
    assert apart == pytest.approx(rows["cql"]["cosine"]["mean"] - rows["lstm"]["cosine"]["mean"])
    assert set(result["q_network"]) == set(policies.Q_COLUMNS)
    assert result["q_network"]["nll"]["mean"] >= result["q_network"]["gap"]["mean"] >= 0
    assert len(result["fgd"]) == 2
    for own in result["fgd"].values():
        assert list(own["rows"]) == list(rows)
        assert own["differences"]["cql - lstm"]["mean"] == pytest.approx(
            own["rows"]["cql"]["distance"] - own["rows"]["lstm"]["distance"])
    text = policies.markdown(json.loads(json.dumps(result)))
    assert text.count("| cql - statistical |") == 6 and "| Spearman of Q" in text


def test_the_command(tiny_store: Path, bundle: bundles.Bundle, work: Path, tmp_path: Path,
                     monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(policies, "networks", lambda store, work: [])
    monkeypatch.setattr(bundles, "load", lambda path: bundle)
    out = tmp_path / "policies.json"
    told = ["--data", str(tiny_store), "--work", str(work), "--out", str(out)]
    assert policies.main([*told, "--limit", "1"]) == 0
    assert json.loads(out.read_text())["store"]["test_recordings"] == 1
    assert "| greedy |" in out.with_suffix(".md").read_text()
    with pytest.raises(SystemExit):
        policies.main([*told, "--limit", "0"])


@pytest.mark.parametrize("lacking", ["q_network", "reward", "reward_judge", "interpreter"])
def test_what_lacks_a_part_is_refused(tiny_store: Path, bundle: bundles.Bundle, work: Path, lacking: str) -> None:
    with pytest.raises(InputError, match="Q-network"):
        policies.policies(Store.open(tiny_store), dataclasses.replace(bundle, **{lacking: None}), work, [],
                          progress=False)


def test_networks_of_the_distance_are_trained_once(tiny_store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                                                   ) -> None:
    trained = []

    def train(store: Store, folder: Path, config: gesture_features.AutoencoderConfig, progress: bool
              ) -> gesture_features.Autoencoder:
        trained.append(config.frames)
        network = gesture_features.Autoencoder(config)
        network.standardise(np.random.default_rng(0).normal(size=(5, config.frames, gesture_features.DIRECTIONS)))
        return network

    monkeypatch.setattr(gesture_features, "train", train)
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    first, again = (policies.networks(Store.open(tiny_store), tmp_path, progress=False) for _ in range(2))
    assert trained == [34, 60] == [one.frames for one in first]
    assert [one.sha256 for one in first] == [one.sha256 for one in again]


def test_the_papers_network_is_taken_where_it_is(outside_data: Path, tiny_store: Path, tmp_path: Path,
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(policies, "FGD_FRAMES", ())
    assert [one.frames for one in policies.networks(Store.open(tiny_store), tmp_path, progress=False)] == [34]
