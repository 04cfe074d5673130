"""A bound at its ends, the parts of an interval held against it, what is skipped, undefined or read back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.acceptance.bounds import (
    ANY,
    HIGH,
    LOW,
    WHOLE,
    Bound,
    Claim,
    at_least,
    at_most,
    count,
    judged,
    skipped,
    summary,
    verdict_table,
)
from eval.stats import Interval
from eval.table import Table, dumps, loads


def test_a_bound_holds_at_its_ends_and_nothing_holds_nan() -> None:
    assert at_most(0.6).keeps(0.6) and not at_most(0.6).keeps(0.61)
    assert at_least(18.0).keeps(18.0) and not at_least(18.0).keeps(17.9)
    assert not Bound(high=0.001, strict=True).keeps(0.001) and Bound(high=0.001, strict=True).keeps(0.0009)
    assert not Bound(low=0.0, strict=True).keeps(0.0)
    assert not ANY.keeps(math.nan)


def test_a_bound_says_which_part_of_the_interval_it_is_of() -> None:
    bounds = (at_most(2.0), at_least(3.0), Bound(1.0, 2.0), Bound(high=1.0, strict=True), ANY,
              Bound(low=0.0, strict=True, of=LOW),
              Bound(low=0.0, of=HIGH), Bound(-5.0, 5.0, of=WHOLE))
    assert [bound.text(1) for bound in bounds] == [
        "at most 2.0", "at least 3.0", "1.0 to 2.0", "below 1.0", "", "lower end above 0", "upper end at least 0",
        "interval -5 to 5"]


@pytest.mark.parametrize(("bound", "holds"), [
    (Bound(low=0.4), True), (Bound(low=0.4, of=LOW), False), (Bound(low=0.4, of=WHOLE), None),
    (Bound(low=0.05, of=LOW), True), (Bound(low=0.05, of=WHOLE), True), (Bound(low=0.8, of=HIGH), True),
    (Bound(high=0.8, of=HIGH), False), (Bound(low=0.95, of=WHOLE), False), (Bound(high=0.05, of=WHOLE), False)])
def test_mean_ends_and_whole_interval_are_held_against_the_bound(bound: Bound, holds: bool | None) -> None:
    assert judged("a", Interval(0.5, 0.1, 0.9, 8), bound).holds is holds


@given(st.floats(-1, 1), st.floats(0, 1), st.floats(-1, 1))
def test_a_whole_interval_is_decided_only_where_both_of_its_ends_are(middle: float, half: float, limit: float) -> None:
    value, bound = Interval(middle, middle - half, middle + half, 3), Bound(low=limit, strict=True, of=WHOLE)
    ends = {bound.keeps(value.low), bound.keeps(value.high)}
    assert bound.holds(value) in ({True: (True,), False: (False, None)}[ends.pop()] if len(ends) == 1 else (None,))


def test_a_clause_is_judged_by_its_mean_and_what_is_undefined_is_broken() -> None:
    wide = judged("a", Interval(0.5, 0.1, 0.9, 8), at_most(0.6))
    assert wide.holds is True and wide.entry == {"name": "a", "value": 0.5, "low": 0.1, "high": 0.9, "n": 8,
                                                 "bound": "at most 0.60", "holds": True, "reason": ""}
    nothing = judged("b", Interval.undefined(), at_least(1.0), reason="why")
    assert nothing.holds is False and "undefined" in nothing.reason and nothing.reason.endswith("; why")
    assert Claim("e", Bound(low=0.0, of=WHOLE)).judge(Interval.undefined()).holds is None, "nothing is decided"
    shown, left = judged("c", 3.0), skipped("d", "no store")
    assert shown.holds is None and left.holds is None and "no store" in left.reason
    every = [wide, nothing, shown, left]
    assert summary([verdict.entry for verdict in every]) == "1 of 2 clauses hold."
    table = verdict_table("t", every)
    assert "| b | - | at least 1.00 | NO |" in table.markdown()
    again = Table.from_dict(loads(dumps(table.to_dict()))).facts["clauses"]
    assert count(again) == (1, 2) and [entry["name"] for entry in again] == ["a", "b", "c", "d"]
    with pytest.raises(ValueError, match="of one figure"):
        verdict_table("t", [wide, wide])
