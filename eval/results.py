"""Where a command's figures are kept: JSON for programs, and beside it the same as Markdown for readers.

What is undefined is NaN in numbers and null in JSON, which has no NaN.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from data_module.files import write_text


def plain(value: Any) -> Any:
    """Null for what is no finite number, however deep it lies."""
    if isinstance(value, dict):
        return {key: plain(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return [plain(own) for own in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def dumped(result: dict[str, Any], indent: int | None = None) -> str:
    """The JSON of a result, with a line's end."""
    return json.dumps(plain(result), indent=indent, allow_nan=False) + "\n"


def loaded(text: str) -> Any:
    """A result again, NaN where it has null. ValueError where it is no JSON."""
    return _undefined(json.loads(text))


def _undefined(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _undefined(own) for key, own in value.items()}
    if isinstance(value, list):
        return [_undefined(own) for own in value]
    return float("nan") if value is None else value


def keep(result: dict[str, Any], tables: str, out: str | Path) -> None:
    """Write `out` (.json) and its .md, each whole or not at all; the folder is made where it lacks."""
    place = Path(out)
    place.parent.mkdir(parents=True, exist_ok=True)
    write_text(place, dumped(result, indent=1))
    write_text(place.with_suffix(".md"), tables)


def publish(result: dict[str, Any], tables: str, out: str | Path | None) -> None:
    """`keep` where a file is asked for, and the tables on the screen."""
    if out:
        keep(result, tables, out)
    print(tables)
