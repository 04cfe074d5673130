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
