"""A contact sheet of a lexicon: every lexeme at its start, middle and end, with what its hands do in words.

The words are read off the decoded lexeme alone: how far each hand goes from where it began, and which way, in
centimetres, the hips standing still.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from data_module.types import Array, Motion
from eval.pictures.strips import STRIP, draw_row
from gesticulator.export.figure import INK, figure_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS, MOST = 6, 60
"""Lexemes in a row, and on a sheet."""
RESTS = 0.04
"""Metres: a hand that goes no further from where it began rests."""
BACK = 0.5
"""A hand whose end is nearer to its start than this share of its furthest point has gone there and back."""
CLEAR = 0.45
"""A direction is told when it has this share of the way."""
_WIDE, _TALL = 2.75, 2.17
"""Inches of a lexeme with its three lines of text."""
_LAYOUT = replace(STRIP, spacing=0.95, margin=0.7, low=0.72, high=1.98)


def in_words(motion: Motion) -> str:
    """Describe the path of both hands from the first frame to the last, such as "right 18 cm up and out; left rests".

    Up, forward and out (away from the middle of the body) are those of the character, which faces forward.
    """
    points = figure_points(motion, np.arange(len(motion)) / motion.fps)
    paths = {side: _way(points[f"{side}Hand"], math.copysign(1.0, points[f"{side}Arm"][0, 0]))
            for side in ("Right", "Left")}
    # Most lexemes move both hands alike, and one phrase says so.
    if len(set(paths.values())) == 1:
        path = paths["Right"]
        return "both rest" if path == "rests" else f"both {path}"
    return "; ".join(f"{side.lower()} {path}" for side, path in paths.items())


def _way(path: Array, outwards: float) -> str:
    """One hand's way [T, 3]; outwards: 1 or -1, the side that it is on."""
    moved = path - path[0]
    away = np.linalg.norm(moved, axis=1)
    furthest = int(away.argmax())
    if away[furthest] < RESTS:
        return "rests"
    returns = away[-1] < BACK * away[furthest]
    # A hand that returns has gone nowhere: its furthest point tells the gesture.
    way = moved[furthest] if returns else moved[-1]
    length = float(np.linalg.norm(way))
    named = ((way[1], "up", "down"), (way[0] * outwards, "out", "in"), (way[2], "forward", "back"))
    words = [more if share > 0 else less for share, more, less in sorted(named, key=lambda part: -abs(part[0]))
             if abs(share) >= CLEAR * length][:2]
    return f"{100 * length:.0f} cm {' and '.join(words)}{', and back' if returns else ''}"


def sheet(lexemes: Sequence[int], motions: Sequence[Motion], titles: Sequence[str], silent: Sequence[int]) -> Figure:
    """The lexemes that are named, in that order, three figures each. motions, titles: one for every lexeme."""
    from matplotlib.figure import Figure as NewFigure

    rows = math.ceil(len(lexemes) / COLUMNS)
    figure = NewFigure(figsize=(COLUMNS * _WIDE, rows * _TALL), facecolor="white", layout="constrained")
    axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axis in axes:
        axis.axis("off")
    for axis, lexeme in zip(axes, lexemes, strict=False):
        last = (len(motions[lexeme]) - 1) / motions[lexeme].fps
        draw_row(axis, motions[lexeme], np.array([0.0, last / 2, last]), "front", _LAYOUT,
                 2 * _LAYOUT.spacing + 2 * _LAYOUT.margin)
        axis.texts[0].remove()  # which view it is: all are the same
        axis.set_title("\n".join((f"{lexeme}{' (silent)' if lexeme in silent else ''}",
                                  *titles[lexeme].split("; "))), fontsize=8, color=INK)
    return figure
