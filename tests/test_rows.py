"""Rows, cells and tables: what is compared with what, and that tables of stored cells give the same values."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from data_module.errors import InputError
from eval.ablate import cells as cell_figures
from eval.ablate import tables
from eval.ablate.cells import Cell, Cells, CellStore, summaries
from eval.ablate.command import FIGURES
from eval.ablate.rows import (
    COLUMNS,
    CONTROLS,
    OURS,
    RACER_OURS,
    RACER_SIZES,
    REFERENCES,
    ROWS,
    SYSTEMS,
    TABLES,
    base,
    is_racer,
)
from eval.ablate.run import RgRows, configured
from eval.commands import ABLATE
from eval.context import EvalContext
from eval.stats import Interval
from eval.table import NO_BUNDLE, NOT_RECORDED, Provenance, Table, dumps, load, save
from gesticulator.bundle import config as configs
from gesticulator.training import presets
from gesticulator.training.stages import GENERATOR, LEXICON, STAGES, Run

ABOUT = Provenance("gesticulator ablate", "abc1234", NO_BUNDLE, "2026-01-02", NOT_RECORDED)


# ------------------------------------------------------------------------------------------------------------- rows

@pytest.mark.parametrize("preset", RACER_SIZES)
def test_every_row_changes_something_and_no_two_are_equal(preset: str) -> None:
    papers = base(preset)
    variants: dict[str, str] = {}
    for name, row in ROWS.items():
        # RACER's rows stand on a bundle of the default preset, whose alpha is 1.
        default = configs.with_settings(presets.preset("default"), RACER_SIZES[preset])
        start = default if is_racer(name) else papers
        variant = json.dumps([configs.to_dict(configs.with_settings(start, row.set)), row.play, row.style, row.split,
                              row.train, row.scale])
        assert variant not in variants, f"{name} is {variants.get(variant)} again"
        variants[variant] = name
        assert row.ask and (row.train == "stages") != is_racer(name)


def test_rows_start_from_any_preset_of_the_papers_system_at_its_own_widths() -> None:
    for name in presets.PRESETS:
        if (own := presets.preset(name)).system == "paper":
            rows = base(name)
            assert (rows.name, rows.lexicon, rows.encoder) == (name, own.lexicon, own.encoder), "the preset as it is"
            assert not (rows.schedules.gate.steps or rows.schedules.cql.steps or rows.generator.use_control)
    with pytest.raises(InputError, match="paper-trinity"):
        base("default")


def test_racers_rows_are_what_the_paper_says_and_train_equally_long() -> None:
    base = configs.with_settings(presets.preset("default"), RACER_SIZES["paper-quick"])
    of = {name.removeprefix("racer-"): configs.with_settings(base, row.set) for name, row in ROWS.items()
          if is_racer(name)}
    for config in of.values():
        assert (config.cql.width, config.schedules.cql.steps, config.schedules.cql.batch) == (64, 400, 32)
        # Temporal differences are learned all along, by targets that are copied far more often than values reach.
        assert config.cql.warm_up == 0 and 400 / config.cql.copy_every >= 5 / (1 - min(config.cql.gamma, 0.9)) - 1e-9
    assert of["supervised"].cql == dataclasses.replace(base.cql, temporal=0.0)
    assert of["dqn"].cql == dataclasses.replace(base.cql, conservative=0.0)
    assert of["distance"].episodes == dataclasses.replace(base.episodes, reward="distance")
    assert of["literal"].episodes.shares == presets.LITERAL.shares
    assert of["alpha=10"].cql.conservative == 10.0 and of["cql"] == base
    assert TABLES["RACER Table 2"].printed("racer-distance", "return") == ()


def test_tables_hold_rows_and_columns_that_there_are() -> None:
    for title, table in TABLES.items():
        papers = {COLUMNS[key].paper for key in table.columns}
        for line in table.lines:
            assert line.row in (*ROWS, *REFERENCES, *SYSTEMS), title
            assert line.row in (*REFERENCES, *SYSTEMS) or ROWS[line.row].split == table.split
            assert set(line.paper) <= papers, f"a figure of the paper that {title} would not show"
            assert all(len(values) == len(table.places) for values in line.paper.values())
    assert {line.row for table in TABLES.values() for line in table.lines} >= set(ROWS)
    assert TABLES["RG Table 1"].lines[6].paper == {
        "maje": (70.10, 30.07), "mad": (2.51, 3.53), "fgd": (29.75, 5.22), "pmb": (85.74, 83.10)}, "w/o SC"


def test_all_tables_and_figures_of_both_papers_are_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert ABLATE.main("gesticulator ablate", ["--list"]) == 0
    shown = capsys.readouterr().out
    for name in (*ROWS, *FIGURES, *REFERENCES, *CONTROLS):
        assert re.search(rf"^{re.escape(name)} ", shown, re.MULTILINE), name
    for number in (2, 5, 6, 9, 11, 14, 15, 16, 17, 18):  # Figure 10 is not drawn: docs/coverage.md, RG-29
        assert re.search(rf"RG Fig\. {number}\b", shown), number
    for title in (*(f"RG Table {k}" for k in range(1, 8)), "RACER Table 1", "RACER Table 2"):
        assert title in shown
    assert "--set rhythm.beats.rule=even" in shown


# ---------------------------------------------------------------------------------------------- what a row trains

def context_of(config: configs.Config) -> RgRows:
    """Keys alone: nothing is opened."""
    store = SimpleNamespace(fingerprint="0" * 64, recordings=[])
    return RgRows(EvalContext(Run(config, store, Path())))  # type: ignore[arg-type]


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
    context = context_of(base("paper-quick"))
    changed, ours = context.run(row, 1), context.run(OURS, 1)
    for names, equal in ((same, True), (other, False)):
        for name in names.split():
            assert (changed.key(STAGES[name]) == ours.key(STAGES[name])) == equal, name


def test_a_seed_shares_speech_levels_and_nothing_that_another_command_would_take_for_its_own() -> None:
    config = base("paper-quick")
    context = context_of(config)
    one, two = (context.run(OURS, seed) for seed in (config.seed, config.seed + 1))
    assert one.key(LEXICON) == context.first.key(LEXICON) != two.key(LEXICON), "a seed is its lexicon, too"
    assert one.key(GENERATOR) == context.first.key(GENERATOR), "as the training command would"
    assert two.key(LEXICON) == context.run("no-style", config.seed + 1).key(LEXICON), "shared by the rows of a seed"
    plain = context_of(dataclasses.replace(config, seed=config.seed + 1)).first
    assert two.key(GENERATOR) not in (one.key(GENERATOR), plain.key(GENERATOR)), "the encoder is shared"
    assert one.seed(GENERATOR) != two.seed(GENERATOR)
    learned = base("tiny")  # hears through an encoder that is trained first
    cut = context_of(learned).run("no-segmentation", learned.seed)
    alone = context_of(configured(learned, "no-segmentation")).first
    assert cut.key(GENERATOR) != alone.key(GENERATOR), "it hears through the speech encoder of all rows"


# -------------------------------------------------------------------------------------------------------------- cells

def cell(row: str, seed: int, value: float, clips: int = 2, key: str = "k", shared: str = "s") -> Cell:
    """Every column is `value` on the first clip, one more on the next."""
    return {"row": row, "seed": seed, "key": key, "shared": shared,
            "sets": {"pmb_curve": {"percent": [1.0] * 10}},
            "clips": [{"name": str(k), "decisions": 2 * k + 1, **dict.fromkeys(COLUMNS, value + k)}
                      for k in range(clips)]}


def cells_of(**rows: list[float]) -> Cells:
    """One value a seed."""
    return {name.replace("_", "-"): {seed: cell(name, seed, value) for seed, value in enumerate(values, start=1)}
            for name, values in rows.items()}


def test_cells_come_back_and_a_broken_one_is_named(tmp_path: Path) -> None:
    store = CellStore(tmp_path / "new")
    assert store.read() == {} and store.finished("ours", 1, "k") is None
    first, second = cell("ours", 1, 1.0), cell("ours", 2, float("nan"))
    store.add(first)
    store.add(second)
    assert dumps(store.finished("ours", 2, "k")) == dumps(second) and store.finished("ours", 2, "other") is None
    store.add(cell("ours", 1, 7.0))
    assert store.read()["ours"][1]["clips"][0]["maje"] == 7.0 and list(store.read()["ours"]) == [1, 2]
    for text in (dumps(first)[:40], "{}", '{"row": 3}'):
        store.file("ours", 1).write_text(text)
        with pytest.raises(InputError, match=r"ours-1\.json"):
            store.read()


def test_figures_are_means_over_seeds_and_clips_by_their_weights() -> None:
    rows = summaries({**cells_of(ours=[1.0, 2.0, 3.0]), "racer-cql": {1: cell("racer-cql", 1, 1.0)}})
    assert rows["ours"]["figures"]["maje"].mean == 2.5 and rows["ours"]["decided"]
    figures = rows["racer-cql"]["figures"]
    assert figures["return"].mean == 1.5 and figures["accuracy"].mean == 1.75, "clips of 1 and of 3 decisions"
    assert not rows["racer-cql"]["decided"]
    half = cell("racer-cql", 1, 1.0)
    del half["clips"][1]["maje"]  # it was not played
    assert summaries({"racer-cql": {1: half}})["racer-cql"]["figures"]["maje"].text(1) == "1.0"


def test_only_seeds_and_clips_that_both_have_are_compared_and_the_performer_pairs_with_all() -> None:
    def rows(**of: list[list[float]]) -> Cells:
        return {name: {seed: {"clips": [{"name": str(k), "fgd": value} for k, value in enumerate(clips)]}
                       for seed, clips in enumerate(seeds, start=name != "performer")} for name, seeds in of.items()}

    every = rows(ours=[[1.0, 2.0, 3.0]] * 3, other=[[5.0, 5.0]] * 2, performer=[[5.0, 6.0]])
    seeds, apart = cell_figures.pairs(every["ours"], every["other"], "fgd")
    assert seeds == [1, 2] and apart.tolist() == [[-4.0, -3.0]] * 2
    assert cell_figures.pairs(every["performer"], every["ours"], "fgd")[1].tolist() == [[4.0, 4.0]] * 3


# ------------------------------------------------------------------------------------------------------------- tables

def test_tables_show_ours_beside_the_papers_and_mark_what_is_undecided() -> None:
    cells = cells_of(ours=[1.0] * 3, no_style=[2.0])
    table = tables.paper_table("RG Table 1", summaries(cells), cells)
    one_seed = table.rows["Ours (w/o ZC) (undecided: 1 of 3 seeds)"]["maje"]
    assert isinstance(one_seed, Interval) and one_seed.mean == 2.5 and one_seed.n == 2
    assert table.rows["Ours (w/o ZC) (undecided: 1 of 3 seeds)"]["maje, paper"] == "52.85 / 21.33"
    assert table.rows["Ours (w/o SC) (not run)"]["maje"] is None
    assert table.rows["SG (no motion given)"]["maje, paper"] == "97.29 / -"


def test_racers_table_has_its_rows_and_the_papers_figures() -> None:
    cells = {"racer-supervised": {s: cell("racer-supervised", s, s) for s in (1, 2)},
             RACER_OURS: {s: cell(RACER_OURS, s, s + 2.0) for s in (1, 2, 3)},
             "racer-dqn": {1: cell("racer-dqn", 1, 9.0)}}
    first = tables.paper_table("RACER Table 2", summaries(cells), cells)
    assert list(first.rows) == ["racer-supervised (undecided: 2 of 3 seeds)", "racer-dqn (undecided: 1 of 3 seeds)",
                                "racer-cql"]
    assert first.rows["racer-cql"]["return, paper"] == "9.34"


def test_tables_and_claims_are_written_again_from_the_cells(tmp_path: Path, refused: Callable[..., str]) -> None:
    out = tmp_path / "ablation"
    assert "holds no cells" in refused("ablate", "--tables", "--out", out)
    for seed in (1, 2, 3):
        CellStore(out).add(cell(OURS, seed, 1.0 * seed))
        CellStore(out).add(cell("no-style", seed, 2.0 * seed))
    facts = {"preset": "tiny", "refused": {}, "store": {"name": "performer", "test_recordings": 2}}
    save([Table("Ablation", {}, {}, facts=facts)], out / "table.json", ABOUT)
    assert ABLATE.main("gesticulator ablate", ["--tables", "--out", str(out)]) == 0
    opening, about, first, *_ = load(out / "table.json")
    assert "rows" not in about.facts and about.facts["preset"] == "tiny"
    assert first.rows["Ours (w/o ZC)"]["fgd"].mean == 4.5  # type: ignore[union-attr]
    page = (tmp_path / "claims.md").read_text().splitlines()
    assert opening.title == "The corpus is synthetic, made by rule" and page[2] == f"### {opening.title}"
    assert any("earlier system" in line and "abc1234" in line for line in page[:8]), "nothing says which it was"
    save([Table("Ablation", {}, {}, facts=facts | {"system": configs.digest(base("tiny"))})], out / "table.json", ABOUT)
    assert ABLATE.main("gesticulator ablate", ["--tables", "--out", str(out)]) == 0
    assert "earlier system" not in (tmp_path / "claims.md").read_text()
