"""The ablation runner on networks of no size: what a row trains and plays, what stands beside it, how a run goes on."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from data_module.errors import InputError
from data_module.motion.bvh import read_bvh, write_bvh
from data_module.store import Store
from eval.ablate import figures as paper
from eval.ablate import racer
from eval.baselines.interpreters import RandomStyle
from eval.commands import ABLATE
from eval.context import EvalContext
from eval.metrics.gesture_features import RawFeatures
from eval.rows import CONTROLS, OURS, REFERENCES, ROWS, rg
from eval.rows.cells import CellStore, summaries
from eval.rows.claims import CLAIMS
from eval.rows.row import COLUMNS
from eval.runner import ablate
from eval.runner import rg as rg_rows
from eval.runner.rg import RgRows
from eval.runner.row import Ablation
from eval.stats import Interval
from eval.table import load, loads
from generator import losses
from gesticulator.bundle import config as configs
from gesticulator.pipeline import Gesticulator
from gesticulator.training.stages import LABELS, Run
from lexicon.movement import MovementLexicon

SHORT = ("schedules.speech.steps=1", "schedules.contrast.steps=1", "schedules.lexicon.steps=20",
         "schedules.generator.steps=6", "schedules.interpreter.steps=4", "schedules.style.steps=4")


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ablate")


@pytest.fixture(scope="module")
def ablation(tiny_store: Path, work: Path) -> Ablation:
    """The tiny preset, shorter still."""
    run = Run(configs.with_settings(rg.tiny(), SHORT), Store.open(tiny_store), work, progress=False)
    context = EvalContext(run, networks={"raw": RawFeatures(34, count=1)}, limit=1)
    return Ablation(RgRows(context), CellStore(work / "nowhere"))


def into(ablation: Ablation, out: Path) -> Ablation:
    """The same with another folder of cells."""
    return dataclasses.replace(ablation, cells=CellStore(out))


def mean(facts: dict[str, Any], row: str, column: str) -> float:
    return float(facts["rows"][row]["figures"][column].mean)


def test_no_style_code_costs_nothing() -> None:
    assert float(losses.style_divergence(torch.zeros(7, 0))) == 0.0
    assert float(losses.style_divergence(torch.zeros(0, 4))) == 0.0
    codes = torch.randn(500, 4, generator=torch.Generator().manual_seed(0))
    assert 0 <= float(losses.style_divergence(codes)) < 0.01


def test_random_codes_are_normal_and_repeat() -> None:
    def sampled(seed: int) -> np.ndarray:
        style = RandomStyle(8, seed)
        state, out = style.start(0), []
        for _ in range(400):
            code, state = style.step(state, None, 0)  # type: ignore[arg-type]
            out.append(code.numpy()[0])
        return np.array(out)

    assert np.array_equal(sampled(1), sampled(1)) and not np.array_equal(sampled(1), sampled(2))
    assert abs(sampled(1).mean()) < 0.05 and abs(sampled(1).std() - 1) < 0.05


def test_rows_and_figures_of_the_paper(ablation: Ablation, work: Path, tmp_path: Path) -> None:
    names = ["ours", "no-audio-no-style", "no-lexemes", "random-style", "style-editing"]
    drawn = {"figure-2": "svg", "figure-6": "png", "figure-9-ours": "png", "figure-9-performer": "png",
             "figure-10": "png", "figure-11": "svg", "figure-14": "svg", "figure-17": "png"}
    own = into(ablation, tmp_path / "ablation")
    facts = ablate.ablate(own, only=[*names, *drawn, "figure-16"], seeds=1)
    assert set(names) <= set(facts["rows"]) and "performer" in facts["rows"]
    assert facts["refused"] == {"figure-16": "not run: range-0.5-1.0, range-0.2-1.0"}
    assert read_bvh(work / "played" / "ours-1" / f"{own.rg.names('test')[0]}.bvh").fps > 10
    for name, kind in drawn.items():
        check_figure(own, name, kind)
    alone = own.cells.read()["no-lexemes"][1]["clips"][0]
    assert math.isnan(alone["accuracy"]), "it has no lexemes that could be right"
    assert alone["diversity"] >= 0, "its motion is read by the lexicon of ours"


def check_figure(own: Ablation, name: str, kind: str) -> None:
    figure = loads((own.cells.folder / f"{name}.json").read_text())
    assert figure["figure"].startswith("RG Fig.") and figure["caption"]
    assert (own.cells.folder / f"{name}.{kind}").stat().st_size > 1000


def test_the_command_goes_on_where_it_was_stopped(ablation: Ablation, work: Path, tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    own, anew = into(ablation, tmp_path / "ablation"), not list(work.glob("generator-*"))
    facts = ablate.ablate(own, only=["ours", "random-style", "figure-9-ours", "figure-16"], seeds=1)
    assert {"ours", "random-style", "performer"} <= set(facts["rows"])
    assert facts["refused"] == {"figure-16": "not run: range-0.5-1.0, range-0.2-1.0"}
    check_figure(own, "figure-9-ours", "png")
    cells = own.cells.read()
    one, random = cells["ours"][1], cells["random-style"][1]
    assert len(one["clips"]) == 1 and set(COLUMNS) <= set(one["clips"][0])
    assert 0 <= one["clips"][0]["accuracy"] <= 100 and one["sets"]["fgd"][0]["distance"] > 0
    assert (one["stages"]["generator"] > 0) is anew, "a test before this one may have trained the same"
    assert set(random["stages"].values()) == {0.0}, "the same weights, played anew"
    performer = cells["performer"][0]["clips"][0]
    assert performer["maje"] == 0 and performer["fgd"] == pytest.approx(0, abs=1e-9)
    titles = [table.title for table in load(own.cells.folder / "table.json")]
    assert "RG Table 1 (test)" in titles and sum(
        load(tmp_path / "claims.json")[0].facts["count"].values()) == len(CLAIMS)

    def nothing(*given: object) -> None:
        raise AssertionError("finished rows are reused")

    picture, stored = (own.cells.folder / "figure-9-ours.png").stat().st_mtime_ns, own.cells.file.read_text()
    with monkeypatch.context() as patched:
        patched.setattr(rg_rows, "assemble", nothing)
        ablate.ablate(own, only=["ours", "figure-9-ours"], seeds=1)
    assert own.cells.file.read_text() == stored
    assert (own.cells.folder / "figure-9-ours.png").stat().st_mtime_ns == picture, "a figure of the same rows stands"
    own.cells.file.write_text("".join(line for line in stored.splitlines(True) if '"row": "ours"' not in line)
                              + stored[:60])  # a commit of before, and a line that was cut short
    ablate.ablate(own, only=["ours"], seeds=1)
    assert own.cells.read()["ours"][1]["clips"] == one["clips"], "the same figures, measured again"


def test_controls_and_references_stand_beside_the_rows(ablation: Ablation, tmp_path: Path) -> None:
    facts = ablate.ablate(Ablation(RgRows(dataclasses.replace(
        ablation.context, limit=None)), CellStore(tmp_path / "a")), only=["ours"], seeds=1)
    rows = facts["rows"]
    figures = {name: {key: mean(facts, name, key) for key in COLUMNS} for name in (*REFERENCES, *CONTROLS)
               if name in rows}
    assert figures["performer"]["maje"] == figures["performer"]["mad"] == 0 and figures["jitter"]["maje"] > 1
    assert figures["still"]["speech_speed"] < 1e-6 and figures["performer"]["speech_speed"] > 0.05
    assert figures["jitter"]["mad"] > 10 * figures["still"]["mad"], "noise accelerates"
    assert figures["reversed"]["diversity"] > 0 and figures["shuffled"]["maje"] > 1
    assert math.isnan(figures["halves"]["maje"])
    assert figures["halves"]["fgd"] > figures["performer"]["fgd"], "no set is as near to itself as to another"
    table = next(one for one in load(tmp_path / "a" / "table.json") if one.title == "RG Table 1 (test)")
    assert sum(name.startswith("halves: ") for name in table.rows) == 1 and table.notes[-1].startswith("(!) ")
    assert table.columns["maje"].title == "MAJE (!)" and "jitter (" in "".join(table.notes)


def test_the_row_without_hint_and_mask_plays_other_lexemes_in_silence(ablation: Ablation) -> None:
    """With the mask on the row would play silent lexemes in silence, as `ours` does: it would test nothing."""
    bundles = {name: ablation.rg.trained(name, 1)[0] for name in (OURS, "no-hint")}
    recording = ablation.rg.shown
    own = {}
    for name, bundle in bundles.items():
        # A level prior over all lexemes: what is chosen in silence shows what may be chosen.
        made = Gesticulator(bundle)(recording.speech, speaker=recording.info.speaker, interpreter="lstm", seed=1,
                                    temperature=50.0)
        silent = made.lexemes[np.asarray(made.blocks.silent)]
        assert len(silent) >= 5
        own[name] = float(np.isin(silent, bundle.silent).mean())
    assert own[OURS] == 1.0 > own["no-hint"]
    hinted = [ablation.rg.runs(name, 1)[1].get(LABELS).hinted for name in (OURS, "no-hint")]
    assert not np.array_equal(hinted[0], hinted[1])


def test_beats_and_sizes_are_drawn_from_what_was_kept(ablation: Ablation, monkeypatch: pytest.MonkeyPatch
                                                      ) -> None:
    beats, onsets, edges = np.arange(0.5, 20, 0.5), np.arange(0.55, 20, 0.5), np.arange(0, 20, 0.4)
    monkeypatch.setattr(RgRows, "clips", lambda self, name: [
        {"beats": beats if name == OURS else beats + 0.25, "onsets": onsets, "edges": edges}])
    _, caption, numbers = paper.FIGURES["figure-16"].draw(ablation.rg, {})
    assert "chance" in caption and numbers[OURS] == 100.0 and numbers["range-0.2-1.0"] < 100
    rows = {f"size-{size}": {"figures": {key: Interval(size / 7, 0.0, 99.0, 3) for key in COLUMNS}}
            for size in rg.SIZES[:3]}
    _, _, numbers = paper.FIGURES["figure-18"].draw(ablation.rg, rows)
    assert numbers["25 lexemes, FGD"] == pytest.approx(25 / 7)
    with pytest.raises(InputError, match="needs two sizes"):
        paper.FIGURES["figure-18"].draw(ablation.rg, {})


def test_the_listed_figures_are_those_that_are_drawn() -> None:
    assert tuple(paper.FIGURES) == ablate.FIGURES
    for figure in paper.FIGURES.values():
        assert set(figure.rows) <= {*ROWS, *REFERENCES}


def test_movements_and_their_head_are_a_row_judged_as_all_others_are(ablation: Ablation, tmp_path: Path) -> None:
    bundle, _ = ablation.rg.trained("flow", 1)
    assert isinstance(bundle.lexicon, MovementLexicon) and bundle.style is None
    facts = ablate.ablate(into(ablation, tmp_path / "a"), only=["flow"], seeds=1)
    figures = facts["rows"]["flow"]["figures"]
    assert math.isnan(figures["accuracy"].mean), "its lexemes are not those that all are judged by"
    means = {key: figures[key].mean for key in ("maje", "fgd", "diversity", "variance", "speech_speed")}
    assert np.isfinite(list(means.values())).all(), means
    table = next(one for one in load(tmp_path / "a" / "table.json") if one.title == "Movements (test)")
    assert [name.split(" (undecided")[0] for name in table.rows][2] == "movements, flow"


def test_another_systems_motion_is_a_row(ablation: Ablation, tmp_path: Path) -> None:
    recording, folder = ablation.rg.shown, tmp_path / "theirs"
    own = into(ablation, tmp_path / "out" / "ablation")
    folder.mkdir()
    write_bvh(folder / "nobody.bvh", recording.motion)
    with pytest.raises(InputError, match="no motion for a test recording"):
        ablate.ablate(own, only=["figure-5"], seeds=1, systems={"SG": folder})
    write_bvh(folder / f"{recording.info.name}.bvh", recording.motion)
    facts = ablate.ablate(own, only=["figure-5"], seeds=1, systems={"SG": folder})
    assert mean(facts, "SG", "maje") == pytest.approx(0, abs=0.1), "the performer's own motion, through a file"
    assert mean(facts, "SG", "pmb") == pytest.approx(mean(facts, "performer", "pmb"), abs=3)
    tables = {table.title: table for table in load(own.cells.folder / "table.json")}
    assert tables["RG Table 1 (test)"].rows["SG"]["maje, paper"] == "97.29 / -" and facts["rows"]["SG"]["decided"]
    assert "SG" in tables["RG Table 5 (test)"].rows
    figure = loads((own.cells.folder / "figure-5.json").read_text())
    assert figure["figure"] == "RG Fig. 5 and 8a" and 0 < figure["numbers"]["share_within_bounds"] <= 1


def test_racers_rows_stand_on_what_is_trained_here(ablation: Ablation, tmp_path: Path,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    short = ("schedules.reward.steps=4", "schedules.cql.steps=4", "cql.width=16", "cql.heads=2", "cql.layers=1")
    monkeypatch.setitem(ROWS, "q-network", dataclasses.replace(ROWS["q-network"], settings=short))
    own = into(ablation, tmp_path / "ablation")
    facts = ablate.ablate(own, only=["racer-supervised", "racer-alpha=0.1"], seeds=1)
    assert set(facts["rows"]) == {"racer-supervised", "racer-cql", "racer-alpha=0.1"}
    assert facts["rows"]["racer-alpha=0.1"]["run_as"] == "racer-cql"
    assert mean(facts, "racer-alpha=0.1", "return") == mean(facts, "racer-cql", "return")
    cell = CellStore(own.cells.folder).read()["racer-cql"][1]
    assert cell["clips"][0]["silent"] == 100.0 and cell["clips"][0]["pmb_narrow"] <= 100
    assert len(cell["sets"]["fgd"]) == 1 and set(summaries({"racer-cql": {1: cell}})) == {"racer-cql"}
    titles = [table.title for table in load(own.cells.folder / "table.json")]
    assert "RACER Table 2, training reward (test)" in titles
    before = own.cells.file.read_bytes()
    monkeypatch.setattr(racer.RacerRows, "measured", None)
    ablate.ablate(own, only=["racer-alpha=0.1"], seeds=1)
    assert own.cells.file.read_bytes() == before, "finished rows are reused"


def test_what_cannot_be_asked(tiny_store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["--data", str(tiny_store), "--work", str(tmp_path)]
    for wrong, word in ((["--only", "nothing"], "choose among"), (["--system", "ours=."], "name of a row"),
                        (["--seeds", "0"], "--seeds 0")):
        with pytest.raises(SystemExit) as error:
            ABLATE.main("gesticulator ablate", [*given, *wrong])
        assert error.value.code == 2 and word in capsys.readouterr().err
    with pytest.raises(SystemExit):
        ABLATE.main("gesticulator ablate", [])
