"""Bootstrap intervals: known answers and an independent library."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import bootstrap

from eval.bootstrap import interval


def test_a_constant_has_no_width() -> None:
    got = interval([2.0, 2.0, 2.0])
    assert (got.mean, got.low, got.high, got.clips) == (2.0, 2.0, 2.0, 3)


def test_it_agrees_with_scipy() -> None:
    values = np.random.default_rng(0).exponential(size=40)
    ours = interval(values, draws=20_000)
    theirs = bootstrap((values,), np.mean, n_resamples=20_000, method="percentile",
                       rng=np.random.default_rng(1)).confidence_interval
    np.testing.assert_allclose([ours.low, ours.high], [theirs.low, theirs.high], rtol=0.02)


def test_weights_make_a_mean_over_blocks() -> None:
    assert interval([1.0, 3.0], [3, 1]).mean == 1.5


def test_nothing_defined_is_nan_and_undefined_clips_are_left_out() -> None:
    assert math.isnan(interval([float("nan")]).mean)
    assert interval([1.0, float("nan"), 1.0]).clips == 2


def test_the_weighted_mean_agrees_with_scipys_paired_bootstrap_of_a_ratio() -> None:
    rng = np.random.default_rng(3)
    values, blocks = rng.normal(5, 1, 30), rng.integers(1, 200, 30).astype(float)
    ours = interval(values, blocks, draws=20_000)
    theirs = bootstrap((values * blocks, blocks), lambda top, under, axis: top.sum(axis) / under.sum(axis), paired=True,
                       n_resamples=20_000, method="percentile", rng=np.random.default_rng(4)).confidence_interval
    np.testing.assert_allclose([ours.low, ours.high], [theirs.low, theirs.high], atol=0.02)
    assert ours.low < ours.mean < ours.high and ours.clips == 30


def test_a_clip_without_blocks_says_nothing() -> None:
    got = interval([1.0, 50.0, 2.0], [3, 0, 3])
    assert got.mean == 1.5 and got.clips == 2 and 1.0 <= got.low <= got.high <= 2.0
    assert math.isnan(interval([1.0, 2.0], [0, 0]).mean) and interval([], []).clips == 0


@pytest.mark.parametrize(("values", "weights"), [
    ([1.0, float("inf")], None), ([[1.0, 2.0]], None), ([1.0, 2.0], [1.0]), ([1.0, 2.0], [1.0, -1.0]),
    ([1.0, 2.0], [1.0, float("nan")])])
def test_nonsense_is_refused(values: list[float], weights: list[float] | None) -> None:
    with pytest.raises(ValueError):
        interval(values, weights)
