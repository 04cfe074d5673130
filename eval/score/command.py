"""`gesticulator score`: real, generated and foreign motion side by side, on the same clips, with the controls.

    gesticulator score --truth DIR --system NAME=DIR ... [--speech DIR] [--fgd FOLDER] [--work DIR] [--bundle DIR]
                       [--units STORE] [--split test] [--piece SECONDS] [--fps NAME=RATE]
                       [--out results/score.json]

Every DIR holds motion by clip (see `eval.clip.foreign` for what can be read), or is a store, of which one split counts,
or a bundle, which is played for the sounds of the truth; clips are matched by their names, only those that all have are
read, and what does not match is named. All motion is brought onto the 16-joint character, to the lowest frame rate
among them and, clip by clip, to the shortest length. Each figure is a mean over clips with its bootstrap 95
% interval, or of the set of clips, with the basic bootstrap's; systems are compared in pairs over the same clips.
`eval.metrics.METRICS` lists the figures.

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
from functools import cached_property
from pathlib import Path

import numpy as np

from data_module.blocks import cut
from data_module.errors import InputError
from data_module.store import SPLITS, Store
from data_module.types import Array, Blocks, Motion
from eval import stats
from eval.baselines import controls as baselines
from eval.baselines.unit_selection import NAME as UNITS
from eval.clip.clip_set import TRUTH, ClipSet, common_clips, listed, shared_names
from eval.clip.foreign import Clip, named, names_in, read_folder
from eval.context import EvalContext, provenance
from eval.metrics import CLIP_METRICS, EYE_METRICS, METRICS, SET_METRICS, Metric, eye, fgd
from eval.metrics.diversity import diversity, motion_variance
from eval.metrics.encode import EncodedMotion, encode_motion
from eval.metrics.evaluate import (
    ACCURACY,
    MOTION_METRICS,
    SYNCHRONY,
    MotionBeats,
    OnsetTrack,
    Values,
    clip_values,
    eye_values,
    lexeme_values,
    synchrony,
)
from eval.metrics.gesture_features import pooled, spaces
from eval.metrics.mismatch import Mismatch, matrix, mismatch
from eval.metrics.smoothness import hand_speeds, hellinger, speed_histogram
from eval.score.played_rows import PlayedBundle, group_table, sounds_of, unit_selection_row
from eval.score.tables import BOBBING, FLOOR, NO_FLOOR, STILL, Figures, Flag, Scores, tables
from eval.stats import Indices, Interval
from eval.table import Marked, Table, publish
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import bundle_folder

MOST = 60
"""Clips of a mismatch test at most, evenly chosen: it tries all pairs."""
SAME = (1e-9, 1e-4)
"""Figures that differ by less, absolutely or relatively, are equal: rounding of files and of sums leaves as much."""


# ------------------------------------------------------------------------------------------------------------ rows

@dataclass
class ScoreRow:
    """A set of motions and what was measured. kind: "truth", "system" or "control".

    values: metric -> [clips]; sets: metric -> a figure of the clips with these numbers; features: network -> [n, E] by
    clip; reasons: metric -> why its figure is undefined.
    """

    name: str
    kind: str
    motions: list[Motion]
    beats: list[MotionBeats]
    values: dict[str, Array] = field(default_factory=dict)
    sets: dict[str, Callable[[Indices], float]] = field(default_factory=dict)
    features: dict[str, list[Array]] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ScoredClips:
    """The clips that all rows share, heard once. context: networks, seed and the bundle whose lexicon reads motion,
    if any; blocks: of each clip's speech as the bundle cuts it, None without the one or the other; truth: the speakers'
    own motion in them."""

    context: EvalContext
    clips: ClipSet
    tracks: list[OnsetTrack | None]
    voices: list[eye.VoiceActivity | None]
    blocks: list[Blocks | None]

    @classmethod
    def of(cls, context: EvalContext, clips: ClipSet) -> ScoredClips:
        """Each speech is heard and cut once for all rows."""
        bundle = context.models
        return cls(context, clips, *(list(each) for each in zip(*((
            None if speech is None else OnsetTrack.of(speech), None if speech is None else eye.hear(speech),
            None if speech is None or bundle is None else cut(speech, bundle.config.rhythm))
            for speech in clips.speeches), strict=True)))

    @cached_property
    def truth(self) -> list[EncodedMotion | None]:
        """The speakers' own motion as the bundle reads it."""
        return self.encoded(self.clips.motions[TRUTH])

    def encoded(self, motions: Sequence[Motion]) -> list[EncodedMotion | None]:
        """Motions of all clips as the bundle reads them; None where nothing is said."""
        return [None if speech is None or blocks is None else
                encode_motion(self.context.bundle, motion, blocks, speech.speaker or "")
                for motion, speech, blocks in zip(motions, self.clips.speeches, self.blocks, strict=True)]

    def row(self, name: str, kind: str, motions: list[Motion]) -> ScoreRow:
        """Everything about one set of motions."""
        row = ScoreRow(name, kind, motions, [MotionBeats.of(motion) for motion in motions])
        speakers = self.clips.motions[TRUTH]
        truth = baselines.to_common_length(motions, speakers)[1]
        _put(row, MOTION_METRICS, [
            clip_values(motion, second, beats, track, self.context.seed + k) for k, (motion, second, beats, track)
            in enumerate(zip(motions, truth, row.beats, self.tracks, strict=True))])
        _put(row, tuple(EYE_METRICS), [
            eye_values(motion, voice, None if blocks is None else blocks.edges, self.context.space)
            for motion, voice, blocks in zip(motions, self.voices, self.blocks, strict=True)])
        row.features = {key: pooled(motions, network) for key, network in self.context.networks.items()}
        first, second = (np.array([speed_histogram(hand_speeds(motion)) for motion in clips])
                        for clips in (motions, speakers))
        row.sets["speed_distance"] = lambda chosen: hellinger(first[chosen].sum(0), second[chosen].sum(0))
        # Last, as it is the only part that may have no lexicon to measure with.
        self._lexemes(row)
        return row

    def _lexemes(self, row: ScoreRow) -> None:
        """Measure the lexemes nearest to a row's blocks, if there is a lexicon."""
        of_sets = ("diversity", "motion_variance")
        bundle = self.context.models
        if bundle is None:
            row.values[ACCURACY] = np.full(len(row.motions), np.nan)
            row.reasons |= dict.fromkeys((*of_sets, ACCURACY), "no lexicon was given (--bundle)")
            return
        encoded = self.encoded(row.motions)
        _put(row, (ACCURACY,), [lexeme_values(*pair) for pair in zip(encoded, self.truth, strict=True)])
        if not any(encoded):
            row.reasons |= dict.fromkeys(of_sets, "no speech is known")
            return
        vectors = bundle.lexicon.vectors.double().numpy()
        # Blocks are redrawn with their clips, so each figure is of the drawn clips' blocks together.
        latents = [None if motion is None else motion.latents.double().numpy() for motion in encoded]
        labels = [np.zeros(0, dtype=np.int64) if motion is None else motion.labels for motion in encoded]

        def of_clips(values: Sequence[Array | None], chosen: Indices) -> Array:
            return np.concatenate([part for k in chosen if (part := values[k]) is not None] or [vectors[:0]])

        row.sets["diversity"] = lambda chosen: diversity(np.concatenate([labels[k] for k in chosen]), len(vectors))
        row.sets["motion_variance"] = lambda chosen: motion_variance(
            of_clips(latents, chosen), np.concatenate([labels[k] for k in chosen]), vectors)


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
    # A control that cannot be made leaves a note and not a gap: its silence would look like a pass.
    controls = {STILL: baselines.mean_pose(truth)}
    groups: list[str] | None = clips.groups
    try:
        baselines.donors(truth, seed, groups)
    except ValueError:
        groups = None
        notes.append("clips of one sound could not be kept apart in the shuffled row and the halves: too few groups")
    for name, make in baselines.CONTROLS.items():
        try:
            controls[name] = (baselines.shuffled(truth, seed, groups) if name == "shuffled" else make(truth, seed))
        except ValueError as error:
            notes.append(f"no row {name}: {error}")
    if any(voices):
        controls[BOBBING] = baselines.bobbing(truth, [np.zeros(0) if voice is None else voice.onsets[0]
                                                  for voice in voices])
    return controls, notes


# --------------------------------------------------------------------------------------------------------- figures

def row_figures(row: ScoreRow, truth: ScoreRow, context: EvalContext
                ) -> tuple[dict[str, Marked], dict[str, fgd.Figure]]:
    """Every metric of a row, and the distances by network."""
    out: dict[str, Interval] = {name: stats.mean_interval(values, seed=context.seed)
                                for name, values in row.values.items()}
    for name in SET_METRICS:
        # A distance is never negative; the basic bootstrap's bounds may be.
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
    doubt = not sure and math.isfinite(figure.distance) and figure.verdict.startswith("no")
    reason = "" if math.isfinite(figure.distance) else f"{min(figure.windows)} windows in a set, and 2 are needed"
    return Marked(figure.interval, "(?)" if doubt else "", reason)


def floor_figures(truth: ScoreRow, shared: ScoredClips) -> tuple[dict[str, Marked], dict[str, fgd.Figure]]:
    """Distances between two halves of the truth; what is no distance between sets has none."""
    context = shared.context
    out = {name: Marked(Interval.undefined(), reason=NO_FLOOR) for name in (*CLIP_METRICS, *EYE_METRICS, *SET_METRICS)}
    # Halves come back as motions; their numbers are wanted, since features were computed once for all.
    place = {id(motion): k for k, motion in enumerate(truth.motions)}
    groups = shared.clips.groups if len(set(shared.clips.groups)) > 1 else None
    try:
        both = baselines.split_halves(truth.motions, context.seed, groups)
    except ValueError as error:
        return out | {key: Marked(Interval.undefined(), reason=str(error))
                      for key in ("speed_distance", *context.networks)}, {}
    halves = [[place[id(motion)] for motion in half] for half in both]
    counts = [np.sum([speed_histogram(hand_speeds(truth.motions[k])) for k in half], axis=0) for half in halves]
    # Histograms are summed before they are compared: a mean of clips' distances is another figure.
    out["speed_distance"] = Marked(Interval.exact(hellinger(counts[0], counts[1]), min(map(len, halves))))
    distances = {}
    for key, network in context.networks.items():
        first, second = ([truth.features[key][k] for k in half] for half in halves)
        distances[key] = fgd.measure(first, second, network, seed=context.seed)
    return out | {key: fgd_cell(figure) for key, figure in distances.items()}, distances


def differences(first: ScoreRow, second: ScoreRow, truth: ScoreRow, context: EvalContext) -> dict[str, Marked]:
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


def mismatches(rows: Sequence[ScoreRow], shared: ScoredClips) -> dict[str, dict[str, Mismatch]]:
    """The mismatch test of each row by each metric of synchrony."""
    known = [k for k, track in enumerate(shared.tracks) if track is not None]
    # All pairs of n clips are n squared tests, so a large set is thinned evenly.
    few = [known[k] for k in np.unique(np.linspace(0, len(known) - 1, min(MOST, len(known))).round().astype(int))]
    tracks = [track for k in few if (track := shared.tracks[k]) is not None]

    def tried(name: str, beats: Sequence[MotionBeats]) -> Array:
        return matrix(lambda i, j: synchrony(name, beats[i], tracks[j]), len(beats))

    return {row.name: {name: mismatch(tried(name, [row.beats[k] for k in few]), seed=shared.context.seed)
                       for name in SYNCHRONY} for row in rows}


# ----------------------------------------------------------------------------------------------------------- flags

def flags(rows: Mapping[str, ScoreRow], figures: Figures, metrics: Mapping[str, Metric], seed: int) -> list[Flag]:
    """Which control beats what, by which metric.

    A control beats a system when its value is the better one, by more than rounding; the truth when it is as good or
    better by a metric where more is better; the floor when a distance between sets is no larger. It does not differ
    from the truth when the paired interval of their difference holds 0. A control that is as good as a system is listed
    too: a known fault does no worse.
    """
    listed_flags = []
    systems = [row.name for row in rows.values() if row.kind == "system"]
    for name, metric in metrics.items():
        for control in (row for row in rows.values() if row.kind == "control"):
            says = _against_truth(name, metric, control, rows[TRUTH], figures, seed)
            badness = _badness(metric, figures, name, control.name)
            # "Beats" and "as good as" apart from rounding: files hold six digits.
            theirs = {system: _badness(metric, figures, name, system) for system in systems}
            beaten = [system for system, value in theirs.items() if _below(badness, value)]
            alike = [system for system, value in theirs.items() if math.isfinite(badness) and math.isfinite(value)
                     and not _below(badness, value) and not _below(value, badness)]
            says += [f"beats {', '.join(beaten)}"] if beaten else []
            says += [f"is as good as {', '.join(alike)}"] if alike else []
            if says and metric.good:
                listed_flags.append(Flag(name, control.name, "; ".join(says)))
    return listed_flags


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
    control_value, truth_value = mean_of(figures, control.name, name), mean_of(figures, TRUTH, name)
    if not (math.isfinite(control_value) and math.isfinite(truth_value)):
        return []
    if metric.good == "low":
        floor = mean_of(figures, FLOOR, name)
        if control_value > floor:
            return []
        return [f"is no farther than half of the truth from the other ({control_value:.3g}, {floor:.3g})"]
    if metric.good == "high" and control_value >= truth_value:
        return [f"beats the truth ({control_value:.3g}, {truth_value:.3g})"]
    apart = (stats.paired(control.values[name], truth.values[name], seed=seed) if name in control.values
             else stats.of_set(_less(control.sets[name], truth.sets[name]), len(truth.motions), seed=seed))
    if apart.low <= 0.0 <= apart.high or control_value == truth_value:
        return [f"does not differ from the truth ({control_value:.3g}, {truth_value:.3g})"]
    return []


def score(context: EvalContext, clips: ClipSet) -> Scores:
    """Measure all rows on the same clips."""
    shared, seed = ScoredClips.of(context, clips), context.seed
    controls, notes = control_rows(clips, seed, shared.voices)
    rows = {name: shared.row(name, TRUTH if name == TRUTH else "system", motions)
            for name, motions in clips.motions.items()}
    rows |= {name: shared.row(name, "control", motions) for name, motions in controls.items()}
    both = {name: row_figures(row, rows[TRUTH], context) for name, row in rows.items()}
    both[FLOOR] = floor_figures(rows[TRUTH], shared)
    figures = {name: pair[0] for name, pair in both.items()}
    distances = {name: pair[1] for name, pair in both.items()}
    metrics = {**CLIP_METRICS, **EYE_METRICS, **SET_METRICS,
               **{key: replace(METRICS["fgd"], title=f"FGD, {key}") for key in context.networks}}
    systems = [row for row in rows.values() if row.kind == "system"]
    # Differences are of systems alone: what a control differs by is said by its flags.
    return Scores(
        clips.names, round(clips.seconds, 2), clips.fps, metrics,
        {name: rows[name].kind if name in rows else "floor" for name in both}, figures,
        {f"{a.name} - {b.name}": differences(a, b, rows[TRUTH], context)
         for a, b in itertools.combinations(systems, 2)},
        distances, mismatches(list(rows.values()), shared),
        flags(rows, figures, metrics, seed), [*clips.notes, *notes])


# --------------------------------------------------------------------------------------------------------- command

def read_all(arguments: argparse.Namespace) -> tuple[dict[str, dict[str, Clip]], list[str]]:
    """The clips of truth and systems, and what was left out of their folders."""
    systems = named(arguments.system, "--system")
    for name in (TRUTH, FLOOR, STILL, BOBBING, UNITS, *baselines.CONTROLS):
        if name in systems:
            raise InputError(f"--system {name}", "is the name of a row of its own", "choose another")
    # Files may state no frame rate or a wrong one; a bundle knows its own.
    rates = {name: _positive(f"--fps {name}", value) for name, value in named(arguments.fps, "--fps").items()}
    unknown = sorted(set(rates) - {TRUTH, *systems})
    if unknown:
        raise InputError(f"--fps {unknown[0]}", "names no system", f"choose among {', '.join((TRUTH, *systems))}")
    bundles = {name: bundle for name, place in systems.items() if (bundle := PlayedBundle.named(place))}
    for name in sorted(set(rates) & set(bundles)):
        raise InputError(f"--fps {name}", "is for motion files, and a bundle is played at its own rate", "leave it out")
    places = {TRUTH: arguments.truth,
              **{name: Path(place) for name, place in systems.items() if name not in bundles}}
    names, notes = shared_names({name: names_in(place, arguments.split) for name, place in places.items()})
    folders: dict[str, dict[str, Clip]] = {}
    for name, place in places.items():
        folders[name], left_out = read_folder(place, arguments.speech, rates.get(name), names, arguments.split)
        notes += [f"{name}: {reason}" for reason in left_out]
    folders |= {name: bundle.row(folders[TRUTH], arguments.seed) for name, bundle in bundles.items()}
    # A folder of sounds was named, so a clip without one is a mistake of names and not a choice.
    silent = [name for name in names if all(clips[name].speech is None for clips in folders.values())]
    if silent and arguments.speech is not None:
        raise InputError(arguments.speech, f"has no sound for {listed(silent, 3)}",
                         "put a sound of that name there, or leave --speech out")
    return folders, notes


def _positive(what: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not (np.isfinite(number) and number > 0):
        raise InputError(what, f"is {value}", "give a number over 0")
    return number


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator score`."""
    add = parser.add_argument
    add("--truth", type=Path, metavar="DIR", help="the speakers' own motion, or a store")
    add("--group", action="store_true",
        help="without --truth: synchrony of bundles on the sounds of --speech, by the part of a file's name before its "
        "first '_', such as LANGUAGE in LANGUAGE_VOICE.flac")
    add("--system", action="append", required=True, metavar="NAME=DIR",
        help="motion files, or a bundle (a folder, default or paper) that is run on the audio of the truth, "
        "NAME=BUNDLE:INTERPRETER; can be repeated")
    add("--speech", type=Path, metavar="DIR", help="folder of the audio (default: beside the motion)")
    add("--fgd", type=Path, metavar="FOLDER", help="folder of the Human3.6M network of the papers")
    add("--work", type=Path, metavar="DIR",
        help="work folder, which keeps the units of --units")
    add("--bundle", metavar="DIR",
        help="bundle whose lexicon measures diversity, motion variance and lexeme accuracy")
    add("--split", default="test", choices=(*SPLITS, "all"), help="split of the store to compare (default: test)")
    add("--piece", metavar="SECONDS", help="cut long clips into pieces of this length")
    add("--fps", action="append", default=[], metavar="NAME=RATE",
        help="frame rate of a system's files, or truth=RATE, if they state none or a wrong one")
    add("--units", metavar="STORE",
        help="add unit selection from this store's training split, the baseline that a system has to beat")
    add("--seed", type=int, default=0)
    add("--out", type=Path, metavar="FILE.json", help="output file; a .md is written beside it")


def scored(arguments: argparse.Namespace) -> Scores:
    """All figures of the command; InputError for input that cannot be used."""
    if arguments.truth is None:
        raise InputError("--truth", "is missing", "name a folder of motion or a store, or compare by --group")
    piece = None if arguments.piece is None else _positive("--piece", arguments.piece)
    bundle = None
    if arguments.bundle:
        bundle = bundles.load(bundle_folder(arguments.bundle))
        # A bundle of RACER's own codec has no lexicon of the kind that these figures are of.
        _ = bundle.block_lexicon
    folders, left_out = read_all(arguments)
    if arguments.units:
        folders[UNITS] = unit_selection_row(folders[TRUTH], Store.open(arguments.units), arguments.work, arguments.seed)
    clips = common_clips(folders, piece=piece)
    clips.notes[:0] = left_out
    context = EvalContext(models=bundle, networks=spaces(arguments.fgd), seed=arguments.seed)
    return score(context, clips)


def run(arguments: argparse.Namespace) -> int:
    """Measure, write and show."""
    measured = [by_group(arguments)] if arguments.group else tables(scored(arguments))
    publish(measured, arguments.out, provenance(arguments))
    return 0


def by_group(arguments: argparse.Namespace) -> Table:
    """The table of `--group`; InputError for options that do not go with it."""
    if arguments.truth is not None or arguments.speech is None:
        raise InputError("--group", "compares sounds and no motion of speakers",
                         "give --speech FOLDER and leave --truth out")
    systems = {}
    for name, place in named(arguments.system, "--system").items():
        bundle = PlayedBundle.named(place)
        if bundle is None:
            raise InputError(f"--system {name}", f"{place} holds no bundle", "give default, paper or a folder")
        systems[name] = bundle
    return group_table(sounds_of(arguments.speech), systems, arguments.seed)
