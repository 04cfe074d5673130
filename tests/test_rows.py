"""Rows, cells, tables and claims: what is compared with what, and that tables of stored cells keep their values."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from data_module.errors import InputError
from eval.commands import ABLATE
from eval.context import EvalContext
from eval.rows import (
    CONTROLS,
    OURS,
    REFERENCES,
    ROWS,
    SYSTEMS,
    TABLES,
    claims,
    controls,
    decisions,
    racer,
    rg,
    tables,
)
from eval.rows.cells import Cell, Cells, CellStore, summaries
from eval.rows.claims import CLAIMS, PaperClaim
from eval.rows.effects import EFFECTS
from eval.rows.row import COLUMNS, DECISIONS
from eval.rows.verdicts import ALIKE, FAILS, HOLDS, NO_TEST, UNDECIDED, Decision
from eval.runner.ablate import FIGURES
from eval.runner.rg import RgRows, configured
from eval.stats import Interval
from eval.table import NO_BUNDLE, NOT_RECORDED, Column, Provenance, Table, dumps, load, loads, save
from gesticulator.bundle import config as configs
from gesticulator.training import presets
from gesticulator.training.stages import (
    CONTRAST,
    GENERATOR,
    INTERPRETER,
    INTERPRETER_TEXT,
    LEXICON,
    SPEECH,
    STYLE,
    STYLE_TEXT,
    Run,
    Stage,
    wanted,
)

STORED = Path(__file__).parent / "data" / "cells"
"""Three rows of a real run at three seeds, and the figures that they had when it was made."""
STAGES: dict[str, Stage[Any]] = {stage.name: stage for stage in (
    SPEECH, CONTRAST, LEXICON, INTERPRETER, INTERPRETER_TEXT, GENERATOR, STYLE, STYLE_TEXT)}


# ------------------------------------------------------------------------------------------------------------- rows

@pytest.mark.parametrize("preset", list(rg.PRESETS))
def test_every_row_changes_something_and_no_two_are_equal(preset: str) -> None:
    base = rg.PRESETS[preset]()
    seen: dict[str, str] = {}
    for name, row in rg.ROWS.items():
        variant = json.dumps([configs.to_dict(configured(base, name)), row.interpreter, row.style, row.split])
        assert variant not in seen, f"{name} is {seen.get(variant)} again"
        seen[variant] = name
        assert name == OURS or variant != json.dumps([configs.to_dict(base), "lstm", "interpreted", "test"])
        assert row.question and row.training == "stages"
ABOUT = Provenance("gesticulator ablate", "abc1234", NO_BUNDLE, "2026-01-02", NOT_RECORDED)


def test_the_row_without_the_hint_lets_any_lexeme_sound_in_silence() -> None:
    base = rg.ablation()
    changed = configured(base, "no-hint").silence
    assert base.silence.hint and base.silence.mask and not changed.hint and not changed.mask


@pytest.mark.parametrize("name", ["default", "tiny"])
def test_every_row_of_racer_is_another_and_trains_equally_long(name: str) -> None:
    base = presets.preset(name)
    seen: dict[str, list[str]] = {}
    for row_name, row in racer.ROWS.items():
        config = configs.with_settings(base, (*racer.PRESETS["ablation"], *row.settings))
        assert (config.cql.width, config.schedules.cql.steps, config.schedules.cql.batch) == (64, 400, 32)
        # Temporal differences are learned all along, by targets that are copied far more often than values reach.
        assert config.cql.warm_up == 0 and 400 / config.cql.copy_every >= 5 / (1 - min(config.cql.gamma, 0.9)) - 1e-9
        assert (row.matched == "") == (not row_name.endswith("-matched"))
        told = json.dumps([configs.to_dict(config), row.training, row.scale, row.matched != ""])
        seen.setdefault(told, []).append(row_name)
    twin = f"racer-alpha={base.cql.conservative:g}"
    assert [own for own in seen.values() if len(own) > 1] == [
        [racer.OURS, twin], [f"{racer.OURS}-matched", f"{twin}-matched"]], "one alpha is ours already"
    same = racer.twins(base)
    assert {row for row, first in same.items() if row != first} == {twin, f"{twin}-matched"}


def test_every_row_is_compared_at_arg_max_and_at_equal_entropy() -> None:
    alone = [name for name, row in racer.ROWS.items() if not row.matched]
    assert {row.matched for row in racer.ROWS.values() if row.matched} == set(alone)
    for name in alone:
        twin = racer.ROWS[f"{name}-matched"]
        assert (twin.settings, twin.training) == (racer.ROWS[name].settings, racer.ROWS[name].training)


def test_racers_rows_are_what_the_paper_says() -> None:
    base = presets.preset("default")
    of = {name.removeprefix("racer-"): configs.with_settings(base, row.settings) for name, row in racer.ROWS.items()}
    assert of["supervised"].cql == dataclasses.replace(base.cql, temporal=0.0)
    assert of["dqn"].cql == dataclasses.replace(base.cql, conservative=0.0, warm_up=0.0)
    assert of["distance"].episodes == dataclasses.replace(base.episodes, reward="distance")
    assert of["literal"].episodes.shares == presets.LITERAL.shares
    assert of["alpha=10"].cql.conservative == 10.0 and of["cql"] == base
    assert set(racer.PAPER) <= set(racer.ROWS) and "return" not in racer.PAPER["racer-distance"]


def test_tables_hold_rows_and_columns_that_there_are() -> None:
    for title, table in TABLES.items():
        papers = {column.paper for column in table.columns.values()}
        for line in table.lines:
            assert line.row in (*ROWS, *REFERENCES, *SYSTEMS), title
            assert line.row in (*REFERENCES, *SYSTEMS) or ROWS[line.row].split == table.split
            if title in rg.TABLES:
                assert set(line.paper) <= papers, f"a figure of the paper that {title} would not show"
    assert {line.row for table in TABLES.values() for line in table.lines} >= set(ROWS)
    assert dict(zip(("maje", "mad", "fgd", "pmb"), ((70.10, 30.07), (2.51, 3.53), (29.75, 5.22), (85.74, 83.10)),
                    strict=True)) == TABLES["RG Table 1"].lines[6].paper, "w/o SC"


def test_all_tables_and_figures_of_both_papers_are_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert ABLATE.main("gesticulator ablate", ["--list"]) == 0
    shown = capsys.readouterr().out
    for name in (*ROWS, *FIGURES, *REFERENCES, *CONTROLS):
        assert re.search(rf"^{re.escape(name)} ", shown, re.MULTILINE), name
    for number in (2, 5, 6, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18):
        assert re.search(rf"RG Fig\. {number}\b", shown), number
    for title in (*(f"RG Table {k}" for k in range(1, 8)), "RACER Table 1", "RACER Table 2", *TABLES):
        assert title in shown
    assert "--set rhythm.beats.rule=even" in shown


# ---------------------------------------------------------------------------------------------- what a row trains

def context_of(config: configs.Config) -> RgRows:
    """Keys alone: nothing is opened."""
    store = SimpleNamespace(fingerprint="0" * 64, recordings=[])
    return RgRows(EvalContext(Run(config, store, Path())))  # type: ignore[arg-type]


def test_the_preset_is_the_papers_system_made_short_and_hears_what_the_shipped_one_hears() -> None:
    ours, theirs, shipped = rg.ablation(), presets.preset("regression"), presets.preset("default")
    # But for the robust features, which are younger than the rows' figures.
    assert ours.front_end == dataclasses.replace(shipped.front_end, robust=False)
    assert "speech" not in [stage.name for stage in wanted(ours)]
    assert (ours.lexicon, ours.rhythm, ours.silence, ours.selection) == (
        theirs.lexicon, theirs.rhythm, theirs.silence, theirs.selection)
    for name in ("lexicon", "generator", "interpreter", "interpreter_text", "style"):
        short, long = getattr(ours.schedules, name), getattr(theirs.schedules, name)
        assert short.steps * short.batch < long.steps * long.batch


@pytest.mark.parametrize(("row", "same", "other"), [
    ("no-style", "interpreter lexicon", "generator style"),
    ("no-position", "interpreter lexicon", "generator style"),
    ("audio-only", "generator style lexicon", "interpreter interpreter_text"),
    ("style-reads", "generator interpreter interpreter_text lexicon", "style_text"),
    ("statistical", "generator style interpreter lexicon", ""),
    ("no-hint", "lexicon", "interpreter"),
    ("no-augmentation", "interpreter lexicon", "generator style"),
    ("pose-aware", "generator style lexicon", "interpreter"),
    ("flow", "", "lexicon generator interpreter"),
    ("no-segmentation", "", "lexicon generator interpreter style"),
    ("no-lexemes", "", "lexicon generator interpreter style")])
def test_a_row_trains_what_its_settings_change_and_nothing_else(row: str, same: str, other: str) -> None:
    context = context_of(rg.ablation())
    (_, mine), (_, theirs) = context.runs(row, 1), context.runs(OURS, 1)
    for names, equal in ((same, True), (other, False)):
        for name in names.split():
            assert (mine.key(STAGES[name]) == theirs.key(STAGES[name])) == equal, name


def test_a_seed_shares_speech_levels_and_lexicon_and_nothing_that_another_command_would_take_for_its_own() -> None:
    config = rg.ablation()
    context = context_of(config)
    one, two = (context.runs(OURS, seed)[1] for seed in (config.seed, config.seed + 1))
    assert one.key(LEXICON) == two.key(LEXICON) == context.first.key(LEXICON)
    assert one.key(GENERATOR) == context.first.key(GENERATOR), "as the training command would"
    plain = context_of(dataclasses.replace(config, seed=config.seed + 1)).first
    assert two.key(GENERATOR) not in (one.key(GENERATOR), plain.key(GENERATOR))
    assert one.seed(GENERATOR) != two.seed(GENERATOR)
    learned = rg.tiny()  # hears through an encoder that is trained first
    cut = context_of(learned).runs("no-segmentation", learned.seed)[1]
    alone = context_of(configured(learned, "no-segmentation")).first
    assert cut.key(GENERATOR) != alone.key(GENERATOR), "it hears through the speech encoder of all rows"


@pytest.mark.parametrize("preset", list(rg.PRESETS))
def test_the_row_of_movements_is_the_shipped_systems_and_all_others_are_the_papers(preset: str) -> None:
    base, shipped = rg.PRESETS[preset](), presets.preset("default")
    ours = configured(base, "flow")
    for read in (lambda c: c.system, lambda c: c.lexicon.size, lambda c: c.lexicon.quantizer,
                 lambda c: c.lexicon.code_width, lambda c: c.lexicon.commitment, lambda c: c.lexicon.revive_below,
                 lambda c: c.lexicon.warm_up,
                 lambda c: c.motion.least_deviation, lambda c: c.motion.smoothing,
                 lambda c: c.silence.hint, lambda c: c.silence.mask, lambda c: c.interpreter.pose_features,
                 lambda c: c.interpreter.memory):
        assert read(ours) == read(shipped)
    assert not ours.generator.styled and not ours.generator.units, "the row asks about lexicon and head alone"
    assert ours.front_end == base.front_end and ours.schedules.generator.steps == base.schedules.generator.steps
    for name in rg.ROWS:
        other = configured(base, name)
        assert name in ("flow", "k-means") or other.system == "paper"


# -------------------------------------------------------------------------------------------------------------- cells

def cell(row: str, seed: int, value: float, clips: int = 2, key: str = "k", shared: str = "s") -> Cell:
    """Every column is `value` on the first clip, one more on the next."""
    columns = [*COLUMNS, *(key for part in DECISIONS.values() for key in part)]
    return {"row": row, "seed": seed, "key": key, "shared": shared, "question": "?", "settings": [],
            "seconds": {"training": 3.0}, "sets": {"pmb_curve": {"percent": [1.0] * 10}},
            "clips": [{"name": str(k), "decisions": 2 * k + 1, **dict.fromkeys(columns, value + k)}
                      for k in range(clips)]}


def cells_of(**rows: list[float]) -> Cells:
    """One value a seed."""
    return {name.replace("_", "-"): {seed: cell(name, seed, value) for seed, value in enumerate(values, start=1)}
            for name, values in rows.items()}


def test_cells_come_back_and_what_was_cut_short_is_made_again(tmp_path: Path) -> None:
    store = CellStore(tmp_path / "new")
    assert store.read() == {} and store.finished("ours", 1, "k") is None
    first, second = cell("ours", 1, 1.0), cell("ours", 2, float("nan"))
    store.add(first)
    store.add(second)
    assert dumps(store.finished("ours", 2, "k")) == dumps(second) and store.finished("ours", 2, "other") is None
    with store.file.open("a") as stream:
        stream.write(dumps(cell("no-style", 1, 5.0))[:40])  # a machine that stopped while it wrote
    assert set(store.read()) == {"ours"}
    store.add(cell("ours", 1, 7.0))
    assert store.read()["ours"][1]["clips"][0]["maje"] == 7.0, "the later line counts, on a line of its own"
    assert sorted(store.read()["ours"]) == [1, 2]


def test_rows_that_stand_on_different_things_are_not_compared(tmp_path: Path) -> None:
    store = CellStore(tmp_path)
    store.add(cell("ours", 1, 1.0, shared="a"))
    store.add(cell("racer-cql", 1, 1.0, shared="its own bundle"))
    assert set(store.read()) == {"ours", "racer-cql"}
    store.add(cell("ours", 2, 1.0, shared="b"))
    with pytest.raises(InputError, match="different presets"):
        store.read()
    assert set(store.read({"rg": "b"})["ours"]) == {2} and "racer-cql" in store.read({"rg": "b"})


def test_figures_are_means_over_seeds_and_clips_by_their_weights() -> None:
    rows = summaries({**cells_of(ours=[1.0, 2.0, 3.0]), "racer-cql": {1: cell("racer-cql", 1, 1.0)}})
    assert rows["ours"]["figures"]["maje"].mean == 2.5 and rows["ours"]["decided"]
    assert rows["ours"]["seconds"] == [3.0] * 3
    figures = rows["racer-cql"]["figures"]
    assert figures["return"].mean == 1.5 and figures["cosine"].mean == 1.75, "clips of 1 and of 3 decisions"
    assert not rows["racer-cql"]["decided"]
    late = {seed: {**cell("ours", seed, 1.0), "late_gains": {"generator": gain, "style": 0.0}}
            for seed, gain in ((1, 0.002), (2, 0.03))}
    settling = tables.training_table(summaries({"ours": late, **cells_of(no_style=[1.0])})).rows
    assert settling["ours"]["late"] == pytest.approx(3.0) and settling["no-style"]["late"] is None
    half = cell("racer-cql", 1, 1.0)
    del half["clips"][1]["maje"]  # it was not played
    assert summaries({"racer-cql": {1: half}})["racer-cql"]["figures"]["maje"].text(1) == "1.0"


def test_tables_of_stored_cells_keep_their_values() -> None:
    cells = CellStore(STORED).read()
    expected = loads((STORED / "expected.json").read_text())
    rows = summaries(cells)
    count = 0
    for name, figures in expected["rows"].items():
        for key, value in figures.items():
            assert rows[name]["figures"][key].to_dict() == pytest.approx(value, rel=1e-9, nan_ok=True), (name, key)
            count += 1
    found = {(claim["where"], claim["first"], claim["second"], claim["metric"]): claim
             for claim in decisions.claims_table(cells).facts["claims"]}
    for held in expected["claims"]:
        own = found[held["where"], held["first"], held["second"], held["metric"]]
        assert own["verdict"] == held["verdict"] and own["difference"] == pytest.approx(held["difference"], rel=1e-9)
    assert count > 80 and len(expected["claims"]) > 5


# ------------------------------------------------------------------------------------------------------------- tables

def shown(table: Table) -> str:
    return "\n".join("|".join(row) for row in table.cells())


def test_tables_show_ours_beside_the_papers_and_mark_what_is_undecided() -> None:
    rows = summaries(cells_of(ours=[1.0] * 3, no_style=[2.0]))
    table = tables.paper_table("RG Table 1", rows, {"no-lexemes": "400 s counted"})
    one_seed = table.rows["Ours (w/o ZC) (undecided: 1 of 3 seeds)"]["maje"]
    assert isinstance(one_seed, Interval) and one_seed.mean == 2.5 and one_seed.n == 2
    assert table.rows["Ours (w/o ZC) (undecided: 1 of 3 seeds)"]["maje, paper"] == "52.85 / 21.33"
    assert table.rows["Ours (w/o SC) (400 s counted)"]["maje"] is None
    assert "SG (not handed in)" in table.rows and "Ours (audio only) (not run)" in table.rows
    assert table.rows["SG (not handed in)"]["maje, paper"] == "97.29 / -"


def test_racers_table_pairs_seeds_and_names_what_is_the_same() -> None:
    cells = {racer.SUPERVISED: {s: cell(racer.SUPERVISED, s, s) for s in (1, 2)},
             racer.OURS: {s: cell(racer.OURS, s, s + 2.0) for s in (1, 2, 3)},
             "racer-alpha=1": {s: {**cell("racer-alpha=1", s, s + 2.0), "run_as": racer.OURS} for s in (1, 2, 3)}}
    rows = summaries(cells)
    first = tables.paper_table("RACER Table 2, training reward", rows, {})
    assert list(first.rows) == ["racer-supervised (undecided: 2 of 3 seeds)", "racer-cql", "racer-alpha=1 = racer-cql"]
    assert first.rows["racer-cql"]["return, paper"] == "9.34"
    apart = tables.racer_differences(cells)[0]
    assert list(apart.rows) == ["racer-cql - racer-supervised"], "not with itself, nor under another name"
    cosine: Any = apart.rows["racer-cql - racer-supervised"]["cosine"]
    assert cosine.text(1) == "2.0 [2.0, 2.0]"


def test_a_control_beats_a_column_by_its_direction() -> None:
    def rows(**means: float) -> dict[str, dict[str, dict[str, Interval]]]:
        return {name: {"figures": {key: Interval.exact(value, 1) for key in COLUMNS}} for name, value in means.items()}

    found = rows(ours=5.0, performer=4.0, jitter=3.2, still=9.0, halves=0.0)
    assert tables.beaten(found, "maje") == {"jitter": 3.2}, "less is better"
    assert tables.beaten(found, "pmb") == {"still": 9.0}, "more is better"
    assert tables.beaten(found, "diversity") == {"jitter": 3.2}, "near the performer's is better"
    assert tables.beaten(found, "accuracy") == {} == tables.beaten(rows(jitter=1.0), "maje")


def test_tables_and_claims_are_drawn_again_from_the_cells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "ablation"
    with pytest.raises(SystemExit) as error:
        ABLATE.main("gesticulator ablate", ["--tables", "--out", str(out)])
    assert error.value.code == 2 and "holds no cells" in capsys.readouterr().err
    for seed in (1, 2, 3):
        CellStore(out).add(cell(OURS, seed, 1.0 * seed))
        CellStore(out).add(cell("no-style", seed, 2.0 * seed))
    facts = {"preset": "tiny", "shared": {}, "refused": {}, "store": {"test_recordings": 2}}
    save([Table("Ablation", {}, {}, facts=facts)], out / "table.json", ABOUT)
    step = {"mean": 2.0, "low": 1.0, "high": 3.0, "n": 5}
    save([Table("x", {"a": Column("a")}, {}, facts={"claim": [step, {**step, "low": 0.4}]})],
         tmp_path / "earlier" / "style_editing.json", ABOUT)
    assert ABLATE.main("gesticulator ablate", ["--tables", "--out", str(out)]) == 0
    first = load(out / "table.json")[0]
    assert first.facts["rows"]["no-style"]["figures"]["fgd"]["mean"] == 4.5 and first.facts["preset"] == "tiny"
    table = next(one for one in load(out / "table.json") if one.title == "Ours less each row")
    apart = table.rows["no-style"]["fgd"]
    assert isinstance(apart, Interval) and apart.mean == -2.0 and apart.low < -3.0, "t of two degrees of freedom"
    found = {claim["where"]: claim for claim in load(tmp_path / "claims.json")[0].facts["claims"]}
    assert found["RG Fig. 10"]["verdict"] == HOLDS and found["RG Fig. 10"]["difference"]["low"] == 0.4
    assert found["RG Fig. 13"]["verdict"] == UNDECIDED


def test_a_table_of_earlier_weights_answers_until_there_is_a_new_one(tmp_path: Path) -> None:
    for folder, mean in (("earlier", 2.0), (".", 3.0)):
        held = {"mean": mean, "low": 1.0, "high": 4.0, "n": 5}
        save([Table("x", {"a": Column("a")}, {}, facts={"claim": [held]})], tmp_path / folder / "languages.json", ABOUT)
        assert decisions.probed(tmp_path)["RG Fig. 13"].value.mean == mean


# ------------------------------------------------------------------------------------------------------------- claims

LOWER = PaperClaim("RG Table 1", "ours", "no-style", "fgd", "below")
HIGHER = PaperClaim("RG Table 1", "ours", "no-lexemes", "pmb_above_chance")


def cells_by(metric: str, **rows: list[list[float]]) -> Cells:
    """Cells with metric = rows[row][seed][clip]; the performer and the controls have no seed."""
    return {name.replace("_", "-"): {seed: {"clips": [{"name": f"clip {k}", metric: value}
                                                      for k, value in enumerate(clips)]}
                                     for seed, clips in enumerate(seeds, start=name not in ("performer", *CONTROLS))}
            for name, seeds in rows.items()}


def fgd_cells(**rows: list[list[float]]) -> Cells:
    """Cells of FGD, and controls that are worse than anything else."""
    clips = max(len(seeds[0]) for seeds in rows.values())
    return cells_by("fgd", **rows, shuffled=[[1e4 + k for k in range(clips)]])


def test_differences_are_paired_over_seeds_and_clips() -> None:
    rng = np.random.default_rng(0)
    hard = rng.normal(3, 0.1, size=(3, 1)) + rng.normal(10, 3, size=12)  # what clips and seeds differ by is far more
    better = hard - 2 + rng.normal(0, 0.3, size=(3, 12))
    found = decisions.judged(LOWER, fgd_cells(ours=better.tolist(), no_style=hard.tolist()))
    assert found.word == HOLDS and found.over == (3, 12)
    assert found.value.mean == pytest.approx(-2, abs=0.2)
    assert found.margin == pytest.approx((12.53 - 10.78) / 12.53 / 2 * hard.mean(), rel=0.01), "as a share"
    other = decisions.judged(LOWER, fgd_cells(ours=hard.tolist(), no_style=better.tolist()))
    assert other.word == FAILS and other.reason.startswith("the opposite")
    other = decisions.judged(LOWER, fgd_cells(ours=better.tolist(), no_style=rng.normal(10, 9, size=(3, 12)).tolist()))
    assert other.word == UNDECIDED and len(other.needed) == 2


def test_the_margin_is_half_of_the_papers_effect() -> None:
    cells = fgd_cells(ours=[[1.0, 2.0]] * 3, no_style=[[2.0, 6.0]] * 3)
    assert claims.margin_of(LOWER, cells) == pytest.approx((12.53 - 10.78) / 12.53 / 2 * 4.0)
    assert claims.margin_of(HIGHER, {}) == pytest.approx((91.36 - 85.74) / 2)
    assert claims.margin_of(PaperClaim("RG Table 1", OURS, "no-style", "pmb_above_chance", "alike"), {}) == 5.0
    assert np.isnan(claims.margin_of(PaperClaim("RG Fig. 18", "size-100", "size-10", "fgd", "below"), cells))


def test_a_claim_needs_a_printed_effect_and_a_metric_that_passes_its_controls() -> None:
    rows = {"ours": [[50.0, 51.0, 52.0]] * 3, "no_lexemes": [[30.0, 31.0, 32.5]] * 3}
    wrong = [[5.0, 6.0, 7.5]]
    assert decisions.judged(HIGHER, cells_by("pmb_above_chance", **rows, shuffled=wrong, jitter=wrong)).word == HOLDS
    found = decisions.judged(HIGHER, cells_by("pmb_above_chance", **rows, shuffled=wrong, jitter=[[49.0, 51.5, 53.0]]))
    assert found.word == NO_TEST and found.reason == "jitter no worse than ours"
    assert decisions.judged(HIGHER, cells_by("pmb_above_chance", **rows)).reason == "its controls were not run"
    silent = PaperClaim("RG 6.4.1", OURS, "no-hint", "silence_speed", "below")
    found = decisions.judged(silent, cells_by("silence_speed", ours=[[1.0, 2.0, 3.0]] * 3,
                                              no_hint=[[2.0, 3.5, 4.0]] * 3, still=[[0.0, 1.1, 2.2]]))
    assert found.word == NO_TEST and found.reason == "the paper prints no effect"


def test_an_amount_is_less_in_a_still_body_and_not_more_in_noise() -> None:
    def reason(still: float, jitter: float) -> str:
        rows = {"ours": [[3.0, 3.1, 3.2]] * 3, "performer": [[4.0, 4.1, 4.2]], "still": [[still, still, still + 0.1]],
                "jitter": [[jitter, jitter + 0.1, jitter + 0.21]], "reversed": [[4.0, 4.1, 4.2]]}
        return controls.failing("diversity", cells_by("diversity", **rows))

    assert reason(0.0, 4.0) == ""
    assert reason(3.2, 4.0) == "still no worse than ours"
    assert "jitter has more than the performer" in reason(0.0, 5.0)


def test_returns_need_random_lexemes_that_earn_less(tmp_path: Path) -> None:
    def keep(random: float) -> str:
        rows = {name: {"return": Interval(mean, mean - 0.5, mean + 0.5, 8)} for name, mean in
                (("performer", 3.0), ("random", random), ("majority", 0.0))}
        table = Table("Policies: training reward", {"return": Column("return")}, rows)
        save([table], tmp_path / "policies.json", ABOUT)
        return controls.failing("return", {}, tmp_path)

    assert keep(1.0) == "" and keep(2.5) == "random lexemes not shown to earn less than the performer's"
    assert "not known" in controls.failing("return", {}, None)


def test_fewer_than_three_seeds_or_no_figure_decide_nothing() -> None:
    found = decisions.judged(LOWER, fgd_cells(ours=[[1.0, 1.5] * 5] * 2, no_style=[[2.0, 2.6] * 5] * 3))
    assert found.word == UNDECIDED and found.reason == "2 of 3 seeds"
    assert found.value.mean == pytest.approx(-1.05), "it is shown all the same"
    assert decisions.judged(LOWER, fgd_cells(ours=[[1.0]] * 3)).reason == "not run: no-style"
    empty = fgd_cells(ours=[[float("nan")] * 2] * 3, no_style=[[1.0] * 2] * 3)
    assert decisions.judged(LOWER, empty).reason == "no figure of a clip that both have"


def test_a_claim_without_a_valid_test_names_the_one_beside_it() -> None:
    numbers = {(claim.where, claim.first, claim.second, claim.metric): k for k, claim in enumerate(CLAIMS)}
    fgd, pmb = (numbers["RG Table 1", OURS, "no-lexemes", key] for key in ("fgd", "pmb_above_chance"))
    found = [Decision(NO_TEST if claim.metric == "fgd" else UNDECIDED) for claim in CLAIMS]
    assert decisions.beside(fgd, found) == pmb and decisions.beside(pmb, found) is None


def test_an_effect_has_the_verdict_of_its_first_claim_with_a_valid_test() -> None:
    names = [claim.name for claim in CLAIMS]
    first, second = next(effect for effect in EFFECTS if len(effect.claims) == 2).claims
    verdicts = {first: NO_TEST, second: FAILS}
    told = decisions.effects([Decision(verdicts.get(name, HOLDS)) for name in names])
    effect = next(one for one in told if names.index(second) + 1 in one["claims"])
    assert (effect["verdict"], effect["claim"]) == (FAILS, names.index(second) + 1)
    verdicts[first] = HOLDS
    told = decisions.effects([Decision(verdicts.get(name, UNDECIDED)) for name in names])
    assert any(one["verdict"] == HOLDS and one["claim"] == names.index(first) + 1 for one in told)
    assert len(set(names)) == len(names)


def test_only_seeds_and_clips_that_both_have_are_compared_and_the_performer_pairs_with_all() -> None:
    own = fgd_cells(ours=[[1.0, 2.0, 3.0]] * 3, no_style=[[5.0, 5.0]] * 2, performer=[[5.0, 6.0]])
    seeds, apart = tables.pairs(own["ours"], own["no-style"], "fgd")
    assert seeds == [1, 2] and apart.tolist() == [[-4.0, -3.0]] * 2
    assert tables.pairs(own["performer"], own["ours"], "fgd")[1].tolist() == [[4.0, 4.0]] * 3


def test_every_claim_is_of_rows_and_figures_that_there_are() -> None:
    assert len({(claim.where, claim.first, claim.second, claim.metric) for claim in CLAIMS}) == len(CLAIMS) == 83
    decisions = {key for part in DECISIONS.values() for key in part}
    for claim in (claim for claim in CLAIMS if not claim.needs):
        assert claim.says in ("above", "below", "alike")
        where = [table for title, table in TABLES.items() if title.split(",")[0] == claim.where]
        assert {claim.first, claim.second} <= {line.row for table in where for line in table.lines}
        assert claim.metric in (decisions if claim.where == claims.RACER_TABLE else COLUMNS)
        splits = {ROWS[name].split for name in (claim.first, claim.second) if name in ROWS}
        assert len(splits) == 1, "of one split"


def test_the_papers_numbers_bear_their_claims_out() -> None:
    """What is listed as a claim of the paper must be true of the paper's own figures."""
    numbered = 0
    for claim in CLAIMS:
        text = "" if claim.needs else claims.papers_numbers(claim)
        for place in filter(None, text.split("; ")):
            one, other = (float(part) for part in place.split(" ", 1)[1].split(" and "))
            numbered += 1
            if claim.says == "alike":
                assert abs(one - other) < ALIKE, claim
            else:
                assert (one > other) == (claim.says == "above") and one != other, claim
    assert numbered > 60
    first = next(c for c in CLAIMS if (c.where, c.second, c.metric) == ("RG Table 1", "no-lexemes", "fgd"))
    assert claims.papers_numbers(first) == "Trinity 10.78 and 29.75; TED 2.04 and 5.22"
    reward = next(c for c in CLAIMS if (c.second, c.metric) == ("racer-dqn", "return"))
    assert claims.papers_numbers(reward) == "Trinity 9.34 and 4.23"
