"""The rule of verdicts: known answers on either side of each bound, and experiments that are as often right as said."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eval.crossed import Components, components
from eval.rows.verdicts import FAILS, HOLDS, UNDECIDED, decide, needed_for, present
from eval.stats import Interval


def found(mean: float, error: float, seeds: int = 3) -> Components:
    """A difference with so many degrees of freedom that t is z: the intervals are 1.96 and 1.645 errors either way."""
    return Components(mean, 0.0, error ** 2 * 15, 0.0, error, 1e9, seeds, 15)


@pytest.mark.parametrize(("mean", "error", "above", "below", "reason"), [
    (3.0, 1.0, HOLDS, FAILS, "the opposite"), (-3.0, 1.0, FAILS, HOLDS, "the opposite"),
    (1.9, 1.0, UNDECIDED, UNDECIDED, ""), (0.0, 1.0, FAILS, FAILS, "equivalent to none"),
    (0.4, 1.0, UNDECIDED, UNDECIDED, ""), (1.0, 0.4, FAILS, FAILS, "less than half of the paper's effect"),
    (1.5, 0.4, HOLDS, FAILS, "the opposite")])
def test_a_margin_of_two_and_every_side_of_the_bounds(mean: float, error: float, above: str, below: str, reason: str
                                                      ) -> None:
    told = decide(found(mean, error), "above", 2.0)
    assert (told.word, decide(found(mean, error), "below", 2.0).word) == (above, below)
    assert reason in (told.reason, decide(found(mean, error), "below", 2.0).reason)
    mirrored = decide(found(-mean, error), "below", 2.0)
    assert (mirrored.word, mirrored.reason) == (told.word, told.reason)


@pytest.mark.parametrize(("mean", "error", "word"), [
    (0.0, 1.0, HOLDS), (1.0, 0.5, HOLDS), (1.0, 1.0, UNDECIDED), (5.0, 1.0, FAILS), (-5.0, 1.0, FAILS),
    (3.5, 1.0, UNDECIDED)])
def test_alike_is_within_the_margin(mean: float, error: float, word: str) -> None:
    assert decide(found(mean, error), "alike", 2.0).word == word


def test_two_seeds_decide_nothing_and_say_so() -> None:
    told = decide(found(9.0, 1.0, seeds=2), "above", 2.0)
    assert (told.word, told.reason, told.needed) == (UNDECIDED, "2 of 3 seeds", ())


def test_something_is_there_when_every_interval_is_above_zero() -> None:
    above, around, below = Interval(2, 1, 3, 9), Interval(0.5, -1, 2, 9), Interval(-2, -3, -1, 9)
    few = Interval(2, 1, 3, 2)
    assert present([above, above]).word == HOLDS and present([above]).value == above
    assert present([above, around]).word == UNDECIDED and present([above, around]).value == around
    assert present([above, below, around]).word == FAILS
    assert present([above, few]).word == UNDECIDED and "1 are over less than 3 clips" in present([above, few]).reason
    assert present([around]).needed == (1, math.ceil(9 * (2.8 * (3 / 3.92) / 0.5) ** 2))


@pytest.mark.parametrize("sizes", [(0.3, 1.0, 1.0), (0.1, 3.0, 1.0)])
def test_as_many_seeds_and_clips_as_are_named_decide_in_four_of_five_experiments(sizes: tuple[float, float, float]
                                                                                 ) -> None:
    seed, clip, rest = sizes
    margin = 1.0
    seeds, clips = needed_for(Components(0.3, seed ** 2, clip ** 2, rest ** 2, 1.0, 3.0, 3, 15), margin)
    rng, right = np.random.default_rng(3), {0.0: 0, 2 * margin: 0}
    for truth in right:
        for _ in range(80):
            table = truth + seed * rng.normal(size=(seeds, 1)) + clip * rng.normal(size=clips) + rest * rng.normal(
                size=(seeds, clips))
            right[truth] += decide(components(table), "above", margin).word == (HOLDS if truth else FAILS)
    assert right[0.0] / 80 == pytest.approx(0.85, abs=0.1), "the number is whole, so power is 80 % or a little more"
    assert right[2 * margin] / 80 > 0.75


def test_more_spread_or_a_narrower_margin_needs_more() -> None:
    base = Components(0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 3, 15)
    seeds, clips = needed_for(base, 2.0)
    assert clips == 60 and needed_for(base, 1.0)[0] > seeds
    wide = needed_for(Components(0.0, 0.01, 400.0, 1.0, 1.0, 2.0, 3, 15), 2.0)
    assert wide[1] > 60, "where clips differ by much, no number of seeds is enough"
