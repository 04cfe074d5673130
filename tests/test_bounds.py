"""A bound at its ends; what is skipped, undefined or read back."""

import json
import math

import pytest

from eval.acceptance.bounds import ANY, Bound, Verdict, summary, verdict_table
from eval.stats import Interval
from eval.table import Table, dumps


def test_a_bound_holds_at_its_ends_and_nothing_holds_nan() -> None:
    assert Bound(high=0.6).keeps(0.6) and not Bound(high=0.6).keeps(0.61)
    assert Bound(low=18.0).keeps(18.0) and not Bound(low=18.0).keeps(17.9)
    assert not Bound(high=0.001, strict=True).keeps(0.001) and Bound(high=0.001, strict=True).keeps(0.0009)
    assert not Bound(low=0.0, strict=True).keeps(0.0)
    assert not ANY.keeps(math.nan)
    assert [bound.text(1) for bound in (Bound(high=2.0), Bound(low=3.0), Bound(1.0, 2.0), Bound(high=1.0, strict=True),
                                        Bound(low=0.0, strict=True), ANY)] == [
        "at most 2.0", "at least 3.0", "1.0 to 2.0", "below 1.0", "above 0.0", ""]


def test_a_clause_is_judged_by_its_mean_and_what_is_undefined_is_broken() -> None:
    wide = Verdict("a", Bound(high=0.6), Interval(0.5, 0.1, 0.9, 8))
    assert wide.holds is True and wide.entry == {"name": "a", "value": 0.5, "low": 0.1, "high": 0.9, "n": 8,
                                                 "bound": "at most 0.60", "holds": True, "reason": ""}
    nothing = Verdict("b", Bound(low=1.0), Interval.undefined(), reason="why")
    assert nothing.holds is False and nothing.entry["reason"] == "undefined: the motion has nothing of it; why"
    shown = Verdict("c", ANY, Interval.exact(3.0, 1))
    left = Verdict("d", ANY, Interval.undefined())
    assert shown.holds is None and left.holds is None
    every = [wide, nothing, shown, left]
    assert summary(every) == "1 of 2 clauses hold."
    table = verdict_table("t", every)
    assert "| b | - | at least 1.00 | NO |" in table.markdown()
    again = Table.from_dict(json.loads(dumps(table.to_dict()))).facts["clauses"]
    assert [entry["name"] for entry in again] == ["a", "b", "c", "d"]
    beside = verdict_table("t", [wide], {"theirs": [Verdict("a", Bound(high=0.6), Interval.exact(0.7, 1))]})
    assert beside.rows["a"]["theirs"] == "0.70 !"
    with pytest.raises(ValueError, match="of one figure"):
        verdict_table("t", [wide, wide])
