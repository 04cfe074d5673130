"""The papers' figures, drawn from plain arrays: what a report shows beside its tables.

    delta_curves       PMB against its tolerance                        RG Fig. 11
    cluster_bars       entropy of lexemes within clusters of sound      RG Fig. 14
    embedding_panels   latents of several rows in one t-SNE             RG Figs. 15, 17
    beat_strips        motion beats beside onsets                       RG Fig. 16
    size_sweep         metrics against the size of the lexicon          RG Fig. 18
    overview           a few seconds of speech, blocks and motion       RG Fig. 2
    differences        every claim of `eval.rows.claims` with its interval

Each takes numbers and gives a figure; nothing is computed here that is not said, so a picture holds what its numbers
hold. The same input gives the same bytes (`save`). Colours are of the palette of Okabe and Ito (2008), which people
with any colour vision tell apart, and no meaning hangs on colour alone: lines have markers, verdicts have shapes,
lexemes, of which there are too many for any palette, have numbers. The other figures of the papers are drawn by
`data_module.intervals` (5, 8a), `lexicon_map` (6, 8b), `strips` (9) and `edited` (10).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_module.errors import InputError
from data_module.motion.motion_beats import beats_of_speed
from data_module.speech.beats import merged
from data_module.types import Array, BeatFlag, Beats, Speech, Word
from eval.draw.lexicon_map import Labels, colours, embed
from eval.draw.strips import BEAT_COLOURS, FLOOR, INK, SOFT
from eval.metrics import pmb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, VERMILION, GREEN, PINK, ORANGE, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
PALETTE = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY)
GREY = "#6f6a62"
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ((0, (5, 2)), (0, (5, 2, 1, 2)), (0, (10, 3)))
BEAT_MARKERS = {BeatFlag.ONSET: "o", BeatFlag.LOUD_PSEUDO: "^", BeatFlag.EVEN_PSEUDO: "s", BeatFlag.BOUNDARY: "D"}
BEAT_NAMES = {BeatFlag.ONSET: "onset", BeatFlag.LOUD_PSEUDO: "first loud frame", BeatFlag.EVEN_PSEUDO: "even",
              BeatFlag.BOUNDARY: "start or end"}

# Inches and points: 9 inches are 864 pixels of a page, and 9 points are 12.
_WIDE, _TEXT, _TITLE = 9.0, 9.0, 10.0
_NUMBERED, _LEAST_NUMBERED = 12, 3
_COLUMNS = 3
_LANES = 3

Triple = tuple[float, float, float]
"""A mean and the two ends of its interval."""


# -------------------------------------------------------------------------------------------------- what all share

def _canvas(high: float) -> Figure:
    try:
        from matplotlib.figure import Figure as NewFigure
    except ImportError:
        raise InputError("figures", "need matplotlib, which is not installed",
                         "pip install 'gesticulator[figures]'") from None
    return NewFigure(figsize=(_WIDE, high), facecolor="white", layout="constrained")


def _bare(axis: Axes, keep: Collection[str] = ("left", "bottom")) -> None:
    """Only these sides of the frame, in the house's ink."""
    for side, spine in axis.spines.items():
        spine.set_visible(side in keep)
        spine.set_color(SOFT)
    axis.tick_params(labelsize=_TEXT, color=SOFT, labelcolor=INK)
    if "left" not in keep:
        axis.set_yticks([])
    axis.title.set_fontsize(_TITLE)
    for label in (axis.xaxis.label, axis.yaxis.label, axis.title):
        label.set_color(INK)
    axis.xaxis.label.set_fontsize(_TEXT)
    axis.yaxis.label.set_fontsize(_TEXT)


def _vector(values: ArrayLike, name: str, *, gaps: bool = False, rising: bool = False) -> Array:
    """[n] numbers; ValueError when they are not (NaN, where `gaps` allows it, is not drawn)."""
    own = np.asarray(values, dtype=np.float64)
    if own.ndim != 1:
        raise ValueError(f"{name}: must be [n], not {list(own.shape)}")
    if not (np.isfinite(own) | (gaps & np.isnan(own))).all():
        raise ValueError(f"{name}: holds values that are not finite")
    if rising and (np.diff(own) <= 0).any():
        raise ValueError(f"{name}: must rise strictly")
    return own


def _stretch(start: float, seconds: float) -> float:
    """The end of a stretch of time; ValueError when there is none."""
    if not (math.isfinite(start) and start >= 0 and math.isfinite(seconds) and seconds > 0):
        raise ValueError(f"a stretch of {seconds} s from {start} s is none")
    return start + seconds


def _triple(values: Sequence[float], name: str) -> Triple:
    """Mean, low and high; all may be NaN."""
    mean, low, high = (float(value) for value in values)
    if math.isinf(mean) or math.isinf(low) or math.isinf(high) or low > high:
        raise ValueError(f"{name}: {mean}, {low}, {high} are no mean and interval")
    return mean, low, high


# ---------------------------------------------------------------------------------------------------------- Fig. 11

def delta_curves(curves: Mapping[str, Sequence[float]], deltas: Sequence[float],
                 chance: Mapping[str, Sequence[float]] | None = None, dashed: Collection[str] = ()) -> Figure:
    """PMB in percent over delta in seconds, one line for each row (RG Fig. 11).

    curves: row -> [n] percent (NaN is left out of the line); deltas: [n], rising; chance: what unrelated beats reach,
    for rows of `curves`, thin and dotted in the row's colour; dashed: the rows that are references. ValueError for
    lengths that differ, percentages outside 0 to 100 and unknown names. Every curve nears 100 % as delta grows: a row
    tells something where it stands above its chance.
    """
    at = _vector(deltas, "deltas", rising=True)
    chances = chance or {}
    unknown = {*chances, *dashed} - {*curves}
    if unknown or not curves or not len(at):
        raise ValueError(f"no curve of {', '.join(sorted(unknown)) or 'anything'}")
    figure = _canvas(4.6)
    axis = figure.subplots()
    references = [name for name in curves if name in dashed]
    for number, name in enumerate(name for name in curves if name not in dashed):
        turn, place = divmod(number, len(PALETTE))
        colour, marker = PALETTE[place], MARKERS[(place + turn) % len(MARKERS)]
        axis.plot(at, _percent(curves[name], at, name), color=colour, marker=marker, markersize=5, linewidth=1.6,
                  label=name)
        _draw_chance(axis, at, chances, name, colour)
    for number, name in enumerate(references):
        colour = (INK, GREY)[number % 2]
        axis.plot(at, _percent(curves[name], at, name), color=colour, linestyle=DASHES[number % len(DASHES)],
                  linewidth=1.6, label=name)
        _draw_chance(axis, at, chances, name, colour)
    if chances:
        axis.plot([], [], color=GREY, linestyle=":", linewidth=1.2, label="by chance (in each row's colour)")
    axis.set(xlabel="delta, s", ylabel="PMB, % of motion beats", ylim=(0, 102), xlim=(0, 1.02 * float(at[-1])))
    axis.grid(axis="y", color=FLOOR, linewidth=0.6)
    axis.set_axisbelow(True)
    _bare(axis)
    figure.legend(loc="outside right upper", fontsize=_TEXT, frameon=False, labelcolor=INK, handlelength=3)
    return figure


def _percent(values: Sequence[float], at: Array, name: str) -> Array:
    own = _vector(values, name, gaps=True)
    if own.shape != at.shape or (own < -1e-9).any() or (own > 100 + 1e-9).any():
        raise ValueError(f"{name}: must be {len(at)} percentages")
    return own


def _draw_chance(axis: Axes, at: Array, chances: Mapping[str, Sequence[float]], name: str, colour: str) -> None:
    if name in chances:
        axis.plot(at, _percent(chances[name], at, f"chance of {name}"), color=colour, linestyle=":", linewidth=1.2,
                  label=f"_chance of {name}")


# ----------------------------------------------------------------------------------------------------- Figs. 15, 17

def joint_embedding(latents: Mapping[str, Array], most: int = 1500, seed: int = 0
                    ) -> dict[str, tuple[Array, NDArray[np.int64]]]:
    """The latents of several rows in one t-SNE: row -> its points [n, 2] and which of its latents they are [n].

    latents: row -> [N, D], the same D in all. At most `most` of each are taken, evenly spaced in their order, and
    embedded together (`lexicon_map.embed`), so that what lies near each other in two panels lies near each other.
    Rows with more points take more of the plane. ValueError for fewer than 10 points in all.
    """
    own = {name: np.asarray(values, dtype=np.float64) for name, values in latents.items()}
    if most < 1 or any(values.ndim != 2 or not np.isfinite(values).all() for values in own.values()):
        raise ValueError("latents must be finite, [N, D], and `most` 1 or more")
    if len({values.shape[1] for values in own.values()}) != 1:
        raise ValueError("the rows must have latents of one width")
    # Multiples of n / m, rounded down, are all different where m <= n.
    taken = {name: np.arange(min(most, len(values)), dtype=np.int64) * len(values) // max(1, min(most, len(values)))
             for name, values in own.items()}
    together = np.concatenate([values[taken[name]] for name, values in own.items()])
    if len(together) < 10:
        raise ValueError(f"{len(together)} points are too few to embed")
    ends = np.cumsum([len(which) for which in taken.values()])
    points = np.split(embed(together, seed), ends[:-1])
    return {name: (mine, which) for (name, which), mine in zip(taken.items(), points, strict=True)}


def embedding_panels(panels: Mapping[str, tuple[Array, Labels]], size: int, silent: Sequence[int] = (),
                     behind: Array | None = None) -> Figure:
    """One panel of points for each row, all on the same axes, coloured by lexeme (RG Figs. 15, 17).

    panels: row -> points [n, 2], such as of `joint_embedding`, and their lexemes [n], below `size`; silent: lexemes
    drawn as crosses; behind: [m, 2] points drawn in grey under every panel, such as the performer's. The lexemes that
    are commonest over all panels bear their number where there is room. What fools it: t-SNE keeps who is near whom,
    not distances or densities, and colours of one hue may be two lexemes.
    """
    own = {name: _points(points, labels, size, name) for name, (points, labels) in panels.items()}
    if not own or not sum(len(points) for points, _ in own.values()):
        raise ValueError("no points to draw")
    grey = np.zeros((0, 2)) if behind is None else _points(behind, np.zeros(len(behind), np.int64), 1, "behind")[0]
    everything = np.concatenate([grey, *(points for points, _ in own.values())])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.04 * float((high - low).max()) or 1.0
    counts = np.bincount(np.concatenate([labels for _, labels in own.values()]), minlength=size)
    numbered = [int(i) for i in np.argsort(-counts, kind="stable")[:_NUMBERED] if counts[i] >= _LEAST_NUMBERED]
    across = 2 if len(own) == 4 else min(_COLUMNS, len(own))
    down = math.ceil(len(own) / across)
    wide, tall = (high - low + 2 * margin).tolist()
    inches = _WIDE / max(across, 2)
    figure = _canvas(down * (inches * min(max(tall / wide, 0.5), 1.5) + 0.5))
    # What a number takes up, in the units of the points.
    room = (0.3 * wide / inches, 0.2 * wide / inches)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis, (name, (points, labels)) in zip(axes, own.items(), strict=False):
        axis.scatter(grey[:, 0], grey[:, 1], s=5, color=FLOOR, linewidths=0, rasterized=True, label="behind")
        _draw_points(axis, points, labels, colours(size), silent)
        _draw_numbers(axis, points, labels, numbered, room)
        axis.set_title(f"{name}\n{len(points)} blocks, {len(np.unique(labels))} lexemes")
        axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal",
                 xticks=[], yticks=[])
        _bare(axis, ("left", "bottom", "top", "right"))
    for axis in axes[len(own):]:
        axis.axis("off")
    return figure


def _points(points: Array, labels: Labels, size: int, name: str) -> tuple[Array, Labels]:
    at, own = np.asarray(points, dtype=np.float64), np.asarray(labels)
    if at.shape != (len(own), 2) or own.ndim != 1 or not np.isfinite(at).all():
        raise ValueError(f"{name}: points must be finite, [n, 2], with n labels")
    if len(own) and not (np.issubdtype(own.dtype, np.integer) and own.min() >= 0 and own.max() < size):
        raise ValueError(f"{name}: labels must be integers from 0 to {size - 1}")
    return at, own.astype(np.int64)


def _draw_points(axis: Axes, points: Array, labels: Labels, palette: Sequence[str], silent: Sequence[int]) -> None:
    for lexeme in np.unique(labels).tolist():
        mine = points[labels == lexeme]
        still = lexeme in silent
        axis.scatter(mine[:, 0], mine[:, 1], s=14 if still else 9, marker="x" if still else "o", color=palette[lexeme],
                     alpha=0.8, linewidths=0.8 if still else 0, rasterized=True, label=str(lexeme))


def _draw_numbers(axis: Axes, points: Array, labels: Labels, numbered: Sequence[int], room: tuple[float, float]
                  ) -> None:
    """The numbers of these lexemes on their points, the first first; one that would cover another is left out."""
    placed = np.zeros((0, 2))
    for lexeme in numbered:
        mine = points[labels == lexeme]
        if len(mine) < _LEAST_NUMBERED:
            continue
        # The point nearest to the median of its own: a mean may lie where none is.
        place = mine[np.linalg.norm(mine - np.median(mine, axis=0), axis=1).argmin()]
        if (np.abs(placed - place) < room).all(axis=1).any():
            continue
        placed = np.vstack([placed, place])
        axis.text(float(place[0]), float(place[1]), str(lexeme), fontsize=_TEXT - 1, color=INK, ha="center",
                  va="center", bbox={"boxstyle": "round,pad=0.12", "fc": "white", "ec": SOFT, "lw": 0.8, "alpha": 0.85})


# ---------------------------------------------------------------------------------------------------------- Fig. 16

def beat_strips(rows: Mapping[str, tuple[Array, Array, Array]], start: float, seconds: float,
                delta: float = pmb.DELTA) -> Figure:
    """Which motion beats an onset matches, over a stretch of the same speech for each row (RG Fig. 16).

    rows: row, such as a range of onset intervals -> motion beats [n], onsets [m], block edges [k], all seconds. Onsets
    are ticks above, motion beats dots below, filled where `pmb.matched` gives them an onset, and joined to it. The
    matching is that of the whole row, onsets merged as in `pmb.pmb`; the figure at the right is of the motion beats
    within the stretch. What fools it: a few seconds are an example, and unrelated beats are matched too.
    """
    end = _stretch(start, seconds)
    if not rows or not delta > 0:
        raise ValueError("beat strips need a row at least and a delta above 0")
    figure = _canvas(0.8 + 0.95 * len(rows))
    axes = figure.subplots(len(rows), 1, squeeze=False, sharex=True).ravel()
    for axis, (name, parts) in zip(axes, rows.items(), strict=True):
        beats, onsets, edges = (np.sort(_vector(part, f"{name}, {what}")) for part, what in
                                zip(parts, ("motion beats", "onsets", "edges"), strict=True))
        _draw_beats(axis, beats, merged(onsets, pmb.MERGE), edges, (start, end), delta)
        axis.set_ylabel(name, rotation=0, ha="right", va="center")
        axis.set(xlim=(start, end), ylim=(-0.35, 1.35))
        _bare(axis, ("bottom",) if axis is axes[-1] else ())
        axis.tick_params(bottom=axis is axes[-1], labelbottom=axis is axes[-1])
    axes[-1].set_xlabel(f"seconds; matched: an onset less than {delta:g} s away, one for one")
    handles, _ = axes[0].get_legend_handles_labels()
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), fontsize=_TEXT, frameon=False,
                  labelcolor=INK)
    return figure


def _draw_beats(axis: Axes, beats: Array, onsets: Array, edges: Array, span: tuple[float, float], delta: float
                ) -> None:
    """One row of `beat_strips`: what lies in the span, and the pairs of the beats that do."""
    from matplotlib.collections import LineCollection

    def within(times: Array) -> NDArray[np.bool_]:
        return (times >= span[0]) & (times <= span[1])

    pairs, seen = pmb.matched(beats, onsets, delta), within(beats)
    paired, alone = seen & (pairs >= 0), seen & (pairs < 0)
    axis.vlines(onsets[within(onsets)], 0.78, 1.22, color=INK, linewidth=1.6, label="onset")
    joined = [[(float(onsets[k]), 0.78), (float(beat), 0.0)] for beat, k in zip(beats[paired], pairs[paired],
                                                                             strict=True)]
    axis.add_collection(LineCollection(joined, colors=BLUE, linewidths=1.2, label="_pairs"))
    axis.scatter(beats[paired], np.zeros(paired.sum()), s=38, color=BLUE, zorder=4, clip_on=False,
                 label="motion beat, matched")
    axis.scatter(beats[alone], np.zeros(alone.sum()), s=38, facecolor="white", edgecolor=VERMILION, linewidths=1.6,
                 zorder=3, clip_on=False, label="motion beat, not matched")
    axis.vlines(edges[within(edges)], -0.35, 1.35, color=SOFT, linewidth=0.8, alpha=0.6, zorder=0, label="block edge")
    count = int(seen.sum())
    told = f"PMB {100 * paired.sum() / count:.0f} %\n{paired.sum()} of {count}" if count else "no motion\nbeat"
    axis.text(1.015, 0.5, told, transform=axis.transAxes, fontsize=_TEXT, color=INK, va="center")


# ---------------------------------------------------------------------------------------------------------- Fig. 18

def size_sweep(sizes: Sequence[int], figures: Mapping[str, Sequence[Triple]],
               reference: Mapping[str, float] | None = None, *, reference_name: str = "performer",
               chosen: int | None = None) -> Figure:
    """Metrics over the size of the lexicon, one panel for each (RG Fig. 18).

    sizes: [n], rising; figures: the metric's title -> a (mean, low, high) for each size, NaN where there is none;
    reference: the metric's title -> a value drawn across as a dashed line; chosen: the size that is in use, marked by a
    dotted line. ValueError for lengths that differ or an interval that is none.
    """
    at = _vector(sizes, "sizes", rising=True)
    if not len(at) or at[0] <= 0 or not figures or (chosen is not None and not chosen > 0):
        raise ValueError("a sweep needs sizes above 0 and a metric at least")
    across = min(_COLUMNS, len(figures))
    down = math.ceil(len(figures) / across)
    figure = _canvas(3.1 * down)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis, (title, values) in zip(axes, figures.items(), strict=False):
        if len(values) != len(at):
            raise ValueError(f"{title}: {len(values)} figures for {len(at)} sizes")
        own = np.array([_triple(value, title) for value in values])
        _draw_intervals(axis, at, own)
        if chosen is not None:
            axis.axvline(chosen, color=GREY, linestyle=":", linewidth=1.2, label="size in use")
        if reference and math.isfinite(reference.get(title, math.nan)):
            axis.axhline(reference[title], color=INK, linestyle=DASHES[0], linewidth=1.2, label=reference_name)
        axis.set_xscale("log")
        axis.set_xticks(at, [f"{size:g}" for size in at])
        axis.set_xticks([], minor=True)
        axis.set(title=title, xlabel="lexemes")
        axis.grid(axis="y", color=FLOOR, linewidth=0.6)
        axis.set_axisbelow(True)
        _bare(axis)
    for axis in axes[len(figures):]:
        axis.axis("off")
    _legend_below(figure, axes[:len(figures)])
    return figure


def _draw_intervals(axis: Axes, at: Array, own: Array) -> None:
    """Means [n] joined by a line, each with its interval; own: [n, 3]."""
    axis.plot(at, own[:, 0], color=BLUE, marker="o", markersize=5, linewidth=1.6, label="mean and 95 % interval")
    known = np.isfinite(own).all(axis=1)
    axis.vlines(at[known], own[known, 1], own[known, 2], color=BLUE, linewidth=1.4, label="_interval")
    for end in (1, 2):
        axis.plot(at, own[:, end], color=BLUE, marker="_", markersize=8, linestyle="none", label="_end")


def _legend_below(figure: Figure, axes: Iterable[Axes]) -> None:
    """One legend for all panels, each name once."""
    named = {label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    if named:
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=len(named), fontsize=_TEXT,
                      frameon=False, labelcolor=INK)


# ---------------------------------------------------------------------------------------------------------- Fig. 14

def cluster_bars(found: Mapping[str, Mapping[str, Any]]) -> Figure:
    """How much the cluster of a block's sound tells of its lexeme, for each level of the encoder (RG Fig. 14).

    found: whose motion -> `eval.metrics.audio_clusters.association`. Left the entropy of
    the lexeme given the cluster beside what the same lexemes, turned round, have by chance, under the entropy of the
    lexeme alone; right the gain, which alone has an interval. Clusters of a few blocks have a low entropy whatever they
    hold, so a bar means something only beside its chance. ValueError without a level.
    """
    levels = list(dict.fromkeys(name for own in found.values() for name in own if _is_level(own[name])))
    if not levels or any(not _is_level(own.get(name)) for own in found.values() for name in levels):
        raise ValueError("every row must have the same levels, with an entropy each")
    figure = _canvas(3.9)
    bars, gains = figure.subplots(1, 2, width_ratios=(3, 2))
    wide = 0.8 / (2 * len(levels))
    for group, own in enumerate(found.values()):
        total = float(own["lexeme_entropy"])
        bars.hlines(total, group - 0.45, group + 0.45, color=INK, linestyle=DASHES[0], linewidth=1.4,
                    label="lexeme alone" if group == 0 else "_lexeme alone")
        for number, name in enumerate(levels):
            _draw_level(bars, gains, (group + (2 * number + 1 - len(levels)) * wide, wide), name, own[name],
                        PALETTE[number % len(PALETTE)], "" if group == 0 else "_")
    gains.axhline(0.0, color=INK, linewidth=0.9, zorder=0)
    gains.margins(y=0.12)
    for axis, title in ((bars, "entropy of the lexeme given the cluster, nats"),
                        (gains, "gain: chance less entropy, nats")):
        axis.set_xticks(range(len(found)), [f"{name}\n{own['blocks']} blocks" for name, own in found.items()])
        axis.set(title=title, xlim=(-0.55, len(found) - 0.45))
        axis.grid(axis="y", color=FLOOR, linewidth=0.6)
        axis.set_axisbelow(True)
        _bare(axis)
        axis.tick_params(axis="x", length=0)
    _legend_below(figure, (bars,))
    return figure


def _is_level(value: object) -> bool:
    return isinstance(value, Mapping) and "entropy" in value


def _draw_level(bars: Axes, gains: Axes, place: tuple[float, float], name: str, own: Mapping[str, Any], colour: str,
                hidden: str) -> None:
    """A level's bar, that of its chance beside it, and its gain. place: middle and width; hidden: "_" keeps the names
    out of the legend."""
    middle, wide = place
    bars.bar(middle - wide / 2, own["entropy"], 0.9 * wide, color=colour, label=f"{hidden}{name}")
    bars.bar(middle + wide / 2, own["by_chance"], 0.9 * wide, facecolor="white", edgecolor=colour, hatch="///",
             linewidth=1.2, label=f"{hidden}{name}, by chance")
    mean, low, high = _triple((own["gain"].mean, own["gain"].low, own["gain"].high), name)
    gains.vlines(middle, low, high, color=colour, linewidth=1.8, label=f"_{name}")
    gains.plot([middle], [mean], color=colour, marker=MARKERS[0], markersize=6.5, linestyle="none", label=f"_{name}")
    gains.annotate(f"p {own['p']:.2f}", (middle, max(high, mean)), (0, 4), textcoords="offset points", ha="center",
                   fontsize=_TEXT, color=INK)


# ----------------------------------------------------------------------------------------------------------- Fig. 2

@dataclass(frozen=True)
class Overview:
    """What Fig. 2 is drawn from. edges: [N + 1] seconds and lexemes: [N] of the blocks; hand_speed: [T] m/s, frame t at
    t / fps seconds, such as `motion_beats.acting_speed`; silent: lexemes that are hatched; motion_beats: seconds, found
    on `hand_speed` where they are not given."""

    speech: Speech
    beats: Beats
    edges: Array
    lexemes: Labels
    hand_speed: Array
    fps: float
    words: Sequence[Word] = ()
    silent: Sequence[int] = ()
    motion_beats: Array | None = None


def overview(of: Overview, start: float, seconds: float) -> Figure:
    """A stretch of one performance: words, sound and beats, blocks and lexemes, hands and motion beats (RG Fig. 2).

    The stretch is clamped to the speech; ValueError when it lies outside, or lexemes and edges do not agree.
    """
    end = min(_stretch(start, seconds), of.speech.duration)
    cuts, speed = _vector(of.edges, "edges", rising=True), _vector(of.hand_speed, "hand speed")
    lexemes = np.asarray(of.lexemes)
    if start >= end or lexemes.shape != (len(cuts) - 1,) or not of.fps > 0:
        raise ValueError("the stretch lies outside the speech, or edges [N + 1] and lexemes [N] do not agree")
    if not np.issubdtype(lexemes.dtype, np.integer) or (lexemes < 0).any():
        raise ValueError("lexemes must be integers from 0")
    said = [word for word in of.words if word.text and word.end > start and word.start < end]
    high = [*([0.5] if said else []), 1.3, 0.45, 1.1]
    figure = _canvas(sum(high) + 1.0)
    axes = figure.subplots(len(high), 1, sharex=True, height_ratios=high)
    axes[0].set_xlim(start, end)
    if said:
        _draw_words(axes[0], said, start, end)
    sound, cells, hands = axes[-3:]
    _draw_sound(sound, of.speech, of.beats, start, end)
    _draw_cells(cells, cuts, lexemes.astype(np.int64), of.silent, start, end)
    found = (beats_of_speed(speed, of.fps) if of.motion_beats is None
             else _vector(of.motion_beats, "motion beats"))
    _draw_hands(hands, speed, of.fps, found, start, end)
    for axis in axes:
        axis.vlines(cuts[(cuts >= start) & (cuts <= end)], 0, 1, transform=axis.get_xaxis_transform(), color=FLOOR,
                    linewidth=0.8, zorder=0, label="_edges")
        axis.tick_params(bottom=axis is hands, labelbottom=axis is hands)
    hands.set_xlabel("seconds")
    _legend_below(figure, (sound, hands))
    return figure


def _draw_words(axis: Axes, words: Sequence[Word], start: float, end: float) -> None:
    """Each word over its middle, in the first lane where it does not run into another."""
    per_letter = 0.085 * (end - start) / (_WIDE - 1.0)
    free = [start] * _LANES
    for word in words:
        middle = min(max((word.start + word.end) / 2, start), end)
        half = per_letter * (len(word.text) + 1) / 2
        lane = next((i for i, taken in enumerate(free) if taken <= middle - half), int(np.argmin(free)))
        free[lane] = middle + half
        axis.text(middle, _LANES - lane - 0.5, word.text, fontsize=_TEXT, color=INK, ha="center", va="center",
                  clip_on=True)
    axis.set(ylim=(0, _LANES), ylabel="words")
    _quiet(axis)


def _quiet(axis: Axes) -> None:
    """A row without a scale, its name beside it."""
    _bare(axis, ())
    axis.yaxis.label.set(rotation=0, horizontalalignment="right", verticalalignment="center")


def _draw_sound(axis: Axes, speech: Speech, beats: Beats, start: float, end: float) -> None:
    """The envelope of the samples, and beats as lines with a mark of their kind on top."""
    bins = np.linspace(start, end, 1201)
    places = np.minimum((bins * speech.sample_rate).astype(int), len(speech.samples) - 1)
    pieces = speech.samples[:max(int(end * speech.sample_rate), int(places[-1]) + 1)]
    top, low = (np.asarray(pick.reduceat(pieces, places)) for pick in (np.maximum, np.minimum))
    axis.fill_between(bins, low, top, color=SOFT, linewidth=0, step="post", label="_sound")
    limit = float(np.abs([top, low]).max()) or 1.0
    for flag in BeatFlag:
        mine = beats.times[(beats.flags == flag) & (beats.times >= start) & (beats.times <= end)]
        if len(mine):
            axis.vlines(mine, -limit, limit, color=BEAT_COLOURS[flag], linewidth=1.1, label="_beats")
            axis.plot(mine, np.full(len(mine), 1.18 * limit), color=BEAT_COLOURS[flag], marker=BEAT_MARKERS[flag],
                      markersize=5, linestyle="none", label=f"beat: {BEAT_NAMES[flag]}", clip_on=False)
    axis.set(ylim=(-1.05 * limit, 1.32 * limit), ylabel="sound")
    _quiet(axis)


def _draw_cells(axis: Axes, edges: Array, lexemes: Labels, silent: Sequence[int], start: float, end: float) -> None:
    """Blocks as cells of their lexeme's colour, numbered where the number fits."""
    palette = colours(int(lexemes.max(initial=0)) + 1)
    inch = (end - start) / (_WIDE - 1.0)
    for left, right, lexeme in zip(edges[:-1], edges[1:], lexemes.tolist(), strict=True):
        shown = min(right, end) - max(left, start)
        if shown <= 0:
            continue
        still = lexeme in silent
        axis.barh(0.5, right - left, 0.9, left, color="white" if still else palette[lexeme],
                  edgecolor=palette[lexeme] if still else "white", hatch="////" if still else None, linewidth=1.0,
                  label=f"_{lexeme}")
        if shown >= (0.06 + 0.085 * len(str(lexeme))) * inch:
            axis.text((max(left, start) + min(right, end)) / 2, 0.5, str(lexeme), fontsize=_TEXT, ha="center",
                      va="center", color=INK, bbox={"boxstyle": "round,pad=0.12", "fc": "white", "ec": "none"})
    axis.set(ylim=(0, 1), ylabel="lexemes")
    _quiet(axis)


def _draw_hands(axis: Axes, speed: Array, fps: float, found: Array, start: float, end: float) -> None:
    times = np.arange(len(speed)) / fps
    # One frame more on both sides, so that the line reaches the edges.
    seen = (times >= start - 1 / fps) & (times <= end + 1 / fps)
    axis.plot(times[seen], speed[seen], color=INK, linewidth=1.4, label="_speed")
    mine = found[(found >= start) & (found <= end)]
    top = 1.1 * float(speed[seen].max(initial=0.0)) or 1.0
    axis.vlines(mine, -0.22 * top, np.interp(mine, times, speed) if len(speed) else 0.0, color=BLUE, linewidth=0.9,
                label="_beats")
    axis.plot(mine, np.full(len(mine), -0.22 * top), color=BLUE, marker="^", markersize=6, linestyle="none",
              label="motion beat", clip_on=False)
    axis.set(ylim=(-0.32 * top, top), ylabel="arms, m/s")
    _bare(axis)
