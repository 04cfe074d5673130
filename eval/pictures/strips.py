"""Strips: motion as rows of still figures, seen from the front and from the side, for papers, README and judgement.

A strip shows what a number hides: a soldier's return to rest, an elbow behind the back, a hand in the face, the same
clip twice. Each figure is drawn at its own time, with the paths of both hands since the figure before it (the right
hand red, the left hand green); underneath, where they are given, the waveform and its beats on the same time axis.
Several sources stand below each other at the same seconds, and a long stretch goes on in the next line.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.types import Array, BeatFlag, Beats, Motion, Speech
from gesticulator.export.figure import FLOOR, HANDS, INK, SOFT, FlatPart, Look, body, figure_points, flattened, legs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BEAT_COLOURS = {BeatFlag.ONSET: "#c8553d", BeatFlag.LOUD_PSEUDO: "#d08c10", BeatFlag.EVEN_PSEUDO: "#5b7fa6",
                BeatFlag.BOUNDARY: INK}
BEAT_NAMES = {BeatFlag.ONSET: "onset", BeatFlag.LOUD_PSEUDO: "first loud frame", BeatFlag.EVEN_PSEUDO: "even",
              BeatFlag.BOUNDARY: "start or end"}
_MARKERS = dict(zip(BEAT_COLOURS, "o^sD", strict=True))
_UNSAID: dict[str, dict[str, Any]] = {
    "png": {"Software": None}, "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}
_TRAIL_STEPS = 40
POSES = 4.0
"""Figures a second on a page."""
_CAPTION, _SOUND, _CLOCK = 0.24, 0.46, 0.26
"""Metres of height: of a source's name, the waveform, the seconds with the gap below them."""


def from_front(points: Array) -> tuple[Array, Array, Array]:
    """Front view in metres: the character's left is on the right."""
    return points[..., :2], np.ones(points.shape[:-1]), points[..., 2]


def from_side(points: Array) -> tuple[Array, Array, Array]:
    """Side view from the character's left, facing left."""
    return points[..., 2:0:-1] * [-1.0, 1.0], np.ones(points.shape[:-1]), points[..., 0]


class View(NamedTuple):
    """A projection, and the visible thickness of the trunk as a share of its width."""

    look: Look
    trunk: float


VIEWS = {"front": View(from_front, 1.0), "side": View(from_side, 0.72)}


@dataclass(frozen=True)
class Layout:
    """How rows of figures are laid out. spacing, margin: metres between figures, and beside the first and the last (a
    stretched arm ends inside); low, high: metres over the floor that are shown; line: figures of a line; scale: inches
    for a metre; views: a row for each."""

    spacing: float
    margin: float
    low: float
    high: float
    line: int
    scale: float
    views: Sequence[str] = tuple(VIEWS)


PAGE = Layout(0.98, 0.88, 0.60, 2.02, 16, 0.84)
"""From the thighs to a raised hand; a line of 16 figures is 14 inches wide."""


@dataclass(frozen=True)
class Source:
    """A motion to draw, and its name."""

    name: str
    motion: Motion


def page_times(start: float, seconds: float, longest: float) -> Array:
    """[n] seconds, `POSES` a second, as far as the longest motion goes; InputError where there is none."""
    if not (math.isfinite(start) and math.isfinite(seconds) and 0 <= start < longest and seconds > 0):
        raise InputError("plot strip", f"{start:g} s and {seconds:g} s more are outside the motion, which lasts "
                         f"{longest:.2f} s", "give another --start or --seconds")
    # A small number for stretches that poses divide evenly.
    end = min(start + seconds, longest)
    return start + np.arange(max(1, math.floor((end - start) * POSES + 1e-9))) / POSES


def draw_page(sources: Sequence[Source], times: Array, speech: Speech | None = None, beats: Beats | None = None,
              layout: Layout = PAGE) -> Figure:
    """Every source at the same `times` [n] seconds, a row for each view; the sound with its beats below each line.

    A source that ends earlier is left out of the lines that it does not reach. InputError for no source or no time.
    """
    from matplotlib.figure import Figure as NewFigure

    if not sources or len(times) == 0:
        raise InputError("plot strip", "has nothing to draw", "name a motion, --corpus or --ours")
    # A last line that is short keeps the scale of the others, so every row is as wide as a full one.
    wide = (min(len(times), layout.line) - 1) * layout.spacing + 2 * layout.margin
    # The page is a stack of rows, each of a height in metres of the figures' own scale.
    rows: list[tuple[float, Callable[[Axes], None]]] = []
    for at in range(0, len(times), layout.line):
        line = times[at:at + layout.line]
        for source in (source for source in sources if source.motion.duration > line[-1] - 1e-9):
            if source.name:
                rows.append((_CAPTION, partial(_draw_text, text=source.name, size=10.5, colour=INK, weight="bold")))
            rows += [(layout.high - layout.low, partial(draw_row, motion=source.motion, times=line, view=view,
                                                        layout=layout, wide=wide)) for view in layout.views]
        if speech is not None and line[0] < speech.duration:
            rows.append((_SOUND, partial(_draw_sound, speech=speech, beats=beats, times=line, layout=layout,
                                         wide=wide)))
        rows.append((_CLOCK, partial(_draw_clock, times=line, layout=layout, wide=wide)))
    heights = [height for height, _ in rows]
    figure = NewFigure(figsize=(wide * layout.scale, sum(heights) * layout.scale), facecolor="white")
    axes = figure.subplots(len(rows), 1, squeeze=False, height_ratios=heights, gridspec_kw={
        "left": 0.0, "right": 1.0, "bottom": 0.0, "top": 1.0, "hspace": 0.0}).ravel()
    for axis, (_, draw) in zip(axes, rows, strict=True):
        draw(axis)
        axis.axis("off")
    return figure


def _draw_text(axis: Axes, text: str, size: float, colour: str, weight: str = "normal") -> None:
    """A line of text at the left."""
    axis.text(0.005, 0.5, text, fontsize=size, color=colour, va="center", weight=weight)


def _draw_clock(axis: Axes, times: Array, layout: Layout, wide: float) -> None:
    """The seconds of each figure below it."""
    axis.set_xlim(-layout.margin, wide - layout.margin)
    for k, time in enumerate(times):
        axis.text(k * layout.spacing, 0.7, f"{time:.2f} s", ha="center", va="center", fontsize=7.5, color=SOFT)


def draw_row(axis: Axes, motion: Motion, times: Array, view: str, layout: Layout, wide: float) -> None:
    """One view of a motion: a figure for each of `times` (seconds), with the path of both hands since the last one;
    wide: metres of the row."""
    # A figure's trail starts where the figure before it stood; the first has none.
    gap = float(times[1] - times[0]) if len(times) > 1 else 0.0
    for k, time in enumerate(times):
        moments = np.linspace(max(time - gap, 0.0), time, _TRAIL_STEPS) if k else np.array([time])
        _draw_figure(axis, figure_points(motion, moments), view, k * layout.spacing, 100 * k)
    axis.axhline(max(layout.low, 0.0), color=FLOOR, linewidth=1.5, zorder=-10)
    axis.text(0.1 - layout.margin, layout.high - 0.07, view, fontsize=9, color=SOFT, style="italic", va="top")
    axis.set(xlim=(-layout.margin, wide - layout.margin), ylim=(layout.low, layout.high))


def seen(points: Mapping[str, Array], view: View, paper: str) -> list[FlatPart]:
    """The figure at one time, points [1, 3]: legs, then all visible parts, from back to front."""
    whole = [[flattened(part, view.look, paper) for part in parts if part.shown is None or part.shown[0]]
             for parts in (legs(points), body(points, view.look, view.trunk))]
    return [part for parts in whole for part in sorted(parts, key=lambda part: float(part.near[0]))]


def _draw_figure(axis: Axes, points: dict[str, Array], view: str, centre: float, order: int) -> None:
    """The pose at the last of the moments, [T, 3] each, and each hand's trail over its arm."""
    from matplotlib.patches import Polygon

    for level, part in enumerate(seen({name: path[-1:] for name, path in points.items()}, VIEWS[view], "white"), order):
        for corners, colour in part.polygons:
            axis.add_patch(Polygon(corners[0] + [centre, 0.0], facecolor=colour, edgecolor="none", zorder=level))
        if part.hand:
            path, _, _ = VIEWS[view].look(points[f"{part.hand}HandTip"])
            # The first figure has no path behind it.
            if len(path) > 1:
                _draw_trail(axis, path + np.array([centre, 0.0]), HANDS[part.hand], level + 0.5)


def _draw_trail(axis: Axes, path: Array, colour: str, order: float) -> None:
    """The way of a hand [T, 2], faint where it is old."""
    from matplotlib.collections import LineCollection

    age = np.linspace(0.0, 1.0, len(path) - 1)
    axis.add_collection(LineCollection(list(np.stack([path[:-1], path[1:]], axis=1)), colors=colour,
                                       alpha=0.75 * age ** 1.5, linewidths=0.5 + 1.5 * age, capstyle="butt",
                                       zorder=order))


def _draw_sound(axis: Axes, speech: Speech, beats: Beats | None, times: Array, layout: Layout, wide: float) -> None:
    """The waveform under the figures: time runs as they do, so that each stands above its own moment."""
    gap = float(times[1] - times[0]) if len(times) > 1 else 1.0
    start, end = times[0] - gap * layout.margin / layout.spacing, times[-1] + gap * layout.margin / layout.spacing
    draw_wave(axis, speech, beats, max(start, 0.0), min(end, speech.duration))
    for time in times:
        axis.axvline(time, color=FLOOR, linewidth=0.8, zorder=-5)
    axis.set_xlim(start, start + gap * wide / layout.spacing)


def draw_wave(axis: Axes, speech: Speech, beats: Beats | None, start: float, end: float) -> None:
    """The extremes of the samples from start to end, seconds, and beats as lines in the colours of their flags."""
    # The extremes of each bin: a plain line would leave out what lies between its points.
    bins = np.linspace(start, end, 1201)
    # `reduceat` needs places within the samples; the last one may lie at their end.
    places = np.minimum((bins * speech.sample_rate).astype(int), len(speech.samples) - 1)
    pieces = speech.samples[:places[-1] + 1]
    low, top = (np.asarray(pick.reduceat(pieces, places)) for pick in (np.minimum, np.maximum))
    axis.fill_between(bins, low, top, color=SOFT, linewidth=0, step="post", label="_sound")
    limit = float(np.abs([top, low]).max()) or 1.0
    for flag in BeatFlag:
        mine = np.zeros(0) if beats is None else beats.times[
            (beats.flags == flag) & (beats.times >= start) & (beats.times <= end)]
        if len(mine):
            axis.vlines(mine, -limit, limit, color=BEAT_COLOURS[flag], linewidth=1.0, alpha=0.85, label="_beats")
            axis.plot(mine, np.full(len(mine), 1.18 * limit), color=BEAT_COLOURS[flag], marker=_MARKERS[flag],
                      markersize=4, linestyle="none", label=f"beat: {BEAT_NAMES[flag]}", clip_on=False)
    axis.set_ylim(-1.05 * limit, 1.32 * limit)


def save_strip(figure: Figure, path: str | Path, dpi: int = 150) -> None:
    """Write a picture whole or not at all, the same bytes for the same figure; the suffix picks png, svg or pdf.

    It leaves out the date, the version and matplotlib's random names. The names within an SVG are hashes of what they
    name, so several may stand in one page.
    """
    from matplotlib import rc_context

    target, out = Path(path), io.BytesIO()
    kind = target.suffix.lstrip(".").lower()
    if kind not in _UNSAID:
        raise InputError(target, f"'{target.suffix}' is not a picture format", "use .png, .svg or .pdf")
    with rc_context({"svg.hashsalt": "gesticulator", "svg.fonttype": "path"}):
        figure.savefig(out, format=kind, dpi=dpi, metadata=_UNSAID[kind])
    write_bytes(target, out.getvalue())
