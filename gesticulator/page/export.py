"""Files that the page asks for: a plan, rendered and written in any format, with the character that is shown."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError, shown
from gesticulator.export.writers import WRITERS, check_output

if TYPE_CHECKING:
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.performance import Performance

CHARACTERS = (".glb", ".vrm")
"""Suffixes of characters that a page can send."""
Rendered = Callable[[Mapping[str, Any]], "Performance"]
"""A plan in plain values -> its performance."""


def formats() -> list[tuple[str, str]]:
    """Suffix and description of each format."""
    return [(suffix, entry.about) for suffix, entry in sorted(WRITERS.items())]


def exported(request: Mapping[str, Any], rendered: Rendered, retargeter: Retargeter | None) -> bytes:
    """The file that a page asks for.

    request: `plan`, `format` (a suffix), and `character` (`name`, `data` as base64) where the user dropped one on the
    page. retargeter: of the character that the page was opened with. `InputError` for an unknown format, a missing
    dependency, an unusable character and an invalid plan.
    """
    suffix, plan = request.get("format"), request.get("plan")
    if not isinstance(suffix, str) or suffix not in WRITERS or not isinstance(plan, dict):
        raise InputError(f"format {shown(str(suffix))}", "is unknown", f"use one of {', '.join(sorted(WRITERS))}")
    with tempfile.TemporaryDirectory(prefix="gesticulator-") as folder:
        target = Path(folder) / f"talk{suffix}"
        check_output(target)
        performance = rendered(plan)
        if request.get("character") is not None:
            performance = performance.on(_character(request["character"], Path(folder)))
        elif retargeter is not None:
            performance = replace(performance, character=retargeter(performance.motion))
        return performance.save(target).read_bytes()


def _character(told: Any, folder: Path) -> Path:
    """The file of a character that a page sent."""
    name, data = (told.get(part) if isinstance(told, dict) else None for part in ("name", "data"))
    suffix = Path(name).suffix.lower() if isinstance(name, str) else ""
    if suffix not in CHARACTERS or not isinstance(data, str):
        raise InputError("the character", "cannot be used for this format", f"drop one of {', '.join(CHARACTERS)}")
    file = folder / f"character{suffix}"
    try:
        file.write_bytes(base64.b64decode(data, validate=True))
    except ValueError:  # of `binascii`, or of a character that is not ASCII
        raise InputError("the character", "did not arrive whole", "try again") from None
    return file
