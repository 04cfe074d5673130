"""Show the performances of two interpreters side by side on one page.

    python examples/two_takes.py examples/speech.flac lstm advantage two_takes.html
"""

from __future__ import annotations

import sys
from pathlib import Path

from gesticulator import Gesticulator
from gesticulator.export.html import write_comparison


def main(sound: str, first: str, second: str, output: str) -> None:
    """The page plays both at once, and edits the plan of either."""
    gesticulator = Gesticulator.from_pretrained()
    takes = {name: gesticulator(sound, interpreter=name) for name in (first, second)}
    same = (takes[first].lexemes == takes[second].lexemes).mean()
    page = write_comparison(Path(output), {name: take.scene() for name, take in takes.items()})
    print(f"{page}: {same:.0%} of the blocks have the same lexeme in both")


if __name__ == "__main__":
    main(*sys.argv[1:])
