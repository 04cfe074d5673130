"""`gesticulator train-face`: train the network that moves the lips."""

from __future__ import annotations

import argparse
from pathlib import Path

from data_module.errors import InputError
from gesticulator.cli import Command


def arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("--out", required=True, type=Path, metavar="DIR", help="output folder for the weights")
    p.add_argument("--minutes", type=float, default=80.0, help="synthetic speech (default 80)")
    p.add_argument("--epochs", type=int, default=14, help="passes over the speech (default 14)")
    p.add_argument("--seed", type=int, default=1, help="random seed (default 1)")
    p.add_argument("--quiet", action="store_true", help="print no progress")


def run(args: argparse.Namespace) -> int:
    """Train; InputError for invalid arguments or a missing voice."""
    from gesticulator_performer.face.training import FaceTraining, fit, recordings_of, save

    for flag, value, least, most in (("--minutes", args.minutes, 1, 6000), ("--epochs", args.epochs, 1, 1000),
                                     ("--seed", args.seed, 0, 2**31 - 1)):
        if not least <= value <= most:
            raise InputError(f"{flag} {value:g}", "is out of range", f"choose {least} to {most}")
    settings = FaceTraining(minutes=args.minutes, epochs=args.epochs, seed=args.seed)
    net = fit(recordings_of(settings), settings, args.quiet)
    save(net, settings, args.out)
    return 0


COMMAND = Command(
    "train the network that moves the lips", arguments, run,
    examples=("train-face --out face", "train-face --out face --minutes 40"))
