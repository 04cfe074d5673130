"""What metrics are worth beside people: does a metric put systems in the order that people put them in?

People have rated each system, such as by the medians of a study. Of the pairs of systems, Kendall's tau-b (Kendall
1945) takes those that a metric orders as the ratings do, C, less those that it orders the other way, D:

    tau = (C - D) / sqrt(P_m P_r)

where P_m and P_r are the pairs that differ by the metric and by the ratings. 1: the same order, 0: nothing of it, -1:
the reverse. A metric whose good value is the speaker's own counts by its distance from that.

The interval is the bootstrap's, clips and systems both drawn anew: it covers other clips of these systems and other
systems of their kind. It does not cover other raters (a rating counts as exact), speakers or bodies. Where every draw
has one order it has no width, and is not given.

What fools it: few systems, since of seven an order at random has a tau of .62 or more one time in fifteen (in either
direction); many metrics, of which the best is partly the luckiest; and the person among the systems, who is at no
distance from the truth by construction, and so counts only where a metric is not measured from there.

    >>> float(tau(np.array([1.0, 2.0, 3.0]), np.array([10.0, 20.0, 15.0]))).__round__(2)
    0.33
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, shown
from data_module.files import read_object
from data_module.types import Array
from eval import stats
from eval.metrics import CLIP_METRICS, EYE_METRICS, Metric
from eval.stats import Interval
from eval.table import Cell, Column, Table

if TYPE_CHECKING:
    from eval.score.tables import Flag, ScoreRow

FEWEST = 3
"""Systems: of two, any metric has a tau of 1 or of -1."""
FROM_TRUTH = ("joints", "lexemes", "sets", "fgd")
"""Parts whose metrics are distances from the truth, as all are whose good value is near the truth's."""
MOMENTS = ("shuffled", "reversed")
"""Controls of real motion at the wrong moment: they are wrong for what claims to see timing or meaning alone."""
_ADVICE = 'give a number to each system, {"A": 72, "B": 60.5}; more is better'


def read_ratings(path: Path) -> dict[str, float]:
    """The ratings by name; `InputError` for a file that is no JSON object of numbers."""
    ratings = read_object(path, _ADVICE)
    for name, rating in ratings.items():
        if type(rating) not in (int, float):
            raise InputError(path, f"rates {shown(name)} with {shown(rating)}", _ADVICE)
    return {name: float(rating) for name, rating in ratings.items()}


def tau(figures: Array, ratings: Array) -> NDArray[np.float64]:
    """Kendall's tau-b between figures and ratings, [..., S] each; NaN where all are alike. A system whose figure is
    NaN is left out."""
    first, second = np.triu_indices(figures.shape[-1], 1)
    signs, people = (np.sign(values[..., first] - values[..., second]) for values in (figures, ratings))
    people = np.where(np.isnan(signs), 0.0, people)
    pairs = np.sqrt((np.nan_to_num(signs) != 0).sum(-1) * (people != 0).sum(-1))
    return np.divide(np.nansum(signs * people, axis=-1), pairs, out=np.full(pairs.shape, math.nan), where=pairs > 0)


def agreement(badness: Array, drawn: Array, ratings: Array, seed: int = 0) -> Interval:
    """Tau with ratings [S] of what all clips say of the systems, [S], with its interval over clips and systems.

    drawn: [draws, S] what redrawn clips say.
    """
    chosen = np.random.default_rng(seed).integers(len(ratings), size=drawn.shape)
    taus = tau(-np.take_along_axis(drawn, chosen, axis=1), ratings[chosen])
    # A draw whose figures are all alike orders nothing; left out, the others would make the interval too narrow.
    interval = stats.limits(float(tau(-badness, ratings)), np.nan_to_num(taus), len(ratings))
    return Interval.exact(interval.mean, interval.n) if interval.low == interval.high else interval


def badness_of(rows: Sequence[ScoreRow], truth: ScoreRow, name: str, metric: Metric, seed: int) -> tuple[Array, Array]:
    """How bad a metric finds each row, by all clips [S] and by redrawn ones [draws, S]; less is better."""
    if name in CLIP_METRICS or name in EYE_METRICS:
        values = np.stack([row.values[name] for row in (truth, *rows)], axis=-1)
        badness = np.concatenate([np.array([[stats.mean(column) for column in values.T]]),
                                stats.crossed_means(values[None], seed)])
    else:
        figures = [row.sets.get(name, lambda chosen: math.nan) for row in (truth, *rows)]
        counts, rng = len(truth.motions), np.random.default_rng(seed)
        draws = [np.arange(counts), *(chosen for chosen, in stats.resamples(rng, [counts], stats.SET_DRAWS))]
        badness = np.array([[figure(chosen) for figure in figures] for chosen in draws])
    if metric.good == "near":
        badness = np.abs(badness - badness[:, :1])
    badness = -badness[:, 1:] if metric.good == "high" else badness[:, 1:]
    return badness[0], badness[1:]


def ratings_table(systems: Sequence[ScoreRow], truth: ScoreRow, ratings: Mapping[str, float],
                  metrics: Mapping[str, Metric], flags: Sequence[Flag], seed: int) -> Table:
    """A row for each metric: tau among the systems, tau with the person, and the controls that beat the system which
    people rate highest. ratings: by name, the person's under the truth's."""
    systems = [row for row in systems if row.name in ratings]
    everyone, count = [*systems, *([truth] if truth.name in ratings else [])], len(systems)
    scale = np.array([ratings[row.name] for row in everyone])
    best = max(systems, key=lambda row: ratings[row.name]).name
    table: dict[str, dict[str, Cell]] = {}
    for name, metric in metrics.items():
        if metric.good:
            badness, drawn = badness_of(everyone, truth, name, metric, seed)
            by_distance = metric.good == "near" or metric.part in FROM_TRUTH
            wrong = [flag.control for flag in flags if flag.metric == name and best in flag.beaten]
            table[metric.heading] = {
                "systems": agreement(badness[:count], drawn[:, :count], scale[:count], seed),
                "person": None if by_distance or everyone == systems else agreement(badness, drawn, scale, seed),
                "motion": ", ".join(control for control in wrong if control not in MOMENTS),
                "moment": ", ".join(control for control in wrong if control in MOMENTS)}
    columns = {"systems": Column("tau, systems"), "person": Column("tau, with the person"),
               "motion": Column("wrong motion as good"), "moment": Column("wrong moment as good")}
    notes = ["Kendall's tau-b with the ratings: 1 is people's order, 0 none of it, -1 the reverse. [low, high]: 95 %, "
             "clips and systems both drawn anew; not covered are other raters, speakers and bodies. -: undefined, or "
             "measured from the person.",
             f"As good: controls that the metric finds no worse than {best}, which people rate highest of the systems. "
             "Wrong moment: real motion, so that it is wrong for metrics of timing alone.",
             "Of twenty metrics without any relation to the ratings, one excludes 0 by chance."]
    return Table(f"Metrics beside the ratings of {count} systems", columns, table, "metric", notes,
                 {"ratings": dict(ratings)})
