"""The report: what it gathers, that Markdown and HTML say the same, and that the page needs nothing but itself."""

from __future__ import annotations

import base64
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_module.errors import InputError
from eval import ablation_tables, report
from eval.ablation_tables import COLUMNS
from eval.ablations import CONTROLS, OURS, PERFORMER, ROWS, TABLES
from eval.results import keep

SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><path d="M0 0L9 9"/></svg>'
PNG = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5E"
                       "rkJggg==")
NETWORK = {"features": "own <34> frames", "frames": 34, "fps": 15.0, "sha256": "ab" * 32, "reason": "",
           "distance": 3.25}


def kept_cell(row: str, seed: int, clips: int = 6) -> dict[str, Any]:
    """A believable cell: figures that differ by row, and of `statistical` no accuracy."""
    rng = np.random.default_rng([seed, *row.encode()])
    shift = float(rng.uniform(0, 5))
    values = [{key: float(shift + rng.normal()) for key in COLUMNS} for _ in range(clips)]
    if row in (PERFORMER, "no-lexemes"):
        values = [{**own, "accuracy": float("nan"), "teacher_forced": float("nan")} for own in values]
    return {"row": row, "seed": seed, "shared": "s", "settings": ["a.b=1"], "question": f"is {row} | needed?",
            "seconds": {"training": 61.0}, "clips": [{"name": f"clip {k}", **own} for k, own in enumerate(values)],
            "sets": {"pmb_curve": {"percent": rng.uniform(0, 100, size=10).tolist()},
                     "fgd": [NETWORK, {**NETWORK, "features": "raw", "reason": "too few windows"}]}}


def fill(results: Path) -> None:
    """A folder of results as the commands leave it."""
    folder, pictures = results / "ablation", results.parent / "pictures"
    for made in (folder, pictures, results / "racer"):
        made.mkdir(parents=True)
    for row, seeds in ((OURS, (1, 2, 3)), ("no-lexemes", (1, 2, 3)), ("no-style", (1,)), ("statistical", (1, 2, 3)),
                       ("size-10", (1, 2, 3)), (PERFORMER, (0,)), ("still", (0,))):
        for seed in seeds:
            (folder / f"{row}-{seed}.json").write_text(json.dumps(kept_cell(row, seed)))
    rows = ablation_tables.tabled(ablation_tables.read_cells(folder))
    refused = {"no-segmentation": "900 s counted", "figure-14": "no row"}
    result = {"preset": "ablation", "shared": "s", "refused": refused,
              "store": {"name": "made up", "fingerprint": "f" * 64, "test_recordings": 6}, "rows": rows}
    keep(result, "", folder / "table.json")
    for file, name, numbers in (("figure-18", "RG Fig. 18", {"size-10": {"fgd": 1.5, "pmb": float("nan")}}),
                                ("figure-11", "RG Fig. 11", {"delta": [0.1, 0.2], "ours": [51.25, 72.5]}),
                                ("figure-5", "RG Fig. 5 and 8a", {"mean": 0.375, "p": {"of": {"it": [1, 2]}}})):
        (folder / f"{file}.json").write_text(json.dumps({
            "figure": name, "title": f"what {file} shows", "caption": f"A caption of {file}.", "numbers": numbers}))
    (folder / "figure-18.svg").write_text(SVG)
    (folder / "figure-11.png").write_bytes(PNG)
    (pictures / "strip.png").write_bytes(PNG)
    (results / "gate.md").write_text("# Gate\n\n| gate | x |\n|---|---|\n| loud | NaN |\n| b | nan [nan, nan] |\n\n"
                                     "[more](racer/table.md), <script>alert(1)</script>, ![x](https://example.org/x.png)\n")
    (results / "limits.md").write_text("It was made by rule, on 6 recordings.\n")
    (results / "score.json").write_text(json.dumps({
        "metrics": {"jerk": {"title": "jerk of the hands", "digits": 1, "part": "vigour", "good": "near"}},
        "flags": [{"metric": "jerk", "control": "reversed", "says": "is not told from the truth"}], "clips": ["a", "b"],
        "seconds": 20.0, "fps": 15.0, "systems": ["ours"], "controls": ["reversed"]}))
    (results / "score.md").write_text("| vigour | jerk (!) |\n|---|---|\n| ours | 48.25 |\n| still | NaN |\n\n"
                                      "Metrics that a control beats:\n\n- jerk: *reversed* is not told apart.\n")
    (results / "racer" / "table.json").write_text(json.dumps({
        "store": {"name": "made up", "fingerprint": "f" * 64, "test_recordings": 6, "decisions": 60},
        "settings": {"steps": 300}, "motion": {}, "rows": {"cql": {
            "seeds": [1, 2, 3], "decided": True,
            "figures": {"return": {"mean": 9.125, "low": 8.0, "high": 10.0, "clips": 6}}}}}))


class Page(HTMLParser):
    """Tables as rows of cells, every address, ids, and the text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.addresses: list[tuple[str, str]] = []
        self.ids: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self._in_cell = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [(tag, value or "") for key, value in attrs if key in ("src", "href", "data", "srcset")]
        self.ids += [value or "" for key, value in attrs if key == "id"]
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self._in_cell = True

    def handle_endtag(self, tag: str) -> None:
        self._in_cell = self._in_cell and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        self.text += data
        if self._in_cell:
            self.tables[-1][-1][-1] += data


def markdown_tables(text: str) -> list[list[list[str]]]:
    """The tables of a Markdown file, read without the library that renders them."""
    tables, before = [], ""
    for line in text.splitlines():
        if line.startswith("|"):
            if not before.startswith("|"):
                tables.append([])
            cells = [re.sub(r"[`*]", "", cell).strip().replace("\\|", "|")
                     for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            if not all(re.fullmatch(r"-{3,}", cell) for cell in cells):
                tables[-1].append(cells)
        before = line
    return tables


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report that has everything."""
    folder = tmp_path_factory.mktemp("docs")
    fill(folder / "results")
    assert report.main(["--results", str(folder / "results"), "--out", str(folder / "report")]) == 0
    return folder


@pytest.fixture(scope="module")
def markdown(made: Path) -> str:
    return (made / "report" / "report.md").read_text()


@pytest.fixture(scope="module")
def page(made: Path) -> Page:
    return Page((made / "report" / "report.html").read_text())


def test_markdown_and_html_have_the_same_tables(markdown: str, page: Page) -> None:
    ours = markdown_tables(markdown)
    assert len(ours) > 25
    theirs = [[[cell.replace("`", "").replace("*", "").strip() for cell in row] for row in own] for own in page.tables]
    assert theirs == ours


def test_every_number_of_the_papers_tables_is_on_the_page(made: Path, page: Page) -> None:
    rows = json.loads((made / "results" / "ablation" / "table.json").read_text())["rows"]
    shown = {own[0][0]: own for own in page.tables}
    for title, table in TABLES.items():
        own = shown[f"{title} ({table.split})"]
        text = " ".join(cell for row in own for cell in row)
        for line in table.lines:
            for pair in line.paper.values():
                assert all(f"{one:g}" in text for one in pair if one is not None), (title, line.row)
            if line.row in rows:
                for key in table.columns:
                    cell = rows[line.row]["figures"][key]
                    assert np.isnan(cell["mean"]) or f"{cell['mean']:.{COLUMNS[key].digits}f} [" in text
    assert "(900 s counted)" in page.text and "(undecided: 1 of 3 seeds)" in page.text
    racer = shown["RACER Table 2"]
    assert next(row for row in racer if row[0] == "cql")[1:4] == ["9.12 [8.00, 10.00]", "-", "9.34"]
    assert "dqn (not run)" in [row[0] for row in racer]


def test_the_page_needs_nothing_but_itself(page: Page) -> None:
    anchors = [address[1:] for tag, address in page.addresses if tag == "a" and address.startswith("#")]
    assert len(anchors) > 30 and set(anchors) <= set(page.ids) and len(set(page.ids)) == len(page.ids)
    for tag, address in page.addresses:
        if tag != "a":
            assert address.startswith("data:"), (tag, address[:60])
    assert not {"script", "iframe", "object", "embed"} & set(page.tags)
    assert page.tags.count("img") == 3, "two figures and the strip; the one from elsewhere is not fetched"
    assert "picture: x" in page.text and "<script>alert(1)</script>" in page.text, "as text"


def test_figures_stand_in_the_papers_order_with_picture_caption_and_numbers(made: Path, markdown: str, page: Page
                                                                             ) -> None:
    places = [markdown.index(f"### {name}:") for name in ("RG Fig. 5 and 8a", "RG Fig. 9", "RG Fig. 11", "RG Fig. 18")]
    assert places == sorted(places)
    assert "![RG Fig. 18: what figure-18 shows](../results/ablation/figure-18.svg)" in markdown
    html = (made / "report" / "report.html").read_text()
    assert base64.b64encode(SVG.encode()).decode() in html and base64.b64encode(PNG).decode() in html
    assert [["delta", "0.1", "0.2"], ["ours", "51.25", "72.5"]] in page.tables
    assert [["", "fgd", "pmb"], ["size-10", "1.5", "-"]] in page.tables
    assert [["", "value"], ["mean", "0.375"], ["p, of, it", "1, 2"]] in page.tables
    assert "A caption of figure-11." in page.text and "The picture is not there." in page.text
    assert "--only figure-14`" in markdown and "(no row)" in markdown and "--only figure-18" not in markdown
    assert "eval.study" in markdown[markdown.index("### Figures that are lacking"):], "people are asked elsewhere"


def test_the_summary_counts_claims_and_names_what_controls_beat(made: Path, markdown: str) -> None:
    found = report.claims.claims(ablation_tables.read_cells(made / "results" / "ablation"), {})["count"]
    assert (f"{found['holds']} hold, {found['does not hold']} do not hold and {found['undecided']} are undecided"
            in markdown)
    assert found["holds"] + found["does not hold"] >= 3
    box = "\n".join(line for line in markdown.splitlines() if line.startswith(">"))
    assert "jerk of the hands" in box and "Columns of the tables in which a control does as well" in box
    rows = json.loads((made / "results" / "ablation" / "table.json").read_text())["rows"]
    beaten = [COLUMNS[key].title for key in TABLES["RG Table 1"].columns if ablation_tables.beaten(rows, key)]
    assert all(title in box for title in beaten) and CONTROLS


def test_what_is_undefined_says_why(markdown: str) -> None:
    assert "NaN" not in "".join(line for line in markdown.splitlines() if line.startswith("|"))
    table = markdown[markdown.index("\n### RG Table 6"):markdown.index("\n### RG Table 7")]
    assert "right, free-running, % of performer" in table and "no interpreter chose its lexemes" in table
    assert "| loud | - |" in markdown and "| b | - |" in markdown


def test_other_parts_are_there(markdown: str, page: Page) -> None:
    assert "It was made by rule, on 6 recordings." in markdown and "#### Gate" in markdown
    assert "](../results/racer/table.md)" in markdown, "links lead on from where the report lies"
    assert page.tags.count("details") == page.tags.count("summary") >= 3
    for name in report.METRICS:
        module = getattr(__import__(f"eval.{name}"), name)
        first = " ".join((module.__doc__ or "").split())[:60]
        assert first in " ".join(page.text.split()), name
    assert f"`{ROWS[OURS].question}`" not in markdown and "is ours \\| needed?" in markdown
    assert "`rewards.md` (`python -m eval.rewards" in markdown


def test_the_same_inputs_give_the_same_bytes(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made, tmp_path / "docs")
    report.report(tmp_path / "docs" / "results", tmp_path / "docs" / "report")
    for name in ("report.md", "report.html"):
        assert (tmp_path / "docs" / "report" / name).read_bytes() == (made / "report" / name).read_bytes()
    assert sorted(file.name for file in (tmp_path / "docs" / "report").iterdir()) == ["report.html", "report.md"]


def test_null_is_undefined_and_cells_serve_where_the_command_has_not_finished(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made, tmp_path / "docs")
    place = tmp_path / "docs" / "results" / "ablation" / "table.json"
    whole = report.document(report.gather(tmp_path / "docs" / "results"), tmp_path / "docs" / "report")
    place.write_text(place.read_text().replace("NaN", "null"))
    assert report.document(report.gather(tmp_path / "docs" / "results"), tmp_path / "docs" / "report") == whole
    for text in ("{", '{"preset": "x"}'):
        place.write_text(text)
        told = report.document(report.gather(tmp_path / "docs" / "results"), tmp_path / "docs" / "report")
        assert "Cannot be read, so left out: `ablation/table.json`." in told and "### RG Table 1" in told
        assert "the command has not finished" in told


@pytest.mark.parametrize("only", ["gate.md", "score.md", "racer", "ablation", "score.json"])
def test_any_part_may_be_alone(made: Path, tmp_path: Path, only: str) -> None:
    results = tmp_path / "docs" / "results"
    results.mkdir(parents=True)
    source = made / "results" / only
    (shutil.copytree if source.is_dir() else shutil.copy)(source, results / only)
    place, _ = report.report(results, tmp_path / "out")
    told = place.read_text()
    assert next(line for line in told.splitlines() if line.startswith("## ")) == "## Contents"
    assert told.count(" is not there: `python -m ") >= 2
    assert only == "ablation" or "`ablation/table.json` is not there: `python -m eval.ablate" in told


def test_nothing_at_all_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="holds no results"):
        report.gather(tmp_path)
    for folder, word in ((tmp_path, "holds no results"), (tmp_path / "not", "is not a folder")):
        with pytest.raises(SystemExit) as left:
            report.main(["--results", str(folder), "--out", str(tmp_path / "out")])
        told = capsys.readouterr().err
        assert left.value.code == 2 and word in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_anchors_are_those_of_github() -> None:
    assert report.headings("# A, b: c?\n\n## `x_y` z\n\n## `x_y` z\n\n```\n# no\n```\n") == [
        (1, "A, b: c?", "a-b-c"), (2, "x_y z", "x_y-z"), (2, "x_y z", "x_y-z-1")]
