"""Lexeme accuracy by hand and against scikit-learn; its chance level against every order; what fools it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from sklearn.metrics import accuracy_score, cohen_kappa_score

from eval.metrics.accuracy import agreement_by_chance, lexeme_accuracy

PAIRS = st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=40).map(np.array)


def test_by_hand() -> None:
    got = lexeme_accuracy([3, 1, 4, 1], [3, 1, 1, 4])
    assert (got.percent, got.blocks, got.reason) == (50.0, 4, "")
    assert lexeme_accuracy([7], [7]).percent == 100.0 and lexeme_accuracy([7], [0]).percent == 0.0
    # Shares 3/4, 1/4 and 1/2, 1/2: chance 3/8 + 1/8; three of four agree: (75 - 50) / 50.
    met = agreement_by_chance([0, 0, 0, 1], [0, 0, 1, 1])
    assert (met.percent, met.chance, met.kappa, met.blocks) == (75.0, 50.0, pytest.approx(0.5), 4)
    assert agreement_by_chance([0, 1], [1, 0]).kappa == pytest.approx(-1.0)


@given(PAIRS)
def test_it_is_scikit_learns(pairs: np.ndarray) -> None:
    own, chosen = pairs.T
    assert lexeme_accuracy(chosen, own).percent == pytest.approx(100 * accuracy_score(own, chosen))
    met = agreement_by_chance(own, chosen)
    assert met.percent == pytest.approx(lexeme_accuracy(chosen, own).percent)
    assume(not math.isnan(met.kappa))
    assert agreement_by_chance(chosen, own) == met
    assert met.kappa == pytest.approx(cohen_kappa_score(own, chosen), abs=1e-9)
    assert met.kappa <= 1.0 + 1e-12


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=1, max_size=6).map(np.array))
def test_chance_is_the_mean_over_every_order(pairs: np.ndarray) -> None:
    own, chosen = pairs.T
    every = [np.mean(own == np.array(order)) for order in itertools.permutations(chosen)]
    assert agreement_by_chance(own, chosen).chance == pytest.approx(100 * np.mean(every))


def test_undefined_is_nan_with_a_reason() -> None:
    nothing = lexeme_accuracy([], [])
    assert math.isnan(nothing.percent) and nothing.blocks == 0 and nothing.reason
    empty = agreement_by_chance(np.zeros(0, int), np.zeros(0, int))
    assert math.isnan(empty.percent) and math.isnan(empty.chance) and math.isnan(empty.kappa) and empty.reason
    one = agreement_by_chance([2, 2, 2], [2, 2, 2])
    assert (one.percent, one.chance) == (100.0, 100.0) and math.isnan(one.kappa) and "no room" in one.reason


@pytest.mark.parametrize(("first", "second"), [
    ([1, 2], [1]), ([], [1]), ([-1, 0], [0, 0]), ([0, 0], [0, -1]), ([0.5], [1.0]), ([float("nan")], [0]),
    ([[0, 1]], [[0, 1]]), (["a"], ["a"]), ([True], [True])])
def test_what_cannot_be_compared_is_refused(first: list[object], second: list[object]) -> None:
    for measure in (lexeme_accuracy, agreement_by_chance):
        with pytest.raises(ValueError):
            measure(first, second)  # type: ignore[operator, arg-type]


def test_what_the_chapter_says_fools_it_does() -> None:
    rng = np.random.default_rng(0)
    speaker = np.repeat(rng.choice(6, 300, p=[0.5, 0.1, 0.1, 0.1, 0.1, 0.1]), 3)  # runs of three blocks
    commonest = np.full_like(speaker, np.bincount(speaker).argmax())
    constant = agreement_by_chance(speaker, commonest)
    assert constant.percent > 40 and constant.kappa == pytest.approx(0.0, abs=1e-12)
    # Deaf, and told the lexeme before: the order of lexemes passes for hearing, by kappa too.
    copied = agreement_by_chance(speaker[1:], speaker[:-1])
    assert copied.percent > 70 and copied.kappa > 0.6
    # A draw from the true distribution is worse than its arg max: 0.7^2 + 0.3^2 against 0.7.
    own, drawn = rng.random((2, 4000)) < 0.3
    assert lexeme_accuracy(drawn.astype(int), own.astype(int)).percent == pytest.approx(58, abs=3)
    assert lexeme_accuracy(np.zeros(4000, int), own.astype(int)).percent == pytest.approx(70, abs=3)
