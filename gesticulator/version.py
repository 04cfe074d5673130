"""The version, and the check that the packages beside `gesticulator` are the ones that were installed with it."""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder
from pathlib import Path

__version__ = "0.1.0"
"""As it stands in pyproject.toml."""


def check() -> None:
    """Refuse to go on if a file such as `lexicon.py` in the current folder hides one of the packages, whose names are
    ordinary words: exit code 2 and one line in the command, else ImportError."""
    home = Path(__file__).resolve().parents[1]
    for name in ("data_module", "lexicon", "interpreters", "generator", "eval"):
        spec = PathFinder.find_spec(name)
        origin = None if spec is None else spec.origin
        if origin is None or Path(origin).resolve().parents[1] != home:
            line = f"gesticulator: its package {name!r} is not installed; install it again" if origin is None else \
                f"gesticulator: {origin} hides its package {name!r}; rename it, or run the command in another folder"
            if Path(sys.argv[0]).stem in ("gesticulator", "-m"):
                print(line, file=sys.stderr)
                raise SystemExit(2)
            raise ImportError(line)
