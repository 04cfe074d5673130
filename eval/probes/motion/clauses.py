"""A clause of the acceptance: a figure, its interval, the bound that it must keep, and whether it does.

The mean is judged, not the interval: what is asked are means over renderings, and the interval says how far the next
ones would move them. What cannot be measured here (no real take, no fingers) is neither kept nor broken, and says why;
a figure that is undefined for the motion itself (no stroke at all) is broken. A clause without a bound is shown to be
read beside the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eval.stats import Interval
from eval.table import Cell, Column, Table

HOLDS = {True: "yes", False: "NO", None: ""}
COLUMNS = {"value": Column("figure"), "bound": Column("bound"), "holds": Column("holds"), "reason": Column("remark")}


@dataclass(frozen=True)
class ClauseBound:
    """What a figure must be: between low and high, both included; below: less than high, not equal to it."""

    low: float = -math.inf
    high: float = math.inf
    below: bool = False

    def holds(self, value: float) -> bool:
        """Whether a value keeps it; NaN keeps nothing."""
        return bool(self.low <= value <= self.high and not (self.below and value == self.high))

    def text(self, digits: int) -> str:
        """For a reader; nothing where nothing is asked."""
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"{self.low:.{digits}f} to {self.high:.{digits}f}"
        if math.isfinite(self.low):
            return f"at least {self.low:.{digits}f}"
        if math.isfinite(self.high):
            return f"{'below' if self.below else 'at most'} {self.high:.{digits}f}"
        return ""


def at_most(high: float) -> ClauseBound:
    """No more than that."""
    return ClauseBound(high=high)


def at_least(low: float) -> ClauseBound:
    """No less than that."""
    return ClauseBound(low=low)


ANY = ClauseBound()
"""Shown, not judged."""


@dataclass(frozen=True)
class Clause:
    """One line of the acceptance. name: what is measured and on what; holds: None where it is not judged."""

    name: str
    value: Interval
    bound: str
    holds: bool | None
    reason: str = ""
    digits: int = 2

    @classmethod
    def judged(cls, name: str, value: Interval | float, bound: ClauseBound = ANY, *, digits: int = 2, reason: str = ""
               ) -> Clause:
        """By its mean. A value that is undefined breaks its bound."""
        own = value if isinstance(value, Interval) else Interval.exact(value, 1)
        if bound == ANY:
            return cls(name, own, "", None, reason, digits)
        undefined = "" if math.isfinite(own.mean) else "undefined: the motion has nothing of it"
        return cls(name, own, bound.text(digits), bound.holds(own.mean), _both(undefined, reason), digits)

    @classmethod
    def skipped(cls, name: str, why: str) -> Clause:
        """Not measured."""
        return cls(name, Interval.undefined(), "", None, f"not measured: {why}")

    @classmethod
    def from_entry(cls, held: Mapping[str, Any]) -> Clause:
        """What `entry` gave, but for the digits."""
        mean, low, high = (math.nan if held[key] is None else float(held[key]) for key in ("value", "low", "high"))
        # A table that was read back has NaN for every null.
        holds = held["holds"] if isinstance(held["holds"], bool) else None
        return cls(held["name"], Interval(mean, low, high, int(held["n"])), held["bound"], holds, held["reason"])

    @property
    def entry(self) -> dict[str, Any]:
        """For JSON: name, value, low, high, n, bound, holds, reason."""
        return {"name": self.name, "value": self.value.mean, "low": self.value.low, "high": self.value.high,
                "n": self.value.n, "bound": self.bound, "holds": self.holds, "reason": self.reason}

    @property
    def row(self) -> dict[str, Cell]:
        """For a table with `COLUMNS`."""
        return {"value": self.value.text(self.digits), "bound": self.bound, "holds": HOLDS[self.holds],
                "reason": self.reason}


def _both(first: str, second: str) -> str:
    return "; ".join(part for part in (first, second) if part)


def scaled(value: Interval, by: float) -> Interval:
    """An interval times a positive number."""
    return Interval(value.mean * by, value.low * by, value.high * by, value.n)


def summary(clauses: Sequence[Clause]) -> str:
    """How many hold of those that are judged."""
    asked = [clause for clause in clauses if clause.holds is not None]
    return f"{sum(bool(clause.holds) for clause in asked)} of {len(asked)} clauses hold."


def clause_table(title: str, clauses: Sequence[Clause], notes: Sequence[str] = (),
                 facts: Mapping[str, Any] | None = None) -> Table:
    """All of a group as a table; facts["clauses"] is the list of entries. ValueError where two share a name."""
    if len({clause.name for clause in clauses}) != len(clauses):
        raise ValueError("two clauses share a name")
    return Table(title, COLUMNS, {clause.name: clause.row for clause in clauses}, "clause",
                 [summary(clauses), *notes], {**(facts or {}), "clauses": [clause.entry for clause in clauses]})
