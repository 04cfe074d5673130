"""What each source of a corpus brings: the bounds that every source must keep by itself.

A source is a performer of the store: a group of takes, or a person whose strokes were put together. A mean over all
hides one whose forearms were turned outward by retargeting, so two things hold for every source by itself: the forearms
point ahead, and the elbows bend as people's do. Talks are weighed by their seconds.

What fools it: a source of a few seconds has hardly a forearm to judge; the table says how much there is of each.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eval.acceptance.bounds import Bound, Verdict, at_most
from eval.metrics import EYE_METRICS
from eval.stats import mean_interval
from eval.table import Cell, Column, Table
from gesticulator_performer.acceptance.bounds import POOLED, MeasuredTalk

EVERY: dict[str, Bound] = {"eye_splay": at_most(15.0), "eye_azimuth": Bound(-35.0, 5.0),
                           "eye_elbow": Bound(45.0, 100.0)}
"""What every source must keep by itself: percent of the time, degrees, degrees."""


def sources_of(talks: Sequence[MeasuredTalk]) -> dict[str, list[MeasuredTalk]]:
    """The judged talks of every source."""
    judged_talks = [talk for talk in talks if talk.part in POOLED]
    return {name: [talk for talk in judged_talks if talk.source == name]
            for name in sorted({talk.source for talk in judged_talks})}


def verdicts(talks: Sequence[MeasuredTalk]) -> dict[tuple[str, str], Verdict]:
    """(figure, source) -> the verdict on it."""
    out = {}
    for source, members in sources_of(talks).items():
        for figure, bound in EVERY.items():
            value = mean_interval(np.array([talk.figures[figure] for talk in members], dtype=np.float64),
                                  [talk.seconds for talk in members])
            metric = EYE_METRICS[figure]
            out[figure, source] = Verdict(f"{metric.heading}, {source}", bound, value, metric.digits)
    return out


def table(talks: Sequence[MeasuredTalk]) -> Table:
    """Figures down and sources across; facts["clauses"] has every verdict."""
    found, sources = verdicts(talks), sources_of(talks)
    rows: dict[str, dict[str, Cell]] = {}
    for figure, bound in EVERY.items():
        metric = EYE_METRICS[figure]
        shown = {source: found[figure, source].value.text(metric.digits)
                 + (" NO" if found[figure, source].holds is False else "") for source in sources}
        rows[metric.heading] = {"bound": bound.text(metric.digits), **shown}
    minutes = ", ".join(f"{name} {len(members)} ({sum(talk.seconds for talk in members) / 60:.0f} min)"
                        for name, members in sources.items())
    return Table("By source", {"bound": Column("bound"), **{name: Column(name) for name in sources}}, rows, "figure",
                 [f"Talks: {minutes}.", '"NO" where a source misses the bound.'],
                 {"clauses": [verdict.entry for verdict in found.values()]})
