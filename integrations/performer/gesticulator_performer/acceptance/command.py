"""Is a built corpus good enough to learn from? `gesticulator probe corpus --data STORE [--talks 32]`

Its talks against bounds of human likeness (`bounds`), every source by itself (`by_source`), its styles against what can
be heard (`style_from_sound`), and what a scripted performance did with its plan (`planned_strokes`). Everything is
measured on the finished motion and sound; from the truth come only where the corpus was put together, where rest is
meant, what style was asked for and what was planned.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from data_module.errors import InputError
from data_module.motion.skeletons import FINGERED
from data_module.store import Recording, RecordingInfo, Store
from data_module.truth import REST, SCRIPTED
from data_module.types import Array
from eval.acceptance.bounds import SHOWN
from eval.metrics.eye import common_body
from eval.stats import Interval, mean_interval
from eval.table import Cell, Column, Table
from gesticulator_performer.acceptance import bounds as corpus_bounds
from gesticulator_performer.acceptance import by_source, planned_strokes, style_from_sound
from gesticulator_performer.acceptance.bounds import POOLED, STYLE_CLAIMS, MeasuredTalk, TalksVerdict
from gesticulator_performer.acceptance.planned_strokes import TOLERANCE
from gesticulator_performer.acceptance.style_from_sound import StyledWindows

FEWEST = 20
"""Talks of A and B together that a verdict should stand on."""
_LETTERS = {"motion": "A, motion", "talk": "B, talk", "style": "C, style", "reading": "readings"}
_SHIFT = 7.3
"""Seconds that plans are shifted by for the level of chance."""


@dataclass(frozen=True)
class PlayedPlan:
    """Of one recording with strokes: seconds that its beats miss their plan by, the same of the shifted plan, gains and
    what is heard of them, and the clips in order."""

    split: str
    misses: Array
    shifted: Array
    gains: Array
    features: Array
    clips: tuple[str, ...]


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, and how much of it."""
    parser.add_argument("--data", required=True, metavar="STORE", help="a store built by `gesticulator build`")
    parser.add_argument("--talks", type=int, metavar="N",
                        help="number of talks per part, evenly chosen (default: all; styles always use all)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Measure a store; InputError for one that cannot be."""
    if arguments.talks is not None and arguments.talks < 1:
        raise InputError("--talks", f"is {arguments.talks}", "give 1 or more, or leave it out to measure all")
    store = Store.open(arguments.data)
    talks, plans, styled, marked = _measured(store, arguments.talks)
    tables = [bounds_table(store, corpus_bounds.judge(talks), talks, marked)]
    if any(talk.part in POOLED for talk in talks):
        tables.append(by_source.table(talks))
    if styled:
        tables.append(style_table(styled))
    if plans:
        tables.append(plan_table(plans))
    return tables


def chosen(store: Store, talks: int | None) -> list[RecordingInfo]:
    """All recordings, or `talks` of each part, evenly over the store; style always whole."""
    out: list[RecordingInfo] = []
    for part in dict.fromkeys(info.part for info in store.recordings):
        own = [info for info in store.recordings if info.part == part]
        if talks is not None and talks < len(own) and part != "style":
            own = [own[k] for k in np.linspace(0, len(own) - 1, talks).round().astype(int)]
        out += own
    return out


def _measured(store: Store, talks: int | None) -> tuple[list[MeasuredTalk], list[PlayedPlan], list[StyledWindows], int]:
    """Every chosen recording; and how many of those of A and B mark where rest is meant."""
    measured: list[MeasuredTalk] = []
    plans, styled, marked = [], [], 0
    for info in tqdm(chosen(store, talks), desc="measuring", unit="recording", disable=not sys.stderr.isatty()):
        recording = store.load(info.name, len(FINGERED))
        body = common_body(recording.motion)
        # What was not made in parts is judged as talks of one part.
        talk = corpus_bounds.measure(recording, body)
        measured.append(talk if talk.part else replace(talk, part=POOLED[-1]))
        if recording.truth and recording.truth.strokes:
            plans.append(plan_of(recording))
        windows = style_from_sound.windows_of(recording, body)
        styled += [windows] if windows is not None else []
        marked += bool(recording.truth and any(mark.what == REST for mark in recording.truth.marks))
    return measured, plans, styled, marked


def plan_of(recording: Recording) -> PlayedPlan:
    """What became of the strokes of a recording that has some."""
    assert recording.truth is not None
    # Takes from scripts are placed by their marks, not by the beat that is found in their motion.
    strokes = tuple(stroke for stroke in recording.truth.strokes if not stroke.clip.startswith(SCRIPTED))
    times = np.array([stroke.syllable for stroke in strokes])
    return PlayedPlan(recording.info.split, planned_strokes.stroke_misses(recording.motion, strokes),
                      planned_strokes.stroke_misses(recording.motion, strokes, _SHIFT),
                      np.array([stroke.gain for stroke in strokes]),
                      planned_strokes.gain_features(recording.speech, times),
                      tuple(stroke.clip.removesuffix("-mirrored") for stroke in strokes))


# -------------------------------------------------------------------------------------------------------------- tables

def bounds_table(store: Store, verdicts: Sequence[TalksVerdict], talks: Sequence[MeasuredTalk], marked: int) -> Table:
    """Every bound with its verdict, pooled over A and B, and each part beside it."""
    parts = list(dict.fromkeys(talk.part for talk in talks))
    rows: dict[str, dict[str, Cell]] = {}
    for verdict in verdicts:
        pooled, digits = verdict.pooled, verdict.pooled.claim.digits
        row: dict[str, Cell] = {**pooled.row, **{part: own.value.text(digits) + (" !" if own.holds is False else "")
                                                 for part, own in verdict.parts.items()}}
        if math.isfinite(verdict.least):
            row["talks"] = f"{verdict.least:.{digits}f} to {verdict.most:.{digits}f}"
        rows[pooled.figure] = row
    judged = [talk for talk in talks if talk.part in POOLED]
    counts = ", ".join(f"{_LETTERS.get(part, part)}: {len(own)} ({sum(t.seconds for t in own) / 60:.0f} min)"
                       for part in parts if (own := [t for t in talks if t.part == part]))
    missed = [verdict.pooled.figure for verdict in verdicts if verdict.pooled.holds is False]
    unknown = [verdict.pooled.figure for verdict in verdicts if verdict.pooled.holds is None]
    notes = [f"Recordings: {counts}. Pooled over the {len(judged)} talks of A and B, weighed by their seconds, with "
             "bootstrap 95 % intervals; of the worst talk there is none. \"!\": the part alone misses the bound.",
             f"Outside: {'; '.join(missed) or 'nothing'}." + (f" Unknown: {'; '.join(unknown)}." if unknown else ""),
             f"Rest is marked in {marked} recordings; where it is not, no frame is left out of a freeze."]
    if len(judged) < FEWEST:
        notes.append(f"Fewer than {FEWEST} talks of A and B: the verdicts do not count.")
    columns = {"bound": Column("bound"), "value": Column("A and B"), "holds": Column("holds"),
               **{part: Column(_LETTERS.get(part, part)) for part in parts}, "talks": Column("talks of A and B")}
    return Table("A corpus against the bounds of human likeness", columns, rows, "figure", notes,
                 {"bounds": [verdict.to_dict() for verdict in verdicts], "store": store.fingerprint,
                  "talks": [{"name": talk.name, "part": talk.part, "seconds": talk.seconds} for talk in talks]})


def style_table(styled: Sequence[StyledWindows]) -> Table:
    """R2 of what is told of styles from 8 s of sound; only sound alone is held against the bounds."""
    scores = style_from_sound.told(styled)
    rows: dict[str, dict[str, Cell]] = {}
    facts = []
    for target in style_from_sound.TARGETS:
        claim = STYLE_CLAIMS[target]
        row: dict[str, Cell] = {"bound": claim.bound.text(claim.digits),
                                **{known: own[target] for known, own in scores.items()}}
        if scores:
            verdict = claim.judge(scores[style_from_sound.KNOWN[0]][target])
            row["holds"], score = SHOWN[verdict.holds], verdict.value
            facts.append({"name": claim.figure, "value": score.mean, "low": claim.bound.low, "high": math.inf,
                          "holds": verdict.holds, "interval": [score.low, score.high], "parts": {"style": score.mean}})
        rows[target] = row
    windows = sum(len(own.features) for own in styled)
    note = (f"{len(styled)} recordings of part C, {windows} windows; each recording is predicted by a fit on the "
            "others, so its text is unseen, its voice mostly not. The verdict uses audio alone.")
    columns = {"bound": Column("bound"), style_from_sound.KNOWN[0]: Column("sound alone"), "holds": Column("holds"),
               **{known: Column(known) for known in style_from_sound.KNOWN[1:]}}
    return Table("Style recognised from 8 s of audio, R2", columns, rows, "style", [note], {"bounds": facts})


def plan_table(plans: Sequence[PlayedPlan]) -> Table:
    """What a scripted performance did with its plan."""
    shares: list[Interval] = [
        mean_interval([float((own <= TOLERANCE).mean()) for own in values], [float(len(own)) for own in values])
        for values in ([plan.misses for plan in plans], [plan.shifted for plan in plans])]
    rows: dict[str, dict[str, Cell]] = {
        "motion beats within 20 ms of plan": {"value": shares[0]}, "the same by chance": {"value": shares[1]},
        "median miss, ms": {"value": 1000.0 * float(np.median(np.concatenate([plan.misses for plan in plans])))},
        "longest run of one clip": {"value": max(planned_strokes.longest_repetition(plan.clips) for plan in plans)},
        "stroke size from audio, R2": {"value": gain_figure(plans)}}
    strokes = sum(len(plan.misses) for plan in plans)
    return Table("Strokes and their plan", {"value": Column("value", digits=3)}, rows, "figure",
                 [f"{len(plans)} recordings, {strokes} strokes."])


def gain_figure(plans: Sequence[PlayedPlan]) -> Interval:
    """R2 on the split "test", fitted on the others; without such a split every fifth recording is held out."""
    held = [plan.split == "test" for plan in plans]
    if not any(held) or all(held):
        held = [k % 5 == 4 for k in range(len(plans))]
    train, test = ([(plan.features, plan.gains) for plan, out in zip(plans, held, strict=True) if out is wanted]
                   for wanted in (False, True))
    if not train or not test:
        return mean_interval([])
    return mean_interval(planned_strokes.gain_r2(train, test), [float(len(gains)) for _, gains in test])
