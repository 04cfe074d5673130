"""The mutants of formulas are what the tree holds: `benchmarks/mutants.py` tells whether tests kill them."""

import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))

import mutants  # noqa: E402

PACKAGES = {"data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval"}


@pytest.mark.parametrize("mutant", mutants.MUTANTS, ids=lambda mutant: mutant.formula)
def test_a_mutant_has_one_place_and_a_test_file(mutant: mutants.Mutant) -> None:
    assert mutant.occurrences() == 1, f"{mutant.fragment!r} must occur once in {mutant.file}"
    assert "\n" not in mutant.fragment and mutant.fragment != mutant.replacement
    assert (ROOT / mutant.test).is_file(), mutant.test
    changed = (ROOT / mutant.file).read_text(encoding="utf-8").replace(mutant.fragment, mutant.replacement)
    compile(changed, mutant.file, "exec")  # a mutant that is no Python is killed by anything


def test_there_are_56_of_all_packages_and_each_has_a_name() -> None:
    assert len(mutants.MUTANTS) == 56
    assert max(Counter(mutant.formula for mutant in mutants.MUTANTS).values()) == 1
    assert {mutant.file.split("/")[0] for mutant in mutants.MUTANTS} == PACKAGES


def test_the_files_that_run_as_on_older_processors_exist() -> None:
    (names,) = re.findall(r"^numeric=\(([\w\s]+)\)", (ROOT / ".ci" / "processors").read_text(), re.M)
    assert len(names.split()) > 20
    assert [name for name in names.split() if not (ROOT / "tests" / f"test_{name}.py").is_file()] == []


JUDGE = """
import sys
from pathlib import Path
import hypothesis.strategies, pytest  # once, before the forks
sys.path.insert(0, "benchmarks")
import mutants as m
tree = Path(sys.argv[1])
wrong = ("a * b", "a + b"), ("a * b", "b * a"), ("a * b", "a *"), ("b", "c"), ("a * b", "a * b.c")
for fragment, replacement in wrong:
    print(m.tried(m.Mutant("product", "formula.py", fragment, replacement, "test_formula.py"), tree).verdict)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the benchmark forks, which this system cannot")
def test_what_is_noticed_is_killed_and_what_is_not_survives(tmp_path: Path) -> None:
    """A sum for a product is killed, the product the other way round survives; what is no Python, and a fragment that
    occurs twice, are errors; an exception in the formula is noticed like any wrong number."""
    formula = tmp_path / "formula.py"
    formula.write_text("def product(a, b):\n    return a * b\n")
    (tmp_path / "test_formula.py").write_text(
        "from formula import product\n\n\ndef test_product():\n    assert product(2, 3) == 6\n")
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTEST_", "COV_"))}
    done = subprocess.run([sys.executable, "-c", JUDGE, str(tmp_path)], cwd=ROOT, env=environment, text=True,
                          capture_output=True, check=True)
    assert done.stdout.split() == ["killed", "survived", "error", "error", "killed"]
    assert formula.read_text() == "def product(a, b):\n    return a * b\n", "the line is put back"
