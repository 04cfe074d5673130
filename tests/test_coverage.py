"""docs/coverage.md cannot say more than the files and the tests show."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "coverage.md"
STATES = {"todo", "partial", "done"}
PARTS = {"RG": 52, "RA": 22, "JX": 11, "MO": 14}
IDS = [f"{part}-{number:02}" for part, last in PARTS.items() for number in range(1, last + 1)]
VERDICTS = {"holds", "does not hold", "undecided"}


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
    for line in PAGE.read_text(encoding="utf-8").splitlines():
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


def effects() -> list[tuple[str, tuple[str, ...], str]]:
    """(effect, rows that it belongs to, verdict) of the table of effects."""
    _, _, source = PAGE.read_text(encoding="utf-8").partition("\n## Effects\n")
    lines = [line for line in source.splitlines() if line.startswith("| ")][1:]
    cells = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
    return [(effect, names(rows_of), verdict) for effect, rows_of, verdict, _ in cells]


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


def test_what_is_done_has_an_effect_that_was_decided() -> None:
    states = {row.id: row.state for row in rows()}
    assert effects()
    for effect, belongs, verdict in effects():
        assert verdict in VERDICTS, effect
        for row in belongs:
            assert states[row] == "partial" if verdict == "undecided" else states[row] in STATES, f"{row}: {effect}"
