"""The report: it shows every table that lies there, says what is lacking, and leads to what is there."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from data_module.errors import InputError
from eval import report, report_claims
from eval.commands import REPORT
from eval.context import without_work
from eval.metrics import METRICS
from eval.probes import PROBES
from eval.stats import Interval
from eval.table import (
    MOST_COLUMNS,
    NO_BUNDLE,
    NOT_RECORDED,
    Column,
    Provenance,
    Table,
    dumps,
    load_with_provenance,
    markdown,
    save,
)

DOCS = Path(__file__).parent.parent / "docs"
STORED = [file for file in sorted((DOCS / "results").rglob("*.json")) if file.with_suffix(".md").is_file()
          and file.stem not in ("cluster", "look_ahead")]
"""Files of tables; the pages of the cluster and of look-ahead are written by their benchmarks."""
SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><path d="M0 0L9 9"/></svg>'
ABOUT = Provenance("gesticulator probe x", "abc1234", NO_BUNDLE, "2026-01-02", NOT_RECORDED)
STORE = {"store": {"name": "made up", "fingerprint": "f" * 64}}


def one(title: str, value: float, facts: dict[str, Any] | None = None) -> Table:
    """A table of one cell, with a row that would break another."""
    rows = {"ours | mine": {"x": Interval(value, value - 1, value + 1, 3)}, "none": {"x": Interval.undefined()}}
    return Table(title, {"x": Column("figure", "mm", 1)}, rows, facts=facts or {})


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A folder of results as the commands leave it, without the probe of rewards."""
    folder = tmp_path / "docs" / "results"
    save([one("Claims", 1.0, {"count": {"holds": 3, "does not hold": 1}})], folder / "claims.json", ABOUT)
    save([one("RG Table 1 (test)", 12.5, STORE), one("RG Table 2 (test)", 13.5)],
         folder / "ablation" / "table.json", ABOUT)
    save([one("Vigour", 14.5), Table("Flags", {}, {}, facts={"flags": [
        {"metric": "jerk", "title": "joint jerk, m/s^3", "control": "reversed", "says": "does not differ"}]})],
        folder / "score.json", ABOUT)
    for number, (name, probe) in enumerate(report.probe_files().items()):
        if name != "rewards":
            save([one(f"of {name}", 100.0 + number)], folder / f"{name}.json",
                 replace(ABOUT, command=f"gesticulator probe {probe}"))
    for file, paper, numbers in (("figure-18", "RG Fig. 18", {"size-10": {"fgd": 1.5, "pmb": float("nan")}}),
                                 ("figure-5", "RG Fig. 5 and 8a", {"p": {"of": list(range(99))}})):
        (folder / "ablation" / f"{file}.json").write_text(dumps({
            "figure": paper, "title": f"what {file} shows", "caption": f"A caption of {file}.", "numbers": numbers}))
    (folder / "ablation" / "figure-18.svg").write_text(SVG)
    (folder / "limits.md").write_text("# Limits\n\nIt was made by rule, see [the corpus](corpus.md).\n")
    return folder


def test_every_table_is_there_under_its_heading(results: Path) -> None:
    text = report.document(report.gather(results), results.parent / "report")
    sections = dict(re.findall(r"^## ([^\n]+)\n(.*?)(?=^## |\Z)", text, flags=re.MULTILINE | re.DOTALL))
    assert list(sections)[:4] == ["What this is", "What this corpus cannot show", "Claims", "Tables"]
    assert "12.5 [11.5, 13.5]" in sections["Tables"] and "### RG Table 2 (test)" in sections["Tables"]
    assert "14.5 [13.5, 15.5]" in sections["Metrics and their controls"]
    assert "**Of 4 claims: 3 holds, 1 does not hold.**" in sections["What this is"]
    assert "joint jerk, m/s^3" in sections["What this is"] and "ffffffffffff" in sections["What this is"]
    for number, (name, probe) in enumerate(report.probe_files().items()):
        found = f"{100.0 + number:.1f} [" in sections["Other measurements"]
        assert found == (name != "rewards"), name
        assert f"`gesticulator probe {probe}`" in sections["Other measurements"]
    assert "`rewards.json` (`gesticulator probe rewards`)" in sections["Other measurements"]
    assert "ours \\| mine" in text and "nan" not in text.split("## The metrics")[0].lower()
    assert "[the corpus](../results/corpus.md)" in text, "links lead on from where the report lies"


def test_the_first_pages_say_what_holds_what_does_not_and_what_is_open(results: Path) -> None:
    interval = {"mean": 2.35, "low": 1.87, "high": 2.83, "n": 15}
    names = (("holds", "", "Trinity 3.4 and 1.91", 0.7), ("does not hold", "equivalent to none", "", None),
             ("no valid test", "jitter no worse than ours; beside it: 1", "", None), ("undecided", "", "", 0.2))
    held = [{"where": f"RG Table {k}", "sentence": f"FGD: claim {k}", "verdict": word, "reason": reason, "paper": paper,
             "difference": interval, "margin": margin, "needed": [6, 60] if word == "undecided" else []}
            for k, (word, reason, paper, margin) in enumerate(names, start=1)]
    effects = [{"effect": "lexemes provide the variety", "verdict": "holds", "claim": 1}]
    save([one("Claims", 1.0, {"count": {"holds": 1}, "claims": held, "effects": effects})],
         results / "claims.json", ABOUT)
    text = report.document(report.gather(results), results.parent / "report")
    pages = dict(re.findall(r"^## ([^\n]+)\n(.*?)(?=^## |\Z)", text, flags=re.MULTILINE | re.DOTALL))
    assert list(pages)[1:5] == ["What holds", "What does not hold",
                                "What could not be tested, and what is undecided", "Method"]
    assert "lexemes provide the variety (claim 1)" in pages["What holds"]
    assert "| 1 | RG Table 1. FGD: claim 1 | Trinity 3.4 and 1.91 | 2.35 [1.87, 2.83] | 0.7 |" in pages["What holds"]
    failed = pages["What does not hold"]
    assert "claim 2 (equivalent to none)" in failed and "claim 1" not in failed
    still = pages["What could not be tested, and what is undecided"]
    assert "| jitter no worse than ours | 3 | 1 |" in still and "| 6, 60 |" in still
    assert "TOST" in pages["Method"] and "Satterthwaite" in pages["Method"]
    assert "Metrics that a control beats: joint jerk, m/s^3; FGD." in pages["What this is"]


def test_a_caption_says_what_is_seen_by_the_numbers() -> None:
    styles = {f"height, asked {level}": value for level, value in (("low", 0.1), ("mid", 0.3), ("high", 0.2))}
    assert report_claims.seen("RG Fig. 10", styles).endswith(
        "height 0.10, 0.30 and 0.20 where low, middle and high are asked for, 0 of 1 in that order.")
    sweep = {f"{size} lexemes, {metric}": value for metric in ("FGD", "PMB at 0.1 s above chance, %")
             for size, value in ((10, 2.52), (400, 0.37))}
    assert "FGD 2.5, 0.37 with 10, 400 lexemes" in report_claims.seen("RG Fig. 18", sweep)
    assert report_claims.seen("RG Fig. 10", {"height, asked low": 1.0}) == "", "half of the numbers say nothing"
    assert report_claims.seen("RG Fig. 2", {}) == ""
    stored = report.gather(DOCS / "results")
    told = [figure.paper for figure in stored.figures if report_claims.seen(figure.paper, figure.numbers)]
    assert len(told) >= 8, "the figures that have numbers"


def test_figures_stand_in_the_papers_order_with_caption_and_numbers(results: Path) -> None:
    text = report.document(report.gather(results), results.parent / "report")
    assert text.index("### RG Fig. 5 and 8a:") < text.index("### RG Fig. 18:")
    assert "![RG Fig. 18: what figure-18 shows](../results/ablation/figure-18.svg)" in text
    assert "The picture is not there." in text and "A caption of figure-5." in text
    assert "| size-10, fgd | 1.5" in text and "| size-10, pmb | - |" in text, "a single row is a list"
    curves = report.numbers_table({"ours": {"0.1": 70.25, "0.2": 84.5}, "still": {"0.1": 1.0, "0.2": 2.0}}).markdown()
    assert "| ours | 70.2500 | 84.5000 |" in curves, "rows with the same columns are a table"
    assert "99 values, in the file" in text


def test_the_contents_lead_to_every_heading(results: Path) -> None:
    text = report.document(report.gather(results), results.parent / "report")
    links = re.findall(r"\]\(#([^)]+)\)", text.split("## What this is")[0])
    anchors = [anchor for level, _, anchor in report.headings(text) if level == 2]
    assert links == anchors and len(set(links)) == len(links) > 7
    assert report.headings("# A, b: c?\n\n## `x_y` z\n\n## `x_y` z\n\n```\n# no\n```\n") == [
        (1, "A, b: c?", "a-b-c"), (2, "`x_y` z", "x_y-z"), (2, "`x_y` z", "x_y-z-1")]


def test_the_chapters_are_the_docstrings(results: Path) -> None:
    text = report.document(report.gather(results), results.parent / "report")
    for metric in METRICS.values():
        assert f"| {metric.about} |" in text
    assert {f"metrics.{metric.chapter}" for metric in METRICS.values()} <= set(report.CHAPTERS)
    assert "What fools it" in text.split("## The metrics")[1]


@pytest.mark.parametrize("only", ["claims.json", "score.json", "ablation", "corpus.json"])
def test_any_part_may_be_alone_and_the_rest_is_named(results: Path, tmp_path: Path, only: str) -> None:
    alone = tmp_path / "alone"
    alone.mkdir()
    (shutil.copytree if (results / only).is_dir() else shutil.copy)(results / only, alone / only)
    text = report.report(alone, tmp_path / "out").read_text()
    assert text.count("is not there: `gesticulator ") >= 2
    assert len(re.findall(r"`\w+\.json` \(`gesticulator probe", text)) == len(PROBES) - (only == "corpus.json")


def test_what_cannot_be_read_is_left_out_and_named(results: Path) -> None:
    (results / "corpus.json").write_text('{"tables": 3}')
    (results / "ablation" / "figure-5.json").write_text("{")
    text = report.document(report.gather(results), results.parent / "report")
    assert "Cannot be read, so left out: `corpus.json`, `ablation/figure-5.json`." in text and "RG Fig. 18" in text


def test_nothing_at_all_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="holds no results"):
        report.gather(tmp_path)
    for folder, word in ((tmp_path, "holds no results"), (tmp_path / "not", "is not a folder")):
        with pytest.raises(SystemExit) as left:
            REPORT.main("gesticulator report", ["--results", str(folder), "--out", str(tmp_path / "out")])
        told = capsys.readouterr().err
        assert left.value.code == 2 and word in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("file", STORED, ids=lambda file: file.relative_to(DOCS).as_posix())
def test_a_stored_table_says_where_it_comes_from_and_fits_a_page(file: Path) -> None:
    tables, about = load_with_provenance(file)
    page = file.with_suffix(".md").read_text()
    assert page == markdown(tables, about), "what is read is what is kept"
    assert page.startswith(f"`{about.command}` · commit ")
    heads = [line for line in page.splitlines() if set(line) == {"|", "-"}]
    assert heads and all(line.count("---") <= MOST_COLUMNS for line in heads)
    assert all(table.title for table in tables)


@pytest.mark.parametrize("table", sorted((DOCS / "results").rglob("*.md")), ids=lambda path: path.name)
def test_the_command_of_a_table_names_no_place_of_one_machine(table: Path) -> None:
    assert not re.search(r"[ =]/\w", table.read_text(encoding="utf-8").partition(" · commit ")[0].splitlines()[0])


def test_a_command_is_kept_without_its_work_folder() -> None:
    words = ["probe", "motion", "--work", "/a/b", "--limit", "16", "--work=/a/b", "--out", "motion.json"]
    assert without_work(words) == ["probe", "motion", "--limit", "16", "--out", "motion.json"]


def test_the_stored_results_are_all_shown(tmp_path: Path) -> None:
    """What lies in docs/results is of this version: nothing is unreadable, and the same results give the same page."""
    gathered = report.gather(DOCS / "results")
    assert gathered.unreadable == []
    page = report.report(DOCS / "results", tmp_path)
    assert report.report(DOCS / "results", tmp_path).read_bytes() == page.read_bytes()
