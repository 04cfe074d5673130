"""The report: it shows every table that lies there, names what it cannot read, and leads to what is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from data_module.errors import InputError
from eval import report
from eval.commands import REPORT
from eval.context import without_work
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
STORED = [file for file in sorted((DOCS / "results").rglob("*.json")) if file.with_suffix(".md").is_file()]
"""Files of tables."""
ABOUT = Provenance("gesticulator probe x", "abc1234", NO_BUNDLE, "2026-01-02", NOT_RECORDED)


def one(title: str, value: float) -> Table:
    """A table of one cell, with a row that would break another."""
    rows = {"ours | mine": {"x": Interval(value, value - 1, value + 1, 3)}, "none": {"x": Interval.undefined()}}
    return Table(title, {"x": Column("figure", "mm", 1)}, rows)


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A folder of results as the commands leave it."""
    folder = tmp_path / "docs" / "results"
    for name, title, value in (("quality", "Quality", 14.5), ("claims", "Claims", 1.0),
                               ("ablation/table", "RG Table 1 (test)", 12.5)):
        save([one(title, value)], folder / f"{name}.json", ABOUT)
    (folder / "ablation" / "figures.json").write_text(dumps({"figure-18": {
        "figure": "RG Fig. 18", "title": "how many lexemes"}}))
    (folder / "ablation" / "figure-18.svg").write_text("<svg/>")
    return folder


def test_every_table_stands_under_its_heading_and_the_contents_lead_there(results: Path) -> None:
    text = report.document(results, results.parent / "report")
    headings = re.findall(r"^## (.+)$", text, flags=re.MULTILINE)
    assert headings == ["Claims", "Table", "Figure 18", "Quality"]
    assert re.findall(r"^- \[(.+)\]\(#(.+)\)$", text, flags=re.MULTILINE) == [
        (name, name.lower().replace(" ", "-")) for name in headings]
    for figure in ("14.5 [13.5, 15.5]", "1.0 [0.0, 2.0]", "12.5 [11.5, 13.5]"):
        assert figure in text
    assert "ours \\| mine" in text and "nan" not in text and text.count("commit `abc1234`") == 3
    assert "![RG Fig. 18: how many lexemes](../results/ablation/figure-18.svg)" in text


def test_what_cannot_be_read_is_left_out_and_named(results: Path) -> None:
    (results / "quality.json").write_text('{"tables": 3}')
    (results / "ablation" / "figures.json").write_text("{")
    text = report.document(results, results.parent / "report")
    assert "No tables of results: `ablation/figures.json`, `quality.json`." in text and "12.5 [11.5, 13.5]" in text


def test_nothing_at_all_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="holds no results"):
        report.document(tmp_path, tmp_path)
    for folder, word in ((tmp_path, "holds no results"), (tmp_path / "not", "is not a folder")):
        with pytest.raises(SystemExit) as left:
            REPORT.main("gesticulator report", ["--results", str(folder), "--out", str(tmp_path / "out")])
        error = capsys.readouterr().err
        assert left.value.code == 2 and word in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("file", STORED, ids=lambda file: file.relative_to(DOCS).as_posix())
def test_a_stored_table_says_where_it_comes_from_and_fits_a_page(file: Path) -> None:
    tables, about = load_with_provenance(file)
    page = file.with_suffix(".md").read_text()
    assert page == markdown(tables, about), "what is read is what was written"
    assert page.startswith(f"`{about.command}` · commit ")
    heads = [line for line in page.splitlines() if set(line) == {"|", "-"}]
    assert heads and all(line.count("---") <= MOST_COLUMNS for line in heads)
    assert all(table.title for table in tables)


@pytest.mark.parametrize("table", sorted((DOCS / "results").rglob("*.md")), ids=lambda path: path.name)
def test_the_command_of_a_table_names_no_place_of_one_machine(table: Path) -> None:
    assert not re.search(r"[ =]/\w", table.read_text(encoding="utf-8").partition(" · commit ")[0].splitlines()[0])


def test_a_command_is_recorded_without_its_work_folder() -> None:
    words = ["probe", "motion", "--work", "/a/b", "--limit", "16", "--work=/a/b", "--out", "motion.json"]
    assert without_work(words) == ["probe", "motion", "--limit", "16", "--out", "motion.json"]
