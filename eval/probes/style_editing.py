"""Does the motion do what is asked of its style? (RG 7.2.1, Fig. 10)

    gesticulator probe style-editing --data STORE [--bundle DIR] [--picture FILE.png]

For each feature (height of the right hand, speed of both hands, radius of both hands) and each level (low, mid, high:
the 15, 50 and 85 % quantiles of training) every clip is generated with that level asked for throughout and nothing
else, and what came out is measured, unsmoothed, and averaged over the clip. Every row plays the same clips with the
same seed, so differences between rows are paired. An editing signal is accepted when low, mid and high stand in order
and neighbouring 95 % intervals do not overlap.

Floor: the row where nothing is asked. Beside it: the motion that the store holds for the same clips. What fools these
figures: a hand that trembles is a fast hand, so speed is given a second time after smoothing over 50 ms, which takes
tremor off; features go together in a body (raising a hand from the hip takes it outwards), so that a change of what
was not asked for need not be an error; and fewer than about ten clips make an interval too narrow.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from data_module.errors import InputError
from data_module.store import Store
from eval.ablate.style_editing import CLIPS, SECONDS, SHOWN, excerpts, figures, played_by
from eval.pictures.edited import figure_10
from eval.pictures.strips import save_strip
from eval.table import Column, Marked, Table
from gesticulator.pipeline import Gesticulator

EDITING = {"asked": Column("requested low / mid / high"), "low": Column("realised low", digits=3),
           "mid": Column("mid", digits=3), "high": Column("high", digits=3), "apart": Column("intervals apart"),
           "low_to_mid": Column("low to mid", digits=3), "mid_to_high": Column("mid to high", digits=3),
           "share": Column("share of the requested range"), "in_order": Column("clips in order", "%", 0)}


def tables(result: Mapping[str, Any]) -> list[Table]:
    """What became of each level, what every row does, and what else an edit changes.

    The facts of the first have the claim of RG Fig. 10: what each feature rises by from level to level, in spreads of
    training.
    """
    clips, spread = result["clips"], result["spread"] | {"steady_speed": result["spread"]["speed"]}
    claim = [{key: value if key == "n" else value / spread[feature] for key, value in told[step].to_dict().items()}
             for feature, told in result["editing"].items() for step in ("low_to_mid", "mid_to_high")]
    changes = {SHOWN[feature].title: {name: Marked(own, f"({own.mean / spread[name]:+.1f})")
                                      for name, own in row.items()} for feature, row in result["elsewhere"].items()}
    facts = {key: result[key] for key in ("clips", "asked", "spread", "values")} | {"claim": claim}
    about = (f"{len(clips)} test clips, {sum(clip['seconds'] for clip in clips):.0f} s; the same clips and seed in "
             "every row.")
    return [Table("Style editing", EDITING, {SHOWN[feature].heading: own for feature, own in result["editing"].items()},
                  "feature", [about], facts),
            Table("Measured motion of every row", SHOWN, result["rows"], "row"),
            Table("Effect of a control at high instead of low", SHOWN, changes, "asked",
                  ["In brackets: in standard deviations of training."])]


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, a bundle, how many clips."""
    parser.add_argument("--data", required=True, metavar="STORE", help="store whose test split is used")
    parser.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="also draw RG Fig. 10")
    parser.add_argument("--clips", type=int, default=CLIPS, help=f"number of clips (default {CLIPS})")
    parser.add_argument("--seconds", type=float, default=SECONDS, help=f"seconds of each clip (default {SECONDS:g})")
    parser.add_argument("--quiet", action="store_true", help="print no progress bar")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Play every level; InputError for a bundle without controls."""
    if arguments.picture and arguments.picture.suffix.lower() != ".png":
        raise InputError(f"--picture {arguments.picture}", "does not end in .png", "name it FILE.png")
    clips = excerpts(Store.open(arguments.data), arguments.clips, arguments.seconds)
    torch.set_num_threads(1)
    system = Gesticulator.from_pretrained(arguments.bundle)
    if system.bundle.levels is None:
        raise InputError(arguments.bundle or "the shipped bundle", "has no controls",
                         "use a bundle trained with style editing")
    result = figures(played_by(system), clips, system.bundle.levels, progress=not arguments.quiet)
    if arguments.picture:
        save_strip(figure_10(result), arguments.picture)
    return tables(result)
