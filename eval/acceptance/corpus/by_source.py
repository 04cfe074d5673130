"""What each source of a corpus brings, and what all bring together: the bounds of the acceptance, printed by source.

A source is a performer of the store: a group of takes, or a person whose strokes were put together. A mean over all
hides one whose forearms were turned outward on the way to us, so three bounds hold for every source by itself: the
forearms point ahead, and the elbows bend as people's do. The others (`bounds.toml`) are asked of all
together, and a source that misses one is marked.

Talks are weighed by their seconds. First movements are pooled over the talks of a source and held against circular
shifts. Pitch with trunk is left to `gesticulator probe motion`, which shows the test split's own motion in its column
"corpus".

What fools it: a source of a few seconds has hardly a forearm to judge; the table tells how much there is of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eval.acceptance import timing
from eval.acceptance.bounds import SHOWN, Bound, Measured, Verdict, at_most, bounds_of, judge, judged, mark
from eval.acceptance.corpus.bounds import POOLED, MeasuredTalk
from eval.metrics.eye.units import Leads
from eval.stats import Interval, mean_interval
from eval.table import Cell, Column, Table

EVERY: dict[str, Bound] = {"eye_splay": at_most(15.0), "eye_azimuth": Bound(-35.0, 5.0),
                           "eye_elbow": Bound(45.0, 100.0)}
"""What every source must keep by itself."""
_LEFT_OUT = (timing.PITCH_P, "eye_seam", "eye_repetition", "eye_frechet_pooled")
"""Pitch, block boundaries (a corpus has none; its joins are judged in `bounds`), and figures relative to a corpus."""
ROWS = {name: row for name, row in bounds_of("motion").items() if name not in _LEFT_OUT}
FIGURES = tuple(ROWS)
ALL = "all"


def of(talks: Sequence[MeasuredTalk]) -> dict[str, Interval]:
    """The figures of some talks together."""
    seconds = [talk.seconds for talk in talks]
    out = {name: mean_interval(np.array([talk.figures[name] for talk in talks], dtype=np.float64), seconds)
           for name in FIGURES if name not in timing.TITLES}
    known = [talk.first for talk in talks if talk.first is not None]
    if not known:
        return out
    first = Leads.pooled(known)
    count = len(first.seconds)
    return out | {timing.FIRST: Interval.exact(first.before, count),
                  timing.FIRST_CHANCE: Interval.exact(first.chance, count),
                  timing.FIRST_P: Interval.exact(first.p, count)}


def groups(talks: Sequence[MeasuredTalk]) -> dict[str, list[MeasuredTalk]]:
    """The judged talks of every source, and all of them."""
    judged_talks = [talk for talk in talks if talk.part in POOLED]
    sources = {name: [talk for talk in judged_talks if talk.source == name]
               for name in sorted({talk.source for talk in judged_talks})}
    return {**sources, ALL: judged_talks}


def verdicts(talks: Sequence[MeasuredTalk]) -> list[Verdict]:
    """The bounds of every source by itself, and those of all together."""
    own = {name: of(members) for name, members in groups(talks).items() if members}
    out = [judged(ROWS[figure].title.format(on=source), figures[figure], bound, digits=ROWS[figure].digits)
           for source, figures in own.items() if source != ALL for figure, bound in EVERY.items()]
    together = {(name, ALL): Measured(own[ALL].get(name, Interval.undefined())) for name in FIGURES if ALL in own}
    return out + judge([replace(row, on=()) for row in ROWS.values()], together)


def table(talks: Sequence[MeasuredTalk]) -> Table:
    """Figures down, all together and every source across; facts["clauses"] has every verdict."""
    told = groups(talks)
    own = {name: of(members) for name, members in told.items() if members}
    found = verdicts(talks)
    holds = {verdict.figure: verdict.holds for verdict in found}
    rows: dict[str, dict[str, Cell]] = {}
    for name in (*FIGURES, timing.FIRST, timing.FIRST_CHANCE):
        bound = ROWS.get(name)
        title = timing.TITLES[name] if bound is None else bound.title.removesuffix(", {on}")
        digits = timing.DIGITS[name] if bound is None else bound.digits
        row: dict[str, Cell] = {"bound": "" if bound is None else bound.bound.text(digits),
                                "holds": SHOWN[holds.get(f"{title}, {ALL}")]}
        for source, figures in own.items():
            missed = source != ALL and name in EVERY and holds[f"{title}, {source}"] is False
            value = figures.get(name, Interval.undefined())
            row[source] = value.text(digits) + (" NO" if missed else mark(name, value))
        rows[title] = row
    minutes = ", ".join(f"{name} {len(members)} ({sum(talk.seconds for talk in members) / 60:.0f} min)"
                        for name, members in told.items())
    refused = [verdict.figure for verdict in found if verdict.holds is False]
    columns = {"bound": Column("bound"), ALL: Column("A and B"), "holds": Column("holds"),
               **{name: Column(name) for name in own if name != ALL}}
    asked = "; ".join(f"{ROWS[name].title.removesuffix(', {on}')} {bound.text(ROWS[name].digits)}"
                      for name, bound in EVERY.items())
    return Table("By source", columns, rows, "figure",
                 [f"Talks: {minutes}.", f'Of every source by itself: {asked}; "NO" where one misses it, "!" where it '
                  "misses a bound of all.", f"Refused: {'; '.join(refused) or 'nothing'}."],
                 {"clauses": [verdict.entry for verdict in found]})
