"""Bootstrap intervals: known answers and an independent library."""

from __future__ import annotations

import math

import numpy as np
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
