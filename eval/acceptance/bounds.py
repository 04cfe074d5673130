"""The table of bounds (`bounds.toml`): a figure, the limits that it must keep, and the verdict on a measured value.

A row of the table is one clause for each set of stimuli that it names. The mean of a figure is held against the limits,
as what is wanted is a mean over renderings; the interval says how far the next ones would move it. An undefined mean
breaks the bound. A figure that cannot be measured (no store, no fingers) is skipped with the reason: its verdict
neither holds nor fails and is not counted.
"""

from __future__ import annotations

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

__all__ = ["Bound", "Claim", "Measured", "Row", "Verdict", "at_least", "at_most", "verdict_table"]

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


def at_most(high: float) -> Bound:
    """No more than that."""
    return Bound(high=high)


def at_least(low: float) -> Bound:
    """No less than that."""
    return Bound(low=low)


@dataclass(frozen=True)
class Claim:
    """A figure with its subject and unit, and its bound; digits: decimals in tables."""

    figure: str
    bound: Bound = ANY
    digits: int = 2

    def judge(self, value: Interval, reason: str = "") -> Verdict:
        """The verdict on a measured value; reason: a remark for the reader."""
        if self.bound == ANY:
            return Verdict(self, value, None, reason)
        undefined = "" if math.isfinite(value.mean) else "undefined: the motion has nothing of it"
        return Verdict(self, value, self.bound.keeps(value.mean), "; ".join(filter(None, (undefined, reason))))

    def undecided(self, reason: str) -> Verdict:
        """The verdict where there is no value to judge."""
        return Verdict(self, Interval.undefined(), None, reason)


@dataclass(frozen=True)
class Verdict:
    """A claim, the measured value and whether it keeps the bound; holds: None where that is not decided."""

    claim: Claim
    value: Interval
    holds: bool | None
    reason: str = ""

    @property
    def figure(self) -> str:
        """The title of the measured figure."""
        return self.claim.figure

    @property
    def entry(self) -> dict[str, Any]:
        """For JSON: name, value, low, high, n, bound, holds, reason."""
        return {"name": self.figure, "value": self.value.mean, "low": self.value.low, "high": self.value.high,
                "n": self.value.n, "bound": self.claim.bound.text(self.claim.digits), "holds": self.holds,
                "reason": self.reason}

    @property
    def row(self) -> dict[str, Cell]:
        """For a table with `COLUMNS`."""
        return {"value": self.value.text(self.claim.digits), "bound": self.claim.bound.text(self.claim.digits),
                "holds": SHOWN[self.holds], "reason": self.reason}


def count(entries: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    """How many hold, and how many are decided, of verdicts as `Verdict.entry` gives them, also when read back."""
    decided = [entry["holds"] for entry in entries if isinstance(entry["holds"], bool)]
    return sum(decided), len(decided)


def summary(entries: Sequence[Mapping[str, Any]]) -> str:
    """The same as a sentence."""
    holding, decided = count(entries)
    return f"{holding} of {decided} clauses hold."


def verdict_table(title: str, verdicts: Sequence[Verdict]) -> Table:
    """Verdicts as a table; facts["clauses"] is the list of entries. ValueError where two are of one figure."""
    if len({verdict.figure for verdict in verdicts}) != len(verdicts):
        raise ValueError("two claims are of one figure")
    entries = [verdict.entry for verdict in verdicts]
    return Table(title, COLUMNS, {verdict.figure: verdict.row for verdict in verdicts}, "clause",
                 [summary(entries)], {"clauses": entries})


# --------------------------------------------------------------------------------------------------------- the table

@dataclass(frozen=True)
class Measured:
    """A figure on one set of stimuli. remark: for the reader; missing: why it could not be measured, if so."""

    value: Interval = field(default_factory=Interval.undefined)
    remark: str = ""
    missing: str = ""


Figures = Mapping[tuple[str, str], Measured]
"""(Figure, set of stimuli) -> its value."""
Results = dict[tuple[str, str], Measured]
"""The same while it is put together."""


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

    def sets(self, figures: Figures) -> list[str]:
        """The sets of stimuli of the row on which the figure was measured."""
        measured = [on for figure, on in figures if figure == self.figure]
        return [on for on in self.on if on in measured] if self.on else measured

    def judge(self, figures: Figures) -> list[Verdict]:
        """A verdict for each set of stimuli of which there is a value."""
        return [self._judge(on, figures) for on in self.sets(figures)]

    def _judge(self, on: str, figures: Figures) -> Verdict:
        def claim(bound: Bound) -> Claim:
            return Claim(self.title.format(on=on), bound, self.digits)

        measured, other = figures[self.figure, on], figures.get((self.figure, self.over or self.limit))
        value, remark = measured.value, measured.remark
        lacking = measured.missing or self._lacking(on, figures)
        # A ratio without its denominator is not measured; a limit without its set leaves a figure that is only shown.
        if self.over and other is None:
            lacking = lacking or LACKING["corpus"]
        if lacking:
            return claim(ANY).undecided(f"not measured: {lacking}")
        if self.over and other is not None:
            reference = other.value.mean
            return claim(self.bound).judge(value.times(1.0 / reference), f"{value.mean:.2f} and {reference:.2f}")
        if not self.limit or other is None:
            return claim(ANY if self.limit else self.bound).judge(value, remark)
        source = f"the bound is {f'{self.times:g} times ' if self.times != 1.0 else ''}that of: {self.limit}"
        return claim(at_most(self.times * max(other.value.mean, self.least))).judge(
            value, "; ".join(filter(None, (remark, source))))

    def _lacking(self, on: str, figures: Figures) -> str:
        """Why the figure has no value, where that is no fault of the motion; else empty."""
        if not self.needs or math.isfinite(figures[self.figure, on].value.mean):
            return ""
        # Fingers that stand still have no correlation, and that is a fault and not a lack of data.
        moving = figures.get(("eye_fingers", on), Measured()).value
        return "" if self.needs == FINGERS and math.isfinite(moving.mean) else LACKING[self.needs]


def judge(rows: Sequence[Row], figures: Figures) -> list[Verdict]:
    """The verdicts of all rows, in their order."""
    return [verdict for row in rows for verdict in row.judge(figures)]


@cache
def table() -> dict[str, tuple[Row, ...]]:
    """Group -> its rows, as `bounds.toml` has them; ValueError for a key that no row has."""
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
    try:
        return Row(figure, title, bound, (on,) if isinstance(on, str) else tuple(on), **entry)
    except TypeError as error:
        raise ValueError(f"{TABLE.name}, {figure}: {error}") from None


def bounds_of(group: str) -> dict[str, Row]:
    """Figure -> its judged row, of a group in which every figure stands once."""
    return {row.figure: row for row in table()[group] if row.bound != ANY}


def mark(figure: str, value: Interval) -> str:
    """" !" where a figure of the group `motion` lies outside of its bound."""
    row = bounds_of("motion").get(figure)
    return " !" if row is not None and math.isfinite(value.mean) and not row.bound.keeps(value.mean) else ""
