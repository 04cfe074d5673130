"""The files and tests that docs/coverage.md names exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "coverage.md").read_text(encoding="utf-8")
ROWS = {line.split(" | ")[0].strip("| "): re.findall(r"`([\w./-]+\.(?:py|md|toml|json)(?:::[\w:]+)?)`", line)
        for line in PAGE.splitlines() if re.match(r"\| [A-Z]{2}-\d\d \|", line)}


@cache
def functions(path: Path) -> frozenset[str]:
    """The tests that a file defines, those in classes as Class::test."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    groups = [("", tree.body), *((f"{node.name}::", node.body) for node in tree.body if isinstance(node, ast.ClassDef))]
    return frozenset(f"{prefix}{node.name}" for prefix, body in groups for node in body
                     if isinstance(node, ast.FunctionDef) and node.name.startswith("test"))


def test_the_page_has_rows() -> None:
    assert {"RG-01", "RA-01"} <= set(ROWS)


@pytest.mark.parametrize("row", ROWS)
def test_files_and_tests_of_a_row_exist(row: str) -> None:
    for named in ROWS[row]:
        file, _, test = named.partition("::")
        assert (ROOT / file).is_file(), f"{row} names a file that does not exist: {file}"
        assert not test or test in functions(ROOT / file), f"{row} names a test that does not exist: {named}"
