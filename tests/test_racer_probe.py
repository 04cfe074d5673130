"""The acceptance of RACER: its formulas by hand, verdicts where the answer is known, and the command end to end."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from eval.ablate.policy import entropy_of, matched_temperature
from eval.acceptance.bounds import Verdict, at_least, judged
from eval.acceptance.racer import command as racer
from eval.acceptance.racer import gate, values
from eval.acceptance.racer.command import CQL, LSTM, MAJORITY, MATCHED, PERFORMER, RANDOM, PlayedPolicy, RacerMeasures
from eval.acceptance.racer.playing import PlayedFigures
from eval.commands import PROBE
from eval.metrics import gesture_features
from interpreters.episodes import Demonstration
from interpreters.reward import RewardConfig, RewardModel
from interpreters.reward_table import EnsembleReward, RewardTable


def test_a_matched_temperature_has_the_entropy_that_was_asked() -> None:
    scores = torch.randn(50, 20, generator=torch.Generator().manual_seed(0))
    for nats in (0.5, 1.5, 2.8):
        assert entropy_of(scores / matched_temperature(scores, nats)) == pytest.approx(nats, abs=0.02)
    assert entropy_of(torch.zeros(3, 8)) == pytest.approx(math.log(8))
    # Values that differ by hundredths are brought to the same variety as log-odds that differ by units.
    assert matched_temperature(0.01 * scores, 1.5) == pytest.approx(0.01 * matched_temperature(scores, 1.5), rel=0.06)


def test_a_partial_correlation_sees_what_the_other_does_not_explain() -> None:
    rng = np.random.default_rng(0)
    prior, reward = rng.normal(size=(4, 300)), rng.normal(size=(4, 300))
    # By hand, from the residuals of two regressions.
    mixed = 2.0 * prior + 0.5 * reward

    def rest(of: np.ndarray) -> np.ndarray:
        centred, given = of - of.mean(1, keepdims=True), prior - prior.mean(1, keepdims=True)
        return centred - given * ((centred * given).sum(1) / (given ** 2).sum(1))[:, None]

    one, other = rest(mixed), rest(reward + 0.3 * prior)
    expected = (one * other).sum(1) / np.sqrt((one ** 2).sum(1) * (other ** 2).sum(1))
    np.testing.assert_allclose(values.partial_correlations(mixed, reward + 0.3 * prior, prior), expected)
    # A value that repeats the behaviour and nothing else has none, however well it correlates.
    copy = prior + 0.01 * rng.normal(size=prior.shape)
    assert np.abs(values.partial_correlations(copy, prior + reward, prior)).max() < 0.3
    assert np.isnan(values.partial_correlations(prior, reward, prior)).all()


def rewards(seed: int, count: int = 2) -> EnsembleReward:
    torch.manual_seed(seed)
    models = [RewardModel(RewardConfig(width=8, projection=6, window=4, longest=5), 3, 6, 4).eval()
              for _ in range(count)]
    draw = torch.Generator().manual_seed(9)
    audio, times, motion = (torch.randn(*shape, generator=draw) for shape in ((40, 3, 4), (40,), (6, 3, 6)))
    return EnsembleReward([RewardTable(model, audio, times, motion, centred=True) for model in models], 0.5)


def test_a_reward_agrees_with_itself_and_not_with_a_stranger() -> None:
    rng = np.random.default_rng(1)
    takes = [Demonstration(number, 0, np.arange(20) + 20 * number, rng.integers(6, size=20), np.zeros(20, bool))
             for number in range(2)]
    same = gate.agreed(rewards(0), rewards(0), takes)
    assert same.single.mean == pytest.approx(1, abs=1e-5) and same.returns.mean == pytest.approx(1, abs=1e-5)
    other = gate.agreed(rewards(0), rewards(5), takes)
    assert other.single.mean < 0.6 and other.returns.mean < 0.6


def test_an_ensemble_is_its_members_mean_less_their_disagreement() -> None:
    both = rewards(0)
    lexemes, blocks, valid = torch.tensor([[1, 2, 3, 4]]), torch.tensor([[5, 6, 7, 8]]), torch.ones(1, 4)
    each = torch.stack([table.rewards(lexemes, blocks, valid) for table in both.tables])
    torch.testing.assert_close(both.rewards(lexemes, blocks, valid), each.mean(0) - 0.5 * each.std(0))
    torch.testing.assert_close(both.of([1], 0.0).rewards(lexemes, blocks, valid), each[1])
    every = both.every(lexemes[:, :-1], blocks, valid)
    assert float(every[0, 4]) == pytest.approx(float(both.rewards(lexemes, blocks, valid)), abs=1e-5)


def test_a_centred_reward_is_0_on_average_over_sound() -> None:
    table = rewards(0, 1).tables[0]
    lexemes = torch.tensor([[1, 2, 3, 4]])
    got = [float(table.rewards(lexemes, torch.arange(end - 3, end + 1)[None], torch.ones(1, 4)))
           for end in range(3, 40)]
    assert np.mean(got) == pytest.approx(0, abs=1e-5)


def row(judge: float, reward: float, **others: float) -> PlayedFigures:
    noise = np.linspace(-0.01, 0.01, 12)
    own = {"judge": judge, "reward": reward, "judge_shifted": 0.1, "reward_shifted": 0.1, "pmb": 30.0,
           "speech_speed": 0.3, "silence_speed": 0.05, **others}
    return PlayedFigures({key: value + noise for key, value in own.items()}, [np.arange(20) % 7], [], {})


def measures(gain: float) -> RacerMeasures:
    played = {PERFORMER: row(0.3, 0.3), LSTM: row(0.3, 0.3), MATCHED: row(0.3, 0.3), RANDOM: row(0.1, 0.1),
              MAJORITY: row(0.0, 0.0), CQL: row(0.2, 0.2), "cql, matched": row(0.2, 0.2),
              **{f"advantage {beta:g}": row(0.3 + gain * beta, 0.3 + 0.1 * beta) for beta in (0.5, 1, 2)}}
    variety = {"lexeme_diversity": np.full(3, 4.0), "rare": np.full(3, 5.0)}
    return RacerMeasures(played, dict.fromkeys(played, variety), racer.BETAS, 1.0)


ROWS = {MATCHED: PlayedPolicy("lstm", 0.9)}


def verdicts(clauses: list[Verdict]) -> dict[str, bool | None]:
    return {clause.figure: clause.holds for clause in clauses}


def test_a_policy_that_the_judge_likes_is_accepted_and_one_that_it_does_not_is_not() -> None:
    good = verdicts([*racer.won(measures(0.06), ROWS), *racer.timed(measures(0.06)), *racer.knob(measures(0.06))])
    assert all(holds for holds in good.values() if holds is not None) and sum(h is True for h in good.values()) >= 9
    bad = verdicts([*racer.won(measures(-0.06), ROWS), *racer.knob(measures(-0.06))])
    assert bad["judge on motion: advantage 1 less the lstm at equal entropy"] is False
    assert bad["judge's gain over the training reward's"] is False
    assert bad["judge on motion: no worse than the performer"] is False
    assert bad["knob: least step of the judge over beta 0 to 2"] is False
    assert bad["knob: least step of the training reward over beta 0 to 2"] is True
    # A gain that the judge sees the tenth part of is the reward's own error.
    assert verdicts(racer.won(measures(0.01), ROWS))["judge's gain over the training reward's"] is False


def test_an_entry_is_plain_json() -> None:
    made = racer.entry(judged("a", 0.5, at_least(0.6), reason="why"))
    assert json.loads(json.dumps(made)) == {"name": "a", "value": 0.5, "low": None, "high": None,
                                            "bound": "at least 0.60", "holds": False, "reason": "why"}


def test_the_command_judges_every_clause(tiny_store: Path, tiny_movement_bundle: Path, tmp_path: Path,
                                         monkeypatch: pytest.MonkeyPatch) -> None:
    # The networks of FGD as after a few steps: their distances are judged, whatever they are.
    monkeypatch.setattr(gesture_features, "SETTINGS", replace(gesture_features.SETTINGS, steps=20))
    work = tiny_movement_bundle.with_name(tiny_movement_bundle.name + ".work")
    out, list_of = tmp_path / "racer.json", tmp_path / "racer_acceptance.json"
    assert PROBE.main("gesticulator probe", [
        "racer", "--data", str(tiny_store), "--bundle", str(tiny_movement_bundle), "--work", str(work), "--quiet",
        "--limit", "1", "--seconds", "8", "--control-steps", "2", "--out", str(out), "--json", str(list_of)]) == 0
    found = json.loads(list_of.read_text())
    assert len(found) >= 20 and len({clause["name"] for clause in found}) == len(found)
    assert {key for clause in found for key in clause} == {"name", "value", "low", "high", "bound", "holds", "reason"}
    by_name = {clause["name"]: clause for clause in found}
    assert by_name["reward models in the bundle"]["holds"] is True
    assert 0 < by_name["cost of a block on one thread, ms"]["value"] < 1000


def test_without_the_work_folder_of_the_training_it_says_so(tiny_store: Path, tiny_movement_bundle: Path,
                                                            tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        PROBE.main("gesticulator probe", [
            "racer", "--data", str(tiny_store), "--bundle", str(tiny_movement_bundle), "--work", str(tmp_path / "none"),
            "--quiet"])
    assert left.value.code == 2
    assert "reward (in --work)" in capsys.readouterr().err
