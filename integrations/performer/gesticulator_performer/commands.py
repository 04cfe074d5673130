"""The verb that draws takes; cheap to import, as `gesticulator --help` lists them."""

from __future__ import annotations

import argparse
from pathlib import Path

from gesticulator.cli import Command


def _of_takes(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("out", type=Path, metavar="DIR", help="output folder, for gesticulator build --repertoire")
    parser.add_argument("--seed", type=int, default=1, help="another seed gives other takes (default 1)")


def _draw_takes(arguments: argparse.Namespace) -> int:
    from gesticulator_performer.sources.gesture_takes import write_takes

    print(f"{arguments.out}: {write_takes(arguments.out, arguments.seed)} takes, with takes.csv")
    return 0


GESTURE_TAKES = Command("draw takes of the named gestures, as BVH with marked phases", _of_takes, _draw_takes,
                        examples=("gesture-takes takes",))
