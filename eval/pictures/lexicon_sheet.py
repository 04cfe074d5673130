"""A contact sheet of a lexicon (RG Fig. 6): `gesticulator plot lexicon --data STORE --out lexemes.png`.

The lexemes that a store uses most, as the decoder makes them, each at its start, middle and end, with its number, how
often it occurs, and whether it is silent. A movement begins where the training block nearest to it began. What fools
it: the decoder alone has never been made to move smoothly, so a decoded lexeme may tremble where the block did not.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from data_module.types import Motion
from eval.context import EvalContext
from eval.pictures.strips import PAGE, draw_row, save_strip
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from lexicon.movement import MovementLexicon

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS, MOST = 6, 60
"""Lexemes in a row, and on a sheet."""
_WIDE, _TALL = 2.75, 1.8
"""Inches of a lexeme with its line of text."""
_LAYOUT = replace(PAGE, spacing=0.95, margin=0.7, low=0.72, high=1.98)


@torch.no_grad()
def decoded(bundle: Bundle) -> list[Motion]:
    """Each lexeme through the decoder, on the mean pose of all performers: K frames of normalised time."""
    lexicon = bundle.block_lexicon
    # In normalised time, as the lexicon was trained.
    blocks = lexicon.shown()
    if isinstance(lexicon, MovementLexicon):
        # The first frame is the pose before the block that a movement was taken from.
        blocks = torch.cat([lexicon.examples[:, -1:], blocks], dim=1)
    poses = blocks.double().numpy() * bundle.statistics.deviation + bundle.statistics.mean_pose.mean(axis=0)
    representation = representation_of(bundle.config)
    return [representation.motion(pose, bundle.config.rhythm.fps) for pose in poses]


def sheet(motions: Sequence[Motion], titles: Sequence[str]) -> Figure:
    """Lexemes in order, three figures each."""
    from matplotlib.figure import Figure as NewFigure

    across = min(COLUMNS, len(motions))
    rows = math.ceil(len(motions) / across)
    figure = NewFigure(figsize=(across * _WIDE, rows * _TALL), facecolor="white", layout="constrained")
    axes = figure.subplots(rows, across, squeeze=False).ravel()
    for axis in axes:
        axis.axis("off")
    for axis, motion, title in zip(axes, motions, titles, strict=False):
        last = (len(motion) - 1) / motion.fps
        draw_row(axis, motion, np.array([0.0, last / 2, last]), "front", _LAYOUT,
                 2 * _LAYOUT.spacing + 2 * _LAYOUT.margin)
        axis.texts[0].remove()  # which view it is: all are the same
        axis.set_title(title, fontsize=8)
    return figure


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator plot lexicon`."""
    EvalContext.arguments(parser)
    parser.add_argument("--out", type=Path, default=Path("lexemes.png"), metavar="FILE",
                        help="the picture, .png, .svg or .pdf (default: lexemes.png)")


def run(arguments: argparse.Namespace) -> list[Path]:
    """Draw it; the picture's path."""
    context = EvalContext.of(arguments)
    motions, silent = decoded(context.bundle), context.bundle.silent
    # A lexicon may have more lexemes than the motion ever uses.
    counts = np.bincount(context.labels, minlength=len(motions))
    # The most used first: a sheet of all would be too small to read.
    order = [lexeme for lexeme in np.argsort(-counts, kind="stable")[:MOST].tolist() if counts[lexeme]]
    titles = [f"{lexeme}{' (silent)' if lexeme in silent else ''}, {100 * counts[lexeme] / counts.sum():.1f} %"
              for lexeme in order]
    save_strip(sheet([motions[lexeme] for lexeme in order], titles), arguments.out, dpi=100)
    return [arguments.out]
