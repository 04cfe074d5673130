"""The table of bounds (`bounds.toml`): a figure, the limits that it must keep, and the verdict on a measured value.

A row of the table is one clause for each set of stimuli that it names. The mean of a figure is held against the limits,
as what is wanted is a mean over renderings; the interval says how far the next ones would move it. An undefined mean
breaks the bound. A figure that cannot be measured (no store, no fingers) is skipped with the reason: its verdict
neither holds nor fails and is not counted.
"""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from eval.metrics import EYE_METRICS
from eval.stats import Interval
from eval.table import Cell, Column, Table

__all__ = ["Bound", "Measured", "Row", "Verdict", "verdict_table"]

TABLE = Path(__file__).with_name("bounds.toml")
SHOWN = {True: "yes", False: "NO", None: ""}
COLUMNS = {"value": Column("figure"), "bound": Column("bound"), "holds": Column("holds"), "reason": Column("remark")}
FINGERS = "fingers"
LACKING = {"voices": "needs several recordings with a voice", "pauses": "too few pauses",
           FINGERS: "the motion has no finger joints", "edges": "block boundaries are not known",
           "reference": "no reference space, or no store", "corpus": "no store was given",
           "waking": "no long pause was found", "silence": "no silent lexeme followed another",
           "partings": "they never part", "long": "the sounds are too short"}
"""Inputs that a figure may lack without a fault of the motion (`needs` of a row): the reason why it is not measured."""


@dataclass(frozen=True)
class Bound:
    """Limits of a figure, either of which may be infinite. strict: the limits themselves are outside."""

    low: float = -math.inf
    high: float = math.inf
    strict: bool = False

    def keeps(self, value: float) -> bool:
        """True if a number lies within the limits; NaN does not."""
        return bool(self.low < value < self.high if self.strict else self.low <= value <= self.high)

    def text(self, digits: int = 2) -> str:
        """For a reader, such as "at least 0.60"; empty without limits."""
        low, high = f"{self.low:.{digits}f}", f"{self.high:.{digits}f}"
        if math.isfinite(self.low):
            return f"{low} to {high}" if math.isfinite(self.high) else f"{'above' if self.strict else 'at least'} {low}"
        return f"{'below' if self.strict else 'at most'} {high}" if math.isfinite(self.high) else ""


ANY = Bound()
"""Shown, not judged."""


@dataclass(frozen=True)
class Verdict:
    """A figure with its subject and unit, its bound and the measured value. digits: decimals in tables; reason: a
    remark for the reader."""

    figure: str
    bound: Bound
    value: Interval
    digits: int = 2
    reason: str = ""

    @property
    def holds(self) -> bool | None:
        """Whether the value keeps the bound; None where there is none."""
        return self.bound.keeps(self.value.mean) if self.bound != ANY else None

    @property
    def entry(self) -> dict[str, Any]:
        """For JSON: name, value, low, high, n, bound, holds, reason."""
        undefined = self.holds is False and not math.isfinite(self.value.mean)
        reasons = ("undefined: the motion has nothing of it" if undefined else "", self.reason)
        return {"name": self.figure, "value": self.value.mean, "low": self.value.low, "high": self.value.high,
                "n": self.value.n, "bound": self.bound.text(self.digits), "holds": self.holds,
                "reason": "; ".join(filter(None, reasons))}

    @property
    def row(self) -> dict[str, Cell]:
        """For a table with `COLUMNS`."""
        return {"value": self.value.text(self.digits), "bound": self.bound.text(self.digits),
                "holds": SHOWN[self.holds], "reason": self.entry["reason"]}


def summary(verdicts: Sequence[Verdict]) -> str:
    """How many hold, of those that are decided."""
    decided = [verdict.holds for verdict in verdicts if verdict.holds is not None]
    return f"{sum(decided)} of {len(decided)} clauses hold."


def verdict_table(title: str, verdicts: Sequence[Verdict], beside: Mapping[str, Sequence[Verdict]] | None = None
                  ) -> Table:
    """Verdicts as a table; facts["clauses"] is the list of entries. beside: by a column's name the verdicts on another
    motion, of which the values are shown, with "!" where one does not hold. ValueError where two are of one figure."""
    rows = {verdict.figure: verdict.row for verdict in verdicts}
    if len(rows) != len(verdicts):
        raise ValueError("two claims are of one figure")
    for name, others in (beside or {}).items():
        for other in others:
            rows[other.figure][name] = f"{other.row['value']}{' !' if other.holds is False else ''}"
    columns = {**COLUMNS, **{name: Column(name) for name in beside or {}}}
    return Table(title, columns, rows, "clause", [summary(verdicts)],
                 {"clauses": [verdict.entry for verdict in verdicts]})


# --------------------------------------------------------------------------------------------------------- the table

@dataclass(frozen=True)
class Measured:
    """A figure on one set of stimuli. remark: for the reader; missing: why it could not be measured, if so."""

    value: Interval = field(default_factory=Interval.undefined)
    remark: str = ""
    missing: str = ""


Results = dict[tuple[str, str], Measured]
"""(Figure, set of stimuli) -> its value."""


@dataclass(frozen=True)
class Row:
    """A row of the table. on: sets of stimuli, empty for every set on which the figure was measured; title: with "{on}"
    where the set belongs; needs: a key of `LACKING`; over: the set by whose mean the value is divided; limit: the set
    whose mean of the same figure, times `times` and at least `least` before that, is the upper limit."""

    figure: str
    title: str
    bound: Bound
    on: tuple[str, ...] = ()
    digits: int = 2
    needs: str = ""
    over: str = ""
    limit: str = ""
    times: float = 1.0
    least: float = -math.inf

    def sets(self, figures: Results) -> list[str]:
        """The sets of stimuli of the row on which the figure was measured."""
        measured = [on for figure, on in figures if figure == self.figure]
        return [on for on in self.on if on in measured] if self.on else measured

    def judge(self, figures: Results) -> list[Verdict]:
        """A verdict for each set of stimuli of which there is a value."""
        return [self._judge(on, figures) for on in self.sets(figures)]

    def _judge(self, on: str, figures: Results) -> Verdict:
        measured, other = figures[self.figure, on], figures.get((self.figure, self.over or self.limit))
        value, remark, bound = measured.value, measured.remark, self.bound
        lacking = measured.missing or self._lacking(on, figures)
        # A ratio without its denominator is not measured; a limit without its set leaves a figure that is only shown.
        if self.over and other is None:
            lacking = lacking or LACKING["corpus"]
        if self.over and other is not None:
            value, remark = value.times(1.0 / other.value.mean), f"{value.mean:.2f} and {other.value.mean:.2f}"
        if self.limit:
            bound = ANY if other is None else Bound(high=self.times * max(other.value.mean, self.least))
        title = self.title.format(on=on)
        if lacking:
            return Verdict(title, ANY, Interval.undefined(), self.digits, f"not measured: {lacking}")
        return Verdict(title, bound, value, self.digits, remark)

    def _lacking(self, on: str, figures: Results) -> str:
        """Why the figure has no value, where that is no fault of the motion; else empty."""
        if not self.needs or math.isfinite(figures[self.figure, on].value.mean):
            return ""
        # Fingers that stand still have no correlation, and that is a fault and not a lack of data.
        moving = figures.get(("eye_fingers", on), Measured()).value
        return "" if self.needs == FINGERS and math.isfinite(moving.mean) else LACKING[self.needs]


def judge(rows: Sequence[Row], figures: Results) -> list[Verdict]:
    """The verdicts of all rows, in their order."""
    return [verdict for row in rows for verdict in row.judge(figures)]


@cache
def table() -> dict[str, tuple[Row, ...]]:
    """Group -> its rows, as `bounds.toml` has them."""
    groups = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    titles = groups.pop("titles")
    return {group: tuple(_row({"on": held.get("on", ()), **entry}, titles) for entry in held["rows"])
            for group, held in groups.items()}


def _row(entry: dict[str, Any], titles: Mapping[str, str]) -> Row:
    figure, on, high = entry.pop("figure"), entry.pop("on"), entry.pop("high", math.inf)
    # An upper limit that is another set's figure is known only once both are measured.
    if isinstance(high, dict):
        entry |= {"limit": high.pop("of"), **high}
        high = math.inf
    bound = Bound(entry.pop("low", -math.inf), high, entry.pop("strict", False))
    metric = EYE_METRICS.get(figure)
    title = titles[figure] if metric is None else titles.get(figure, f"{metric.heading}, {{on}}")
    entry.setdefault("digits", 2 if metric is None else metric.digits)
    return Row(figure, title, bound, (on,) if isinstance(on, str) else tuple(on), **entry)
