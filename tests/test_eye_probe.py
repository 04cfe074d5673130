"""The table of the figures for the eye, and the probe that fills it: systems rendered here, written, and read again."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bursts import recording

from data_module.blocks import cut
from data_module.errors import InputError
from data_module.motion.bvh import write_bvh
from data_module.speech.audio import write_flac
from data_module.store import StoreWriter
from data_module.types import Speech
from eval.acceptance.motion.seen import sample_of
from eval.baselines import controls as baselines
from eval.clip.foreign import edges_of_plan
from eval.commands import PROBE
from eval.metrics import EYE_METRICS
from eval.metrics.eye import ReferenceSpace, figures, frechet, hear
from eval.metrics.eye import sample as eye_table
from eval.metrics.eye.sample import CONTROLS, EyeSample, controls, eye_tables, heading
from eval.probes import eye as probe
from eval.renderings import TAKE, AcceptanceVoice
from eval.table import Table, load
from gesticulator.bundle.features import SpeechFeatures


@pytest.fixture(scope="module")
def space() -> ReferenceSpace:
    """A space of noise, so that no outside data is needed."""
    rng = np.random.default_rng(0)
    axes = np.linalg.svd(rng.normal(size=(40, 40)))[2][:10]
    return ReferenceSpace(rng.normal(size=40), rng.uniform(0.5, 2, 40), axes, frechet.Moments(np.zeros(10), np.eye(10)))


def sample(seeds: list[int], space: ReferenceSpace | None = None) -> EyeSample:
    """Measured clips of the recordings with these seeds."""
    out = EyeSample()
    for seed in seeds:
        one = recording("one", seed)
        out.add(one.motion, hear(one.speech), cut(one.speech).edges, space, group=str(seed))
    return out


def row(table: Table, name: str) -> dict:
    return dict(table.rows[heading(name)])


def test_the_table_shows_means_ranges_marks_and_the_controls_that_pass(space: ReferenceSpace) -> None:
    two, real = sample([0, 1], space), recording("one", 0)
    wrong = controls(real.motion, hear(real.speech), space)
    assert tuple(wrong) == CONTROLS
    systems, of_controls = eye_tables({"corpus": two, "single": sample([2], space)}, wrong, space, "eye")
    assert list(systems.columns) == ["corpus", "single", "range", "controls"]
    assert list(of_controls.columns) == list(CONTROLS)
    mean = float(np.mean(two.values["eye_speed_50"]))
    assert row(systems, "eye_speed_50")["corpus"].startswith(f"{mean:.2f} [")
    assert "[" not in row(systems, "eye_speed_50")["single"], "one clip has no interval"
    # Synthetic paths are no person: what lies outside is marked, and only that.
    facts = systems.facts["figures"]["corpus"]
    for name in EYE_METRICS:
        if heading(name) in systems.rows and math.isfinite(facts[name]["mean"]):
            low, high = eye_table.eye.RANGES[name]
            assert row(systems, name)["corpus"].endswith(" !") == (not low <= facts[name]["mean"] <= high), name
    for name in EYE_METRICS:
        if heading(name) in systems.rows:
            told = row(systems, name)["controls"].split(", ")
            assert set(EYE_METRICS[name].fooled_by) <= set(told)
            for control in CONTROLS:
                value = of_controls.facts["figures"][control][name]["mean"]
                assert control in told or not eye_table.eye.within(name, value)
    assert "figures refuse it" in of_controls.notes[0]
    json.loads(json.dumps(systems.to_dict(), default=str))


def test_pooled_distances_are_of_all_windows_and_the_corpus_is_at_0_from_itself(space: ReferenceSpace) -> None:
    corpus, other = sample([0, 1], space), sample([3], space)
    systems = eye_tables({"corpus": corpus, "other": other}, {}, space, "eye")[0]
    facts = systems.facts["figures"]
    every = np.concatenate(corpus.windows)
    assert facts["corpus"]["eye_frechet_pooled"]["mean"] == pytest.approx(space.distance(every))
    assert facts["corpus"]["eye_frechet_corpus"]["mean"] == pytest.approx(0.0, abs=1e-6)
    moments = space.moments(every)
    assert moments is not None
    assert facts["other"]["eye_frechet_corpus"]["mean"] == pytest.approx(space.distance(other.windows[0], moments))
    assert facts["other"]["eye_frechet"]["mean"] == facts["other"]["eye_frechet_pooled"]["mean"]
    bare = eye_tables({"corpus": sample([0])}, {}, None, "eye")
    assert len(bare) == 1 and heading("eye_frechet") not in bare[0].rows


def test_rolled_features_come_late_and_the_grid_stays() -> None:
    blocks = cut(recording("one", 0).speech)
    rng = np.random.default_rng(1)
    low, high = (rng.normal(size=(len(blocks), 12, 5)).astype(np.float32) for _ in range(2))
    encoded = SpeechFeatures(blocks, low, high, rng.normal(size=(len(blocks), 12, 3)).astype(np.float32))
    by = 7
    late = baselines.rolled(encoded, by)
    np.testing.assert_array_equal(late.low[by:, :, :-1], low[:-by, :, :-1])
    np.testing.assert_array_equal(late.low[..., -1], low[..., -1])
    np.testing.assert_array_equal(late.high[:by, :, :-1], high[-by:, :, :-1])
    np.testing.assert_array_equal(late.blocks.silent[by:], blocks.silent[:-by])
    np.testing.assert_array_equal(late.blocks.edges, blocks.edges)
    assert late.text is not None and encoded.text is not None
    np.testing.assert_array_equal(late.text[by:], encoded.text[:-by])
    np.testing.assert_array_equal(encoded.low, low)
    half = baselines.rolled(replace(encoded, text=None), 10 ** 6)
    np.testing.assert_array_equal(half.high[len(blocks) // 2:, :, :-1], high[:-(len(blocks) // 2), :, :-1])


def test_what_the_probe_writes_it_reads_again_to_the_same_figures(tmp_path: Path, space: ReferenceSpace,
                                                                  monkeypatch: pytest.MonkeyPatch,
                                                                  capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    writer = StoreWriter(tmp_path / "store", "folder", {}, 1, "free")
    for seed, name in enumerate(("one", "two", "test")):
        writer.add(recording(name, seed, 12.0, "test" if name == "test" else "train"))
    writer.finish(["one", "two", "test"])
    write_flac(tmp_path / "voice.flac", recording("new", 9, 11.0).speech)
    np.savez(tmp_path / "space.npz", mean=space.mean, sd=space.sd, axes=space.axes, own_mean=space.real.mean,
             own_root=np.eye(10))
    begin = ["eye", "--speech", str(tmp_path / "voice.flac"), "--data", str(tmp_path / "store"), "--renderings", "2",
             "--reference", str(tmp_path / "space.npz")]
    assert PROBE.main("gesticulator probe", [*begin, "--write", str(tmp_path / "made"), "--out",
                                             str(tmp_path / "first.json")]) == 0
    first = load(tmp_path / "first.json")
    assert list(first[0].columns) == ["corpus", "unit selection", "ours", "range", "controls"]
    assert "real-time factor" in capsys.readouterr().out
    names = sorted(file.name for file in (tmp_path / "made" / "ours").iterdir())
    assert names == [f"voice.{seed}.{kind}" for seed in (0, 1) for kind in ("bvh", "json")]
    again = [*begin, "--test-voices", "--out", str(tmp_path / "second.json")]
    for name, folder in (("a", "ours"), ("b", "unit selection")):
        again += ["--system", f"{name}={tmp_path / 'made' / folder}"]
    assert PROBE.main("gesticulator probe", again) == 0
    second = load(tmp_path / "second.json")
    facts = second[0].facts["figures"]
    for name, folder in (("a", "ours"), ("b", "unit selection")):
        for figure, value in facts[name].items():
            if "rolled" not in figure:  # nobody can tell from files what the system had made of other sound
                told = first[0].facts["figures"][folder][figure]["mean"]
                if told is None or value["mean"] is None:
                    assert told == value["mean"], figure
                else:
                    assert value["mean"] == pytest.approx(told, rel=1e-3, abs=1e-3, nan_ok=True), (name, figure)
        assert facts[folder] == first[0].facts["figures"][folder], "the same again"
    assert list(second[1].columns)[:3] == ["corpus", "unit selection", "ours"] and "test split" in second[1].title


def test_wrong_input_is_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                            capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    sound = tmp_path / "voice.flac"
    write_flac(sound, Speech(np.zeros(16000, np.float32), 16000))
    wrong = ((["eye"], "no sound"), (["eye", "--speech", str(sound), "--renderings", "0"], "renderings"),
             (["eye", "--speech", str(sound), "--test-voices"], "needs a store"),
             (["eye", "--speech", str(sound), "--system", "ours=x"], "column of its own"),
             (["eye", "--speech", str(sound), "--reference", str(sound)], "give eye_reference.npz"))
    for arguments, told in wrong:
        with pytest.raises(SystemExit) as caught:
            PROBE.main("gesticulator probe", arguments)
        said = capsys.readouterr().err
        assert caught.value.code == 2 and told in said and len(said.strip().splitlines()) == 1, said


@pytest.mark.parametrize(("plan", "told"), [
    ({"edges": [0.0, 0.4, 1.0]}, [0.0, 0.4, 1.0]),
    ({"blocks": [{"start": 0.0, "end": 0.4}, {"start": 0.4, "end": 1.0}]}, [0.0, 0.4, 1.0]),
    ({"edges": [0.0, 0.4, 0.4]}, None), ({"blocks": []}, None), ({"edges": "wide"}, None), ([1, 2], None)])
def test_edges_come_from_a_plan(plan: object, told: list[float] | None, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    assert edges_of_plan(file) is None
    file.write_text(json.dumps(plan))
    if told is None:
        with pytest.raises(InputError, match=r"plan\.json"):
            edges_of_plan(file)
    else:
        np.testing.assert_array_equal(edges_of_plan(file), told)


def test_a_system_without_a_sound_s_motion_is_refused(tmp_path: Path) -> None:
    one = recording("one", 0, 6.0)
    write_bvh(tmp_path / "other.bvh", one.motion)
    voice = AcceptanceVoice("voice", one.speech, TAKE)
    with pytest.raises(InputError, match="no motion for voice"):
        probe._read("a", tmp_path, [voice])
    write_bvh(tmp_path / "voice.3.bvh", one.motion)
    found = sample_of(probe._read("a", tmp_path, [voice]), None)
    own = figures(one.motion, voice.heard)
    assert len(found.windows) == 1
    assert found.values["eye_speed_95"][0] == pytest.approx(own["eye_speed_95"], rel=1e-3)
