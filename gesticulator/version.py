"""The version, and whether the packages beside `gesticulator` are the ones that were installed with it.

The program installs five packages beside `gesticulator` whose names are ordinary words. A `lexicon.py` in the current
folder hides ours from `python -m gesticulator`, and a distribution such as dns-lexicon, which also has a package
`lexicon`, overwrites it. Only the standard library is imported here: what would be imported may be the wrong module.
"""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder
from pathlib import Path

__version__ = "0.1.0"
"""As it stands in pyproject.toml."""

NAMES = ("data_module", "lexicon", "interpreters", "generator", "eval")
"""The packages that are installed beside `gesticulator`."""
MARK = b'__part_of__ = "gesticulator"'
"""The line of their `__init__.py` by which they are recognised."""
_READ = 4096
"""Bytes of a file that are searched for the mark."""


def clash() -> str | None:
    """One line that names the file in the way of one of `NAMES` and the cure, or None where all are ours."""
    for name in NAMES:
        if name in sys.modules and hasattr(sys.modules[name], "__part_of__"):
            continue
        spec = PathFinder.find_spec(name)
        found = None if spec is None else spec.origin
        if spec is None:
            return f"gesticulator: its package {name!r} is not installed; install gesticulator again"
        if found is None or not _is_ours(Path(found)):
            where = found or next(iter(spec.submodule_search_locations or ()), name)
            return f"gesticulator: {where} hides the package {name!r} that this program installs; {_cure(Path(where))}"
    return None


def _is_ours(file: Path) -> bool:
    try:
        with file.open("rb") as stream:
            return MARK in stream.read(_READ)
    except OSError:
        return False


def _cure(file: Path) -> str:
    """What to do about a file: it lies where ours was installed (it overwrote it), or before it on the path."""
    home = Path(__file__).resolve().parents[1]
    if file.resolve().is_relative_to(home):
        return ("another distribution has overwritten it: install gesticulator in a virtual environment of its own, or "
                "uninstall the other one and install gesticulator again")
    return "rename it, or run the command gesticulator from another folder"


def check() -> None:
    """Refuse to go on where a name is taken: exit code 2 and one line in a program of ours, else ImportError."""
    line = clash()
    if line is None:
        return
    started = Path(sys.argv[0]).stem if sys.argv else ""
    if started in ("gesticulator", "-m"):
        print(line, file=sys.stderr)
        raise SystemExit(2)
    raise ImportError(line)
