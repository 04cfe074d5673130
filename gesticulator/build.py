"""`gesticulator build`: build a training store from a corpus (`data_module.build`)."""

from __future__ import annotations

import argparse
from pathlib import Path

from data_module import build
from gesticulator.cli import Command


def _draw_takes(args: argparse.Namespace) -> None:
    """Draw the takes of named gestures that the performer is to play, unless they are there."""
    folder: Path | None = args.repertoire
    if folder is None or folder.exists() or args.corpus != "performer":
        return
    build.asked_for(args)
    from gesticulator.directing.gesture_takes import write_takes

    print(f"{folder}: {write_takes(folder, args.seed)} takes of named gestures were drawn", flush=True)


def _run(args: argparse.Namespace) -> int:
    _draw_takes(args)
    return build.run(args)


COMMAND = Command(
    "build a training store from recordings of speech and motion", build.add_arguments, _run,
    examples=("build performer --preset tiny --out store", "build folder --source DIR --out store",
              "build beat --source DIR --out store --workers 4"))
