"""The repository keeps within the ceilings of budget.json."""

import json
from pathlib import Path

import pytest
from budget import measure, tracked

BUDGET = json.loads((Path(__file__).parent / "budget.json").read_text(encoding="utf-8"))


def test_nothing_is_over_its_budget() -> None:
    files = tracked()
    if not files:
        pytest.skip("this is no checkout of the repository")
    counts = measure(files)
    assert {name: counts[name] for name, most in BUDGET["at_most"].items() if counts[name] > most} == {}
    assert {name: counts[name] for name, least in BUDGET["at_least"].items() if counts[name] < least} == {}
