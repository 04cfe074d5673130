"""What the gate's figures say of gates whose worth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from performances import perform

from data_module.store import Recording, RecordingInfo, StoreWriter
from data_module.types import Array, Speech
from eval.commands import PROBE
from eval.metrics.calibration import auc, brier, calibration, calibration_error
from eval.probes import gate as figures
from eval.probes.gate import GatedMotion, GateScores, knowledge, row
from eval.stats import Interval, of_groups
from eval.table import load
from gesticulator.bundle import bundle as bundles
from gesticulator.pipeline import Gesticulator
from interpreters.gate import ActivityGate, GateConfig

blocks = st.lists(st.tuples(st.booleans(), st.sampled_from([0.0, 0.1, 0.35, 0.5, 0.8, 1.0])), min_size=1, max_size=25)


def by_pairs(active: np.ndarray, scores: Array) -> float:
    """The chance that an active block is scored over a still one, a tie counting half."""
    pairs = [(a > s) + 0.5 * (a == s) for a in scores[active] for s in scores[~active]]
    return float(np.mean(pairs)) if pairs else float("nan")


@given(blocks)
def test_auc_is_the_chance_of_the_right_order(drawn: list[tuple[bool, float]]) -> None:
    active, scores = np.array([a for a, _ in drawn]), np.array([s for _, s in drawn])
    assert auc(active, scores) == pytest.approx(by_pairs(active, scores), nan_ok=True)


@given(blocks, st.data())
def test_weights_are_repetitions(drawn: list[tuple[bool, float]], data: st.DataObject) -> None:
    active, scores = np.array([a for a, _ in drawn]), np.array([s for _, s in drawn])
    times = np.array(data.draw(st.lists(st.integers(0, 3), min_size=len(drawn), max_size=len(drawn))))
    again, said = np.repeat(active, times), np.repeat(scores, times)
    if not len(again):
        return
    weights = times.astype(float)
    assert auc(active, scores, weights) == pytest.approx(by_pairs(again, said), nan_ok=True)
    assert brier(active, scores, weights) == pytest.approx(np.mean((said - again) ** 2))
    assert calibration_error(active, scores, weights) == pytest.approx(calibration_error(again, said))


def test_calibration_of_an_honest_and_of_a_boastful_gate() -> None:
    active = np.array([True] * 25 + [False] * 75 + [True] * 80 + [False] * 20)
    honest = np.repeat([0.25, 0.8], 100)
    assert calibration_error(active, honest) == pytest.approx(0, abs=1e-12)
    boastful = np.repeat([0.55, 1.0], 100)
    assert calibration_error(active, boastful) == pytest.approx((0.3 + 0.2) / 2)
    told = calibration(active, boastful)
    assert list(told) == ["0.5 to 0.6", "0.9 to 1.0"]
    assert told["0.5 to 0.6"] == pytest.approx({"blocks": 100, "said": 0.55, "happened": 0.25})
    assert told["0.9 to 1.0"] == pytest.approx({"blocks": 100, "said": 1.0, "happened": 0.8})
    assert brier(active, honest) == pytest.approx((0.25 * 0.75 + 0.8 * 0.2) / 2)


def test_groups_are_drawn_whole() -> None:
    owner, seen = np.array([0, 0, 0, 1, 2, 2]), []

    def statistic(weights: Array) -> float:
        seen.append(weights)
        return float(weights[0])

    got = of_groups(statistic, owner, draws=400)
    assert (got.mean, got.n) == (1.0, 3)
    drawn = np.array(seen)
    assert (drawn[:, 0] == drawn[:, 1]).all() and (drawn[:, 4] == drawn[:, 5]).all()
    assert (drawn[:, 0] + drawn[:, 3] + drawn[:, 4] == 3).all()
    # The count of one of three groups in three draws is binomial: 0 in 8 of 27, 3 in 1 of 27.
    assert np.mean(drawn[:, 0] == 0) == pytest.approx(8 / 27, abs=0.07)
    assert (got.low, got.high) == (0.0, 3.0)


def judged(count: int = 8, length: int = 120) -> list[GateScores]:
    """A gate that is right nine times in ten and says so; silence knows the pauses; loudness is noise. Half of the
    recordings are of a lively performer; two share their speech."""
    rng, out = np.random.default_rng(0), []
    for i in range(count):
        active = rng.random(length) < (0.8 if i % 2 else 0.4)
        said = np.where(active ^ (rng.random(length) < 0.1), 0.9, 0.1)
        pause = ~active & (rng.random(length) < 0.3)
        out.append(GateScores(f"speech {min(i, count - 2)}", active, {
            figures.GATE: said, figures.LOUDNESS: rng.random(length), figures.SILENCE: (~pause).astype(float),
            figures.PERFORMER: np.full(length, 0.8 if i % 2 else 0.4)}))
    return out


def test_knowledge_of_known_systems() -> None:
    told = judged()
    knows, calibrated = knowledge(told, {"seconds": 60.0}, draws=40)
    assert "8 recordings (7 with speech of their own), 60 s, 960 blocks" in knows.notes[0]
    cells: dict[str, dict[str, Any]] = {name: dict(own) for name, own in knows.rows.items()}
    area = {name: own["auc"].mean for name, own in cells.items()}
    inside = {name: own["auc_within_recordings"].mean for name, own in cells.items()}
    assert area[figures.GATE] == pytest.approx(0.9, abs=0.03) == inside[figures.GATE]
    assert area[figures.LOUDNESS] == pytest.approx(0.5, abs=0.05)
    assert inside[figures.SILENCE] == pytest.approx(0.65, abs=0.04)
    assert inside[figures.PERFORMER] == 0.5 < area[figures.PERFORMER]  # who it is tells nothing within a recording
    for name, own in cells.items():
        assert own["auc"].low <= own["auc"].mean <= own["auc"].high
        if name != figures.GATE:
            assert own["gate_leads_by"].mean == pytest.approx(area[figures.GATE] - area[name])
            assert own["gate_leads_by"].above()
    rate = float(np.concatenate([own.active for own in told]).mean())
    assert f"and {rate * (1 - rate):.3f} for always saying the base rate" in calibrated.notes[0]
    said = np.concatenate([own.scores[figures.GATE] for own in told])
    assert f"Brier score {brier(np.concatenate([own.active for own in told]), said):.3f}" in calibrated.notes[0]


def hands(gesturing: list[bool], closed: list[bool], speeds: list[float]) -> GatedMotion:
    """Blocks of half a second at 10 frames a second, the hands at a constant speed in each."""
    speed = np.repeat(np.array(speeds), 5)
    return GatedMotion(np.array(gesturing), np.array(closed), speed, np.repeat(np.arange(len(speeds)), 5))


def test_use_of_a_known_gate() -> None:
    free = [hands([True] * 4, [False] * 4, [1.0, 1.2, 0.8, 1.0]), hands([True] * 2, [False] * 2, [2.0, 2.0])]
    shut = [hands([True, False, False, True], [False, True, True, False], [1.0, 0.2, 0.2, 1.0]),
            hands([True, True], [False, False], [2.0, 2.0])]
    got = {key: value.mean for key, value in row(shut, free).items() if isinstance(value, Interval)}
    assert got["gesturing"] == pytest.approx(4 / 6) and got["gesturing_change"] == pytest.approx(-2 / 6)
    assert got["hand_speed"] == pytest.approx((4 * 0.6 + 2 * 2.0) / 6)
    assert got["hand_speed_change"] == pytest.approx(4 * (0.6 - 1.0) / 6)
    assert got["closed_speed"] == pytest.approx(0.2)  # the second performance has no closed block and no say
    assert got["closed_speed_without"] == pytest.approx(1.0) and got["closed_speed_change"] == pytest.approx(-0.8)
    assert row(shut, free)["closed_blocks"] == 2
    assert np.isnan(row(free, free)["closed_speed"].mean)  # type: ignore[union-attr]
    assert "gesturing_change" not in row(shut)


def test_loudness_is_the_level_against_the_recording() -> None:
    rng = np.random.default_rng(0)
    samples = 0.01 * rng.standard_normal(16000 * 3)
    samples[16000:24000] *= 10
    got = figures.loudness(Speech(samples.astype(np.float32), 16000), np.array([0.0, 1.0, 1.5, 3.0]))
    np.testing.assert_allclose(got, [0, 20, 0], atol=0.5)


# ----------------------------------------------------------------------------------- with the product

def gated(bias: float = 0.0) -> bundles.Bundle:
    """The shipped bundle with an untrained gate, which `bias` opens or shuts."""
    bundle = bundles.load(bundles.SHIPPED)
    torch.manual_seed(0)
    model = ActivityGate(GateConfig(audio_features=4, width=8), bundle.config.rhythm.frames,
                         len(bundle.statistics.low.to_dict()["mean"]), len(bundle.speakers)).eval()
    with torch.no_grad():
        model.classify.weight.mul_(20)
        model.classify.bias.fill_(bias)
    config = replace(bundle.config, gate=model.config)
    return replace(bundle, config=config).with_parts(gate=model)


def recording(bundle: bundles.Bundle, index: int = 0) -> Recording:
    made = perform(4.0, seed=index, fps=50.0)
    info = RecordingInfo(f"take{index}", "test", bundle.speakers[index % len(bundle.speakers)], "tone", "en",
                         group=f"take{index}")
    return Recording(info, made.speech, made.motion)


def test_a_gate_is_judged_beside_its_controls() -> None:
    bundle = gated()
    system, take = Gesticulator(bundle), recording(bundle)
    made, _ = figures.play(system, take, figures.ASKED)
    got, own = figures.judge(system, take, made)
    assert len(got.active) == len(got.scores[figures.GATE]) == len(got.scores[figures.LOUDNESS])
    assert np.isfinite(got.scores[figures.GATE]).all() and np.ptp(got.scores[figures.GATE]) > 0
    assert set(got.scores[figures.SILENCE]) == {0.0, 1.0}  # the tone has a silent middle
    np.testing.assert_array_equal(own.closed, ~got.active)


def test_activity_shuts_and_opens() -> None:
    bundle = gated(bias=0.3)
    system, take = Gesticulator(bundle), recording(bundle, 1)
    still, half, free = (figures.play(system, take, activity)[1] for activity in (0.0, 0.5, 1.0))
    assert still.closed.all() and not still.gesturing.any()
    assert not free.closed.any()
    assert not (half.gesturing & half.closed).any()
    assert free.block.max() + 1 == len(free.gesturing) == len(half.gesturing)


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bundle = gated()
    writer = StoreWriter(tmp_path / "store", "tones", {}, 0, "none")
    for index in range(2):
        writer.add(recording(bundle, index))
    writer.finish(["take0", "take1"])
    for name, own in (("with", bundle), ("without", bundle.with_parts(gate=None))):
        bundles.save(own, tmp_path / name, "a card")
    data, out = ["--data", str(tmp_path / "store")], tmp_path / "new" / "gate.json"
    def ask(*more: str) -> int:
        return PROBE.main("gesticulator probe", ["gate", *data, *more])

    assert ask("--bundle", str(tmp_path / "with"), "--out", str(out)) == 0
    knows, calibration, use = load(out)
    assert list(knows.rows) == [figures.GATE, figures.LOUDNESS, figures.SILENCE, figures.PERFORMER]
    assert knows.facts["store"]["split"] == "test" and "2 with speech of their own" in knows.notes[0]
    assert sum(row["blocks"] for row in calibration.rows.values()) > 0  # type: ignore[misc]
    assert list(use.rows) == ["performer", "0", "0.25", "0.5", "0.75", "1"]
    assert use.rows["0"]["gesturing"].mean == 0 == use.rows["1"]["hand_speed_change"].mean  # type: ignore[union-attr]
    assert "gesturing_change" not in use.rows["performer"]
    for wrong, says in ((["--bundle", str(tmp_path / "without")], "has no gate"),
                        (["--bundle", str(tmp_path / "with"), "--limit", "0"], "must be 1 or more")):
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            ask(*wrong)
        assert stopped.value.code == 2
        assert says in capsys.readouterr().err
