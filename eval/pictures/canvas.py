"""The common look of plots: the width of a page's picture, its text, frame and legend."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal

from gesticulator.export.figure import FLOOR, INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Place = Literal["outside lower center", "outside upper center"]
WIDE = 9.0
"""Inches: 864 pixels of a page."""
COLUMNS = 3
"""Panels in a row: what a page is wide enough for."""
STYLE: dict[Any, Any] = {
    "font.size": 9.0, "axes.titlesize": 10.0, "axes.spines.top": False, "axes.spines.right": False,
    "axes.edgecolor": SOFT, "axes.labelcolor": INK, "axes.titlecolor": INK, "text.color": INK, "xtick.labelcolor": INK,
    "ytick.labelcolor": INK, "axes.axisbelow": True, "grid.color": FLOOR, "legend.frameon": False,
    "lines.markersize": 5.0}
"""Settings of matplotlib, for `matplotlib.rc_context` about whatever draws."""


def canvas(high: float) -> Figure:
    """An empty picture so many inches high."""
    from matplotlib.figure import Figure as NewFigure

    return NewFigure(figsize=(WIDE, high), facecolor="white", layout="constrained")


def legend(figure: Figure, axes: Iterable[Axes], place: Place = "outside lower center") -> None:
    """One legend for all panels, each name once."""
    named = {label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(list(named.values()), list(named), ncols=max(len(named), 1), loc=place)


def row_without_scale(axis: Axes, name: str) -> None:
    """A row with its name beside it and no numbers."""
    axis.set_ylabel(name, rotation=0, ha="right", va="center")
    axis.set_yticks([])
    axis.spines[["left", "bottom"]].set_visible(False)
