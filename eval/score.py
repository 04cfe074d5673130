"""`python -m eval score`: real, generated and foreign motion side by side, on the same clips, with the controls.

    python -m eval score --truth DIR --system NAME=DIR ... [--speech DIR] [--fgd FOLDER] [--work DIR] [--bundle DIR]
                         [--split test] [--piece SECONDS] [--rate FPS] [--fps NAME=RATE] [--out results/score.json]

Every DIR holds motion by clip (see `eval.foreign` for what can be read), or is a store, of which one split counts;
clips are matched by their names, only those that all have are read, and what does not match is named. All motion is
brought onto the 16-joint character, to the lowest frame rate among them (or --rate) and, clip by clip, to the shortest
length. Each figure is a mean over clips with its bootstrap 95 % interval, or of the set of clips, with the basic
bootstrap's; systems are compared in pairs over the same clips.

Beside the systems stand rows of motion known to be wrong (`eval.baselines`), made of the truth: shuffled among the
speeches, played backwards, with 2 cm of jitter, and the mean pose of each clip, held still. One half of the truth
against the other is the floor of distances between sets. A metric that a control beats is marked, and by whom said: it
cannot tell good from bad in that respect, and a good value of it proves nothing.

What fools a table as a whole: few clips (a long take can be cut by --piece, but pieces of one take are alike, so that
intervals are too narrow), and the many columns: of twenty, one is beyond its 95 % by chance.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, one_line_errors
from data_module.motion.kinematics import resample
from data_module.store import SPLITS, Store
from data_module.types import Array, Motion, Speech
from eval import baselines as controls
from eval import fgd, pmb
from eval.bootstrap import Interval, interval
from eval.clip_scores import (
    LEXEME_METRICS,
    METRICS,
    SYNCHRONY,
    Heard,
    Metric,
    Moved,
    Spoken,
    Told,
    Values,
    clip_values,
    curve,
    lexeme_values,
    synchrony,
    told,
)
from eval.foreign import Clip, names_in, read_folder
from eval.gesture_features import FPS, Features, RawFeatures, as_features, load, pooled, published
from eval.mismatch import matrix, mismatch
from eval.results import keep
from eval.smoothness import hand_speeds, hellinger, speed_histogram

TRUTH, FLOOR, STILL = "truth", "truth, half against half", "mean pose, held"
NO_FLOOR = "a floor is of distances between sets"
RAW_FRAMES = (34, 60)
"""Windows of the raw directions, at 15 fps, where networks of two lengths are not to be had."""
DRAWS = 200
MOST = 60
"""Clips of a mismatch test at most, evenly chosen: it tries all pairs."""
FEW = 10
"""Clips below which intervals are too narrow."""
_UNEVEN = 0.5  # seconds by which lengths may differ without a word

Indices = NDArray[np.int64]
CLIP_METRICS = {**METRICS, **LEXEME_METRICS}
SET_METRICS: dict[str, Metric] = {
    "speed_distance": Metric("distance of hand-speed histograms (Hellinger)", 3, "sets", "low"),
    "diversity": Metric("diversity, nats", 2, "sets", "near"),
    "motion_variance": Metric("motion variance", 3, "sets", "near"),
}
"""The metrics that have a value for a set of clips, but for FGD, which has one for each network."""


# ------------------------------------------------------------------------------------------------------ the ground

@dataclass
class Ground:
    """The same clips of all. groups: those of one group share their sound. speeches: None where not known."""

    names: list[str]
    groups: list[str]
    speeches: list[Speech | None]
    motions: dict[str, list[Motion]]
    fps: float
    notes: list[str] = field(default_factory=list)


def common_ground(folders: Mapping[str, Mapping[str, Clip]], rate: float | None = None, piece: float | None = None
                  ) -> Ground:
    """The clips that all of truth and systems have, at one frame rate, each of one length, in pieces where asked.

    InputError when no name is common to all.
    """
    names, notes = shared({row: list(clips) for row, clips in folders.items()})
    fps = rate or min(clips[name].motion.fps for clips in folders.values() for name in names)
    ground = Ground([], [], [], {row: [] for row in folders}, fps, [*notes, *_body_notes(folders, names, fps)])
    for name in names:
        _add(ground, [clips[name] for clips in folders.values()], list(folders), piece)
    return ground


def shared(names: Mapping[str, Sequence[str]]) -> tuple[list[str], list[str]]:
    """The names that all rows have, in the truth's order, and a note for each row that has more.

    InputError when there is none.
    """
    common = [name for name in names[TRUTH] if all(name in own for own in names.values())]
    if not common:
        raise InputError("truth and systems", "have no clip in common", "give files of one clip one name: "
                         + "; ".join(f"{row} has {_listed(own, 3)}" for row, own in names.items()))
    notes = []
    for row, own in names.items():
        over: dict[str, list[str]] = {}
        for name in own:
            lacking = ", ".join(other for other, theirs in names.items() if name not in theirs)
            if lacking:
                over.setdefault(lacking, []).append(name)
        notes += [f"{row}: {_listed(some, 4)} {'is' if len(some) == 1 else 'are'} not compared, because {lacking} "
                  f"{'have' if ',' in lacking else 'has'} none of {'that name' if len(some) == 1 else 'these names'}"
                  for lacking, some in over.items()]
    return common, notes


def _listed(names: Sequence[str], most: int) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _body_notes(folders: Mapping[str, Mapping[str, Clip]], names: Sequence[str], fps: float) -> list[str]:
    """What a row has had to give up to be compared: frame rate, joints that it lacks."""
    notes = []
    for row, clips in folders.items():
        rates = sorted({clips[name].motion.fps for name in names} - {fps})
        if rates:
            notes.append(f"{row}: brought from {', '.join(f'{rate:g}' for rate in rates)} to {fps:g} fps")
        absent = sorted({joint for name in names for joint in clips[name].motion.absent})
        if absent:
            notes.append(f"{row}: {', '.join(absent)} {'is' if len(absent) == 1 else 'are'} not known, so that MAJE "
                         "and MAD are over the other joints: compare them with care with rows that have more")
    return notes


def _add(ground: Ground, clips: Sequence[Clip], rows: Sequence[str], piece: float | None) -> None:
    """One clip of all rows, the truth first, cut to the shortest and into pieces."""
    name, fps = clips[0].name, ground.fps
    speech = next((clip.speech for clip in clips if clip.speech is not None), None)
    motions = [resample(clip.motion, fps) for clip in clips]
    frames = min(map(len, motions))
    if speech is not None:
        frames = max(1, min(frames, int(speech.duration * fps + 1e-6)))
    ground.notes += [f"{name}: {row} lasts {motion.duration:.2f} s, and {frames / fps:.2f} s are compared"
                     for row, motion in zip(rows, motions, strict=True) if motion.duration - frames / fps > _UNEVEN]
    step = frames if piece is None else max(1, round(piece * fps))
    for number in range(max(1, frames // step)):
        begin, end = number * step, min((number + 1) * step, frames)
        ground.names.append(name if frames // step < 2 else f"{name}, piece {number + 1}")
        ground.groups.append(clips[0].group or name)
        ground.speeches.append(None if speech is None else _cropped(speech, begin / fps, end / fps))
        for row, motion in zip(rows, motions, strict=True):
            ground.motions[row].append(motion.crop(begin, end))


def _cropped(speech: Speech, begin: float, end: float) -> Speech:
    """What is heard from `begin` to `end` seconds; the words do not count here."""
    first = min(round(begin * speech.sample_rate), len(speech.samples) - 1)
    last = max(first + 1, round(end * speech.sample_rate))
    return replace(speech, samples=speech.samples[first:last], words=None)


def mean_pose(clips: Sequence[Motion]) -> list[Motion]:
    """Each clip held still in its mean pose (the rotation nearest to all of a joint's)."""
    out = []
    for clip in clips:
        outer = np.einsum("tji,tjk->jik", clip.rotations, clip.rotations)
        turns = np.linalg.eigh(outer)[1][..., -1]
        out.append(replace(clip, rotations=np.tile(turns, (len(clip), 1, 1)),
                           root_positions=np.tile(clip.root_positions.mean(axis=0), (len(clip), 1))))
    return out


# ------------------------------------------------------------------------------------------------------------ rows

@dataclass
class Row:
    """A set of motions and what was measured. kind: "truth", "system" or "control".

    values: metric -> [clips]; sets: metric -> a figure of the clips with these numbers; features: network -> [n, E] by
    clip; reasons: metric -> why its figure is undefined; curves: mode -> [clips, deltas].
    """

    name: str
    kind: str
    motions: list[Motion]
    moved: list[Moved]
    values: dict[str, Array] = field(default_factory=dict)
    sets: dict[str, Callable[[Indices], float]] = field(default_factory=dict)
    features: dict[str, list[Array]] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    curves: dict[str, Array] = field(default_factory=dict)


def measured(name: str, kind: str, motions: list[Motion], ground: Ground, heard: Sequence[Heard | None],
             networks: Mapping[str, Features], read: Reading | None, seed: int) -> Row:
    """Everything about one set of motions. read: what a bundle makes of the speech, None without a bundle."""
    row = Row(name, kind, motions, [Moved.of(motion) for motion in motions])
    truth = controls.to_common_length(motions, ground.motions[TRUTH])[1]
    every = [clip_values(motion, own, moved, sound, seed + k) for k, (motion, own, moved, sound)
             in enumerate(zip(motions, truth, row.moved, heard, strict=True))]
    _put(row, METRICS, every)
    for mode in ("A", "B"):
        row.curves[mode] = np.array([curve(moved, sound, mode) for moved, sound in zip(row.moved, heard, strict=True)
                                     if sound is not None]).reshape(-1, len(pmb.DELTAS))
    for key, network in networks.items():
        row.features[key] = pooled(motions, network)
    own_counts, their_counts = (np.array([speed_histogram(hand_speeds(motion)) for motion in clips])
                                for clips in (motions, ground.motions[TRUTH]))
    row.sets["speed_distance"] = lambda chosen: hellinger(own_counts[chosen].sum(0), their_counts[chosen].sum(0))
    _lexemes(row, read)
    return row


def _put(row: Row, metrics: Mapping[str, Metric], every: Sequence[Values]) -> None:
    """The values of all clips into a row, and why some have none."""
    for metric in metrics:
        row.values[metric] = np.array([values.numbers[metric] for values in every])
        why = sorted({values.reasons[metric] for values in every if metric in values.reasons})
        if why:
            lacking = int(np.isnan(row.values[metric]).sum())
            row.reasons[metric] = f"{lacking} of {len(every)} clips: {'; '.join(why)}"


@dataclass(frozen=True)
class Reading:
    """What a bundle makes of the clips: the blocks of each speech, and how it reads the speakers' own motion."""

    bundle: Any
    spoken: list[Spoken | None]
    truth: list[Told | None]

    @classmethod
    def of(cls, bundle: Any, ground: Ground) -> Reading:
        """Each speech is cut and heard once for all rows."""
        spoken = [None if speech is None else Spoken.of(bundle, speech) for speech in ground.speeches]
        return cls(bundle, spoken, cls._told(bundle, ground.motions[TRUTH], spoken))

    def told(self, motions: Sequence[Motion]) -> list[Told | None]:
        """Motions of all clips as the bundle reads them; None where nothing is said."""
        return self._told(self.bundle, motions, self.spoken)

    @staticmethod
    def _told(bundle: Any, motions: Sequence[Motion], spoken: Sequence[Spoken | None]) -> list[Told | None]:
        return [None if own is None else told(bundle, motion, own) for motion, own in zip(motions, spoken, strict=True)]


def _lexemes(row: Row, read: Reading | None) -> None:
    """What the lexemes nearest to a row's blocks tell, where there is a lexicon."""
    lexeme_sets = ("diversity", "motion_variance")
    if read is None:
        row.values |= {metric: np.full(len(row.motions), np.nan) for metric in LEXEME_METRICS}
        row.reasons |= dict.fromkeys((*lexeme_sets, *LEXEME_METRICS), "no lexicon was given (--bundle)")
        return
    own = read.told(row.motions)
    judged = read.bundle.reward_judge is not None
    _put(row, LEXEME_METRICS, [lexeme_values(one, truth, judged) for one, truth in zip(own, read.truth, strict=True)])
    if not any(own):
        row.reasons |= dict.fromkeys(lexeme_sets, "no speech is known")
        return
    counts, sums, squares = lexeme_moments(own, read.bundle.lexicon.vectors.double().numpy())
    row.sets["diversity"] = lambda chosen: entropy(counts[chosen].sum(axis=0))
    row.sets["motion_variance"] = lambda chosen: mean_variance(
        *(part[chosen].sum(axis=0) for part in (counts, sums, squares)))


def lexeme_moments(read: Sequence[Told | None], vectors: Array) -> tuple[Array, Array, Array]:
    """[clips, S] each: for every lexeme the number of blocks, the sum of their distances to its vector and the sum of
    squares, both told from the mean distance of all. What redrawn sets are summed from: the blocks are not needed."""
    lengths = [np.zeros(0) if own is None else np.linalg.norm(own.latents - vectors[own.labels], axis=1)
               for own in read]
    middle = float(np.concatenate(lengths).mean())
    labels = [np.zeros(0, dtype=np.int64) if own is None else own.labels for own in read]
    powers = [np.array([np.bincount(own, (length - middle) ** power, minlength=len(vectors))
                        for own, length in zip(labels, lengths, strict=True)]) for power in (0, 1, 2)]
    return powers[0], powers[1], powers[2]


def entropy(counts: Array) -> float:
    """Nats, of counts [S] (RG Eq. 23, as `diversity.diversity`); NaN of nothing."""
    shares = counts[counts > 0] / max(counts.sum(), 1.0)
    return abs(float(-(shares * np.log(shares)).sum())) if len(shares) else float("nan")


def mean_variance(counts: Array, sums: Array, squares: Array) -> float:
    """The mean over lexemes of the unbiased variance, from sums [S] (as `diversity.motion_variance`); NaN where no
    lexeme occurs twice."""
    twice = counts > 1
    n, total, square = counts[twice], sums[twice], squares[twice]
    return float(np.maximum((square - total ** 2 / n) / (n - 1), 0.0).mean()) if twice.any() else float("nan")


def control_rows(ground: Ground, seed: int) -> tuple[dict[str, list[Motion]], list[str]]:
    """Each control's motions, and why one could not be made."""
    made, notes = {STILL: mean_pose(ground.motions[TRUTH])}, []
    truth = ground.motions[TRUTH]
    groups: list[str] | None = ground.groups
    try:
        controls.donors(truth, seed, groups)
    except ValueError:
        groups = None
        notes.append("clips of one sound could not be kept apart in the shuffled row and the halves: too few groups")
    for name, make in controls.CONTROLS.items():
        try:
            made[name] = controls.shuffled(truth, seed, groups) if name == "shuffled" else make(truth, seed)
        except ValueError as error:
            notes.append(f"no row {name}: {error}")
    return made, notes


# --------------------------------------------------------------------------------------------------------- figures

def set_interval(of: Callable[[Indices], float], clips: int, seed: int = 0) -> Interval:
    """A figure of all clips and its 95 % interval over redrawn ones (the basic bootstrap's, see `fgd.measure`)."""
    got = of(np.arange(clips))
    rng = np.random.default_rng(seed)
    drawn = np.array([of(rng.integers(clips, size=clips)) for _ in range(DRAWS if clips > 1 else 0)])
    drawn = drawn[np.isfinite(drawn)]
    if not np.isfinite(got) or len(drawn) == 0:
        return Interval(got, float("nan"), float("nan"), clips)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Interval(got, 2.0 * got - float(high), 2.0 * got - float(low), clips)


def row_figures(row: Row, truth: Row, networks: Mapping[str, Features], seed: int) -> dict[str, Any]:
    """Every metric of a row: mean, interval, clips, and the reason where it is undefined or not to be trusted."""
    out: dict[str, Any] = {}
    for metric, values in row.values.items():
        out[metric] = interval(values, seed=seed).to_dict()
    for metric in SET_METRICS:
        out[metric] = (set_interval(row.sets[metric], len(row.motions), seed).to_dict() if metric in row.sets
                       else Interval(float("nan"), float("nan"), float("nan"), 0).to_dict())
        if metric == "speed_distance" and np.isfinite(out[metric]["low"]):
            out[metric] |= {"low": max(0.0, out[metric]["low"]), "high": max(0.0, out[metric]["high"])}
    for key, network in networks.items():
        out[key] = _fgd_cell(fgd.measure(row.features[key], truth.features[key], network, paired=True, seed=seed))
    for metric, reason in row.reasons.items():
        out[metric]["reason"] = reason
    for metric, cell in out.items():
        if not np.isfinite(cell["mean"]) and not cell.get("reason"):
            cell["reason"] = f"{metric} is not defined for these clips"
    return out


def _fgd_cell(figure: fgd.Figure) -> dict[str, Any]:
    return {**figure.interval.to_dict(), "mean": figure.distance, "bias": figure.bias, "windows": list(figure.windows),
            "needed": figure.needed, "features": figure.features, "frames": figure.frames, "fps": figure.fps,
            "sha256": figure.sha256, "reason": figure.reason, "verdict": fgd_verdict(figure)}


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


def floor_figures(ground: Ground, truth: Row, networks: Mapping[str, Features], seed: int) -> dict[str, Any]:
    """Distances between two halves of the truth; what is no distance between sets has none."""
    nan = Interval(float("nan"), float("nan"), float("nan"), 0).to_dict()
    out: dict[str, Any] = {metric: {**nan, "reason": NO_FLOOR}
                           for metric in (*CLIP_METRICS, *SET_METRICS)}
    place = {id(motion): k for k, motion in enumerate(truth.motions)}
    halves: list[list[int]] = []
    for groups in (ground.groups, None):
        try:
            halves = [[place[id(motion)] for motion in half]
                      for half in controls.split_halves(truth.motions, seed, groups)]
            break
        except ValueError as error:
            for key in ("speed_distance", *networks):
                out[key] = {**nan, "reason": str(error)}
    if not halves:
        return out
    counts = [sum(speed_histogram(hand_speeds(truth.motions[k])) for k in half) for half in halves]
    out["speed_distance"] = {**nan, "mean": hellinger(np.asarray(counts[0]), np.asarray(counts[1])),
                             "clips": min(map(len, halves))}
    for key, network in networks.items():
        first, second = ([truth.features[key][k] for k in half] for half in halves)
        out[key] = _fgd_cell(fgd.measure(first, second, network, seed=seed))
    return out


def differences(first: Row, second: Row, truth: Row, networks: Mapping[str, Features], seed: int) -> dict[str, Any]:
    """First less second, paired over clips, with intervals."""
    from eval.policies import fgd_difference

    out: dict[str, Any] = {metric: interval(first.values[metric] - second.values[metric], seed=seed).to_dict()
                           for metric in CLIP_METRICS}
    for metric in SET_METRICS:
        if metric in first.sets and metric in second.sets:
            out[metric] = set_interval(_less(first.sets[metric], second.sets[metric]), len(first.motions),
                                       seed).to_dict()
    for key in networks:
        out[key] = fgd_difference(first.features[key], second.features[key], truth.features[key])
    return out


def _less(first: Callable[[Indices], float], second: Callable[[Indices], float]) -> Callable[[Indices], float]:
    """First less second, of the same clips."""
    return lambda chosen: first(chosen) - second(chosen)


def mismatches(rows: Sequence[Row], heard: Sequence[Heard | None], seed: int) -> dict[str, Any]:
    """The mismatch test of each row by each metric of synchrony."""
    spoken = [k for k, sound in enumerate(heard) if sound is not None]
    few = [spoken[k] for k in np.unique(np.linspace(0, len(spoken) - 1, min(MOST, len(spoken))).round().astype(int))]
    sounds = [sound for k in few if (sound := heard[k]) is not None]
    out: dict[str, Any] = {}
    for row in rows:
        moved = [row.moved[k] for k in few]
        out[row.name] = {name: mismatch(_tried(name, moved, sounds), seed=seed).to_dict() for name in SYNCHRONY}
    return out


def _tried(name: str, moved: Sequence[Moved], sounds: Sequence[Heard]) -> Array:
    """[n, n] a metric of synchrony of every motion with every speech."""
    return matrix(lambda i, j: synchrony(name, moved[i], sounds[j]), len(moved))


# ----------------------------------------------------------------------------------------------------------- flags

def flags(rows: Mapping[str, Row], figures: Mapping[str, Mapping[str, Any]], metrics: Mapping[str, Metric], seed: int
          ) -> list[dict[str, str]]:
    """Which control beats what, by which metric: [{"metric", "control", "says"}].

    A control beats a system when its value is the better one, by more than rounding; the truth when it is as good or
    better by a metric where more is better; the floor when a distance between sets is no larger. It is not told from
    the truth when the paired interval of their difference holds 0. One that is as good as a system says so too: what is
    known to be wrong does no worse.
    """
    found = []
    for metric, column in metrics.items():
        for control in (row for row in rows.values() if row.kind == "control"):
            says = _against_truth(metric, column, control, rows[TRUTH], figures, seed)
            own = _badness(column, figures, metric, control.name)
            beaten = [row.name for row in rows.values() if row.kind == "system"
                      and _below(own, _badness(column, figures, metric, row.name))]
            if beaten:
                says.append(f"beats {', '.join(beaten)}")
            alike = [row.name for row in rows.values() if row.kind == "system" and row.name not in beaten
                     and _alike(own, _badness(column, figures, metric, row.name))]
            if alike:
                says.append(f"is as good as {', '.join(alike)}")
            if says and column.good:
                found.append({"metric": metric, "control": control.name, "says": "; ".join(says)})
    return found


def _below(first: float, second: float) -> bool:
    """By more than what the rounding of files and of sums leaves."""
    return second - first > 1e-9 + 1e-4 * max(abs(first), abs(second))


def _alike(first: float, second: float) -> bool:
    """Both known, and neither below the other."""
    return bool(np.isfinite(first) and np.isfinite(second)) and not (_below(first, second) or _below(second, first))


def _badness(column: Metric, figures: Mapping[str, Mapping[str, Any]], metric: str, row: str) -> float:
    value = float(figures[row][metric]["mean"])
    if column.good == "near":
        return abs(value - float(figures[TRUTH][metric]["mean"]))
    return -value if column.good == "high" else value


def _against_truth(metric: str, column: Metric, control: Row, truth: Row,
                   figures: Mapping[str, Mapping[str, Any]], seed: int) -> list[str]:
    own, theirs = (float(figures[name][metric]["mean"]) for name in (control.name, TRUTH))
    if not (np.isfinite(own) and np.isfinite(theirs)):
        return []
    if column.good == "low":
        floor = float(figures.get(FLOOR, {}).get(metric, {}).get("mean", float("nan")))
        return [f"is no farther than half of the truth from the other ({own:.3g}, {floor:.3g})"] if own <= floor else []
    if column.good == "high" and own >= theirs:
        return [f"beats the truth ({own:.3g}, {theirs:.3g})"]
    apart = (interval(control.values[metric] - truth.values[metric], seed=seed) if metric in control.values
             else set_interval(_less(control.sets[metric], truth.sets[metric]), len(truth.motions), seed))
    near = apart.low <= 0.0 <= apart.high
    return [f"is not told from the truth ({own:.3g}, {theirs:.3g})"] if near or own == theirs else []


# ----------------------------------------------------------------------------------------------------------- result

def score(ground: Ground, networks: Mapping[str, Features], bundle: Any = None, *, with_controls: bool = True,
          seed: int = 0) -> dict[str, Any]:
    """The whole table, as plain values."""
    heard = [Heard.of(speech) if speech is not None else None for speech in ground.speeches]
    made, notes = control_rows(ground, seed) if with_controls else ({}, [])
    kinds = [(name, TRUTH if name == TRUTH else "system", motions) for name, motions in ground.motions.items()]
    kinds += [(name, "control", motions) for name, motions in made.items()]
    read = None if bundle is None else Reading.of(bundle, ground)
    rows = {name: measured(name, kind, motions, ground, heard, networks, read, seed)
            for name, kind, motions in kinds}
    figures = {name: row_figures(row, rows[TRUTH], networks, seed) for name, row in rows.items()}
    if with_controls:
        figures[FLOOR] = floor_figures(ground, rows[TRUTH], networks, seed)
    columns = {**CLIP_METRICS, **SET_METRICS, **{key: Metric(f"FGD, {key}", 2, "fgd", "low") for key in networks}}
    systems = [row for row in rows.values() if row.kind == "system"]
    return {
        "clips": ground.names, "seconds": round(sum(m.duration for m in ground.motions[TRUTH]), 2), "fps": ground.fps,
        "systems": [row.name for row in systems], "controls": list(made), "notes": [*ground.notes, *notes],
        "metrics": {key: {"title": column.title, "digits": column.digits, "part": column.part, "good": column.good}
                    for key, column in columns.items()},
        "rows": figures,
        "curves": {"deltas": list(pmb.DELTAS), **{name: {mode: _mean(values) for mode, values in row.curves.items()}
                                                  for name, row in rows.items()}},
        "differences": {f"{a.name} - {b.name}": differences(a, b, rows[TRUTH], networks, seed)
                        for a, b in itertools.combinations(systems, 2)},
        "mismatch": mismatches(list(rows.values()), heard, seed),
        "flags": flags(rows, figures, columns, seed),
    }


def _mean(curves: Array) -> list[float]:
    """[deltas] the mean over the clips that have a value."""
    known = curves[np.isfinite(curves).all(axis=1)]
    return known.mean(axis=0).tolist() if len(known) else [float("nan")] * curves.shape[1]


# ------------------------------------------------------------------------------------------------------ for readers

_GOOD = {"low": "less is better", "high": "more is better", "near": "near the truth's is good", "": "no judgement"}
_PARTS = {"joints": "joints against the speaker's own", "beats": "motion beats and onsets",
          "consistency": "beat consistency", "vigour": "vigour and smoothness", "lexemes": "as the bundle reads it",
          "sets": "sets of motion", "fgd": "sets of motion, by a network's features"}
_ROWS = {TRUTH: "the speakers' own motion", STILL: "the truth's mean pose, clip by clip, without movement",
         "shuffled": "the truth of another clip with this speech", "reversed": "the truth played backwards",
         "jitter": "the truth with every joint 2 cm off, anew in each frame"}
_LEGEND = (
    "[low, high]: 95 % interval over clips. NaN: undefined, the reason is told below. (!): a metric that a control "
    "beats, see below. (?): a distance of a set too small for it, see \"FGD of\".",
    "PMB: share of motion beats with an onset of the speech within so many seconds. Beats A: where the arms brake "
    "hardest; B: where they stand still. Chance is the same motion with the speech moved.")


def markdown(result: Mapping[str, Any]) -> str:
    """The tables for a reader; metrics that a control beats bear (!)."""
    flagged = {flag["metric"] for flag in result["flags"]}
    lines = _head_lines(result)
    for part, title in _PARTS.items():
        keys = [key for key, column in result["metrics"].items() if column["part"] == part]
        if not keys:
            continue
        heads = [_head(result["metrics"][key], key in flagged) for key in keys]
        lines += [f"| {title} | {' | '.join(heads)} |", "|---|" + "---|" * len(keys)]
        lines += [f"| {name} | " + " | ".join(_cell(row[key], result["metrics"][key]["digits"], name == TRUTH)
                                              for key in keys) + " |"
                  for name, row in result["rows"].items() if part in ("sets", "fgd") or name != FLOOR]
        lines += [f"| {name} | " + " | ".join(_cell(row.get(key), result["metrics"][key]["digits"]) for key in keys)
                  + " |" for name, row in result["differences"].items()]
        lines.append("")
    lines += [*_curve_lines(result), *_mismatch_lines(result), *_fgd_lines(result), *_flag_lines(result),
              *_reason_lines(result)]
    if result["notes"]:
        lines += ["Notes:", "", *(f"- {note}" for note in result["notes"]), ""]
    return "\n".join(lines).rstrip() + "\n"


def _head_lines(result: Mapping[str, Any]) -> list[str]:
    """What is compared, what the rows are, how cells are to be read."""
    clips = len(result["clips"])
    lines = [f"{clips} clip{'' if clips == 1 else 's'}, {result['seconds']:.0f} s, at {result['fps']:g} fps."
             + (f" Fewer than {FEW} clips: the intervals are too narrow." if clips < FEW else ""), "", "Rows:", "",
             f"- {TRUTH}: {_ROWS[TRUTH]}", f"- judged: {', '.join(result['systems'])}"]
    lines += [f"- {name}: {_ROWS[name]} (control, known to be wrong)" for name in result["controls"]]
    if result["controls"]:
        lines.append(f"- {FLOOR}: as far apart as two sets of real motion of this size are")
    if result["differences"]:
        lines.append("- A - B: the difference of two systems, paired over clips")
    return [*lines, "", *(f"{line}\n" for line in _LEGEND)]


def _head(column: Mapping[str, Any], flagged: bool) -> str:
    return f"{column['title']}{' (!)' if flagged else ''}, {_GOOD[column['good']]}"


def _cell(value: Mapping[str, Any] | None, digits: int, sure: bool = False) -> str:
    """sure: of the truth against itself, which no sample is too small for."""
    if value is None or not np.isfinite(value["mean"]):
        return "NaN"
    doubt = "" if sure or not value.get("verdict", "").startswith("no") else " (?)"
    if not np.isfinite(value["low"]):
        return f"{value['mean']:.{digits}f}{doubt}"
    return f"{value['mean']:.{digits}f}{doubt} [{value['low']:.{digits}f}, {value['high']:.{digits}f}]"


def _curve_lines(result: Mapping[str, Any]) -> list[str]:
    deltas = result["curves"]["deltas"]
    lines = ["| PMB, % at delta, s | " + " | ".join(f"{delta:g}" for delta in deltas) + " |",
             "|---|" + "---|" * len(deltas)]
    lines += [f"| {name}, {mode} | " + " | ".join(f"{value:.0f}" if np.isfinite(value) else "NaN" for value in values)
              + " |" for name, modes in result["curves"].items() if name != "deltas"
              for mode, values in modes.items()]
    return [*lines, ""]


def _mismatch_lines(result: Mapping[str, Any]) -> list[str]:
    lines = ["| mismatch test | metric | right speech | others' | difference | p |", "|---|---|---|---|---|---|"]
    for name, tests in result["mismatch"].items():
        for metric, test in tests.items():
            digits = result["metrics"][metric]["digits"] + 1
            numbers = (f"{test['right']:.{digits}f} | {test['wrong']:.{digits}f} | {_cell(test['difference'], digits)} "
                       f"| {test['p_value']:.3g}" if not test["reason"] else f"NaN | NaN | NaN | {test['reason']}")
            lines.append(f"| {name} | {result['metrics'][metric]['title']} | {numbers} |")
    clips = len(result["clips"])
    if 1 < clips < 5:
        lines += ["", f"With {clips} clips p cannot be below {1 / math.factorial(clips):.3g}: look at the differences, "
                      "or take more clips (or --piece)."]
    return [*lines, ""]


def _fgd_lines(result: Mapping[str, Any]) -> list[str]:
    """Is each distance of enough windows?"""
    lines = ["| FGD of | network (SHA-256) | window | windows of it / of the truth | needed | bias of the sample "
             "| enough? |", "|---|---|---|---|---|---|---|"]
    lines += [f"| {name} | {cell['features']} ({cell['sha256'][:12]}) | {cell['frames']} at {cell['fps']:g} fps "
              f"| {cell['windows'][0]} / {cell['windows'][1]} | {cell['needed']} | {_bias(cell['bias'])} "
              f"| {cell['verdict']} |"
              for name, row in result["rows"].items() if name != TRUTH for cell in row.values() if "sha256" in cell]
    return [*lines, "", "Bias of the sample: as far as two samples of this size of one motion are apart by chance, if "
            "windows were independent; those of one clip are not, so it is more.", ""]


def _bias(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "NaN"


def _flag_lines(result: Mapping[str, Any]) -> list[str]:
    if not result["controls"]:
        return ["No controls were measured, so nothing here says which metric can be trusted.", ""]
    told: dict[str, list[str]] = {}
    for flag in result["flags"]:
        told.setdefault(flag["metric"], []).append(f"*{flag['control']}* {flag['says']}")
    lines = [f"- {result['metrics'][metric]['title']}: {'. '.join(says)}." for metric, says in told.items()]
    return ["Metrics that a control beats:", "", *(lines or ["- none"]), ""]


def _reason_lines(result: Mapping[str, Any]) -> list[str]:
    rows_of: dict[tuple[str, str], list[str]] = {}
    for name, row in result["rows"].items():
        for metric, cell in row.items():
            if cell.get("reason") and "sha256" not in cell and cell["reason"] != NO_FLOOR:
                rows_of.setdefault((metric, cell["reason"]), []).append(name)
    told: dict[tuple[str, str], list[str]] = {}
    for (metric, reason), names in rows_of.items():
        told.setdefault((reason, "; ".join(names)), []).append(result["metrics"][metric]["title"])
    lines = [f"- {'; '.join(titles)} (rows: {names}): {reason}" for (reason, names), titles in told.items()]
    return ["Undefined:", "", *lines, ""] if lines else []


# --------------------------------------------------------------------------------------------------------- command

def networks_of(fgd_folder: Path | None, work: Path | None, truth: Path) -> dict[str, Features]:
    """What FGD is measured in, two window lengths at least: the papers' network (fgd_folder), our own that lie in work
    (trained there on the truth's training split where it is a store), and raw directions for lengths that lack."""
    found: list[Features] = [published(fgd_folder)] if fgd_folder else []
    if work is not None:
        own = sorted(file.parent for file in work.rglob("gesture_features.json"))
        if not own and (truth / "store.json").is_file():
            from eval.policies import networks

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
    for name in (TRUTH, FLOOR, STILL, *controls.CONTROLS):
        if name in systems:
            raise InputError(f"--system {name}", "is the name of a row of its own", "choose another")
    rates = {name: _positive(f"--fps {name}", value) for name, value in named(arguments.fps, "--fps").items()}
    unknown = sorted(set(rates) - {TRUTH, *systems})
    if unknown:
        raise InputError(f"--fps {unknown[0]}", "names no system", f"choose among {', '.join((TRUTH, *systems))}")
    places = {TRUTH: arguments.truth, **{name: Path(place) for name, place in systems.items()}}
    names, notes = shared({name: names_in(place, arguments.split) for name, place in places.items()})
    folders: dict[str, dict[str, Clip]] = {}
    for name, place in places.items():
        folders[name], said = read_folder(place, arguments.speech, rates.get(name), names, arguments.split)
        notes += [f"{name}: {one}" for one in said]
    unheard = [name for name in names if all(clips[name].speech is None for clips in folders.values())]
    if unheard and arguments.speech is not None:
        raise InputError(arguments.speech, f"has no sound for {_listed(unheard, 3)}",
                         "put a sound of that name there, or leave --speech out")
    return folders, notes


def _positive(what: str, value: str | float) -> float:
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not (np.isfinite(number) and number > 0):
        raise InputError(what, f"is {value}", "give a number over 0")
    return number


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser("eval score", description="Real, generated and foreign motion side by side.")
    p.add_argument("--truth", type=Path, required=True, metavar="DIR", help="the speakers' own motion, or a store")
    p.add_argument("--system", action="append", required=True, metavar="NAME=DIR", help="may be given many times")
    p.add_argument("--speech", type=Path, metavar="DIR", help="where the sounds lie (default: beside the motion)")
    p.add_argument("--fgd", type=Path, metavar="FOLDER", help="the Human3.6M network of the papers")
    p.add_argument("--work", type=Path, metavar="DIR", help="our own networks of gesture features are kept there")
    p.add_argument("--bundle", metavar="DIR", help="its lexicon measures diversity, motion variance and lexeme "
                   "accuracy, its judging model the reward ('shipped': the one that comes along)")
    p.add_argument("--split", default="test", choices=(*SPLITS, "all"),
                   help="what is compared of a store (default: test)")
    p.add_argument("--piece", metavar="SECONDS", help="cut long clips into pieces of this length")
    p.add_argument("--rate", metavar="FPS", help="frame rate to compare at (default: the lowest of all)")
    p.add_argument("--fps", action="append", default=[], metavar="NAME=RATE",
                   help="frame rate of a system's files, or truth=RATE, where they have none or a wrong one")
    p.add_argument("--no-controls", action="store_true", help="leave out the rows of motion that is known to be wrong")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--out", type=Path, metavar="FILE.json", help="a .md is written beside it")
    arguments = p.parse_args(argv)
    with one_line_errors("eval score"):
        result = run(arguments)
        tables = markdown(result)
        if arguments.out:
            keep(result, tables, arguments.out)
        print(tables, end="")
    return 0


def run(arguments: argparse.Namespace) -> dict[str, Any]:
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
    networks = networks_of(arguments.fgd, arguments.work, arguments.truth)
    ground = common_ground(folders, rate, piece)
    ground.notes[:0] = left_out
    return score(ground, networks, bundle, with_controls=not arguments.no_controls, seed=arguments.seed)


if __name__ == "__main__":
    sys.exit(main())
