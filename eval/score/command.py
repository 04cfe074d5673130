"""`gesticulator score`: real, generated and foreign motion side by side, on the same clips, with the controls.

    gesticulator score --truth DIR --system NAME=DIR ... [--speech DIR] [--fgd FOLDER] [--bundle DIR] [--split test]
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

What fools a table as a whole: few clips, whose intervals are too narrow, and the many columns: of twenty, one is beyond
its 95 % by chance.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from data_module.blocks import cut
from data_module.errors import InputError
from data_module.store import SPLITS
from data_module.types import Array, Blocks, Motion
from eval import stats
from eval.baselines import controls as baselines
from eval.clip.clip_set import TRUTH, ClipSet, common_clips, listed, shared_names
from eval.clip.foreign import Clip, named, names_in, read_folder
from eval.context import EvalContext, provenance
from eval.metrics import CLIP_METRICS, EYE_METRICS, METRICS, SET_METRICS, Metric, evaluate, eye, fgd
from eval.metrics.diversity import diversity, motion_variance
from eval.metrics.encode import EncodedMotion, encode_motion
from eval.metrics.gesture_features import pooled, spaces
from eval.metrics.smoothness import hand_speeds, hellinger, speed_histogram
from eval.score.played_rows import PlayedBundle
from eval.score.ratings import FEWEST, ratings_table, read_ratings
from eval.score.tables import BOBBING, FLOOR, STILL, Figures, Flag, ScoreRow, Scores, screen, tables
from eval.stats import Indices, Interval
from eval.table import Marked, save
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import bundle_folder

SAME = (1e-9, 1e-4)
"""Figures that differ by less, absolutely or relatively, are equal: rounding of files and of sums leaves as much."""


# ------------------------------------------------------------------------------------------------------------ rows


@dataclass(frozen=True)
class ScoredClips:
    """The clips that all rows share, heard once. context: networks, seed and the bundle whose lexicon reads motion,
    if any; blocks: of each clip's speech as the bundle cuts it, None without the one or the other; truth: the speakers'
    own motion in them."""

    context: EvalContext
    clips: ClipSet
    tracks: list[evaluate.OnsetTrack | None]
    voices: list[eye.VoiceActivity | None]
    blocks: list[Blocks | None]

    @classmethod
    def of(cls, context: EvalContext, clips: ClipSet) -> ScoredClips:
        """Each speech is heard and cut once for all rows."""
        bundle = context.models
        # A clip without speech keeps its place: all lists go by the same numbers.
        return cls(context, clips, *(list(each) for each in zip(*((
            None if speech is None else evaluate.OnsetTrack.of(speech), None if speech is None else eye.hear(speech),
            None if speech is None or bundle is None else cut(speech, bundle.config.rhythm))
            for speech in clips.speeches), strict=True)))

    @cached_property
    def truth(self) -> list[EncodedMotion | None]:
        """The speakers' own motion as the bundle reads it."""
        return self.encoded(self.clips.motions[TRUTH])

    @cached_property
    def features(self) -> dict[str, list[Array]]:
        """network -> [n, E] by clip of the speakers' own motion."""
        return {key: pooled(self.clips.motions[TRUTH], network) for key, network in self.context.networks.items()}

    def encoded(self, motions: Sequence[Motion]) -> list[EncodedMotion | None]:
        """Motions of all clips as the bundle reads them; None where nothing is said."""
        return [None if speech is None or blocks is None else
                encode_motion(self.context.bundle, motion, blocks, speech.speaker or "")
                for motion, speech, blocks in zip(motions, self.clips.speeches, self.blocks, strict=True)]

    def row(self, name: str, kind: str, motions: list[Motion]) -> ScoreRow:
        """Everything about one set of motions."""
        row = ScoreRow(name, kind, motions, [evaluate.MotionBeats.of(motion) for motion in motions])
        speakers = self.clips.motions[TRUTH]
        truth = [speaker.crop(0, len(motion)) for motion, speaker in zip(motions, speakers, strict=True)]
        # Each clip with a seed of its own: equal draws of chance would tie the clips to each other.
        seeds = range(self.context.seed, self.context.seed + len(motions))
        _put(row, evaluate.MOTION_METRICS, list(map(
            evaluate.clip_values, motions, truth, row.beats, self.tracks, seeds)))
        _put(row, tuple(EYE_METRICS), [
            evaluate.eye_values(motion, voice, None if blocks is None else blocks.edges)
            for motion, voice, blocks in zip(motions, self.voices, self.blocks, strict=True)])
        row.features = {key: pooled(motions, network) for key, network in self.context.networks.items()}
        row.sets |= {key: fgd.of_chosen(row.features[key], real) for key, real in self.features.items()}
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
            row.values[evaluate.ACCURACY] = np.full(len(row.motions), np.nan)
            row.reasons |= dict.fromkeys((*of_sets, evaluate.ACCURACY), "no lexicon was given (--bundle)")
            return
        encoded = self.encoded(row.motions)
        _put(row, (evaluate.ACCURACY,), list(map(evaluate.lexeme_values, encoded, self.truth)))
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


def _put(row: ScoreRow, metrics: Sequence[str], every: Sequence[evaluate.Values]) -> None:
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
    for name, make in baselines.CONTROLS.items():
        try:
            controls[name] = make(truth, clips.groups, seed)
        except ValueError as error:
            notes.append(f"no row {name}: {error}")
    if any(voices):
        controls[BOBBING] = baselines.bobbing(truth, [np.zeros(0) if voice is None else voice.onsets[0]
                                                  for voice in voices])
    return controls, notes


# --------------------------------------------------------------------------------------------------------- figures

def row_figures(row: ScoreRow, truth: ScoreRow, context: EvalContext) -> dict[str, Marked]:
    """Every metric of a row, FGD by network."""
    out: dict[str, Interval] = {name: stats.mean_interval(values, seed=context.seed)
                                for name, values in row.values.items()}
    for name in SET_METRICS:
        # A distance is never negative; the basic bootstrap's bounds may be.
        least = 0.0 if name == "speed_distance" else -math.inf
        out[name] = (stats.of_set(row.sets[name], len(row.motions), seed=context.seed, least=least)
                     if name in row.sets else Interval.undefined())
    figures = {name: Marked(value, reason=row.reasons.get(name, "" if math.isfinite(value.mean) else
                                                          f"{name} is not defined for these clips"))
               for name, value in out.items()}
    return figures | {key: fgd_cell(fgd.measure(row.features[key], truth.features[key], paired=True,
                                                seed=context.seed), row.kind == TRUTH) for key in context.networks}


def fgd_cell(figure: fgd.Figure, sure: bool = False) -> Marked:
    """A distance; (?) and why, where the sample is too small for it. sure: of the truth against itself."""
    doubt = "" if sure else figure.doubt
    return Marked(figure.interval, "(?)" if doubt else "", doubt)


def floor_figures(truth: ScoreRow, shared: ScoredClips) -> dict[str, Marked]:
    """Distances between two halves of the truth; what is no distance between sets has none."""
    context = shared.context
    try:
        halves = baselines.split_halves(truth.motions, shared.clips.groups, context.seed)
    except ValueError as error:
        return dict.fromkeys(("speed_distance", *context.networks), Marked(Interval.undefined(), reason=str(error)))
    counts = [np.sum([speed_histogram(hand_speeds(truth.motions[k])) for k in half], axis=0) for half in halves]
    # Histograms are summed before they are compared: a mean of clips' distances is another figure.
    out = {"speed_distance": Marked(Interval.exact(hellinger(counts[0], counts[1]), min(map(len, halves))))}
    for key in context.networks:
        first, second = ([truth.features[key][k] for k in half] for half in halves)
        out[key] = fgd_cell(fgd.measure(first, second, seed=context.seed))
    return out


def differences(first: ScoreRow, second: ScoreRow, context: EvalContext) -> dict[str, Marked]:
    """First less second, paired over clips, with intervals."""
    out = {name: stats.paired(first.values[name], second.values[name], seed=context.seed)
           for name in (*CLIP_METRICS, *EYE_METRICS)}
    for name, figure in first.sets.items():
        out[name] = stats.of_set(lambda chosen, one=figure, other=second.sets[name]: one(chosen) - other(chosen),
                                 len(first.motions), seed=context.seed)
    return {name: Marked(value) for name, value in out.items()}


# ----------------------------------------------------------------------------------------------------------- flags

def flags(kinds: Mapping[str, str], figures: Figures, metrics: Mapping[str, Metric]) -> list[Flag]:
    """Which control does no worse than what, by which metric: than a system, than the truth by a metric where more is
    better, or than the floor of a distance between sets."""
    found = []
    for name, metric in metrics.items():
        rivals = [row for row, kind in kinds.items() if kind == "system" or (
            # What is near the truth's cannot be nearer than the truth, and nothing is farther from itself.
            row == {"high": TRUTH, "low": FLOOR}.get(metric.good))]
        for control in (row for row, kind in kinds.items() if kind == "control" and metric.good):
            badness = _badness(metric, figures, name, control)
            beaten = [row for row in rivals if not_worse(badness, _badness(metric, figures, name, row))]
            if beaten:
                found.append(Flag(name, control, beaten))
    return found


def mean_of(figures: Figures, row: str, metric: str) -> float:
    """A figure without its interval; NaN where it is not there."""
    cell = figures.get(row, {}).get(metric)
    return cell.value.mean if cell is not None and isinstance(cell.value, Interval) else math.nan


def not_worse(control: float, system: float) -> bool:
    """True if a control's badness is no larger than a system's, but for rounding; False for what is undefined."""
    # Files hold six digits.
    return control <= system + SAME[0] + SAME[1] * max(abs(control), abs(system))


def _badness(metric: Metric, figures: Figures, name: str, row: str) -> float:
    value = mean_of(figures, row, name)
    if metric.good == "near":
        return abs(value - mean_of(figures, TRUTH, name))
    return -value if metric.good == "high" else value


def score(context: EvalContext, clips: ClipSet, ratings: Mapping[str, float] | None = None) -> Scores:
    """Measure all rows on the same clips. ratings: people's, of systems and truth, three systems or more."""
    shared, seed = ScoredClips.of(context, clips), context.seed
    controls, notes = control_rows(clips, seed, shared.voices)
    rows = {name: shared.row(name, TRUTH if name == TRUTH else "system", motions)
            for name, motions in clips.motions.items()}
    rows |= {name: shared.row(name, "control", motions) for name, motions in controls.items()}
    figures = {name: row_figures(row, rows[TRUTH], context) for name, row in rows.items()}
    figures[FLOOR] = floor_figures(rows[TRUTH], shared)
    metrics = {**CLIP_METRICS, **EYE_METRICS, **SET_METRICS,
               **{key: replace(METRICS["fgd"], title=f"FGD, {key}") for key in context.networks}}
    systems = [row for row in rows.values() if row.kind == "system"]
    kinds = {**{name: row.kind for name, row in rows.items()}, FLOOR: "floor"}
    found = flags(kinds, figures, metrics)
    # Differences are of systems alone: what a control differs by is said by its flags.
    return Scores(
        clips.names, round(clips.seconds, 2), clips.fps, metrics,
        kinds, figures,
        {f"{a.name} - {b.name}": differences(a, b, context)
         for a, b in itertools.combinations(systems, 2)},
        found, [*clips.notes, *notes], ratings_table(systems, rows[TRUTH], ratings, metrics, found, seed) if ratings
        else None)


# --------------------------------------------------------------------------------------------------------- command

def read_all(arguments: argparse.Namespace) -> tuple[dict[str, dict[str, Clip]], list[str]]:
    """The clips of truth and systems, and what was left out of their folders."""
    systems = named(arguments.system, "--system")
    for name in (TRUTH, FLOOR, STILL, BOBBING, *baselines.CONTROLS):
        if name in systems:
            raise InputError(f"--system {name}", "is the name of a row of its own", "choose another")
    bundles = {name: bundle for name, place in systems.items() if (bundle := PlayedBundle.named(place))}
    places = {TRUTH: arguments.truth,
              **{name: Path(place) for name, place in systems.items() if name not in bundles}}
    # Names before contents: thousands of files are not read for the few that all have.
    names, notes = shared_names({name: names_in(place, arguments.split) for name, place in places.items()})
    folders: dict[str, dict[str, Clip]] = {}
    for name, place in places.items():
        folders[name], left_out = read_folder(place, arguments.speech, names, arguments.split)
        notes += [f"{name}: {reason}" for reason in left_out]
    folders |= {name: bundle.row(folders[TRUTH], arguments.seed) for name, bundle in bundles.items()}
    # A folder of sounds was named, so a clip without one is a mistake of names and not a choice.
    silent = [name for name in names if all(clips[name].speech is None for clips in folders.values())]
    if silent and arguments.speech is not None:
        raise InputError(arguments.speech, f"has no sound for {listed(silent, 3)}",
                         "put a sound of that name there, or leave --speech out")
    return folders, notes


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator score`."""
    add = parser.add_argument
    add("--truth", type=Path, required=True, metavar="DIR", help="the speakers' own motion, or a store")
    add("--system", action="append", required=True, metavar="NAME=DIR",
        help="motion files, or a bundle (a folder, default or paper) that is run on the audio of the truth, "
        "NAME=BUNDLE:INTERPRETER; can be repeated")
    add("--speech", type=Path, metavar="DIR", help="folder of the audio (default: beside the motion)")
    add("--fgd", type=Path, metavar="FOLDER", help="folder of the Human3.6M network of the papers")
    add("--bundle", metavar="DIR",
        help="bundle whose lexicon measures diversity, motion variance and lexeme accuracy")
    add("--split", default="test", choices=(*SPLITS, "all"), help="split of the store to compare (default: test)")
    add("--ratings", type=Path, metavar="FILE.json",
        help='people\'s ratings, {"NAME": NUMBER}, by the names of the systems and of the folder of --truth: shows how '
        "each metric agrees with them")
    add("--seed", type=int, default=0)
    add("--out", type=Path, metavar="FILE.json", help="output file; a .md is written beside it")


def scored(arguments: argparse.Namespace) -> Scores:
    """All figures of the command; InputError for input that cannot be used."""
    ratings, unrated = known_ratings(arguments) if arguments.ratings else (None, [])
    bundle = None
    if arguments.bundle:
        bundle = bundles.load(bundle_folder(arguments.bundle))
        # A bundle of RACER's own codec has no lexicon of the kind that these figures are of.
        _ = bundle.block_lexicon
    folders, left_out = read_all(arguments)
    clips = common_clips(folders)
    clips.notes[:0] = [*unrated, *left_out]
    context = EvalContext(models=bundle, networks=spaces(arguments.fgd), seed=arguments.seed)
    return score(context, clips, ratings)


def known_ratings(arguments: argparse.Namespace) -> tuple[dict[str, float], list[str]]:
    """The ratings of the rows, the person's under the truth's name, and notes on names that are no row; InputError for
    fewer than three systems."""
    ratings, systems = read_ratings(arguments.ratings), named(arguments.system, "--system")
    person = arguments.truth.absolute().name
    if person in ratings and person not in systems:
        ratings[TRUTH] = ratings.pop(person)
    few, strange = len(set(systems) & set(ratings)), listed(sorted(set(ratings) - {TRUTH, *systems}), 5)
    if few < FEWEST:
        raise InputError(arguments.ratings, f"rates {few} of the systems", f"a tau needs {FEWEST}: give ratings by the "
                         "names of --system")
    return ({name: rating for name, rating in ratings.items() if name in (TRUTH, *systems)},
            [f"{arguments.ratings}: {strange} is no row"] if strange else [])


def run(arguments: argparse.Namespace) -> int:
    """Measure, write all, and show what matters most."""
    scores = scored(arguments)
    if arguments.out:
        save(tables(scores), arguments.out, provenance(arguments))
    print(screen(scores, arguments.out), end="")
    return 0
