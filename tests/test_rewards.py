"""Does a reward rank: every quantity by hand, rewards whose answer is known, the tables on random models."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from untrained import PLAIN, untrained

from data_module.errors import InputError
from data_module.layers import freeze
from data_module.store import Store
from eval.ablate import rewards
from eval.ablate.rewards import RewardProbe
from eval.commands import ABLATE
from eval.context import EvalContext
from eval.table import load
from gesticulator.bundle import bundle as bundles
from gesticulator.training.stages.corpus import Corpus, prepare
from gesticulator.training.stages.lexicon import token_labels
from gesticulator.training.stages.q_network import takes_of
from interpreters.episodes import Demonstration
from interpreters.reward import RewardConfig, RewardModel

# ------------------------------------------------------------------------------------------------------- quantities


def test_retrieval_both_ways_against_chance() -> None:
    # Three windows of one recording, one of another, which has no rival of its own recording.
    owner = np.array([0, 0, 0, 1])
    scores = np.array([[0.9, 0.1, 0.2, 1.0], [0.8, 0.5, 0.6, 0.0], [0.3, 0.4, 0.7, 0.0], [0.0, 0.0, 0.0, 0.5]])
    same = owner[:, None] == owner
    hits = rewards.retrieval(scores, same)
    np.testing.assert_array_equal(hits["motion_r1"], [100, 0, 100, np.nan])
    np.testing.assert_array_equal(hits["audio_r1"], [100, 100, 100, np.nan])
    np.testing.assert_allclose(hits["chance_r1"], [100 / 3] * 3 + [np.nan])
    others = rewards.retrieval(scores, ~same)
    np.testing.assert_array_equal(others["motion_r1"], [0, 100, 100, 100])
    np.testing.assert_array_equal(others["audio_r1"], [100, 100, 100, 0])
    np.testing.assert_allclose(others["chance_r1"], [50, 50, 50, 25])
    assert not rewards.retrieval(np.ones((4, 4)), np.ones((4, 4), dtype=bool))["motion_r1"].any()


def test_a_shift_goes_both_ways_and_stays_in_the_take() -> None:
    own, owner = rewards.windows([take([0] * 6, silent=[]), take([0] * 3, silent=[], recording=1)], 2)

    def score(motion: np.ndarray, audio: np.ndarray) -> np.ndarray:
        assert motion.shape == audio.shape == (len(motion), 2)
        return 10.0 * motion[:, 0] + audio[:, 0]  # windows are named by their first block

    def shifted(shift: int) -> np.ndarray:
        return rewards.shifted(score, own, owner, shift)

    np.testing.assert_array_equal(shifted(0), [0, 11, 22, 33, 44, 1100, 1111])
    np.testing.assert_array_equal(shifted(1), [10, 11, 22, 33, 34, 1110, 1101])
    np.testing.assert_array_equal(shifted(3), [30, 41, np.nan, 3, 14, np.nan, np.nan])
    assert np.isnan(shifted(5)).all()


def test_two_models_agree_over_actions_and_not_over_states() -> None:
    first = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [5.0, 5.0, 5.0]])
    second = np.array([[10.0, 20.0, 30.0], [9.0, 8.0, 7.0], [0.0, 1.0, 0.0], [1.0, 2.0, 3.0]])
    np.testing.assert_allclose(rewards.agreement(first, second), [1.0, -1.0, 0.0, np.nan], atol=1e-12)
    # What differs between states alone, by as much as one likes, is no agreement.
    assert abs(rewards.agreement(np.array([[100.0, 101.0, 100.0]]), np.array([[101.0, 100.5, 100.0]]))[0]) < 1e-12


def take(lexemes: list[int], silent: list[int], recording: int = 0) -> Demonstration:
    count = len(lexemes)
    return Demonstration(recording, 0, np.arange(count) + 100 * recording, np.array(lexemes),
                         np.isin(np.arange(count), silent))


# ------------------------------------------------------------------------------------------------- models and tables

@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("rewards")


@pytest.fixture(scope="module")
def bundle(tiny_store: Path, work: Path) -> bundles.Bundle:
    """A bundle that nobody trained, with two reward models that look back on four blocks."""
    own = untrained(*PLAIN)
    corpus = prepare(Store.open(tiny_store), own.config, work, progress=False)
    models = [RewardModel(RewardConfig(width=16, projection=8, window=4), own.config.rhythm.frames,
                          corpus.motion.shape[-1], corpus.low.shape[-1]) for _ in range(2)]
    for model in models:
        freeze(model)
    return dataclasses.replace(own, statistics=corpus.statistics).with_parts(reward=models[0], reward_judge=models[1])


@pytest.fixture(scope="module")
def corpus(tiny_store: Path, bundle: bundles.Bundle, work: Path) -> Corpus:
    return prepare(Store.open(tiny_store), bundle.config, work, progress=False)


def test_a_probe_gives_the_reward_of_the_model(bundle: bundles.Bundle, corpus: Corpus) -> None:
    labels = token_labels(bundle.lexicon, corpus)
    assert bundle.reward is not None
    probe, own = RewardProbe.of(bundle.reward, bundle, corpus, labels), takes_of(corpus, labels, "test")[0]
    at, _ = rewards.windows([own], 4)
    decoded = probe.score("decoded", at, at)
    np.testing.assert_allclose(decoded, probe.played(labels[at], at), atol=1e-5)
    along = probe.table.sequence(torch.as_tensor(own.lexemes), torch.as_tensor(own.blocks)).numpy()
    np.testing.assert_allclose(decoded, along[3:], atol=1e-5)
    spoken = ~own.silent[1:]
    true = own.lexemes[1:][spoken]
    np.testing.assert_allclose(probe.every(own)[np.arange(len(true)), true], along[1:][spoken], atol=1e-5)
    for kind in ("captured", "decoded"):
        np.testing.assert_allclose(np.diagonal(probe.pairs(kind, at[:5])), probe.score(kind, at[:5], at[:5]), atol=1e-5)
    moved = probe.pairs("captured", at[:5])
    np.testing.assert_allclose(moved[3, 1:2], probe.score("captured", at[3:4], at[1:2]), atol=1e-5)
    with torch.no_grad():
        as_trained, heard = bundle.reward.embed({
            "motion": corpus.motion[torch.as_tensor(at)],
            "audio": corpus.low[torch.as_tensor(at), bundle.reward.frames:2 * bundle.reward.frames].float(),
            "valid": torch.ones(at.shape)})
    np.testing.assert_allclose((as_trained * heard).sum(-1).numpy(), probe.score("captured", at, at), atol=1e-5)


class Knows:
    """A reward that knows the moment: what is less far away has more; nothing but the pose tells it."""

    model = type("Model", (), {"config": RewardConfig(window=2, longest=2)})()
    table = type("Table", (), {"size": 7})()

    def score(self, kind: str, motion: np.ndarray, audio: np.ndarray) -> np.ndarray:
        assert kind in ("captured", "decoded")
        return -np.abs(motion - audio).mean(axis=1) / 1000

    def pairs(self, kind: str, own: np.ndarray) -> np.ndarray:
        return np.asarray(-np.abs(own[:, None, 0] - own[None, :, 0]) / 1000)

    def played(self, lexemes: np.ndarray, audio: np.ndarray) -> np.ndarray:
        assert lexemes.max() < 7
        return np.full(len(audio), -1.0)


@pytest.fixture(scope="module")
def context(tiny_store: Path, bundle: bundles.Bundle, work: Path) -> EvalContext:
    return EvalContext.over(Store.open(tiny_store), bundle, work, progress=False)


def test_a_reward_that_knows_the_moment_finds_it() -> None:
    takes = [take([0] * 40, silent=[0, 1, 2], recording=k) for k in range(3)]
    silent = np.zeros(300, dtype=bool)
    silent[[0, 1, 2, 100, 101, 102, 200, 201, 202]] = True
    found: Any = rewards.retrieved(Knows(), takes, silent)  # type: ignore[arg-type]
    assert found["decoded"]["motion_r1"].mean == found["decoded"]["audio_r1"].mean == 100.0
    assert found["decoded"]["chance_r1"].mean == pytest.approx(100 / 19), "the first of twenty is silent"
    moved: Any = rewards.shifts(Knows(), takes, silent)["decoded"]  # type: ignore[arg-type]
    assert moved["matched - 8"].mean == pytest.approx(0.008) and moved["another recording"].mean < -0.1
    assert moved["matched - random"].mean == pytest.approx(1.0)


def test_the_tables_of_random_models(context: EvalContext) -> None:
    found, shifts, single = rewards.rewards(context)
    assert found.facts["store"]["test_recordings"] == 2 and len(found.rows) == 6
    for hits in found.rows.values():  # nobody trained it: what it finds is not far from what guessing would
        assert hits["motion_r1"].mean < 50 and hits["chance_r1"].mean < 50  # type: ignore[union-attr]
    assert list(shifts.rows)[:8] == ["0", "1", "2", "4", "8", "16", "another recording", "random"]
    assert shifts.rows["0"]["reward: decoded"] != shifts.rows["0"]["judge: decoded"]
    assert f"among {len(context.bundle.lexicon.vectors)} lexemes" in single.notes[0]


def test_the_command(tiny_store: Path, bundle: bundles.Bundle, work: Path, tmp_path: Path,
                     monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundles, "load", lambda path: bundle)
    assert ABLATE.main("gesticulator ablate", ["--rewards", "--data", str(tiny_store), "--work", str(work), "--quiet",
                                               "--out", str(tmp_path)]) == 0
    assert [table.title for table in load(tmp_path / "rewards.json")] == [
        "Retrieval", "Mean reward by shift, blocks", "Single actions"]


@pytest.mark.parametrize("lacking", ["reward", "reward_judge"])
def test_a_bundle_without_both_models_is_refused(context: EvalContext, lacking: str) -> None:
    without: dict[str, Any] = {lacking: None}
    with pytest.raises(InputError, match="reward models"):
        rewards.rewards(dataclasses.replace(context, models=context.bundle.with_parts(**without)))
