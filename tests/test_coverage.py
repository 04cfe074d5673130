"""docs/coverage.md cannot say more than the files and the tests show."""

from __future__ import annotations

import ast
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "coverage.md"
STATES = {"todo", "partial", "done"}
PARTS = {"RG": 52, "RA": 22, "JX": 11, "MO": 14}
IDS = [f"{part}-{number:02}" for part, last in PARTS.items() for number in range(1, last + 1)]
CLAIMS = json.loads((ROOT / "docs" / "results" / "claims.json").read_text(encoding="utf-8"))["tables"][0]["facts"]


@dataclass(frozen=True)
class Row:
    """A row of the page. A cell may name several files or tests, parted by commas."""

    id: str
    what: str
    state: str
    files: tuple[str, ...]
    tests: tuple[str, ...]


def names(cell: str) -> tuple[str, ...]:
    return tuple(name for part in cell.split(",") if (name := part.strip().strip("`")))


def rows() -> list[Row]:
    found = []
    parts = PAGE.read_text(encoding="utf-8").partition("\n## What is missing\n")[0]
    for line in parts.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("|") and cells[0][:2] in PARTS:
            assert len(cells) == 6, f"six cells are expected: {line}"
            found.append(Row(cells[0], cells[1], cells[3], names(cells[4]), names(cells[5])))
    return found


@cache
def functions(path: Path) -> frozenset[str]:
    """The tests that a file defines, those in classes as Class::test."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    plain = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    inner = {f"{group.name}::{node.name}" for group in tree.body if isinstance(group, ast.ClassDef)
             for node in group.body if isinstance(node, ast.FunctionDef)}
    return frozenset(name for name in plain | inner if name.rsplit("::", 1)[-1].startswith("test"))


@dataclass(frozen=True)
class ShownEffect:
    """A row of the table of effects; claim: its number in claims.md."""

    says: str
    rows: tuple[str, ...]
    verdict: str
    claim: int


def table_below(heading: str) -> list[list[str]]:
    """The cells of the rows of the first table below a heading."""
    _, _, source = PAGE.read_text(encoding="utf-8").partition(f"\n## {heading}\n")
    lines = [line for line in source.partition("\n## ")[0].splitlines() if line.startswith("| ")][1:]
    return [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]


def effects() -> list[ShownEffect]:
    return [ShownEffect(effect, names(rows_of), verdict, int(claim))
            for effect, rows_of, verdict, _, claim in table_below("Effects")]


def test_every_part_of_both_papers_stands_there_once_and_in_order() -> None:
    assert [row.id for row in rows()] == IDS


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.id)
def test_a_row_says_only_what_is_there(row: Row) -> None:
    assert row.what
    assert row.state in STATES
    for file in row.files:
        assert (ROOT / file).is_file(), f"{row.id} names a file that is not there: {file}"
    for test in row.tests:
        file, _, name = test.partition("::")
        assert (ROOT / file).is_file(), f"{row.id} names a test file that is not there: {file}"
        assert name in functions(ROOT / file), f"{row.id} names a test that is not there: {test}"
    if row.state == "done":
        assert row.files, f"{row.id} is done without a file"
        assert row.tests, f"{row.id} is done without a test"
    if row.state == "partial":
        assert row.files, f"{row.id} is partial without a file"


def test_every_effect_has_the_verdict_that_stands_in_the_claims() -> None:
    """The page has the effects of claims.json, in order, each with the verdict of the claim that it names."""
    assert [(effect.says, list(effect.rows), effect.verdict, effect.claim) for effect in effects()] == [
        (effect["effect"], effect["rows"], effect["verdict"], effect["claim"]) for effect in CLAIMS["effects"]]
    for effect in effects():
        assert CLAIMS["claims"][effect.claim - 1]["verdict"] == effect.verdict, effect.says


def test_what_is_done_has_an_effect_that_was_decided_or_no_figure_in_the_paper() -> None:
    states = {row.id: row.state for row in rows()}
    assert len(effects()) > 20
    for effect in effects():
        printed = bool(CLAIMS["claims"][effect.claim - 1]["paper"])
        is_open = effect.verdict == "undecided" or (effect.verdict == "no valid test" and printed)
        for row in effect.rows:
            assert states[row] == "partial" or not is_open, f"{row}: {effect.says}"


def test_every_partial_row_says_what_is_missing_and_no_other() -> None:
    lacking = table_below("What is missing")
    listed = [row for cells in lacking for row in names(cells[0])]
    assert sorted(listed) == sorted(row.id for row in rows() if row.state == "partial" and not row.id.startswith("MO"))
    for cells in lacking:
        assert len(cells) == 4 and len(cells[1]) > 15, f"{cells[0]} does not say what is missing"
        assert "`" in cells[2] or "not to be had" in cells[1], f"{cells[0]} names no command"
