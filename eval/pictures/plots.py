"""The papers' figures, drawn from plain arrays: what a report shows beside its tables.

    interval_bars      intervals between onsets and between beats      RG Fig. 5, 8a
    editing_panels     what was asked of the hands and what they did    RG Fig. 10
    delta_curves       PMB against its tolerance                        RG Fig. 11
    cluster_bars       entropy of lexemes within clusters of sound      RG Fig. 14
    beat_strips        motion beats beside onsets                       RG Fig. 16
    size_sweep         metrics against the size of the lexicon          RG Fig. 18
    overview           a few seconds of speech, blocks and motion       RG Fig. 2

Each takes numbers and gives a figure. Colours are of the palette of Okabe and Ito (2008), which people with any colour
vision tell apart, and no meaning hangs on colour alone: lines have markers, lexemes, of which there are too many for
any palette, have numbers. The other figures of the papers are drawn by `embedding` (6, 8b, 15, 17) and `strips` (9).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.blocks import BlockSettings
from data_module.speech.onsets import merged
from data_module.types import Array, Beats, Speech, Word
from eval.metrics import pmb
from eval.pictures.canvas import canvas, legend, row_without_scale
from eval.pictures.embedding import Labels, colours
from eval.pictures.intervals import STEP, Counts
from eval.pictures.strips import draw_wave
from gesticulator.export.figure import FLOOR, INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE = BLUE, VERMILION, GREEN, PINK, ORANGE, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ((0, (5, 2)), (0, (5, 2, 1, 2)), (0, (10, 3)))

Triple = tuple[float, float, float]
"""A mean and the two ends of its interval."""


# ---------------------------------------------------------------------------------------------------------- Fig. 10

def editing_panels(panels: Mapping[str, Mapping[str, tuple[float, Array]]], fps: float) -> Figure:
    """What was asked of a feature and what the motion shows, over time and as boxes (the last column of RG Fig. 10).

    panels: the feature's title -> level -> (the target, the values measured [T] at fps), in one unit. A box holds
    the quartiles, its whiskers 5 and 95 %.
    """
    figure = canvas(2.2 * len(panels))
    axes = figure.subplots(len(panels), 2, squeeze=False, sharey="row", width_ratios=(4, 1))
    for (curves, boxes), (title, levels) in zip(axes, panels.items(), strict=True):
        for number, (level, (target, values)) in enumerate(levels.items()):
            look: dict[str, Any] = {"color": PALETTE[number], "marker": MARKERS[number]}
            curves.plot(np.arange(len(values)) / fps, values, label=level, markevery=max(1, len(values) // 12), **look)
            for axis in (curves, boxes):
                axis.axhline(target, color=PALETTE[number], linestyle=DASHES[0])
        boxes.boxplot([values for _, values in levels.values()], tick_labels=list(levels), whis=(5, 95),
                      showfliers=False, widths=0.5)
        curves.set(ylabel=title, xlabel="s")
        curves.grid(axis="y")
    legend(figure, axes[:, 0])
    return figure


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
    for number, (name, percent) in enumerate(curves.items()):
        look: dict[str, Any] = {"color": PALETTE[number % len(PALETTE)], "marker": MARKERS[number % len(MARKERS)]}
        # References stand apart from what is judged, whatever their number.
        if name in dashed:
            look = {"color": INK, "linestyle": DASHES[number % len(DASHES)]}
        axis.plot(deltas, percent, label=name, **look)
    axis.set(xlabel="delta, s", ylabel="PMB, % of motion beats", ylim=(0, 102), xlim=(0, 1.02 * deltas[-1]))
    axis.grid(axis="y")
    figure.legend(loc="outside right upper", handlelength=3)
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
        row_without_scale(axis, name)
        axis.set(xlim=(start, end), ylim=(-0.35, 1.35))
    axes[-1].set_xlabel(f"seconds; matched: an onset less than {delta:g} s away, one for one")
    legend(figure, axes[:1], "outside upper center")
    return figure


def _draw_beats(axis: Axes, beats: Array, onsets: Array, edges: Array, span: tuple[float, float], delta: float
                ) -> None:
    """One row of `beat_strips`: what lies in the span, and the pairs of the beats that do."""
    from matplotlib.collections import LineCollection

    # Matched before the stretch is cut out: a partner may lie just outside of it.
    pairs, shown = pmb.matched(beats, onsets, delta), (beats >= span[0]) & (beats <= span[1])
    paired, alone = shown & (pairs >= 0), shown & (pairs < 0)
    axis.vlines(onsets, 0.78, 1.22, color=INK, label="onset")
    joined = np.stack([np.stack([onsets[pairs[paired]], beats[paired]], 1), np.tile([0.78, 0.0], (paired.sum(), 1))], 2)
    axis.add_collection(LineCollection(list(joined), colors=BLUE, label="_pairs"))
    axis.scatter(beats[paired], np.zeros(paired.sum()), color=BLUE, zorder=4, label="motion beat, matched")
    axis.scatter(beats[alone], np.zeros(alone.sum()), facecolor="white", edgecolor=VERMILION, zorder=3,
                 label="motion beat, not matched")
    axis.vlines(edges, -0.35, 1.35, color=SOFT, linewidth=0.8, zorder=0, label="block edge")
    count = int(shown.sum())
    label_text = f"PMB {100 * paired.sum() / count:.0f} %\n{paired.sum()} of {count}" if count else "no motion\nbeat"
    axis.text(1.015, 0.5, label_text, transform=axis.transAxes, va="center")


# ---------------------------------------------------------------------------------------------------------- Fig. 18

def size_sweep(sizes: Sequence[int], figures: Mapping[str, Sequence[Triple]], reference: Mapping[str, float],
               chosen: int) -> Figure:
    """Metrics over the size of the lexicon, one panel for each (RG Fig. 18).

    sizes: [n], rising; figures: the metric's title -> a (mean, low, high) for each size, NaN where there is none;
    reference: the metric's title -> the performer's value, a dashed line; chosen: the size that is in use, dotted.
    """
    figure = canvas(3.4)
    axes = figure.subplots(1, len(figures), squeeze=False).ravel()
    for axis, (title, values) in zip(axes, figures.items(), strict=True):
        mean, low, high = np.array(values, dtype=np.float64).T
        axis.errorbar(sizes, mean, (mean - low, high - mean), color=BLUE, marker="o", label="mean and 95 % interval")
        axis.axvline(chosen, color=SOFT, linestyle=":", label="size in use")
        if math.isfinite(reference.get(title, math.nan)):
            axis.axhline(reference[title], color=INK, linestyle=DASHES[0], label="performer")
        # Sizes differ by factors.
        axis.set_xscale("log")
        axis.set_xticks(list(sizes), [f"{size:g}" for size in sizes])
        axis.set_xticks([], minor=True)
        axis.set(title=title, xlabel="lexemes")
        axis.grid(axis="y")
    legend(figure, axes)
    return figure


# ---------------------------------------------------------------------------------------------------------- Fig. 14

def cluster_bars(panels: Mapping[str, Mapping[str, Mapping[str, float]]]) -> Figure:
    """How much the cluster of a block's sound tells of its lexeme, for each level of the encoder (RG Fig. 14).

    panels: whose motion -> `eval.metrics.audio_clusters.association`. The entropy of the lexeme given the cluster
    beside what the same lexemes, turned round, have by chance, under the entropy of the lexeme alone. Clusters of a few
    blocks have a low entropy whatever they hold, so a bar means something only beside its chance.
    """
    # One bar for each level of each motion, the performer's beside ours.
    bars = {f"{whose}\n{level}": value for whose, levels in panels.items() for level, value in levels.items()}
    figure, at = canvas(3.9), np.arange(len(bars))
    axis = figure.subplots()
    told, chance, alone = ([value[key] for value in bars.values()] for key in ("entropy", "by_chance", "alone"))
    shown = axis.bar(at - 0.2, told, 0.38, color=BLUE, label="given the cluster")
    axis.bar_label(shown, [f"p {value['p']:.2f}" for value in bars.values()])
    axis.bar(at + 0.2, chance, 0.38, facecolor="white", edgecolor=BLUE, hatch="///", label="by chance")
    axis.hlines(alone, at - 0.45, at + 0.45, color=INK, linestyle=DASHES[0], label="lexeme alone")
    axis.set_xticks(at, list(bars))
    axis.set(ylabel="entropy of the lexeme, nats")
    axis.grid(axis="y")
    legend(figure, (axis,))
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
    row_without_scale(sound, "sound")
    _draw_cells(cells, of.edges, of.lexemes, of.silent, start, end)
    _draw_hands(hands, of.hand_speed, of.fps, of.motion_beats, start, end)
    for axis in axes:
        axis.vlines(of.edges, 0, 1, transform=axis.get_xaxis_transform(), color=FLOOR, zorder=0, label="_edges")
    hands.set_xlabel("seconds")
    legend(figure, (sound, hands))
    return figure


def _draw_words(axis: Axes, words: Sequence[Word], start: float, end: float) -> None:
    """Each word over its middle, in three lanes in turn, so that neighbours do not run into each other."""
    for number, word in enumerate(words):
        middle = min(max((word.start + word.end) / 2, start), end)
        axis.text(middle, 2.5 - number % 3, word.text, ha="center", va="center", clip_on=True)
    axis.set(ylim=(0, 3))
    row_without_scale(axis, "words")


def _draw_cells(axis: Axes, edges: Array, lexemes: Labels, silent: Sequence[int], start: float, end: float) -> None:
    """Blocks as cells of their lexeme's colour, with its number."""
    palette = colours(int(lexemes.max(initial=0)) + 1)
    for left, right, lexeme in zip(edges[:-1], edges[1:], lexemes.tolist(), strict=True):
        if min(right, end) <= max(left, start):
            continue
        # A silent lexeme is hatched: hue alone would not tell it apart.
        look = ({"color": "white", "edgecolor": palette[lexeme], "hatch": "////"} if lexeme in silent else
                {"color": palette[lexeme], "edgecolor": "white"})
        axis.barh(0.5, right - left, 0.9, left, label=f"_{lexeme}", **look)
        axis.text((max(left, start) + min(right, end)) / 2, 0.5, str(lexeme), ha="center", va="center", clip_on=True,
                  bbox={"boxstyle": "round,pad=0.12", "fc": "white", "ec": "none"})
    axis.set(ylim=(0, 1))
    row_without_scale(axis, "lexemes")


def _draw_hands(axis: Axes, speed: Array, fps: float, beat_times: Array, start: float, end: float) -> None:
    times = np.arange(len(speed)) / fps
    axis.plot(times, speed, color=INK, label="_speed")
    mine = beat_times[(beat_times >= start) & (beat_times <= end)]
    # Motion beats stand below the curve, where nothing hides them.
    top = 1.1 * float(speed[(times >= start) & (times <= end)].max(initial=0.0)) or 1.0
    axis.vlines(mine, -0.22 * top, np.interp(mine, times, speed), color=BLUE, linewidth=0.9, label="_beats")
    axis.plot(mine, np.full(len(mine), -0.22 * top), color=BLUE, marker="^", linestyle="none", label="motion beat")
    axis.set(ylim=(-0.32 * top, top), ylabel="arms, m/s")


# ----------------------------------------------------------------------------------------------------------- Fig. 5

def interval_bars(counted: Counts, title: str) -> Figure:
    """Shares of the intervals by length, since onsets and beats differ in number, with the default bounds of a block.
    """
    figure, bounds = canvas(4), BlockSettings().beats
    axes = figure.subplots()
    for kind, counts, colour in zip(("onsets", "beats"), counted, (BLUE, ORANGE), strict=True):
        axes.bar(np.arange(len(counts)) * STEP, counts / max(1, sum(counts)), STEP, align="edge", alpha=0.5,
                 color=colour, label=f"between {kind} ({sum(counts)})")
    for bound, name in ((bounds.d_min, "d_min"), (bounds.d_max, "d_max")):
        axes.axvline(bound, color=INK, linestyle=":", label=f"{name} {bound:g} s")
    axes.set(title=title, xlabel="seconds (the last bar: all that are longer)", ylabel="share of the intervals")
    axes.legend()
    return figure
