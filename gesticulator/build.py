"""`gesticulator build`: build a training store from a corpus (`data_module.build`)."""

import argparse
from functools import partial

from data_module import build
from gesticulator.cli import PROGRAM, Command


def _run(args: argparse.Namespace) -> int:
    """Parse the rest of the command line for the chosen corpus, and build it."""
    from data_module.corpora.table import reader_of

    reader_of(args.corpus)  # an unknown name is refused before its options are
    chosen = Command(f"build a training store: {args.corpus}", partial(build.add_arguments, corpus=args.corpus),
                     build.run)
    return chosen.main(f"{PROGRAM} build {args.corpus}", args.rest)


COMMAND = Command(
    "build a training store from recordings of speech and motion", build.choose_corpus, _run,
    examples=("build folder --source DIR --out store", "build beat --source DIR --out store --workers 4"))
