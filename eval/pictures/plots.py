"""The papers' figures, drawn from plain arrays: what a report shows beside its tables.

    delta_curves       PMB against its tolerance                        RG Fig. 11
    cluster_bars       entropy of lexemes within clusters of sound      RG Fig. 14
    beat_strips        motion beats beside onsets                       RG Fig. 16
    size_sweep         metrics against the size of the lexicon          RG Fig. 18
    overview           a few seconds of speech, blocks and motion       RG Fig. 2
    style_editing      what was asked for, and what came of it          RG Fig. 10

Each takes numbers and gives a figure; nothing is computed here that is not said, so a picture holds what its numbers
hold. The same input gives the same bytes (`strips.save_strip`). Colours are of the palette of Okabe and Ito (2008),
which people with any colour vision tell apart, and no meaning hangs on colour alone: lines have markers, lexemes, of
which there are too many for any palette, have numbers. The other figures of the papers are drawn by
`data_module.intervals` (5, 8a), `embedding` (6, 8b, 15, 17) and `strips` (9).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from data_module.controls import FEATURES, LEVELS
from data_module.speech.onsets import merged
from data_module.types import Array, Beats, Speech, Word
from eval.metrics import pmb
from eval.pictures.canvas import COLUMNS, TEXT, WIDE, bare, canvas
from eval.pictures.embedding import Labels, colours
from eval.pictures.strips import draw_wave
from gesticulator.export.figure import FLOOR, INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, VERMILION, GREEN, PINK, ORANGE, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
PALETTE = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ((0, (5, 2)), (0, (5, 2, 1, 2)), (0, (10, 3)))
LEVEL_COLOURS = dict(zip(LEVELS, (BLUE, GREEN, VERMILION), strict=True))

Triple = tuple[float, float, float]
"""A mean and the two ends of its interval."""


def _graded(axis: Axes) -> None:
    """With faint lines at the ticks of its height."""
    axis.grid(axis="y", color=FLOOR, linewidth=0.6)
    axis.set_axisbelow(True)
    bare(axis)


def _legend(figure: Figure, axes: Iterable[Axes], *, above: bool = False) -> None:
    """One legend for all panels, each name once, below them or above."""
    named = {label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    if named:
        figure.legend(list(named.values()), list(named), ncols=len(named), fontsize=TEXT, frameon=False, labelcolor=INK,
                      loc="outside upper center" if above else "outside lower center")


# ---------------------------------------------------------------------------------------------------------- Fig. 11

def delta_curves(curves: Mapping[str, Sequence[float]], deltas: Sequence[float], dashed: Collection[str] = ()
                 ) -> Figure:
    """PMB in percent over delta in seconds, one line for each row (RG Fig. 11).

    curves: row -> [n] percent (NaN is left out of the line); deltas: [n], rising; dashed: the rows that are references.
    Every curve nears 100 % as delta grows: a row tells something where it stands above what is known to be wrong.
    """
    figure = canvas(4.6)
    axis = figure.subplots()
    # Six colours and seven markers: 42 rows before two look alike.
    looks, dashes = zip(cycle(PALETTE), cycle(MARKERS), strict=False), cycle(DASHES)
    for name, percent in curves.items():
        if name in dashed:
            axis.plot(deltas, percent, color=INK, linestyle=next(dashes), linewidth=1.6, label=name)
        else:
            colour, marker = next(looks)
            axis.plot(deltas, percent, color=colour, marker=marker, markersize=5, linewidth=1.6, label=name)
    axis.set(xlabel="delta, s", ylabel="PMB, % of motion beats", ylim=(0, 102), xlim=(0, 1.02 * deltas[-1]))
    _graded(axis)
    figure.legend(loc="outside right upper", fontsize=TEXT, frameon=False, labelcolor=INK, handlelength=3)
    return figure


# ---------------------------------------------------------------------------------------------------------- Fig. 16

def beat_strips(rows: Mapping[str, tuple[Array, Array, Array]], start: float, seconds: float,
                delta: float = pmb.DELTA) -> Figure:
    """Which motion beats an onset matches, over a stretch of the same speech for each row (RG Fig. 16).

    rows: row, such as a range of onset intervals -> motion beats [n], onsets [m], block edges [k], all seconds. Onsets
    are ticks above, motion beats dots below, filled where `pmb.matched` gives them an onset, and joined to it. The
    matching is that of the whole row, onsets merged as in `pmb.pmb`; the figure at the right is of the motion beats
    within the stretch. What fools it: a few seconds are an example, and unrelated beats are matched too.
    """
    # A row of fixed height each, so that rows of two pictures compare.
    figure, end = canvas(0.8 + 0.95 * len(rows)), start + seconds
    axes = figure.subplots(len(rows), 1, squeeze=False, sharex=True).ravel()
    for axis, (name, (beats, onsets, edges)) in zip(axes, rows.items(), strict=True):
        _draw_beats(axis, np.sort(beats), merged(np.sort(onsets), pmb.MERGE), edges, (start, end), delta)
        axis.set_ylabel(name, rotation=0, ha="right", va="center")
        axis.set(xlim=(start, end), ylim=(-0.35, 1.35))
        bare(axis, ("bottom",) if axis is axes[-1] else ())
        axis.tick_params(bottom=axis is axes[-1], labelbottom=axis is axes[-1])
    axes[-1].set_xlabel(f"seconds; matched: an onset less than {delta:g} s away, one for one")
    _legend(figure, axes[:1], above=True)
    return figure


def _draw_beats(axis: Axes, beats: Array, onsets: Array, edges: Array, span: tuple[float, float], delta: float
                ) -> None:
    """One row of `beat_strips`: what lies in the span, and the pairs of the beats that do."""
    from matplotlib.collections import LineCollection

    def within(times: Array) -> NDArray[np.bool_]:
        return (times >= span[0]) & (times <= span[1])

    # Matched before the stretch is cut out: a partner may lie just outside of it.
    pairs, shown = pmb.matched(beats, onsets, delta), within(beats)
    paired, alone = shown & (pairs >= 0), shown & (pairs < 0)
    axis.vlines(onsets[within(onsets)], 0.78, 1.22, color=INK, linewidth=1.6, label="onset")
    joined = [[(float(onsets[k]), 0.78), (float(beat), 0.0)] for beat, k in zip(beats[paired], pairs[paired],
                                                                             strict=True)]
    axis.add_collection(LineCollection(joined, colors=BLUE, linewidths=1.2, label="_pairs"))
    axis.scatter(beats[paired], np.zeros(paired.sum()), s=38, color=BLUE, zorder=4, clip_on=False,
                 label="motion beat, matched")
    axis.scatter(beats[alone], np.zeros(alone.sum()), s=38, facecolor="white", edgecolor=VERMILION, linewidths=1.6,
                 zorder=3, clip_on=False, label="motion beat, not matched")
    axis.vlines(edges[within(edges)], -0.35, 1.35, color=SOFT, linewidth=0.8, alpha=0.6, zorder=0, label="block edge")
    count = int(shown.sum())
    label_text = f"PMB {100 * paired.sum() / count:.0f} %\n{paired.sum()} of {count}" if count else "no motion\nbeat"
    axis.text(1.015, 0.5, label_text, transform=axis.transAxes, fontsize=TEXT, color=INK, va="center")


# ---------------------------------------------------------------------------------------------------------- Fig. 18

def size_sweep(sizes: Sequence[int], figures: Mapping[str, Sequence[Triple]],
               reference: Mapping[str, float] | None = None, *, chosen: int | None = None) -> Figure:
    """Metrics over the size of the lexicon, one panel for each (RG Fig. 18).

    sizes: [n], rising; figures: the metric's title -> a (mean, low, high) for each size, NaN where there is none;
    reference: the metric's title -> the performer's value, a dashed line; chosen: the size that is in use, dotted.
    """
    # Three panels in a row are what a page is wide enough for.
    across = min(COLUMNS, len(figures))
    down = math.ceil(len(figures) / across)
    figure = canvas(3.1 * down)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis, (title, values) in zip(axes, figures.items(), strict=False):
        _draw_intervals(axis, np.array(sizes, float), np.array(values, float))
        if chosen is not None:
            axis.axvline(chosen, color=SOFT, linestyle=":", linewidth=1.2, label="size in use")
        if reference and math.isfinite(reference.get(title, math.nan)):
            axis.axhline(reference[title], color=INK, linestyle=DASHES[0], linewidth=1.2, label="performer")
        # Sizes differ by factors.
        axis.set_xscale("log")
        axis.set_xticks(list(sizes), [f"{size:g}" for size in sizes])
        axis.set_xticks([], minor=True)
        axis.set(title=title, xlabel="lexemes")
        _graded(axis)
    for axis in axes[len(figures):]:
        axis.axis("off")
    _legend(figure, axes[:len(figures)])
    return figure


def _draw_intervals(axis: Axes, at: Array, intervals: Array) -> None:
    """Means [n] joined by a line, each with its interval; intervals: [n, 3] mean, low, high."""
    axis.plot(at, intervals[:, 0], color=BLUE, marker="o", markersize=5, linewidth=1.6, label="mean and 95 % interval")
    known = np.isfinite(intervals).all(axis=1)
    axis.vlines(at[known], intervals[known, 1], intervals[known, 2], color=BLUE, linewidth=1.4, label="_interval")


# ---------------------------------------------------------------------------------------------------------- Fig. 14

def cluster_bars(panels: Mapping[str, Mapping[str, Any]]) -> Figure:
    """How much the cluster of a block's sound tells of its lexeme, for each level of the encoder (RG Fig. 14).

    panels: whose motion -> `eval.metrics.audio_clusters.association`. Left the entropy of
    the lexeme given the cluster beside what the same lexemes, turned round, have by chance, under the entropy of the
    lexeme alone; right the gain, which alone has an interval. Clusters of a few blocks have a low entropy whatever they
    hold, so a bar means something only beside its chance.
    """
    levels = [name for name, value in next(iter(panels.values())).items()
              if isinstance(value, Mapping) and "entropy" in value]
    figure = canvas(3.9)
    bars, gains = figure.subplots(1, 2, width_ratios=(3, 2))
    wide = 0.8 / (2 * len(levels))
    for group, measured in enumerate(panels.values()):
        # One name in the legend, whatever the number of panels: matplotlib leaves out names that begin with "_".
        hidden = "_" if group else ""
        bars.hlines(float(measured["lexeme_entropy"]), group - 0.45, group + 0.45, color=INK, linestyle=DASHES[0],
                    linewidth=1.4, label=f"{hidden}lexeme alone")
        for number, name in enumerate(levels):
            level, colour = measured[name], PALETTE[number % len(PALETTE)]
            middle, gain = group + (2 * number + 1 - len(levels)) * wide, level["gain"]
            bars.bar(middle - wide / 2, level["entropy"], 0.9 * wide, color=colour, label=f"{hidden}{name}")
            bars.bar(middle + wide / 2, level["by_chance"], 0.9 * wide, facecolor="white", edgecolor=colour,
                     hatch="///", linewidth=1.2, label=f"{hidden}{name}, by chance")
            gains.vlines(middle, gain.low, gain.high, color=colour, linewidth=1.8, label=f"_{name}")
            gains.plot([middle], [gain.mean], color=colour, marker="o", markersize=6.5, label=f"_{name}")
            gains.annotate(f"p {level['p']:.2f}", (middle, max(gain.high, gain.mean)), (0, 4), ha="center",
                           textcoords="offset points", fontsize=TEXT, color=INK)
    gains.axhline(0.0, color=INK, linewidth=0.9, zorder=0)
    # Room for the p above the highest gain.
    gains.margins(y=0.12)
    for axis, title in ((bars, "entropy of the lexeme given the cluster, nats"),
                        (gains, "gain: chance less entropy, nats")):
        axis.set_xticks(range(len(panels)), [f"{name}\n{panel['blocks']} blocks" for name, panel in panels.items()])
        axis.set(title=title, xlim=(-0.55, len(panels) - 0.45))
        _graded(axis)
    _legend(figure, (bars,))
    return figure


# ----------------------------------------------------------------------------------------------------------- Fig. 2

@dataclass(frozen=True)
class Overview:
    """The data of Fig. 2. edges: [N + 1] seconds and lexemes: [N] of the blocks; hand_speed: [T] m/s, frame t at
    t / fps seconds, such as `motion_beats.acting_speed`; motion_beats: seconds; silent: lexemes that are hatched."""

    speech: Speech
    beats: Beats
    edges: Array
    lexemes: Labels
    hand_speed: Array
    fps: float
    motion_beats: Array
    words: Sequence[Word] = ()
    silent: Sequence[int] = ()


def overview(of: Overview, start: float, seconds: float) -> Figure:
    """A stretch of one performance: words, sound and beats, blocks and lexemes, hands and motion beats (RG Fig. 2).

    The stretch is clamped to the speech.
    """
    end = min(start + seconds, of.speech.duration)
    heights = (0.5, 1.3, 0.45, 1.1)
    figure = canvas(sum(heights) + 1.0)
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    axes[0].set_xlim(start, end)
    spoken, sound, cells, hands = axes
    _draw_words(spoken, [word for word in of.words if word.text and word.end > start and word.start < end], start, end)
    draw_wave(sound, of.speech, of.beats, start, end)
    sound.set_ylabel("sound")
    _quiet(sound)
    _draw_cells(cells, of.edges, of.lexemes, of.silent, start, end)
    _draw_hands(hands, of.hand_speed, of.fps, of.motion_beats, start, end)
    for axis in axes:
        axis.vlines(of.edges, 0, 1, transform=axis.get_xaxis_transform(), color=FLOOR, linewidth=0.8, zorder=0,
                    label="_edges")
        axis.tick_params(bottom=axis is hands, labelbottom=axis is hands)
    hands.set_xlabel("seconds")
    _legend(figure, (sound, hands))
    return figure


def _draw_words(axis: Axes, words: Sequence[Word], start: float, end: float) -> None:
    """Each word over its middle, in three lanes in turn, so that neighbours do not run into each other."""
    for number, word in enumerate(words):
        middle = min(max((word.start + word.end) / 2, start), end)
        axis.text(middle, 2.5 - number % 3, word.text, fontsize=TEXT, color=INK, ha="center", va="center", clip_on=True)
    axis.set(ylim=(0, 3), ylabel="words")
    _quiet(axis)


def _quiet(axis: Axes) -> None:
    """A row without a scale, its name beside it."""
    bare(axis, ())
    axis.yaxis.label.set(rotation=0, horizontalalignment="right", verticalalignment="center")


def _draw_cells(axis: Axes, edges: Array, lexemes: Labels, silent: Sequence[int], start: float, end: float) -> None:
    """Blocks as cells of their lexeme's colour, numbered where the number fits."""
    palette = colours(int(lexemes.max(initial=0)) + 1)
    inch = (end - start) / (WIDE - 1.0)
    for left, right, lexeme in zip(edges[:-1], edges[1:], lexemes.tolist(), strict=True):
        shown = min(right, end) - max(left, start)
        if shown <= 0:
            continue
        # A silent lexeme is hatched: hue alone would not tell it apart.
        still = lexeme in silent
        axis.barh(0.5, right - left, 0.9, left, color="white" if still else palette[lexeme],
                  edgecolor=palette[lexeme] if still else "white", hatch="////" if still else None, linewidth=1.0,
                  label=f"_{lexeme}")
        if shown >= (0.06 + 0.085 * len(str(lexeme))) * inch:
            axis.text((max(left, start) + min(right, end)) / 2, 0.5, str(lexeme), fontsize=TEXT, ha="center",
                      va="center", color=INK, bbox={"boxstyle": "round,pad=0.12", "fc": "white", "ec": "none"})
    axis.set(ylim=(0, 1), ylabel="lexemes")
    _quiet(axis)


def _draw_hands(axis: Axes, speed: Array, fps: float, beat_times: Array, start: float, end: float) -> None:
    times = np.arange(len(speed)) / fps
    # One frame more on both sides, so that the line reaches the edges.
    shown = (times >= start - 1 / fps) & (times <= end + 1 / fps)
    axis.plot(times[shown], speed[shown], color=INK, linewidth=1.4, label="_speed")
    mine = beat_times[(beat_times >= start) & (beat_times <= end)]
    # Motion beats stand below the curve, where nothing hides them.
    top = 1.1 * float(speed[shown].max(initial=0.0)) or 1.0
    axis.vlines(mine, -0.22 * top, np.interp(mine, times, speed) if len(speed) else 0.0, color=BLUE, linewidth=0.9,
                label="_beats")
    axis.plot(mine, np.full(len(mine), -0.22 * top), color=BLUE, marker="^", markersize=6, linestyle="none",
              label="motion beat", clip_on=False)
    axis.set(ylim=(-0.32 * top, top), ylabel="arms, m/s")
    bare(axis)


# ---------------------------------------------------------------------------------------------------------- Fig. 10

def style_editing(result: Mapping[str, Any]) -> Figure:
    """For each feature the first clip over time beside what was asked, and box plots of all clips.

    result: of `eval.ablate.style_editing.figures`. Whiskers reach the extremes; dashes are what was asked for.
    """
    figure = canvas(3 * len(FEATURES))
    for index, (feature, axes) in enumerate(zip(FEATURES, figure.subplots(
            len(FEATURES), 2, width_ratios=(2, 1), sharey="row"), strict=True)):
        over_time, boxes = axes
        rows, requested = {level: f"{feature} {level}" for level in LEVELS} | result["beside"], result["asked"][feature]
        drawn = boxes.boxplot([result["values"][row][feature] for row in rows.values()], whis=(0, 100))
        boxes.set_xticks(range(1, len(rows) + 1), list(rows))
        for place, (level, colour) in enumerate(LEVEL_COLOURS.items(), 1):
            series = result["series"][rows[level]]
            curve = series["values"][index]
            over_time.plot(np.arange(len(curve)) / series["fps"], curve, color=colour, label=level)
            over_time.axhline(requested[level], color=colour, linestyle="--", linewidth=0.8)
            boxes.hlines(requested[level], place - 0.4, place + 0.4, color=colour, linestyle="--")
            drawn["boxes"][place - 1].set_color(colour)
        over_time.set_ylabel(result["titles"][feature])
        if index == 0:
            over_time.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(LEVELS), frameon=False)
    over_time.set_xlabel(f"seconds of {result['clips'][0]['name']} (mean over 4 s)")
    boxes.set_xlabel(f"means over {len(result['clips'])} clips")
    return figure
