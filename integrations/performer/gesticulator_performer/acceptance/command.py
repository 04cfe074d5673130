"""Is a built corpus good enough to learn from? `gesticulator probe corpus --data STORE [--talks 32]`

Its talks are judged by bounds of human likeness (`bounds`), and every source by itself (`by_source`). Everything is
measured on the finished motion; only the places where the corpus was put together and the marked rests come from the
truth.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from data_module.errors import InputError
from data_module.motion.skeletons import FINGERED
from data_module.store import RecordingInfo, Store
from data_module.truth import REST
from eval.metrics.eye import common_body
from eval.table import Cell, Column, Table
from gesticulator_performer.acceptance import bounds as corpus_bounds
from gesticulator_performer.acceptance import by_source
from gesticulator_performer.acceptance.bounds import POOLED, MeasuredTalk, TalksVerdict

FEWEST = 20
"""Talks of A and B together that a verdict should stand on."""
_LETTERS = {"motion": "A, motion", "talk": "B, talk", "style": "C, style", "reading": "readings"}


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, and how much of it."""
    parser.add_argument("--data", required=True, metavar="STORE", help="a store built by `gesticulator build`")
    parser.add_argument("--talks", type=int, metavar="N",
                        help="number of talks per part, evenly chosen (default: all)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Measure a store; InputError for one that cannot be."""
    if arguments.talks is not None and arguments.talks < 1:
        raise InputError("--talks", f"is {arguments.talks}", "give 1 or more, or leave it out to measure all")
    store = Store.open(arguments.data)
    talks, marked = _measured(store, arguments.talks)
    tables = [bounds_table(store, corpus_bounds.judge(talks), talks, marked)]
    if any(talk.part in POOLED for talk in talks):
        tables.append(by_source.table(talks))
    return tables


def chosen(store: Store, talks: int | None) -> list[RecordingInfo]:
    """All recordings, or `talks` of each part, evenly over the store."""
    out: list[RecordingInfo] = []
    for part in dict.fromkeys(info.part for info in store.recordings):
        own = [info for info in store.recordings if info.part == part]
        if talks is not None and talks < len(own):
            own = [own[k] for k in np.linspace(0, len(own) - 1, talks).round().astype(int)]
        out += own
    return out


def _measured(store: Store, talks: int | None) -> tuple[list[MeasuredTalk], int]:
    """Every chosen recording; and how many of those of A and B mark where rest is meant."""
    measured: list[MeasuredTalk] = []
    marked = 0
    for info in tqdm(chosen(store, talks), desc="measuring", unit="recording", disable=not sys.stderr.isatty()):
        recording = store.load(info.name, len(FINGERED))
        # Recordings without parts are judged as talks of one part.
        talk = corpus_bounds.measure(recording, common_body(recording.motion))
        measured.append(talk if talk.part else replace(talk, part=POOLED[-1]))
        marked += bool(recording.truth and any(mark.what == REST for mark in recording.truth.marks))
    return measured, marked


# -------------------------------------------------------------------------------------------------------------- tables

def bounds_table(store: Store, verdicts: Sequence[TalksVerdict], talks: Sequence[MeasuredTalk], marked: int) -> Table:
    """Every bound with its verdict, pooled over A and B, and each part beside it."""
    parts = list(dict.fromkeys(talk.part for talk in talks))
    rows: dict[str, dict[str, Cell]] = {}
    for verdict in verdicts:
        pooled, digits = verdict.pooled, verdict.pooled.digits
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
