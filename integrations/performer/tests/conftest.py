"""The fixtures of the main package's tests: the outside data, calm hypothesis, one thread for torch."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

from data_module.corpora.table import CORPORA

TESTS = Path(__file__).resolve().parents[3] / "tests"
sys.path.insert(0, str(TESTS))
_main = runpy.run_path(str(TESTS / "conftest.py"))
outside_data, free_motion, meaning_data = _main["outside_data"], _main["free_motion"], _main["meaning_data"]
pytest_runtest_setup = _main["pytest_runtest_setup"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Stop at once where the entry points of the distribution are missing."""
    if items and "performer" not in CORPORA:
        pytest.exit("gesticulator-performer is not installed: pip install -e integrations/performer", returncode=4)
