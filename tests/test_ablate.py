"""The ablation runner on networks of no size: what a row trains and plays, what stands beside it, how a run goes on."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from data_module.errors import InputError
from data_module.motion.bvh import read_bvh, write_bvh
from data_module.store import Store
from eval.ablate import command, figures, racer, run
from eval.ablate.ablation import Ablation
from eval.ablate.cells import CellStore
from eval.ablate.rows import COLUMNS, OURS, REFERENCES, ROWS, TABLES, base
from eval.ablate.run import RgRows
from eval.baselines.controls import reversed_in_time
from eval.baselines.interpreters import RandomStyle
from eval.context import EvalContext
from eval.metrics.gesture_features import RawFeatures
from eval.table import NO_BUNDLE, NOT_RECORDED, Provenance, load
from gesticulator.bundle import config as configs
from gesticulator.gesticulator import Gesticulator
from gesticulator.training.stages import LABELS, Run

SHORT = ("schedules.speech.steps=1", "schedules.contrast.steps=1", "schedules.lexicon.steps=20",
         "schedules.generator.steps=6", "schedules.interpreter.steps=4", "schedules.style.steps=4")


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ablate")


@pytest.fixture(scope="module")
def ablation(tiny_store: Path, work: Path) -> Ablation:
    """The tiny preset, shorter still."""
    first = Run(configs.with_settings(base("tiny"), SHORT), Store.open(tiny_store), work, progress=False)
    context = EvalContext(first, networks={"raw": RawFeatures(34)}, limit=1)
    return Ablation(RgRows(context), CellStore(work / "nowhere"))


def into(ablation: Ablation, out: Path) -> Ablation:
    """The same with another folder of cells."""
    return dataclasses.replace(ablation, cells=CellStore(out))


def ablate(here: Ablation, *only: str, **systems: Path) -> dict[str, Any]:
    """The facts of a run of these rows and figures at one seed."""
    return here.run(only, 1, systems, Provenance("gesticulator ablate", "abc1234", NO_BUNDLE, "2026-01-02",
                                                 NOT_RECORDED))


def mean(facts: dict[str, Any], row: str, column: str) -> float:
    return float(facts["rows"][row]["figures"][column].mean)


def test_random_codes_are_normal_and_repeat() -> None:
    def sampled(seed: int) -> np.ndarray:
        style = RandomStyle(8, seed)
        state, out = style.start(0), []
        for _ in range(400):
            code, state = style.step(state, None, 0)  # type: ignore[arg-type]
            out.append(code)
        return np.array(out)

    assert np.array_equal(sampled(1), sampled(1)) and not np.array_equal(sampled(1), sampled(2))
    assert abs(sampled(1).mean()) < 0.05 and abs(sampled(1).std() - 1) < 0.05


def test_rows_and_figures_of_the_paper(ablation: Ablation, tmp_path: Path) -> None:
    names = ["ours", "no-lexemes", "random-style", "style-editing"]
    drawn = {"figure-2": "svg", "figure-6": "png", "figure-9-ours": "png", "figure-9-performer": "png",
             "figure-10": "svg", "figure-11": "svg", "figure-14": "svg", "figure-17": "png"}
    here = into(ablation, tmp_path / "ablation")
    facts = ablate(here, *names, *drawn, "figure-16")
    assert set(names) <= set(facts["rows"]) and "performer" in facts["rows"]
    assert facts["refused"] == {"figure-16": "not run: range-0.5-1.0, range-0.2-1.0"}
    for name, kind in drawn.items():
        check_figure(here, name, kind)
    alone = here.cells.read()["no-lexemes"][1]["clips"][0]
    assert alone["own_code"] == pytest.approx(0, abs=1e-9), "its positive control says that its code does nothing"
    assert math.isnan(alone.get("accuracy", math.nan)), "it has no lexemes that could be right"
    assert alone["diversity"] >= 0, "its motion is read by the lexicon of ours"


def check_figure(here: Ablation, name: str, kind: str) -> None:
    assert (here.cells.out / f"{name}.{kind}").stat().st_size > 1000


def test_the_command_goes_on_where_it_was_stopped(ablation: Ablation, work: Path, tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    here = into(ablation, tmp_path / "ablation")
    facts = ablate(here, "ours", "random-style", "figure-9-ours", "figure-16")
    assert {"ours", "random-style", "performer"} <= set(facts["rows"])
    check_figure(here, "figure-9-ours", "png")
    cells = here.cells.read()
    one = cells["ours"][1]
    assert set(COLUMNS) - set(one["clips"][0]) == {"return", "judge_return", "lexeme_diversity", "longest_run"}
    assert 0 <= one["clips"][0]["accuracy"] <= 100 and one["clips"][0]["fgd"] > 0
    assert len(list(work.glob("generator-*/weights.safetensors"))) == len(list(work.glob("generator-*")))
    assert read_bvh(here.rg.folder("ours") / f"{here.rg.names('test')[0]}.bvh").fps > 10
    doses = [cells[f"jitter-{dose}"][0]["clips"][0] for dose in (1, 2, 3)]
    assert all(set(dose) == {"name", "fgd"} for dose in doses) and doses[0]["fgd"] < doses[2]["fgd"]
    performer = cells["performer"][0]["clips"][0]
    assert performer["maje"] == pytest.approx(0, abs=1e-9) and performer["fgd"] == pytest.approx(0, abs=1e-9)
    titles = [table.title for table in load(here.cells.out / "table.json")]
    count = load(tmp_path / "claims.json")[1].facts["count"]
    assert "RG Table 1 (test)" in titles and sum(count["valid"].values()) == sum(count["published"].values()) == 83

    def nothing(*given: object) -> None:
        raise AssertionError("finished rows are reused")

    files = {file: file.stat().st_mtime_ns for file in here.cells.out.glob("cells/*")}
    with monkeypatch.context() as patched:
        patched.setattr(run.stages, "assemble", nothing)
        ablate(here, "ours")
    assert {file: file.stat().st_mtime_ns for file in files} == files, "finished cells stand"
    here.cells.file("ours", 1).unlink()
    ablate(here, "ours")
    assert here.cells.read()["ours"][1]["clips"] == one["clips"], "the same figures, measured again"


def test_a_cell_has_the_figures_that_score_gives(ablation: Ablation) -> None:
    """The row's motion, scored as a user would: file in, figures out."""
    rg = ablation.rg
    scored = rg.scored(rg.names("test"))
    motions = reversed_in_time(rg.motions("performer"))
    cell = rg.summary(scored, motions)["clips"][0]
    row = scored.row("x", "system", motions)
    for key in ("maje", "mad", "pmb", "pmb_above_chance", "speech_speed"):
        value = float(row.values[COLUMNS[key].metric][0])
        assert cell[key] == pytest.approx(value, rel=1e-6, abs=1e-6, nan_ok=True), key
    assert cell["maje"] > 1
    assert cell["diversity"] == pytest.approx(row.sets["diversity"](np.arange(1))), "one clip is its own set"


def test_the_row_without_hint_and_mask_plays_other_lexemes_in_silence(ablation: Ablation) -> None:
    """With the mask on the row would play silent lexemes in silence, as `ours` does: it would test nothing."""
    bundles = {name: ablation.rg.trained(name, 1)[0] for name in (OURS, "no-hint")}
    recording = ablation.rg.recording(ablation.rg.names("test")[0])
    silent_share = {}
    for name, bundle in bundles.items():
        # A level prior over all lexemes: what is chosen in silence shows what may be chosen.
        performance = Gesticulator(bundle)(recording.speech, speaker=recording.info.speaker, interpreter="lstm", seed=1,
                                           temperature=50.0)
        silent = performance.lexemes[np.asarray(performance.blocks.silent)]
        assert len(silent) >= 5
        silent_share[name] = float(np.isin(silent, bundle.silent).mean())
    assert silent_share[OURS] == 1.0 > silent_share["no-hint"]
    hinted = [ablation.rg.run(name, 1).get(LABELS).hinted for name in (OURS, "no-hint")]
    assert not np.array_equal(hinted[0], hinted[1])


def test_the_listed_figures_are_those_that_are_drawn() -> None:
    assert tuple(figures.FIGURES) == command.FIGURES
    for figure in figures.FIGURES.values():
        assert set(figure.rows) <= {*ROWS, *REFERENCES}


def test_another_systems_motion_is_a_row(ablation: Ablation, tmp_path: Path) -> None:
    name, folder = ablation.rg.names("test")[0], tmp_path / "theirs"
    recording = ablation.rg.recording(name)
    here = into(ablation, tmp_path / "out" / "ablation")
    folder.mkdir()
    write_bvh(folder / "nobody.bvh", recording.motion)
    with pytest.raises(InputError, match="no motion for a test recording"):
        ablate(here, "figure-5", SG=folder)
    write_bvh(folder / f"{name}.bvh", recording.motion)
    facts = ablate(here, "figure-5", SG=folder)
    assert mean(facts, "SG", "maje") == pytest.approx(0, abs=0.1), "the performer's motion, through a file"
    assert mean(facts, "SG", "pmb") == pytest.approx(mean(facts, "performer", "pmb"), abs=3)
    tables = {table.title: table for table in load(here.cells.out / "table.json")}
    assert tables["RG Table 1 (test)"].rows["SG"]["maje, paper"] == "97.29 / -" and facts["rows"]["SG"]["decided"]
    assert "SG" in tables["RG Table 5 (test)"].rows


def test_racers_rows_stand_on_what_is_trained_here(ablation: Ablation, tmp_path: Path,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    short = ("schedules.reward.steps=4", "schedules.cql.steps=4", "cql.width=16", "cql.heads=2", "cql.layers=1")
    monkeypatch.setitem(ROWS, "q-network", msgspec.structs.replace(ROWS["q-network"], set=short))
    here = into(ablation, tmp_path / "ablation")
    names = ("racer-supervised", "racer-cql", "racer-performer", "racer-random", "racer-majority")
    facts = ablate(here, *names)
    assert set(facts["rows"]) == set(names)
    nats = {name: mean(facts, name, "lexeme_diversity") for name in names[2:]}
    assert nats["racer-random"] > nats["racer-performer"] and mean(facts, "racer-performer", "accuracy") == 100
    assert nats["racer-majority"] < nats["racer-random"], "one lexeme, and another in silence"
    assert math.isfinite(mean(facts, "racer-random", "return"))
    cell = here.cells.read()["racer-cql"][1]
    assert set(TABLES["RACER Table 2"].columns) <= set(cell["clips"][0]) and cell["clips"][0]["pmb"] <= 100
    assert "RACER Table 2 (test)" in [table.title for table in load(here.cells.out / "table.json")]
    before = here.cells.file("racer-cql", 1).stat().st_mtime_ns
    monkeypatch.setattr(racer.RacerRows, "measured", None)
    ablate(here, "racer-cql")
    assert here.cells.file("racer-cql", 1).stat().st_mtime_ns == before, "finished rows are reused"


def test_what_cannot_be_run(tiny_store: Path, tmp_path: Path, refused: Any) -> None:
    for wrong, word in ((["--only", "nothing"], "invalid choice"), (["--system", "ours=."], "name of a row"),
                        (["--seeds", "0"], "--seeds 0")):
        assert word in refused("ablate", "--data", tiny_store, "--work", tmp_path, *wrong)
    assert "--data" in refused("ablate")
