"""The plan of a performance as JSON: its blocks and the lexemes that were considered for each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.files import write_text

if TYPE_CHECKING:
    from gesticulator.performance import Performance


def write_plan(path: Path, performance: Performance) -> Path:
    """Write `Performance.explain()` as JSON. Returns `path`."""
    write_text(path, json.dumps(performance.explain(), indent=1, allow_nan=False) + "\n")
    return path
