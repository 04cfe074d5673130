"""The tables of sentences, words and voices, which are data files beside the code."""

from __future__ import annotations

import functools
import tomllib
from pathlib import Path
from typing import Any

ROOM = Path(__file__).parent


@functools.cache
def table(name: str) -> dict[str, Any]:
    """The TOML file `name`, by its path in the package."""
    return tomllib.loads((ROOM / name).read_text(encoding="utf-8"))


def templates(name: str, held_out: bool) -> dict[str, tuple[str, ...]]:
    """The sentences of sentences/NAME.txt by kind: those that are held out for test, or the others."""
    kinds: dict[str, list[str]] = {}
    kind = ""
    for line in (ROOM / "sentences" / f"{name}.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            continue
        if not line.startswith(" "):
            kind = line
            kinds[kind] = []
        elif line.startswith(" =") == held_out:
            kinds[kind].append(line.removeprefix(" =").strip())
    return {kind: tuple(lines) for kind, lines in kinds.items()}


def entries(text: str, mark: str) -> tuple[str, ...]:
    """The entries of a list in a table, which `mark` separates; a list may run over several lines."""
    return tuple(entry.strip() for entry in " ".join(text.split()).split(mark))


def files() -> list[Path]:
    """Every data file, in a fixed order."""
    return sorted([*ROOM.glob("*.toml"), *(ROOM / "sentences").iterdir()])
