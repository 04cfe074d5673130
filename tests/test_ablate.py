"""The ablation runner: what a row is, what rows share, and the whole command on networks of no size."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch

from data_module.errors import InputError
from data_module.motion.bvh import read_bvh, write_bvh
from data_module.store import Store
from eval import ablate, ablation_cells, ablation_figures, ablation_tables, ablations, racer_ablation
from eval.ablation_bench import Bench
from eval.ablation_tables import COLUMNS
from eval.ablations import CONTROLS, ELSEWHERE, OURS, RACER, REFERENCES, ROWS, SYSTEMS, TABLES, configured
from eval.metrics import gesture_features
from generator import losses
from gesticulator import config as configs
from gesticulator.config import Config
from gesticulator.train import Run

SHORT = ("schedules.speech.steps=1", "schedules.contrast.steps=1", "schedules.lexicon.steps=20",
         "schedules.generator.steps=6", "schedules.interpreter.steps=4", "schedules.style.steps=4")
BY = [gesture_features.RawFeatures(34, count=1)]


def base() -> Config:
    """The tiny preset, shorter still."""
    return configs.with_settings(ablations.tiny(), SHORT)


# ------------------------------------------------------------------------------------------------------------- rows

@pytest.mark.parametrize("preset", list(ablations.PRESETS))
def test_every_row_changes_something_and_no_two_are_equal(preset: str) -> None:
    own = ablations.PRESETS[preset]()
    seen = {}
    for name in ROWS:
        row = ROWS[name]
        variant = json.dumps([configs.to_dict(configured(own, name)), row.interpreter, row.style, row.split])
        assert variant not in seen, f"{name} is {seen.get(variant)} again"
        seen[variant] = name
        assert name == OURS or variant != json.dumps([configs.to_dict(own), "lstm", "interpreted", "test"])
        assert all("=" in setting for setting in row.settings) and row.question


def test_tables_hold_rows_and_columns_that_there_are() -> None:
    for title, table in TABLES.items():
        assert set(table.columns) <= set(COLUMNS)
        papers = {COLUMNS[key].paper for key in table.columns}
        for line in table.lines:
            assert line.row in (*ROWS, *REFERENCES, *SYSTEMS), title
            assert set(line.paper) <= papers, f"a figure of the paper that {title} would not show"
            assert line.row in (*REFERENCES, *SYSTEMS) or ROWS[line.row].split == table.split
    assert {line.row for table in TABLES.values() for line in table.lines} >= set(ROWS)
    assert dict(zip(("maje", "mad", "fgd", "pmb"), ((70.10, 30.07), (2.51, 3.53), (29.75, 5.22), (85.74, 83.10)),
                    strict=True)) == TABLES["RG Table 1"].lines[6].paper, "w/o SC"


def test_the_preset_hears_and_names_as_the_default_does() -> None:
    own, default = ablations.ablation(), configs.default()
    ours, theirs = (Run(c, _Fingerprint(), Path()) for c in (own, default))  # type: ignore[arg-type]
    for stage in ("speech", "contrast", "lexicon"):
        assert ours.key(stage) == theirs.key(stage), "a finished stage of the default serves"
    for stage in ("generator", "interpreter", "interpreter_text", "style"):
        assert ours.key(stage) != theirs.key(stage)
        assert ours.schedule(stage).steps < theirs.schedule(stage).steps
    assert own.schedules.gate.steps == own.schedules.cql.steps == own.schedules.reward.steps == 0


class _Fingerprint:
    """All that `Run.key` asks of a store."""

    fingerprint = "0" * 64


@pytest.mark.parametrize(("row", "same", "other"), [
    ("no-style", "interpreter lexicon", "generator style"),
    ("no-position", "interpreter lexicon", "generator style"),
    ("audio-only", "generator style lexicon", "interpreter interpreter_text"),
    ("style-reads", "generator style interpreter interpreter_text lexicon", "style_text"),
    ("statistical", "generator style interpreter lexicon", ""),
    ("no-hint", "generator style lexicon", "interpreter"),
    ("no-augmentation", "interpreter lexicon", "generator style"),
    ("no-segmentation", "", "lexicon generator interpreter style"),
    ("no-lexemes", "", "lexicon generator interpreter style")])
def test_a_row_trains_what_its_settings_change_and_nothing_else(row: str, same: str, other: str) -> None:
    own = ablations.ablation()
    bench = Bench(Run(own, _Fingerprint(), Path()), None, [])  # type: ignore[arg-type]
    (before, mine), (_, theirs) = bench.runs(row, 1), bench.runs(OURS, 1)
    for stages, equal in ((same, True), (other, False)):
        for stage in stages.split():
            runs = (before, bench.first) if stage == "lexicon" else (mine, theirs)
            assert (runs[0].key(stage) == runs[1].key(stage)) == equal, stage


def test_a_seed_shares_ears_and_lexicon_and_nothing_that_another_command_would_take_for_its_own() -> None:
    own = ablations.ablation()
    bench = Bench(Run(own, _Fingerprint(), Path()), None, [])  # type: ignore[arg-type]
    (first, one), (second, two) = bench.runs(OURS, 1), bench.runs(OURS, 2)
    assert first.key("lexicon") == second.key("lexicon") == bench.first.key("lexicon")
    assert one.key("generator") == bench.first.key("generator"), "as the training command would"
    plain = Run(dataclasses.replace(own, seed=2), _Fingerprint(), Path())  # type: ignore[arg-type]
    assert two.key("generator") not in (one.key("generator"), plain.key("generator"))
    cut = bench.runs("no-segmentation", 1)[1]
    plain = Run(configured(own, "no-segmentation"), _Fingerprint(), Path())  # type: ignore[arg-type]
    assert cut.key("generator") != plain.key("generator"), "it hears through the ears of all rows"
    assert one.seed("generator") != two.seed("generator")


def test_no_style_code_costs_nothing() -> None:
    assert float(losses.style_divergence(torch.zeros(7, 0))) == 0.0
    assert float(losses.style_divergence(torch.zeros(0, 4))) == 0.0
    codes = torch.randn(500, 4, generator=torch.Generator().manual_seed(0))
    assert 0 <= float(losses.style_divergence(codes)) < 0.01


# --------------------------------------------------------------------------------------------------------- measuring

def test_the_jackknife_of_a_mean_is_the_values_and_of_a_variance_unbiased() -> None:
    values = np.random.default_rng(0).normal(size=9)
    assert ablation_cells.pseudo_values(lambda k: float(values[k].mean()), 9) == pytest.approx(values)
    assert ablation_cells.pseudo_values(lambda k: float(values[k].var()), 9).mean() == pytest.approx(values.var(ddof=1))
    assert ablation_cells.pseudo_values(lambda k: float(len(k)), 1).tolist() == [1.0]


def test_random_codes_are_normal_and_repeat() -> None:
    def drawn(seed: int) -> np.ndarray:
        style = ablation_cells.RandomStyle(8, seed)
        state, out = style.start(0), []
        for _ in range(400):
            code, state = style.step(state, None, 0)  # type: ignore[arg-type]
            out.append(code.numpy()[0])
        return np.array(out)

    assert np.array_equal(drawn(1), drawn(1)) and not np.array_equal(drawn(1), drawn(2))
    assert abs(drawn(1).mean()) < 0.05 and abs(drawn(1).std() - 1) < 0.05


def cells_of(**values: list[list[float]]) -> ablation_tables.Cells:
    """Cells whose every column is values[row][seed][clip]."""
    return {row.replace("_", "-"): {seed: {
        "settings": [], "question": "?", "seconds": {"training": 3.0}, "sets": {"pmb_curve": {"percent": [1.0] * 10},
                                                                                "fgd": []},
        "clips": [dict.fromkeys(COLUMNS, own) for own in clips]} for seed, clips in enumerate(seeds, start=1)}
        for row, seeds in values.items()}


def test_tables_show_ours_beside_the_papers_and_mark_what_is_undecided() -> None:
    rows = ablation_tables.tabled(cells_of(ours=[[1.0, 3.0]] * 3, no_style=[[2.0, 2.0]]))
    assert rows["ours"]["figures"]["maje"]["mean"] == 2.0 and rows["ours"]["decided"]
    assert not rows["no-style"]["decided"]
    lines = ablation_tables.table_lines("RG Table 1", rows, {"no-lexemes": "400 s counted"})
    assert all(line.count("|") == lines[0].count("|") for line in lines)
    text = "\n".join(lines)
    assert "| Ours (w/o ZC) (undecided: 1 of 3 seeds) |" in text and "| 52.85 / 21.33 |" in text
    assert "| Ours (w/o SC) (400 s counted) | - | 70.1 / 30.07 |" in text and "(not run)" in text
    assert "| Ours | 2.0 [1.0, 3.0] | 49.53 / 18.13 |" in text


def test_a_folder_of_two_presets_is_refused(tmp_path: Path) -> None:
    for seed, shared in ((1, "a"), (2, "b")):
        (tmp_path / f"ours-{seed}.json").write_text(json.dumps({"row": "ours", "seed": seed, "shared": shared}))
    (tmp_path / "ours-3.json").write_text('{"row": "ou')
    with pytest.raises(InputError, match="different presets"):
        ablation_tables.read_cells(tmp_path)
    assert set(ablation_tables.read_cells(tmp_path, "b")["ours"]) == {2}


# ------------------------------------------------------------------------------------------------------ the command

@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ablate")


@pytest.fixture(scope="module")
def bench(tiny_store: Path, work: Path) -> Bench:
    return Bench.of(Store.open(tiny_store), base(), work, BY, limit=1, progress=False)


def test_costs_are_counted_before_they_are_paid(bench: Bench, work: Path, tmp_path: Path) -> None:
    before = sorted(work.rglob("*"))
    long = dataclasses.replace(bench, first=dataclasses.replace(bench.first, config=configs.with_settings(
        bench.first.config, ["schedules.generator.steps=1000000"])))
    long.first.corpus = bench.first.corpus
    result = ablate.ablate(long, tmp_path, only=["no-position"], seeds=1, budget=60.0)
    why = result["refused"]["no-position"]
    assert "s of training counted" in why and "60 s allowed" in why and "generator" in why
    assert not (tmp_path / "no-position-1.json").exists()
    assert not any("no-position" in str(file) or "generator-" in file.name
                   for file in set(work.rglob("*")) - set(before)), "nothing was trained"


def test_the_command_goes_on_where_it_was_stopped(bench: Bench, work: Path, tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["ours", "no-audio-no-style", "no-lexemes", "random-style", "style-editing"]
    drawn_from_these = {"figure-2": "svg", "figure-6": "png", "figure-9-ours": "png", "figure-9-performer": "png",
                        "figure-10": "png", "figure-11": "svg", "figure-14": "svg", "figure-17": "png"}
    result = ablate.ablate(bench, tmp_path, only=[*names, *drawn_from_these, "figure-16"], seeds=1)
    assert {f"{name}-1.json" for name in names} <= {file.name for file in tmp_path.iterdir()}
    assert (tmp_path / "performer-0.json").exists() and set(names) <= set(result["rows"])
    assert result["refused"] == {"figure-16": "not run: range-0.5-1.0, range-0.2-1.0"}
    assert read_bvh(work / "played" / "ours-1" / f"{bench.loaded(bench.recordings('test')[0]).info.name}.bvh").fps > 10
    for name, kind in drawn_from_these.items():
        told = json.loads((tmp_path / f"{name}.json").read_text())
        assert told["figure"].startswith("RG Fig.") and told["caption"]
        assert (tmp_path / f"{name}.{kind}").stat().st_size > 1000
    drawn = (tmp_path / "figure-17.png").stat().st_mtime_ns
    before = (tmp_path / "ours-1.json").read_bytes()
    one, random = (json.loads((tmp_path / f"{name}-1.json").read_text()) for name in ("ours", "random-style"))
    assert len(one["clips"]) == 1 and set(COLUMNS) <= set(one["clips"][0])
    assert 0 <= one["clips"][0]["accuracy"] <= 100 and one["sets"]["fgd"][0]["distance"] > 0
    assert one["stages"]["generator"] > 0 and set(random["stages"].values()) == {0.0}, "the same weights, played anew"
    alone = json.loads((tmp_path / "no-lexemes-1.json").read_text())
    assert alone["clips"][0]["accuracy"] is None, "it has no lexemes that could be right"
    assert alone["clips"][0]["diversity"] > 0, "its motion is read by the lexicon of ours"
    performer = json.loads((tmp_path / "performer-0.json").read_text())
    assert performer["clips"][0]["maje"] == 0 and performer["clips"][0]["fgd"] == pytest.approx(0, abs=1e-9)

    def nothing(*given: object) -> None:
        raise AssertionError("finished rows are reused")

    with monkeypatch.context() as patched:
        patched.setattr(ablation_cells, "fitted", nothing)
        ablate.ablate(bench, tmp_path, only=["ours"], seeds=1, budget=0.001)
    assert (tmp_path / "ours-1.json").read_bytes() == before
    ablate.ablate(bench, tmp_path, only=["figure-17"], seeds=1)
    assert (tmp_path / "figure-17.png").stat().st_mtime_ns == drawn, "a figure of the same rows stands"
    (tmp_path / "ours-1.json").write_text(before.decode()[:60])
    ablate.ablate(bench, tmp_path, only=["ours"], seeds=1)
    again = json.loads((tmp_path / "ours-1.json").read_text())
    assert json.dumps(again["clips"]) == json.dumps(one["clips"]), "a file that was cut short is written again"
    text = ablation_tables.markdown(result)
    assert "undecided: 1 of 3 seeds" in text and "(not run)" in text and "(not handed in)" in text


def test_controls_and_references_stand_beside_the_rows(bench: Bench, tmp_path: Path) -> None:
    rows = ablate.ablate(dataclasses.replace(bench, limit=None, _real={}), tmp_path, only=["ours"], seeds=1)["rows"]
    mean = {name: {key: rows[name]["figures"][key]["mean"] for key in COLUMNS} for name in (*REFERENCES, *CONTROLS)
            if name in rows}
    assert mean["performer"]["maje"] == mean["performer"]["mad"] == 0 and mean["jitter"]["maje"] > 1
    assert mean["still"]["speech_speed"] == pytest.approx(0, abs=1e-6)
    assert mean["performer"]["speech_speed"] > 0.05
    assert mean["jitter"]["mad"] > 10 * mean["still"]["mad"], "noise accelerates"
    assert mean["reversed"]["diversity"] > 0 and mean["shuffled"]["maje"] > 1
    assert set(rows["halves"]["figures"]) and math.isnan(mean["halves"]["maje"])
    assert mean["halves"]["fgd"] > mean["performer"]["fgd"], "no set is as near to itself as to another"
    lines = ablation_tables.table_lines("RG Table 1", rows, {})
    assert sum(line.startswith("| halves: ") for line in lines) == 1 and lines[-1].startswith("(!) ")
    assert "MAJE, mm (!)" in lines[0] and "jitter (" in "\n".join(lines)


def test_beats_and_sizes_are_drawn_from_what_was_kept(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    beats, onsets, edges = np.arange(0.5, 20, 0.5), np.arange(0.55, 20, 0.5), np.arange(0, 20, 0.4)
    ground = ablation_figures.Ground(bench, {})
    monkeypatch.setattr(ablation_figures.Ground, "seen", lambda self, name: [
        {"beats": beats if name == OURS else beats + 0.25, "onsets": onsets, "edges": edges}])
    _, caption, numbers = ablation_figures.FIGURES["figure-16"].draw(ground)
    assert "chance" in caption and numbers[OURS] == 100.0 and numbers["range-0.2-1.0"] < 100
    cells = {f"size-{size}": {"figures": {key: {"mean": size / 7, "low": 0.0, "high": 99.0} for key in COLUMNS}}
             for size in ablations.SIZES[:3]}
    _, _, numbers = ablation_figures.FIGURES["figure-18"].draw(ablation_figures.Ground(bench, cells))
    assert numbers["25 lexemes, FGD"] == pytest.approx(25 / 7)
    with pytest.raises(InputError, match="needs two sizes"):
        ablation_figures.FIGURES["figure-18"].draw(ground)


def test_a_control_beats_a_column_by_its_direction() -> None:
    def rows(**means: float) -> dict[str, object]:
        return {name: {"figures": {key: {"mean": value} for key in COLUMNS}} for name, value in means.items()}

    told = rows(ours=5.0, performer=4.0, jitter=3.2, still=9.0, halves=0.0)
    assert ablation_tables.beaten(told, "maje") == {"jitter": 3.2}, "less is better"
    assert ablation_tables.beaten(told, "pmb") == {"still": 9.0}, "more is better"
    assert ablation_tables.beaten(told, "diversity") == {"jitter": 3.2}, "near the performer's is better"
    assert ablation_tables.beaten(told, "accuracy") == {} == ablation_tables.beaten(rows(jitter=1.0), "maje")


def test_another_systems_motion_is_a_row(bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own, folder, out = bench.loaded(bench.recordings("test")[0]), tmp_path / "theirs", tmp_path / "out"
    folder.mkdir()
    write_bvh(folder / "nobody.bvh", own.motion)
    with pytest.raises(InputError, match="no motion for a test recording"):
        ablate.ablate(bench, out, only=["figure-5"], seeds=1, systems={"SG": folder})
    write_bvh(folder / f"{own.info.name}.bvh", own.motion)
    rows = ablate.ablate(bench, out, only=["figure-5"], seeds=1, systems={"SG": folder})["rows"]
    performer, theirs = (rows[name]["figures"] for name in ("performer", "SG"))
    assert theirs["maje"]["mean"] == pytest.approx(0, abs=0.1), "the performer's own motion, through a file"
    assert theirs["pmb"]["mean"] == pytest.approx(performer["pmb"]["mean"], abs=3)
    line = next(line for line in ablation_tables.table_lines("RG Table 1", rows, {}) if line.startswith("| SG |"))
    assert "97.29 / -" in line and rows["SG"]["decided"]
    assert any(line.startswith("| SG |") for line in ablation_tables.table_lines("RG Table 5", rows, {}))
    told = json.loads((out / "figure-5.json").read_text())
    assert told["figure"] == "RG Fig. 5 and 8a" and 0 < told["numbers"]["share_within_bounds"] <= 1
    assert (out / "figure-5.svg").stat().st_size > 1000


def test_racers_rows_stand_on_what_is_trained_here(bench: Bench, tmp_path: Path,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    short = ("schedules.reward.steps=10", "schedules.cql.steps=6")
    monkeypatch.setitem(ROWS, "q-network", dataclasses.replace(ROWS["q-network"], settings=short))
    ablate.run_racer(bench, tmp_path, ["racer-supervised"], 1, None)
    told = json.loads((tmp_path / "table.json").read_text())
    assert set(told["rows"]) == {"supervised"} and (tmp_path / "supervised-1.json").exists()
    assert np.isfinite(told["rows"]["supervised"]["figures"]["judge_return"]["mean"])


def test_all_tables_and_figures_of_both_papers_are_there() -> None:
    figures = " ".join(own.paper for own in ablation_figures.FIGURES.values()) + " ".join(TABLES) + " ".join(ELSEWHERE)
    for number in (2, 5, 6, "8a", "8b", 9, 10, 11, 12, 13, 14, 15, 16, 17, 18):
        assert re.search(rf"\b{number}\b", figures), number
    assert {f"RG Table {k}" for k in range(1, 8)} | {"RACER Table 1"} <= set(TABLES)
    assert list(RACER.values()) == list(racer_ablation.ROWS) and set(racer_ablation.PAPER) <= set(RACER.values())
    for own in ablation_figures.FIGURES.values():
        assert set(own.rows) <= {*ROWS, *REFERENCES}


def test_what_cannot_be_asked(tiny_store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = ["--data", str(tiny_store), "--work", str(tmp_path)]
    for wrong, word in ((["--only", "nothing"], "choose among"), (["--system", "ours=."], "name of a row"),
                        (["--seeds", "0"], "--seeds 0"), (["--budget", "-1"], "--budget")):
        with pytest.raises(SystemExit):
            ablate.main([*told, *wrong])
        assert word in capsys.readouterr().err
    with pytest.raises(SystemExit):
        ablate.main([])


def test_the_list_shows_every_row(capsys: pytest.CaptureFixture[str]) -> None:
    assert ablate.main(["--list"]) == 0
    told = capsys.readouterr().out
    names = (*ablate.everything(), *REFERENCES, *CONTROLS)
    assert all(re.search(rf"^{re.escape(name)} ", told, re.MULTILINE) for name in names)
    assert "--set rhythm.beats.rule=even" in told and "RG Table 7" in told and "RG Fig. 18" in told
    assert all(f"python -m {command}" in told for command in ELSEWHERE.values())
