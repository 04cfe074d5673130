"""`gesticulator score`: real, generated and foreign motion side by side, on the same clips, with the controls.

    gesticulator score --truth DIR --system NAME=DIR ... [--speech DIR] [--fgd FOLDER] [--work DIR] [--bundle DIR]
                       [--units STORE] [--split test] [--piece SECONDS] [--rate FPS] [--fps NAME=RATE]
                       [--out results/score.json]

Every DIR holds motion by clip (see `eval.foreign` for what can be read), or is a store, of which one split counts;
clips are matched by their names, only those that all have are read, and what does not match is named. All motion is
brought onto the 16-joint character, to the lowest frame rate among them (or --rate) and, clip by clip, to the shortest
length. Each figure is a mean over clips with its bootstrap 95 % interval, or of the set of clips, with the basic
bootstrap's; systems are compared in pairs over the same clips. `eval.metrics.METRICS` lists the figures.

Beside the systems stand rows of motion known to be wrong (`eval.baselines`), made of the truth: shuffled among the
speeches, played backwards, with 2 cm of jitter, with the right arm's motion on both arms, the mean pose of each clip,
held still, and that pose bobbing at the onsets. One half of the truth
against the other is the floor of distances between sets. A metric that a control beats is marked, and by whom said: it
cannot tell good from bad in that respect, and a good value of it proves nothing.

What fools a table as a whole: few clips (a long take can be cut by --piece, but pieces of one take are alike, so that
intervals are too narrow), and the many columns: of twenty, one is beyond its 95 % by chance.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.store import SPLITS, Store
from data_module.types import Array, Motion
from eval import baselines, stats
from eval.clip_set import TRUTH, ClipSet, common_clips, listed, shared_names
from eval.encode import EncodedMotion, SpeechBlocks, encode_motion, judged_reward
from eval.foreign import Clip, names_in, read_folder
from eval.metrics import CLIP_METRICS, EYE_METRICS, METRICS, SET_METRICS, Metric, eye, fgd, pmb
from eval.metrics.diversity import entropy, lexeme_moments, variance_of_moments
from eval.metrics.evaluate import (
    LEXEME_METRICS,
    MOTION_METRICS,
    SYNCHRONY,
    MotionBeats,
    OnsetTrack,
    Values,
    clip_values,
    delta_curve,
    eye_values,
    lexeme_values,
    synchrony,
)
from eval.metrics.gesture_features import FPS, Features, RawFeatures, as_features, load, networks, pooled, published
from eval.metrics.mismatch import Mismatch, matrix, mismatch
from eval.metrics.smoothness import hand_speeds, hellinger, speed_histogram
from eval.stats import Indices, Interval
from eval.table import Cell, Column, Marked, Table, publish, shown_cell

UNITS = "unit selection"
FLOOR, STILL, BOBBING = "truth, half against half", "still", "bobbing"
NO_FLOOR = "a floor is of distances between sets"
RAW_FRAMES = (34, 60)
"""Windows of the raw directions, at 15 fps, where networks of two lengths are not to be had."""
MOST = 60
"""Clips of a mismatch test at most, evenly chosen: it tries all pairs."""
FEW = 10
"""Clips below which intervals are too narrow."""
SAME = (1e-9, 1e-4)
"""Figures that differ by less, absolutely or relatively, are equal: rounding of files and of sums leaves as much."""

Figures = dict[str, dict[str, Marked]]
"""row -> metric -> a figure, with the reason where it is undefined or not to be trusted."""


# ------------------------------------------------------------------------------------------------------------ rows

@dataclass
class ScoreRow:
    """A set of motions and what was measured. kind: "truth", "system" or "control".

    values: metric -> [clips]; sets: metric -> a figure of the clips with these numbers; features: network -> [n, E] by
    clip; reasons: metric -> why its figure is undefined; curves: mode -> [clips, deltas].
    """

    name: str
    kind: str
    motions: list[Motion]
    beats: list[MotionBeats]
    values: dict[str, Array] = field(default_factory=dict)
    sets: dict[str, Callable[[Indices], float]] = field(default_factory=dict)
    features: dict[str, list[Array]] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    curves: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class ClipEncoder:
    """What a bundle makes of the clips: the blocks of each speech, and the speakers' own motion in them."""

    bundle: Any
    speeches: list[SpeechBlocks | None]
    truth: list[EncodedMotion | None]

    @classmethod
    def of(cls, bundle: Any, clips: ClipSet) -> ClipEncoder:
        """Each speech is cut and encoded once for all rows."""
        speeches = [None if speech is None else SpeechBlocks.of(bundle, speech) for speech in clips.speeches]
        made = cls(bundle, speeches, [])
        return replace(made, truth=made.encoded(clips.motions[TRUTH]))

    def encoded(self, motions: Sequence[Motion]) -> list[EncodedMotion | None]:
        """Motions of all clips; None where nothing is said."""
        return [None if speech is None else encode_motion(self.bundle, motion, speech.blocks, speech.speaker)
                for motion, speech in zip(motions, self.speeches, strict=True)]

    def values(self, encoded: Sequence[EncodedMotion | None]) -> list[Values]:
        """`LEXEME_METRICS` of every clip."""
        judged = self.bundle.reward_judge is not None
        rewards = [math.nan if motion is None or speech is None else judged_reward(self.bundle, motion, speech)
                   for motion, speech in zip(encoded, self.speeches, strict=True)]
        return [lexeme_values(motion, truth, reward, judged)
                for motion, truth, reward in zip(encoded, self.truth, rewards, strict=True)]


@dataclass(frozen=True)
class ScoreContext:
    """What all rows are measured with. encoder: None without a bundle."""

    clips: ClipSet
    tracks: list[OnsetTrack | None]
    networks: Mapping[str, Features]
    encoder: ClipEncoder | None
    seed: int
    voices: list[eye.VoiceActivity | None]
    space: eye.ReferenceSpace | None

    def row(self, name: str, kind: str, motions: list[Motion]) -> ScoreRow:
        """Everything about one set of motions."""
        row = ScoreRow(name, kind, motions, [MotionBeats.of(motion) for motion in motions])
        own = self.clips.motions[TRUTH]
        truth = baselines.to_common_length(motions, own)[1]
        _put(row, MOTION_METRICS, [
            clip_values(motion, theirs, beats, track, self.seed + k) for k, (motion, theirs, beats, track)
            in enumerate(zip(motions, truth, row.beats, self.tracks, strict=True))])
        _put(row, tuple(EYE_METRICS), [eye_values(motion, voice, edges, self.space) for motion, voice, edges
                                       in zip(motions, self.voices, self.edges, strict=True)])
        for mode in ("A", "B"):
            row.curves[mode] = np.array([delta_curve(beats, track, mode) for beats, track
                                         in zip(row.beats, self.tracks, strict=True) if track is not None]
                                        ).reshape(-1, len(pmb.DELTAS))
        row.features = {key: pooled(motions, network) for key, network in self.networks.items()}
        ours, theirs = (np.array([speed_histogram(hand_speeds(motion)) for motion in clips])
                        for clips in (motions, own))
        row.sets["speed_distance"] = lambda chosen: hellinger(ours[chosen].sum(0), theirs[chosen].sum(0))
        self._lexemes(row)
        return row

    @property
    def edges(self) -> list[Array | None]:
        """Of each clip, [N + 1] seconds of the blocks that the bundle cuts; None without a bundle or a speech."""
        speeches = [None] * len(self.clips.names) if self.encoder is None else self.encoder.speeches
        return [None if speech is None else speech.blocks.edges for speech in speeches]

    def _lexemes(self, row: ScoreRow) -> None:
        """What the lexemes nearest to a row's blocks say, where there is a lexicon."""
        of_sets = ("diversity", "motion_variance")
        if self.encoder is None:
            row.values |= {metric: np.full(len(row.motions), np.nan) for metric in LEXEME_METRICS}
            row.reasons |= dict.fromkeys((*of_sets, *LEXEME_METRICS), "no lexicon was given (--bundle)")
            return
        encoded = self.encoder.encoded(row.motions)
        _put(row, LEXEME_METRICS, self.encoder.values(encoded))
        if not any(encoded):
            row.reasons |= dict.fromkeys(of_sets, "no speech is known")
            return
        vectors = self.encoder.bundle.lexicon.vectors.double().numpy()
        moments = lexeme_moments([None if one is None else (one.latents.double().numpy(), one.labels)
                                  for one in encoded], vectors)
        row.sets["diversity"] = lambda chosen: entropy(moments[0][chosen].sum(axis=0))
        row.sets["motion_variance"] = lambda chosen: variance_of_moments(
            *(part[chosen].sum(axis=0) for part in moments))


def _put(row: ScoreRow, metrics: Sequence[str], every: Sequence[Values]) -> None:
    """The values of all clips into a row, and why some have none."""
    for metric in metrics:
        row.values[metric] = np.array([values.numbers[metric] for values in every])
        why = sorted({values.reasons[metric] for values in every if metric in values.reasons})
        if why:
            lacking = int(np.isnan(row.values[metric]).sum())
            row.reasons[metric] = f"{lacking} of {len(every)} clips: {'; '.join(why)}"


def control_rows(clips: ClipSet, seed: int, voices: Sequence[eye.VoiceActivity | None] = ()
                 ) -> tuple[dict[str, list[Motion]], list[str]]:
    """Each control's motions, and why one could not be made. voices: of each clip, None where its speech is
    not known; without any nothing bobs."""
    truth, notes = clips.motions[TRUTH], []
    made = {STILL: baselines.mean_pose(truth)}
    groups: list[str] | None = clips.groups
    try:
        baselines.donors(truth, seed, groups)
    except ValueError:
        groups = None
        notes.append("clips of one sound could not be kept apart in the shuffled row and the halves: too few groups")
    for name, make in baselines.CONTROLS.items():
        try:
            made[name] = (baselines.shuffled(truth, seed, groups) if name == "shuffled" else make(truth, seed))
        except ValueError as error:
            notes.append(f"no row {name}: {error}")
    if any(voices):
        made[BOBBING] = baselines.bobbing(truth, [np.zeros(0) if voice is None else voice.onsets[0]
                                                  for voice in voices])
    return made, notes


# --------------------------------------------------------------------------------------------------------- figures

def row_figures(row: ScoreRow, truth: ScoreRow, context: ScoreContext
                ) -> tuple[dict[str, Marked], dict[str, fgd.Figure]]:
    """Every metric of a row, and the distances by network."""
    out: dict[str, Interval] = {name: stats.mean_interval(values, seed=context.seed)
                                for name, values in row.values.items()}
    for name in SET_METRICS:
        least = 0.0 if name == "speed_distance" else -math.inf
        out[name] = (stats.of_set(row.sets[name], len(row.motions), seed=context.seed, least=least)
                     if name in row.sets else Interval.undefined())
    distances = {key: fgd.measure(row.features[key], truth.features[key], network, paired=True, seed=context.seed)
                 for key, network in context.networks.items()}
    figures = {name: Marked(value, reason=row.reasons.get(name, _undefined(name, value)))
               for name, value in out.items()}
    return figures | {key: fgd_cell(figure, row.kind == TRUTH) for key, figure in distances.items()}, distances


def _undefined(name: str, value: Interval) -> str:
    return "" if math.isfinite(value.mean) else f"{name} is not defined for these clips"


def fgd_cell(figure: fgd.Figure, sure: bool = False) -> Marked:
    """A distance; (?) where the sample is too small for it. sure: of the truth against itself."""
    doubt = not sure and math.isfinite(figure.distance) and fgd_verdict(figure).startswith("no")
    return Marked(replace(figure.interval, mean=figure.distance), "(?)" if doubt else "", figure.reason)


def fgd_verdict(figure: fgd.Figure) -> str:
    """Whether the sample suffices, and how many windows in each set would: "yes", or what is wrong with it.

    Twice: the covariance takes `figure.needed` windows, and the bias of the sample, which falls as one over the number
    of windows, should be a tenth of the distance at most.
    """
    fewest = min(figure.windows)
    if not np.isfinite(figure.distance):
        return f"no: {figure.reason}"
    if fewest < figure.needed:
        return f"no: {fewest} windows, and {figure.needed} are needed"
    if figure.distance <= figure.bias:
        return "no: not told from 0, as two samples of one motion of this size are as far apart"
    if figure.bias <= figure.distance / 10:
        return "yes"
    mean_windows = 2.0 / sum(1.0 / count for count in figure.windows)
    wanted = int(np.ceil(10.0 * figure.bias / figure.distance * mean_windows))
    return f"roughly: chance is {100 * figure.bias / figure.distance:.0f} % of it, and a tenth from {wanted} windows on"


def floor_figures(truth: ScoreRow, context: ScoreContext) -> tuple[dict[str, Marked], dict[str, fgd.Figure]]:
    """Distances between two halves of the truth; what is no distance between sets has none."""
    out = {name: Marked(Interval.undefined(), reason=NO_FLOOR) for name in (*CLIP_METRICS, *EYE_METRICS, *SET_METRICS)}
    place = {id(motion): k for k, motion in enumerate(truth.motions)}
    halves: list[list[int]] = []
    for groups in (context.clips.groups, None):
        try:
            halves = [[place[id(motion)] for motion in half]
                      for half in baselines.split_halves(truth.motions, context.seed, groups)]
            break
        except ValueError as error:
            out |= {key: Marked(Interval.undefined(), reason=str(error))
                    for key in ("speed_distance", *context.networks)}
    if not halves:
        return out, {}
    counts = [np.sum([speed_histogram(hand_speeds(truth.motions[k])) for k in half], axis=0) for half in halves]
    out["speed_distance"] = Marked(Interval.exact(hellinger(counts[0], counts[1]), min(map(len, halves))))
    distances = {}
    for key, network in context.networks.items():
        first, second = ([truth.features[key][k] for k in half] for half in halves)
        distances[key] = fgd.measure(first, second, network, seed=context.seed)
    return out | {key: fgd_cell(figure) for key, figure in distances.items()}, distances


def differences(first: ScoreRow, second: ScoreRow, truth: ScoreRow, context: ScoreContext) -> dict[str, Marked]:
    """First less second, paired over clips, with intervals."""
    out = {name: stats.paired(first.values[name], second.values[name], seed=context.seed)
           for name in (*CLIP_METRICS, *EYE_METRICS)}
    for name in SET_METRICS:
        if name in first.sets and name in second.sets:
            out[name] = stats.of_set(_less(first.sets[name], second.sets[name]), len(first.motions), seed=context.seed)
    for key in context.networks:
        out[key] = fgd.difference(first.features[key], second.features[key], truth.features[key])
    return {name: Marked(value) for name, value in out.items()}


def _less(first: Callable[[Indices], float], second: Callable[[Indices], float]) -> Callable[[Indices], float]:
    """First less second, of the same clips."""
    return lambda chosen: first(chosen) - second(chosen)


def mismatches(rows: Sequence[ScoreRow], context: ScoreContext) -> dict[str, dict[str, Mismatch]]:
    """The mismatch test of each row by each metric of synchrony."""
    known = [k for k, track in enumerate(context.tracks) if track is not None]
    few = [known[k] for k in np.unique(np.linspace(0, len(known) - 1, min(MOST, len(known))).round().astype(int))]
    tracks = [track for k in few if (track := context.tracks[k]) is not None]

    def tried(name: str, beats: Sequence[MotionBeats]) -> Array:
        return matrix(lambda i, j: synchrony(name, beats[i], tracks[j]), len(beats))

    return {row.name: {name: mismatch(tried(name, [row.beats[k] for k in few]), seed=context.seed)
                       for name in SYNCHRONY} for row in rows}


# ----------------------------------------------------------------------------------------------------------- flags

@dataclass(frozen=True)
class Flag:
    """What a control does to a metric."""

    metric: str
    control: str
    says: str


def flags(rows: Mapping[str, ScoreRow], figures: Figures, metrics: Mapping[str, Metric], seed: int) -> list[Flag]:
    """Which control beats what, by which metric.

    A control beats a system when its value is the better one, by more than rounding; the truth when it is as good or
    better by a metric where more is better; the floor when a distance between sets is no larger. It is not told from
    the truth when the paired interval of their difference holds 0. One that is as good as a system says so too: what is
    known to be wrong does no worse.
    """
    found = []
    systems = [row.name for row in rows.values() if row.kind == "system"]
    for name, metric in metrics.items():
        for control in (row for row in rows.values() if row.kind == "control"):
            says = _against_truth(name, metric, control, rows[TRUTH], figures, seed)
            own = _badness(metric, figures, name, control.name)
            theirs = {system: _badness(metric, figures, name, system) for system in systems}
            beaten = [system for system, value in theirs.items() if _below(own, value)]
            alike = [system for system, value in theirs.items() if math.isfinite(own) and math.isfinite(value)
                     and not _below(own, value) and not _below(value, own)]
            says += [f"beats {', '.join(beaten)}"] if beaten else []
            says += [f"is as good as {', '.join(alike)}"] if alike else []
            if says and metric.good:
                found.append(Flag(name, control.name, "; ".join(says)))
    return found


def mean_of(figures: Figures, row: str, metric: str) -> float:
    """A figure without its interval; NaN where it is not there."""
    cell = figures.get(row, {}).get(metric)
    return cell.value.mean if cell is not None and isinstance(cell.value, Interval) else math.nan


def _below(first: float, second: float) -> bool:
    return second - first > SAME[0] + SAME[1] * max(abs(first), abs(second))


def _badness(metric: Metric, figures: Figures, name: str, row: str) -> float:
    value = mean_of(figures, row, name)
    if metric.good == "near":
        return abs(value - mean_of(figures, TRUTH, name))
    return -value if metric.good == "high" else value


def _against_truth(name: str, metric: Metric, control: ScoreRow, truth: ScoreRow, figures: Figures, seed: int
                   ) -> list[str]:
    own, theirs = mean_of(figures, control.name, name), mean_of(figures, TRUTH, name)
    if not (math.isfinite(own) and math.isfinite(theirs)):
        return []
    if metric.good == "low":
        floor = mean_of(figures, FLOOR, name)
        return [f"is no farther than half of the truth from the other ({own:.3g}, {floor:.3g})"] if own <= floor else []
    if metric.good == "high" and own >= theirs:
        return [f"beats the truth ({own:.3g}, {theirs:.3g})"]
    apart = (stats.paired(control.values[name], truth.values[name], seed=seed) if name in control.values
             else stats.of_set(_less(control.sets[name], truth.sets[name]), len(truth.motions), seed=seed))
    near = apart.low <= 0.0 <= apart.high
    return [f"is not told from the truth ({own:.3g}, {theirs:.3g})"] if near or own == theirs else []


# ----------------------------------------------------------------------------------------------------------- result

@dataclass(frozen=True)
class Scores:
    """All that was measured. metrics: by column, FGD by network; kinds: row -> "truth", "system", "control", "floor".

    distances: row -> network -> an FGD with what it depends on; curves: "row, mode" -> mean PMB at `pmb.DELTAS`.
    """

    clips: Sequence[str]
    seconds: float
    fps: float
    metrics: Mapping[str, Metric]
    kinds: Mapping[str, str]
    figures: Figures
    differences: Figures
    distances: Mapping[str, Mapping[str, fgd.Figure]]
    mismatch: Mapping[str, Mapping[str, Mismatch]]
    curves: Mapping[str, Sequence[float]]
    flags: Sequence[Flag]
    notes: Sequence[str]


def score(clips: ClipSet, networks: Mapping[str, Features], bundle: Any = None, *, with_controls: bool = True,
          seed: int = 0) -> Scores:
    """Measure all rows on the same clips."""
    tracks = [OnsetTrack.of(speech) if speech is not None else None for speech in clips.speeches]
    voices = [None if speech is None else eye.hear(speech) for speech in clips.speeches]
    context = ScoreContext(clips, tracks, networks, None if bundle is None else ClipEncoder.of(bundle, clips), seed,
                           voices, eye.ReferenceSpace.found())
    made, notes = control_rows(clips, seed, voices) if with_controls else ({}, [])
    rows = {name: context.row(name, TRUTH if name == TRUTH else "system", motions)
            for name, motions in clips.motions.items()}
    rows |= {name: context.row(name, "control", motions) for name, motions in made.items()}
    both = {name: row_figures(row, rows[TRUTH], context) for name, row in rows.items()}
    if with_controls:
        both[FLOOR] = floor_figures(rows[TRUTH], context)
    figures = {name: pair[0] for name, pair in both.items()}
    distances = {name: pair[1] for name, pair in both.items()}
    metrics = {**CLIP_METRICS, **EYE_METRICS, **SET_METRICS,
               **{key: replace(METRICS["fgd"], title=f"FGD, {key}") for key in networks}}
    systems = [row for row in rows.values() if row.kind == "system"]
    return Scores(
        clips.names, round(clips.seconds, 2), clips.fps, metrics,
        {name: rows[name].kind if name in rows else "floor" for name in both}, figures,
        {f"{a.name} - {b.name}": differences(a, b, rows[TRUTH], context)
         for a, b in itertools.combinations(systems, 2)},
        distances, mismatches(list(rows.values()), context),
        {f"{name}, {mode}": _mean(values) for name, row in rows.items() for mode, values in row.curves.items()},
        flags(rows, figures, metrics, seed), [*clips.notes, *notes])


def _mean(curves: Array) -> list[float]:
    """[deltas] the mean over the clips that have a value."""
    known = curves[np.isfinite(curves).all(axis=1)]
    return known.mean(axis=0).tolist() if len(known) else [math.nan] * curves.shape[1]


# ------------------------------------------------------------------------------------------------------ for readers

_GOOD = {"low": "less is better", "high": "more is better", "near": "near the truth's is good", "": "no judgement"}
_PARTS = {"joints": "Joints against the speaker's own", "beats": "Motion beats and onsets",
          "consistency": "Beat consistency", "vigour": "Vigour and smoothness", "lexemes": "As the bundle reads it",
          "eye hands": "What the eye sees: two hands", "eye trunk": "What the eye sees: trunk and life",
          "eye strokes": "What the eye sees: strokes", "eye voice": "What the eye sees: in time with the voice",
          "eye frechet": "What the eye sees: everything at once", "sets": "Sets of motion",
          "fgd": "Sets of motion, by a network's features"}
_ROWS = {TRUTH: "the speakers' own motion", STILL: "the truth's mean pose, clip by clip, without movement",
         "shuffled": "the truth of another clip with this speech", "reversed": "the truth played backwards",
         "jitter": "the truth with every joint 2 cm off, anew in each frame",
         "mirrored": "the truth with the right arm's motion on both arms",
         BOBBING: "the truth's mean pose whose forearms stop at every onset"}
_LEGEND = (
    "[low, high]: 95 % interval over clips. -: undefined, the reason is told below. (!): a metric that a control "
    "beats, see below. (?): a distance of a set too small for it, see \"FGD of\".",
    "PMB: share of motion beats with an onset of the speech within so many seconds. Beats A: where the arms brake "
    "hardest; B: where they stand still. Chance is the same motion with the speech moved.")


def tables(scores: Scores) -> list[Table]:
    """What is compared, a table for each part, and what to make of it; metrics that a control beats bear (!)."""
    flagged = {flag.metric for flag in scores.flags}
    out = [_about(scores)]
    for part, title in _PARTS.items():
        metrics = {name: metric for name, metric in scores.metrics.items() if metric.part == part}
        rows = {name: row for name, row in scores.figures.items() if part in ("sets", "fgd") or name != FLOOR}
        if metrics:
            columns = {name: Column(f"{metric.title}{' (!)' if name in flagged else ''}",
                                    f"{metric.unit}{', ' if metric.unit else ''}{_GOOD[metric.good]}", metric.digits,
                                    metric.good) for name, metric in metrics.items()}
            out.append(Table(title, columns, {name: {key: row[key] for key in columns if key in row}
                                              for name, row in {**rows, **scores.differences}.items()}, "row"))
    out.append(Table("PMB by delta, %", {f"{delta:g}": Column(f"{delta:g} s", digits=0) for delta in pmb.DELTAS},
                     {name: dict(zip((f"{delta:g}" for delta in pmb.DELTAS), values, strict=True))
                      for name, values in scores.curves.items()}, "row, beats"))
    return [*out, _mismatch_table(scores), _fgd_table(scores), _flag_table(scores), *_reason_tables(scores)]


def _about(scores: Scores) -> Table:
    """What is compared, what the rows are, how cells are to be read."""
    clips, kinds = len(scores.clips), scores.kinds
    few = f" Fewer than {FEW} clips: the intervals are too narrow." if clips < FEW else ""
    rows: dict[str, str] = {TRUTH: _ROWS[TRUTH]} | {name: "judged" for name, kind in kinds.items() if kind == "system"}
    rows |= {name: f"{_ROWS[name]} (control, known to be wrong)" for name, kind in kinds.items() if kind == "control"}
    if FLOOR in kinds:
        rows[FLOOR] = "as far apart as two sets of real motion of this size are"
    if scores.differences:
        rows["A - B"] = "the difference of two systems, paired over clips"
    facts = {"clips": list(scores.clips), "seconds": scores.seconds, "fps": scores.fps, "notes": list(scores.notes),
             "systems": [name for name, kind in kinds.items() if kind == "system"],
             "controls": [name for name, kind in kinds.items() if kind == "control"]}
    return Table(f"{clips} clip{'' if clips == 1 else 's'}, {scores.seconds:.0f} s, at {scores.fps:g} fps.{few}",
                 {"what": Column("what it is")}, {name: {"what": told} for name, told in rows.items()}, "row",
                 [*_LEGEND, *(f"Note: {note}." for note in scores.notes)], facts)


def _mismatch_table(scores: Scores) -> Table:
    """Right speech against others'; a row for each row and metric."""
    rows: dict[str, dict[str, Any]] = {}
    for name, tests in scores.mismatch.items():
        for metric, test in tests.items():
            digits = scores.metrics[metric].digits + 1
            cells: dict[str, Cell] = {"right": test.right, "wrong": test.wrong, "difference": test.difference}
            rows[f"{name}, {scores.metrics[metric].title}"] = {
                **{key: shown_cell(cell, digits) for key, cell in cells.items()},
                "p": test.reason or f"{test.p_value:.3g}"}
    clips = len(scores.clips)
    notes = [f"With {clips} clips p cannot be below {1 / math.factorial(clips):.3g}: look at the differences, or take "
             "more clips (or --piece)."] if 1 < clips < 5 else []
    facts = {name: {metric: test.to_dict() for metric, test in tests.items()}
             for name, tests in scores.mismatch.items()}
    return Table("Mismatch test", {"right": Column("right speech"), "wrong": Column("others'"),
                                   "difference": Column("difference"), "p": Column("p")}, rows, "row, metric", notes,
                 facts)


def _fgd_table(scores: Scores) -> Table:
    """Is each distance of enough windows?"""
    rows: dict[str, dict[str, Any]] = {}
    for name, distances in scores.distances.items():
        for key, figure in distances.items() if name != TRUTH else ():
            rows[f"{name}, {key}"] = {
                "network": f"{figure.features} ({figure.sha256[:12]})",
                "window": f"{figure.frames} at {figure.fps:g} fps",
                "windows": f"{figure.windows[0]} / {figure.windows[1]}", "needed": figure.needed,
                "bias": f"{figure.bias:.2g}" if math.isfinite(figure.bias) else None, "enough": fgd_verdict(figure)}
    heads = {"network": "network (SHA-256)", "window": "window", "windows": "windows of it / of the truth",
             "needed": "needed", "bias": "bias of the sample", "enough": "enough?"}
    return Table("FGD of", {key: Column(title) for key, title in heads.items()}, rows, "row, network", [
        "Bias of the sample: as far as two samples of this size of one motion are apart by chance, if windows were "
        "independent; those of one clip are not, so it is more."])


def _flag_table(scores: Scores) -> Table:
    """Which metrics cannot be trusted."""
    title, column = "Metrics that a control beats", {"says": Column("by what")}
    if "control" not in scores.kinds.values():
        return Table(title, {}, {}, notes=["No controls were measured, so nothing here says which metric can be "
                                           "trusted."])
    told: dict[str, list[str]] = {}
    for flag in scores.flags:
        told.setdefault(scores.metrics[flag.metric].heading, []).append(f"*{flag.control}* {flag.says}")
    return Table(title, column if told else {}, {name: {"says": ". ".join(says)} for name, says in told.items()},
                 "metric", [] if told else ["None."],
                 {"flags": [vars(flag) | {"title": scores.metrics[flag.metric].heading} for flag in scores.flags]})


def _reason_tables(scores: Scores) -> list[Table]:
    """Why figures are undefined, if any are; by reason."""
    rows: dict[tuple[str, str], list[str]] = {}
    for metric, column in scores.metrics.items():
        by_reason: dict[str, list[str]] = {}
        for name, figures in scores.figures.items():
            cell = figures.get(metric)
            if cell is not None and cell.reason and column.part != "fgd" and cell.reason != NO_FLOOR:
                by_reason.setdefault(cell.reason, []).append(name)
        for reason, names in by_reason.items():
            rows.setdefault((reason, ", ".join(names)), []).append(column.heading)
    if not rows:
        return []
    return [Table("Undefined", {"rows": Column("rows"), "why": Column("why")}, {
        "; ".join(titles): {"rows": names, "why": reason} for (reason, names), titles in rows.items()}, "metrics")]


# --------------------------------------------------------------------------------------------------------- command

def networks_of(fgd_folder: Path | None, work: Path | None, truth: Path) -> dict[str, Features]:
    """What FGD is measured in, two window lengths at least: the papers' network (fgd_folder), our own that lie in work
    (trained there on the truth's training split where it is a store), and raw directions for lengths that lack."""
    found: list[Features] = [published(fgd_folder)] if fgd_folder else []
    if work is not None:
        own = sorted(file.parent for file in work.rglob("gesture_features.json"))
        if not own and (truth / "store.json").is_file():
            work.mkdir(parents=True, exist_ok=True)
            found += [one for one in networks(Store.open(truth), work) if one.name.startswith("own")]
        found += [as_features(load(folder)) for folder in own]
    lengths = {round(one.frames / one.fps, 6) for one in found}
    for frames in RAW_FRAMES:
        if len(lengths) < 2 and round(frames / FPS, 6) not in lengths:
            found.append(RawFeatures(frames))
            lengths.add(round(frames / FPS, 6))
    table: dict[str, Features] = {}
    for one in found:
        length = f"{one.frames} frames"
        name = one.name if one.name.endswith(length) else f"{one.name}, {length}"
        # Two networks of our own may differ only in what they were trained on.
        table[name if name not in table else f"{name} ({one.sha256[:8]})"] = one
    return table


def named(entries: Sequence[str], what: str) -> dict[str, str]:
    """NAME=VALUE ... as a table; InputError for one that is not, or a name that comes twice."""
    table: dict[str, str] = {}
    for entry in entries:
        name, mark, value = entry.partition("=")
        if not (name and mark and value):
            raise InputError(f"{what} {entry}", "is not of the form NAME=VALUE", "name it: ours=DIR")
        if name in table:
            raise InputError(f"{what} {entry}", "has a name that was given before", "choose another")
        table[name] = value
    return table


def read_all(arguments: argparse.Namespace) -> tuple[dict[str, dict[str, Clip]], list[str]]:
    """The clips of truth and systems, and what was left out of their folders."""
    systems = named(arguments.system, "--system")
    for name in (TRUTH, FLOOR, STILL, BOBBING, UNITS, *baselines.CONTROLS):
        if name in systems:
            raise InputError(f"--system {name}", "is the name of a row of its own", "choose another")
    rates = {name: _positive(f"--fps {name}", value) for name, value in named(arguments.fps, "--fps").items()}
    unknown = sorted(set(rates) - {TRUTH, *systems})
    if unknown:
        raise InputError(f"--fps {unknown[0]}", "names no system", f"choose among {', '.join((TRUTH, *systems))}")
    places = {TRUTH: arguments.truth, **{name: Path(place) for name, place in systems.items()}}
    names, notes = shared_names({name: names_in(place, arguments.split) for name, place in places.items()})
    folders: dict[str, dict[str, Clip]] = {}
    for name, place in places.items():
        folders[name], left_out = read_folder(place, arguments.speech, rates.get(name), names, arguments.split)
        notes += [f"{name}: {one}" for one in left_out]
    silent = [name for name in names if all(clips[name].speech is None for clips in folders.values())]
    if silent and arguments.speech is not None:
        raise InputError(arguments.speech, f"has no sound for {listed(silent, 3)}",
                         "put a sound of that name there, or leave --speech out")
    return folders, notes


def unit_selection_row(truth: Mapping[str, Clip], store: Store, work: Path | None, seed: int) -> dict[str, Clip]:
    """What unit selection makes of the truth's speech; InputError for a clip without speech."""
    from eval.unit_selection import UnitDatabase, UnitSelection

    units = UnitSelection(UnitDatabase.of(store, work=work))
    row = {}
    for name, clip in truth.items():
        if clip.speech is None:
            raise InputError(name, "has no sound to select units by", "give --speech, or leave --units out")
        row[name] = replace(clip, motion=units(clip.speech, seed=seed).motion)
    return row


def _positive(what: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not (np.isfinite(number) and number > 0):
        raise InputError(what, f"is {value}", "give a number over 0")
    return number


def arguments(parser: argparse.ArgumentParser) -> None:
    """What `gesticulator score` takes."""
    add = parser.add_argument
    add("--truth", type=Path, required=True, metavar="DIR", help="the speakers' own motion, or a store")
    add("--system", action="append", required=True, metavar="NAME=DIR", help="may be given many times")
    add("--speech", type=Path, metavar="DIR", help="where the sounds lie (default: beside the motion)")
    add("--fgd", type=Path, metavar="FOLDER", help="the Human3.6M network of the papers")
    add("--work", type=Path, metavar="DIR", help="our own networks of gesture features are stored there")
    add("--bundle", metavar="DIR", help="its lexicon measures diversity, motion variance and lexeme accuracy, its "
        "judging model the reward ('shipped': the one that comes along)")
    add("--split", default="test", choices=(*SPLITS, "all"), help="what is compared of a store (default: test)")
    add("--piece", metavar="SECONDS", help="cut long clips into pieces of this length")
    add("--rate", metavar="FPS", help="frame rate to compare at (default: the lowest of all)")
    add("--fps", action="append", default=[], metavar="NAME=RATE",
        help="frame rate of a system's files, or truth=RATE, where they have none or a wrong one")
    add("--units", metavar="STORE", help="adds a row of unit selection over this store's training split, the baseline "
        "that a system has to beat")
    add("--no-controls", action="store_true", help="leave out the rows of motion that is known to be wrong")
    add("--seed", type=int, default=0)
    add("--out", type=Path, metavar="FILE.json", help="a .md is written beside it")


def scored(arguments: argparse.Namespace) -> Scores:
    """What the command measures; InputError for what the user gave and cannot be used."""
    rate, piece = (None if value is None else _positive(name, value)
                   for name, value in (("--rate", arguments.rate), ("--piece", arguments.piece)))
    bundle = None
    if arguments.bundle:
        from gesticulator import bundle as bundles

        bundle = bundles.load(bundles.SHIPPED if arguments.bundle == "shipped" else arguments.bundle)
        # A bundle of RACER's own codec has no lexicon of the kind that these figures are of.
        _ = bundle.block_models
    folders, left_out = read_all(arguments)
    if arguments.units:
        folders[UNITS] = unit_selection_row(folders[TRUTH], Store.open(arguments.units), arguments.work, arguments.seed)
    networks = networks_of(arguments.fgd, arguments.work, arguments.truth)
    clips = common_clips(folders, rate, piece)
    clips.notes[:0] = left_out
    return score(clips, networks, bundle, with_controls=not arguments.no_controls, seed=arguments.seed)


def run(arguments: argparse.Namespace) -> int:
    """Measure, write and show."""
    publish(tables(scored(arguments)), arguments.out)
    return 0
