"""Where a command's figures are kept: JSON for programs, and beside it the same as Markdown for readers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from data_module.files import write_text


def keep(result: dict[str, Any], tables: str, out: str | Path) -> None:
    """Write `out` (.json) and its .md, each whole or not at all; the folder is made where it lacks."""
    place = Path(out)
    place.parent.mkdir(parents=True, exist_ok=True)
    write_text(place, json.dumps(result, indent=1) + "\n")
    write_text(place.with_suffix(".md"), tables)


def publish(result: dict[str, Any], tables: str, out: str | Path | None) -> None:
    """`keep` where a file is asked for, and the tables on the screen."""
    if out:
        keep(result, tables, out)
    print(tables)
