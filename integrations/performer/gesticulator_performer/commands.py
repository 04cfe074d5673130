"""The verbs of this distribution; cheap to import, as `gesticulator --help` lists them."""

from __future__ import annotations

import argparse
from pathlib import Path

from gesticulator.cli import Command


def _of_smartbody(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", type=Path, metavar="DIR", help="SmartBody's data/behaviorsets")
    parser.add_argument("--out", type=Path, required=True, metavar="STROKES", help="output folder")


def _make_strokes(arguments: argparse.Namespace) -> int:
    from data_module.files import lock
    from gesticulator_performer.sources.smartbody import SmartBody

    out: Path = arguments.out
    with lock(out, "a build", beside=True):
        maker = SmartBody(arguments.source)
        count = maker.write(out)
    print(f"{out}: {count} strokes, with manifest.csv; the performer takes them as SOURCE/strokes")
    for note in maker.notes():
        print(f"  {note}")
    print(f"  licence: {maker.licence}")
    return 0


def _of_takes(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("out", type=Path, metavar="DIR", help="output folder, for gesticulator build --repertoire")
    parser.add_argument("--seed", type=int, default=1, help="another seed gives other takes (default 1)")


def _draw_takes(arguments: argparse.Namespace) -> int:
    from gesticulator_performer.sources.gesture_takes import write_takes

    print(f"{arguments.out}: {write_takes(arguments.out, arguments.seed)} takes, with takes.csv")
    return 0


SMARTBODY = Command("make the performer's strokes of the clips that SmartBody publishes", _of_smartbody, _make_strokes,
                    examples=("smartbody DIR --out SOURCE/strokes",))
GESTURE_TAKES = Command("draw takes of the named gestures, as BVH with marked phases", _of_takes, _draw_takes,
                        examples=("gesture-takes takes",))
