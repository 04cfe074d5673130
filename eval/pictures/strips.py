"""Strips: motion as rows of still figures, seen from the front and from the side, for papers, README and judgement.

A strip shows what a number hides: a soldier's return to rest, an elbow behind the back, a hand in the face, the same
clip twice. Each figure is drawn at its own time, with the paths of both hands since the figure before it (the right
hand red, the left hand green); underneath, where they are given, the waveform and its beats on the same time axis.
Several sources stand below each other at the same seconds, and a long stretch goes on in the next line.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.types import Array, BeatFlag, Beats, Motion, Speech
from gesticulator.export.figure import FLOOR, HANDS, INK, SOFT, VIEWS, figure_points, seen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BEAT_COLOURS = {BeatFlag.ONSET: "#c8553d", BeatFlag.LOUD_PSEUDO: "#d08c10", BeatFlag.EVEN_PSEUDO: "#5b7fa6",
                BeatFlag.BOUNDARY: INK}
BEAT_MARKERS = {BeatFlag.ONSET: "o", BeatFlag.LOUD_PSEUDO: "^", BeatFlag.EVEN_PSEUDO: "s", BeatFlag.BOUNDARY: "D"}
BEAT_NAMES = {BeatFlag.ONSET: "onset", BeatFlag.LOUD_PSEUDO: "first loud frame", BeatFlag.EVEN_PSEUDO: "even",
              BeatFlag.BOUNDARY: "start or end"}
_UNSAID: dict[str, dict[str, Any]] = {
    "png": {"Software": None}, "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}
_TRAIL_STEPS = 40
_WIDEST = 21.0
"""Inches."""
_TITLE, _CAPTION, _SOUND, _CLOCK, _CREDIT, _AIR, _GAP = 0.34, 0.24, 0.46, 0.16, 0.16, 0.06, 0.1
"""Metres of height: of the title, a source's name, the waveform, the seconds, a credit, below a source and a line."""


@dataclass(frozen=True)
class Layout:
    """How rows of figures are laid out. spacing, margin: metres between figures, and beside the first and the last (a
    stretched arm ends inside); low, high: metres over the floor that are shown; line: figures of a line; scale: inches
    for a metre; views: a row for each; legs: of the motion itself, see `figure_points`."""

    spacing: float
    margin: float
    low: float
    high: float
    line: int
    scale: float
    views: Sequence[str] = tuple(VIEWS)
    legs: bool = False


STRIP = Layout(1.12, 0.72, -0.08, 1.93, 1000, 1.2)
"""One motion, from head to foot, in one line."""
PAGE = Layout(0.98, 0.88, 0.60, 2.02, 16, 0.84)
"""Several, from the thighs to a raised hand; a line of 16 figures is 14 inches wide."""


@dataclass(frozen=True)
class Source:
    """A motion to draw, its name, and what is to be said of its rights."""

    name: str
    motion: Motion
    credit: str = ""


def frame_times(motion: Motion, start: float = 0.0, seconds: float | None = None, count: int = 8) -> Array:
    """[count] seconds, evenly spread over the stretch and clamped to the motion; InputError when it holds none."""
    last = (len(motion) - 1) / motion.fps
    end = last if seconds is None else min(start + seconds, last)
    if count < 1:
        raise InputError("--frames", f"must be 1 or more, not {count}")
    if not (math.isfinite(start) and 0 <= start <= last and end >= start):
        raise InputError("strip", f"{start:g} s is outside the motion, which lasts {motion.duration:.2f} s",
                         "give another --start or --seconds")
    return np.linspace(start, end, count) if count > 1 else np.array([start])


def draw_page(sources: Sequence[Source], times: Array, speech: Speech | None = None, beats: Beats | None = None,
              title: str = "", credits: Sequence[str] = (), layout: Layout = PAGE) -> Figure:
    """Every source at the same `times` [n] seconds, a row for each view; the sound with its beats below each line.

    A source that ends earlier is left out of the lines that it does not reach. The credits of sources and those given
    stand at the foot. InputError for no source or no time.
    """
    from matplotlib.figure import Figure as NewFigure

    if not sources or len(times) == 0:
        raise InputError("plot strip", "has nothing to draw", "name a motion, --take, --corpus, --ours or --system")
    lines = [times[at:at + layout.line] for at in range(0, len(times), layout.line)]
    shown = [[source for source in sources if source.motion.duration > line[-1] - 1e-9] for line in lines]
    foot = [*dict.fromkeys([*(source.credit for source in sources if source.credit), *credits])]
    rows = len(layout.views) * (layout.high - layout.low) + _AIR
    tall = sum((_CAPTION if source.name else 0.0) + rows for line_sources in shown for source in line_sources)
    tall += len(lines) * ((_SOUND if speech is not None else 0.0) + _CLOCK + _GAP)
    tall += (_TITLE if title else 0.0) + _CREDIT * len(foot) + _AIR
    wide = (len(lines[0]) - 1) * layout.spacing + 2 * layout.margin
    scale = min(layout.scale, _WIDEST / wide)
    pen = _Pen(NewFigure(figsize=(wide * scale, tall * scale), facecolor="white"), wide, tall)
    if title:
        pen.text(_TITLE, title, 12, INK, ha="center")
    for line, line_sources in zip(lines, shown, strict=True):
        _draw_line(pen, line_sources, line, speech, beats, layout)
    for text in foot:
        pen.text(_CREDIT, text, 7.5, SOFT)
    return pen.figure


@dataclass
class _Pen:
    """Goes down a page in metres of the figures' own scale."""

    figure: Figure
    wide: float
    tall: float
    at: float = 0.0

    def axis(self, height: float, share: float) -> Axes:
        """The next axes of this height and share of the page's width."""
        self.at += height
        return self.figure.add_axes((0.0, 1.0 - self.at / self.tall, share, height / self.tall))

    def text(self, height: float, text: str, size: float, colour: str, **how: Any) -> None:
        """A line of text, at the left or in the middle."""
        self.figure.text(0.5 if "ha" in how else 0.12 / self.wide, 1.0 - (self.at + height / 2) / self.tall, text,
                         fontsize=size, color=colour, va="center", **how)
        self.at += height


def _draw_line(pen: _Pen, sources: Sequence[Source], times: Array, speech: Speech | None, beats: Beats | None,
               layout: Layout) -> None:
    # A last line that is short keeps the scale of the others.
    across = (len(times) - 1) * layout.spacing + 2 * layout.margin
    share = across / pen.wide
    for source in sources:
        if source.name:
            pen.text(_CAPTION, source.name, 10.5, INK, weight="bold")
        for view in layout.views:
            draw_row(pen.axis(layout.high - layout.low, share), source.motion, times, view, layout)
        pen.at += _AIR
    if speech is not None and times[0] < speech.duration:
        draw_sound(pen.axis(_SOUND, share), speech, beats, times, layout)
    clock = pen.axis(_CLOCK, share)
    clock.set(xlim=(-layout.margin, across - layout.margin), ylim=(0.0, 1.0))
    clock.axis("off")
    for k, time in enumerate(times):
        clock.text(k * layout.spacing, 0.5, f"{time:.2f} s", ha="center", va="center", fontsize=7.5, color=SOFT)
    pen.at += _GAP


def draw_row(axis: Axes, motion: Motion, times: Array, view: str, layout: Layout) -> None:
    """One view of a motion: a figure for each of `times` (seconds), with the path of both hands since the last one."""
    # A figure's trail starts where the figure before it stood; the first has none.
    gap = float(times[1] - times[0]) if len(times) > 1 else 0.0
    for k, time in enumerate(times):
        moments = np.linspace(max(time - gap, 0.0), time, _TRAIL_STEPS) if k else np.array([time])
        _draw_figure(axis, figure_points(motion, moments, layout.legs), view, k * layout.spacing, 100 * k)
    axis.axhline(max(layout.low, 0.0), color=FLOOR, linewidth=1.5, zorder=-10)
    axis.text(0.1 - layout.margin, layout.high - 0.07, view, fontsize=9, color=SOFT, style="italic", va="top")
    axis.set(xlim=(-layout.margin, (len(times) - 1) * layout.spacing + layout.margin), ylim=(layout.low, layout.high))
    axis.axis("off")


def _draw_figure(axis: Axes, points: dict[str, Array], view: str, centre: float, order: int) -> None:
    """The pose at the last of the moments, [T, 3] each, and each hand's trail over its arm."""
    from matplotlib.patches import Polygon

    for level, part in enumerate(seen({name: path[-1:] for name, path in points.items()}, VIEWS[view]), order):
        for corners, colour in part.polygons("white"):
            axis.add_patch(Polygon(corners[0] + [centre, 0.0], facecolor=colour, edgecolor="none", zorder=level))
        if part.hand:
            path, _, _ = VIEWS[view].look(points[f"{part.hand}HandTip"])
            _draw_trail(axis, path + np.array([centre, 0.0]), HANDS[part.hand], level + 0.5)


def _draw_trail(axis: Axes, path: Array, colour: str, order: float) -> None:
    """The way of a hand [T, 2], faint where it is old."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgba

    age = np.linspace(0.0, 1.0, len(path) - 1)
    colours = [(*to_rgba(colour)[:3], 0.75 * share ** 1.5) for share in age]
    axis.add_collection(LineCollection(list(np.stack([path[:-1], path[1:]], axis=1)), colors=colours,
                                       linewidths=0.5 + 1.5 * age, capstyle="butt", zorder=order))


def draw_sound(axis: Axes, speech: Speech, beats: Beats | None, times: Array, layout: Layout) -> None:
    """The waveform under the figures: time runs as they do, so that each stands above its own moment."""
    start, end = float(times[0]), float(times[-1])
    # The same share of a spacing beyond the first and the last figure as in the rows above.
    margin = layout.margin / layout.spacing * ((end - start) / max(len(times) - 1, 1) or 1.0)
    draw_wave(axis, speech, beats, max(start - margin, 0.0), min(end + margin, speech.duration))
    for time in times:
        axis.axvline(time, color=FLOOR, linewidth=0.8, zorder=-5)
    axis.set_xlim(start - margin, end + margin)
    axis.axis("off")


def draw_wave(axis: Axes, speech: Speech, beats: Beats | None, start: float, end: float) -> None:
    """The extremes of the samples from start to end, seconds, and beats as lines in the colours of their flags."""
    bins = np.linspace(start, end, 1201)
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
            axis.plot(mine, np.full(len(mine), 1.18 * limit), color=BEAT_COLOURS[flag], marker=BEAT_MARKERS[flag],
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
