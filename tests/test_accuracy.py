"""Lexeme accuracy by hand and against scikit-learn; what fools it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import accuracy_score

from eval.metrics.accuracy import lexeme_accuracy

PAIRS = st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=40).map(np.array)


def test_of_nothing_it_is_undefined() -> None:
    assert math.isnan(lexeme_accuracy([], []))


@given(PAIRS)
def test_it_is_scikit_learns(pairs: np.ndarray) -> None:
    own, chosen = pairs.T
    assert lexeme_accuracy(chosen, own) == pytest.approx(100 * accuracy_score(own, chosen))


@pytest.mark.parametrize(("first", "second"), [
    ([1, 2], [1]), ([], [1]), ([-1, 0], [0, 0]), ([0, 0], [0, -1]), ([0.5], [1.0]), ([float("nan")], [0]),
    ([[0, 1]], [[0, 1]]), (["a"], ["a"]), ([True], [True])])
def test_what_cannot_be_compared_is_refused(first: list[object], second: list[object]) -> None:
    with pytest.raises(ValueError):
        lexeme_accuracy(first, second)  # type: ignore[arg-type]


def test_what_the_chapter_says_fools_it_does() -> None:
    rng = np.random.default_rng(0)
    speaker = np.repeat(rng.choice(6, 300, p=[0.5, 0.1, 0.1, 0.1, 0.1, 0.1]), 3)  # runs of three blocks
    assert lexeme_accuracy(np.full_like(speaker, np.bincount(speaker).argmax()), speaker) > 40
    # Deaf, and told the lexeme before: the order of lexemes passes for hearing.
    assert lexeme_accuracy(speaker[:-1], speaker[1:]) > 70
    # A draw from the true distribution is worse than its arg max: 0.7^2 + 0.3^2 against 0.7.
    own, drawn = (rng.random((2, 4000)) < 0.3).astype(int)
    assert lexeme_accuracy(drawn, own) == pytest.approx(58, abs=3)
    assert lexeme_accuracy(np.zeros(4000, int), own) == pytest.approx(70, abs=3)
