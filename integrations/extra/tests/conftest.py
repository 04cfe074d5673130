"""The fixtures of the main package's tests: the outside data, one thread for torch."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

from gesticulator.export.writers import WRITERS

TESTS = Path(__file__).resolve().parents[3] / "tests"
sys.path.insert(0, str(TESTS))
_main = runpy.run_path(str(TESTS / "conftest.py"))
outside_data, pytest_runtest_setup = _main["outside_data"], _main["pytest_runtest_setup"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Stop at once where the entry points of the distribution are missing."""
    if items and ".g1.csv" not in WRITERS:
        pytest.exit("gesticulator-extra is not installed: pip install -e integrations/extra", returncode=4)
