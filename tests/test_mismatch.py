"""The mismatch test: exact against every assignment, honest where nothing is there."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from eval.metrics import pmb
from eval.metrics.mismatch import mismatch, wrapped


def test_the_p_value_of_a_few_clips_is_that_of_all_assignments() -> None:
    values = np.random.default_rng(3).normal(size=(5, 5)) + np.eye(5)
    every = [np.mean([values[i, j] for i, j in enumerate(order)]) for order in itertools.permutations(range(5))]
    got = mismatch(values)
    assert got.p_value == pytest.approx(np.mean(np.array(every) >= np.trace(values) / 5 - 1e-12))
    assert got.right == pytest.approx(np.diag(values).mean())
    assert got.wrong == pytest.approx(values[~np.eye(5, dtype=bool)].mean())
    assert got.difference.mean == pytest.approx(got.right - got.wrong) and got.difference.n == 5


def test_perfect_preference_has_the_least_p_there_is() -> None:
    assert mismatch(np.eye(4)).p_value == pytest.approx(1 / 24)
    many = mismatch(np.eye(12), draws=999)
    assert many.p_value == pytest.approx(1 / 1000) and many.difference.low == 1.0


def test_good_motions_and_easy_speeches_prove_nothing() -> None:
    rng = np.random.default_rng(1)
    table = rng.normal(size=(10, 1)) * 5 + rng.normal(size=(1, 10)) * 5
    assert mismatch(table, draws=199).p_value == 1.0, "all assignments are alike"
    ps = [mismatch(rng.normal(size=(6, 6))).p_value for _ in range(60)]
    assert 0.35 < np.mean(ps) < 0.65 and np.mean(np.array(ps) < 0.1) < 0.25


def test_undefined_clips_are_left_out() -> None:
    values = np.eye(4)
    values[2] = np.nan
    got = mismatch(values)
    assert got.right == 1.0 and got.difference.n == 3 and got.p_value == pytest.approx(1 / 6)
    for few in (np.ones((1, 1)), np.zeros((0, 0)), np.full((3, 3), np.nan)):
        alone = mismatch(few)
        assert np.isnan(alone.p_value) and "a wrong speech takes two" in alone.reason
    with pytest.raises(ValueError):
        mismatch(np.ones((2, 3)))


def test_speech_goes_round() -> None:
    onsets = np.array([0.5, 1.5])
    np.testing.assert_allclose(wrapped(onsets, 2.0, 5.0), [0.5, 1.5, 2.5, 3.5, 4.5])
    np.testing.assert_allclose(wrapped(onsets, 2.0, 1.0), [0.5])
    assert len(wrapped(np.zeros(0), 2.0, 5.0)) == 0
    with pytest.raises(ValueError):
        wrapped(onsets, 0.0, 5.0)


def test_pmb_prefers_the_speech_that_was_beaten_to() -> None:
    rng = np.random.default_rng(0)
    speeches = [np.sort(rng.uniform(0, 20, 30)) for _ in range(8)]
    beats = [np.sort(rng.choice(own, 15, replace=False) + rng.normal(0, 0.02, 15)) for own in speeches]
    table = np.array([[pmb.pmb(own, speech, 0.05) for speech in speeches] for own in beats])
    assert mismatch(table).p_value < 0.001
    assert mismatch(np.roll(table, 1, axis=1)).p_value > 0.05
