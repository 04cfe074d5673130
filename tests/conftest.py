"""What every test shares: the outside data, a calm hypothesis and one thread for torch."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, settings

torch.set_num_threads(1)

# No deadline: the first call of a numerical library is slow and says nothing about the code under test.
settings.register_profile("project", deadline=None, max_examples=50, derandomize=True,
                          suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("project")


@pytest.fixture(scope="session")
def outside_data() -> Path:
    """The folder that holds strokes/, speech/, takes/ and fgd/; the test is skipped where it is not to be had."""
    told = os.environ.get("GESTICULATOR_DATA")
    if not told:
        pytest.skip("GESTICULATOR_DATA is not set: this test needs the outside data")
    folder = Path(told).expanduser().resolve()
    if not folder.is_dir():
        pytest.skip(f"GESTICULATOR_DATA names no folder: {folder}")
    return folder


@pytest.fixture(scope="session")
def tiny_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of about three minutes by the procedural performer and the numpy speaker, made once for all tests."""
    from data_module.build import main

    folder = tmp_path_factory.mktemp("corpus") / "store"
    assert main(["performer", "--preset", "tiny", "--out", str(folder), "--seed", "5", "--workers", "1"]) == 0
    return folder


@pytest.fixture(scope="session")
def tiny_bundle(tiny_store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The `tiny` preset, trained once by the real command."""
    from gesticulator.train import main

    out = tmp_path_factory.mktemp("trained") / "bundle"
    assert main(["--data", str(tiny_store), "--out", str(out), "--preset", "tiny", "--threads", "1", "--quiet"]) == 0
    return out
