"""The common layout of plots: the size of a page's picture, its text and its frame."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from data_module.errors import InputError
from gesticulator.export.figure import INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Inches and points: 9 inches are 864 pixels of a page, and 9 points are 12.
WIDE, TEXT, TITLE = 9.0, 9.0, 10.0
COLUMNS = 3


def canvas(high: float) -> Figure:
    """An empty picture so many inches high; InputError without matplotlib."""
    try:
        from matplotlib.figure import Figure as NewFigure
    except ImportError:
        raise InputError("figures", "need matplotlib, which is not installed",
                         "pip install 'gesticulator[figures]'") from None
    return NewFigure(figsize=(WIDE, high), facecolor="white", layout="constrained")


def bare(axis: Axes, keep: Collection[str] = ("left", "bottom")) -> None:
    """Only these sides of the frame, in the house's ink."""
    for side, spine in axis.spines.items():
        spine.set_visible(side in keep)
        spine.set_color(SOFT)
    axis.tick_params(labelsize=TEXT, color=SOFT, labelcolor=INK)
    if "left" not in keep:
        axis.set_yticks([])
    axis.title.set_fontsize(TITLE)
    for label in (axis.xaxis.label, axis.yaxis.label, axis.title):
        label.set_color(INK)
    axis.xaxis.label.set_fontsize(TEXT)
    axis.yaxis.label.set_fontsize(TEXT)
