"""The verb `smartbody`; cheap to import, as `gesticulator --help` lists it."""

from __future__ import annotations

import argparse
from pathlib import Path

from gesticulator.cli import Command


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", type=Path, metavar="DIR", help="SmartBody's data/behaviorsets")
    parser.add_argument("--out", type=Path, required=True, metavar="STROKES", help="output folder")


def _make_strokes(arguments: argparse.Namespace) -> int:
    from gesticulator_performer.sources.smartbody import SmartBody

    out: Path = arguments.out
    maker = SmartBody(arguments.source)
    count = maker.write(out)
    print(f"{out}: {count} strokes, with manifest.csv; the performer takes them as SOURCE/strokes")
    for note in maker.notes():
        print(f"  {note}")
    print(f"  licence: {maker.licence}")
    return 0


SMARTBODY = Command("make the performer's strokes of the clips that SmartBody publishes", _arguments, _make_strokes,
                    examples=("smartbody DIR --out SOURCE/strokes",))
