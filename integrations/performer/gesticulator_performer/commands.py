"""The verbs `smartbody` and `train-face`; cheap to import, as `gesticulator --help` lists them."""

from __future__ import annotations

import argparse
from pathlib import Path

from data_module.errors import InputError
from gesticulator.cli import Command


def _arguments_of_smartbody(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", type=Path, metavar="DIR", help="SmartBody's data/behaviorsets")
    parser.add_argument("--out", type=Path, required=True, metavar="STROKES", help="output folder")


def _make_strokes(arguments: argparse.Namespace) -> int:
    from gesticulator_performer.smartbody import LICENCE, SmartBody

    maker = SmartBody(arguments.source)
    count = maker.write(arguments.out)
    print(f"{arguments.out}: {count} strokes, with manifest.csv; the performer takes them as SOURCE/strokes")
    for note in (*maker.notes, f"licence: {LICENCE}"):
        print(f"  {note}")
    return 0


def _arguments_of_face(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", required=True, type=Path, metavar="DIR", help="output folder for the weights")
    parser.add_argument("--minutes", type=float, default=80.0, help="synthetic speech (default 80)")
    parser.add_argument("--seed", type=int, default=1, help="random seed (default 1)")


def _train_face(arguments: argparse.Namespace) -> int:
    from gesticulator_performer.face.training import FaceTraining, fit, recordings_of, save

    if not 1 <= arguments.minutes <= 6000:
        raise InputError(f"--minutes {arguments.minutes:g}", "is out of range", "choose 1 to 6000")
    if arguments.seed < 0:
        raise InputError(f"--seed {arguments.seed}", "is out of range", "give 0 or more")
    settings = FaceTraining(minutes=arguments.minutes, seed=arguments.seed)
    save(fit(recordings_of(settings), settings, quiet=False), settings, arguments.out)
    return 0


SMARTBODY = Command("make the performer's strokes of the clips that SmartBody publishes", _arguments_of_smartbody,
                    _make_strokes, examples=("smartbody DIR --out SOURCE/strokes",))
FACE = Command("train the network that moves the lips", _arguments_of_face, _train_face,
               examples=("train-face --out face",))
