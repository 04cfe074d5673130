"""The fixtures of the main package's tests: the outside data, a tiny store, one thread for torch."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from gesticulator.export.writers import WRITERS

TESTS = Path(__file__).resolve().parents[3] / "tests"
sys.path.insert(0, str(TESTS))
_spec = importlib.util.spec_from_file_location("main_conftest", TESTS / "conftest.py")
assert _spec is not None and _spec.loader is not None
_main = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_main)
outside_data, tiny_store, pytest_runtest_setup = _main.outside_data, _main.tiny_store, _main.pytest_runtest_setup


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Stop at once where the entry points of the distribution are missing."""
    if items and ".g1.csv" not in WRITERS:
        pytest.exit("gesticulator-extra is not installed: pip install -e integrations/extra", returncode=4)
