"""The verbs of `eval`. Cheap to import: what is heavy is imported when a verb runs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from eval.draw import DRAWINGS
from eval.plugin import choice, verb
from eval.probes import PROBES
from gesticulator.cli import Command

if TYPE_CHECKING:
    from eval.table import Table


def _publish(tables: Sequence[Table], arguments: argparse.Namespace) -> None:
    from eval.table import publish

    publish(tables, arguments.out)


def _out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", metavar="FILE.json", help="output file for the tables; a .md is written beside it")


def _name_files(files: Sequence[Path], arguments: argparse.Namespace) -> None:
    print("\n".join(map(str, files)))


SCORE = verb("compare real, generated and other motion, with negative controls", "eval.score",
             "score --truth STORE --system ours=bvh_folder",
             "score --truth real --system ours=generated --speech wav --bundle shipped --out score.json")
ABLATE = verb("repeat the tables, figures and claims of both papers", "eval.ablate",
              "ablate --list", "ablate --data STORE --work DIR --only ours no-style --seeds 1",
              "ablate --data STORE --work DIR --ray local:8", "ablate --data STORE --work DIR --slurm mem_gb=8",
              "ablate --tables --out docs/results/ablation")
PROBE = choice("probe", "answer one question about a bundle or a data set (--list shows them)", PROBES, _publish, _out,
               ("probe --list", "probe quality --data STORE", "probe gate --data STORE --out gate.json"))
REPORT = verb("collect all stored results on one page", "eval.report",
              "report", "report --results docs/results --out docs/report")
STUDY = verb("make a user study, or analyse its ratings", "eval.study",
             "study make --systems ours=DIR truth=DIR --out FOLDER",
             "study analyse --key FOLDER/key.json ratings-*.json --out study.json")
DRAW = choice("draw", "draw a strip, a video or the lexicon (--list shows them)", DRAWINGS, _name_files,
              lambda parser: None, ("draw strip gesture.bvh --sound speech.wav",
                                    "draw video gesture.bvh --sound speech.wav --out film.mp4",
                                    "draw lexicon --data STORE --out FOLDER"))
VERBS: dict[str, Command] = {"score": SCORE, "ablate": ABLATE, "probe": PROBE, "report": REPORT, "study": STUDY,
                             "draw": DRAW}
"""By name, for `python -m eval`; `gesticulator` finds them as entry points."""
