"""A claim: a figure and the bound that it must keep; a verdict: the value that was measured, and whether it does.

Acceptance of motion and of RACER, the bounds of a corpus and the claims of the papers are all of this form. They differ
in which part of the interval is held against the bound:

- `MEAN`: the mean, as what is wanted is a mean over renderings, and the interval says how far the next ones would move
  it. An undefined mean breaks the bound.
- `LOW`, `HIGH`: one end of the interval, for what must not be due to chance ("the lower end lies above 0").
- `WHOLE`: the whole interval. One that straddles the bound, and one that is undefined, decides nothing.

What cannot be measured (no store, no fingers) is skipped with its reason: such a verdict neither holds nor fails, and
is not counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eval.stats import Interval
from eval.table import Cell, Column, Table

__all__ = ["Bound", "Claim", "Verdict", "at_least", "at_most", "judged", "verdict_table"]

MEAN, LOW, HIGH, WHOLE = "mean", "low", "high", "whole"
HOLDS, FAILS, UNDECIDED = "holds", "does not hold", "undecided"
SHOWN = {True: "yes", False: "NO", None: ""}
COLUMNS = {"value": Column("figure"), "bound": Column("bound"), "holds": Column("holds"), "reason": Column("remark")}
_PART = {MEAN: "", LOW: "lower end ", HIGH: "upper end ", WHOLE: "interval "}


@dataclass(frozen=True)
class Bound:
    """Limits of a figure, either of which may be infinite. strict: the limits themselves are outside; of: which part of
    the interval must keep them."""

    low: float = -math.inf
    high: float = math.inf
    strict: bool = False
    of: str = MEAN

    def keeps(self, value: float) -> bool:
        """Whether a number lies within the limits; NaN does not."""
        return bool(self.low < value < self.high if self.strict else self.low <= value <= self.high)

    def holds(self, value: Interval) -> bool | None:
        """Whether a value keeps the bound; None where its interval does not decide."""
        if self.of != WHOLE:
            return self.keeps({MEAN: value.mean, LOW: value.low, HIGH: value.high}[self.of])
        if self.keeps(value.low) and self.keeps(value.high):
            return True
        return False if value.high < self.low or value.low > self.high else None

    def text(self, digits: int = 2) -> str:
        """For a reader, such as "at least 0.60"; empty without limits."""
        low, high = (f"{limit:.{digits}f}" if self.of == MEAN else f"{limit:g}" for limit in (self.low, self.high))
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"{_PART[self.of]}{low} to {high}"
        if math.isfinite(self.low):
            return f"{_PART[self.of]}{'above' if self.strict else 'at least'} {low}"
        if math.isfinite(self.high):
            return f"{_PART[self.of]}{'below' if self.strict else 'at most'} {high}"
        return ""


ANY = Bound()
"""Shown, not judged."""
POSITIVE = Bound(low=0.0, strict=True, of=LOW)
"""A difference that is more than chance."""


def at_most(high: float) -> Bound:
    """No more than that."""
    return Bound(high=high)


def at_least(low: float) -> Bound:
    """No less than that."""
    return Bound(low=low)


@dataclass(frozen=True)
class Claim:
    """A figure, with what it is of and its unit, and its bound; digits: as many are shown."""

    figure: str
    bound: Bound = ANY
    digits: int = 2

    def judge(self, value: Interval | float, reason: str = "") -> Verdict:
        """The verdict on a measured value; reason: a remark for the reader."""
        measured = value if isinstance(value, Interval) else Interval.exact(value, 1)
        if self.bound == ANY:
            return Verdict(self, measured, None, reason)
        undefined = "" if math.isfinite(measured.mean) or self.bound.of == WHOLE else (
            "undefined: the motion has nothing of it")
        return Verdict(self, measured, self.bound.holds(measured), "; ".join(filter(None, (undefined, reason))))

    def undecided(self, reason: str) -> Verdict:
        """The verdict where there is no value to judge."""
        return Verdict(self, Interval.undefined(), None, reason)


@dataclass(frozen=True)
class Verdict:
    """A claim, the value that was measured and whether it keeps the bound; holds: None where that is not decided; over:
    how many of each kind the interval is over, such as seeds and clips, where there are several kinds."""

    claim: Claim
    value: Interval
    holds: bool | None
    reason: str = ""
    over: tuple[int, ...] = ()

    @property
    def figure(self) -> str:
        """What was measured."""
        return self.claim.figure

    @property
    def word(self) -> str:
        """`HOLDS`, `FAILS` or `UNDECIDED`."""
        return UNDECIDED if self.holds is None else HOLDS if self.holds else FAILS

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


def judged(figure: str, value: Interval | float, bound: Bound = ANY, *, digits: int = 2, reason: str = "") -> Verdict:
    """The verdict on a value, for a claim that is made where it is judged."""
    return Claim(figure, bound, digits).judge(value, reason)


def skipped(figure: str, why: str) -> Verdict:
    """A figure that was not measured."""
    return Claim(figure).undecided(f"not measured: {why}")


def count(entries: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    """How many hold, and how many are decided, of verdicts as `Verdict.entry` gives them, also when read back."""
    decided = [entry["holds"] for entry in entries if isinstance(entry["holds"], bool)]
    return sum(decided), len(decided)


def summary(entries: Sequence[Mapping[str, Any]]) -> str:
    """The same as a sentence."""
    holding, decided = count(entries)
    return f"{holding} of {decided} clauses hold."


def verdict_table(title: str, verdicts: Sequence[Verdict], notes: Sequence[str] = (),
                  facts: Mapping[str, Any] | None = None) -> Table:
    """Verdicts as a table; facts["clauses"] is the list of entries. ValueError where two are of one figure."""
    if len({verdict.figure for verdict in verdicts}) != len(verdicts):
        raise ValueError("two claims are of one figure")
    entries = [verdict.entry for verdict in verdicts]
    return Table(title, COLUMNS, {verdict.figure: verdict.row for verdict in verdicts}, "clause",
                 [summary(entries), *notes], {**(facts or {}), "clauses": entries})
