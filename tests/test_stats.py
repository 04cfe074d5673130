"""Intervals: known answers, an independent library, and what the older results were computed with."""

import math

import numpy as np
import pytest
from scipy.stats import bootstrap

from eval.stats import Interval, crossed_means, jackknife, limits, mean_interval, of_set, paired

RNG = np.random.default_rng(7)


def test_it_agrees_with_scipy() -> None:
    values = RNG.exponential(size=40)
    ours = mean_interval(values, draws=20_000)
    theirs = bootstrap((values,), np.mean, n_resamples=20_000, method="percentile",
                       rng=np.random.default_rng(1)).confidence_interval
    np.testing.assert_allclose([ours.low, ours.high], [theirs.low, theirs.high], rtol=0.02)


def test_the_weighted_mean_agrees_with_scipys_paired_bootstrap_of_a_ratio() -> None:
    values, blocks = RNG.normal(5, 1, 30), RNG.integers(1, 200, 30).astype(float)
    ours = mean_interval(values, blocks, draws=20_000)
    theirs = bootstrap((values * blocks, blocks), lambda top, under, axis: top.sum(axis) / under.sum(axis), paired=True,
                       n_resamples=20_000, method="percentile", rng=np.random.default_rng(4)).confidence_interval
    np.testing.assert_allclose([ours.low, ours.high], [theirs.low, theirs.high], atol=0.02)
    assert ours.low < ours.mean < ours.high and ours.n == 30


def test_the_basic_interval_of_a_set_agrees_with_scipy() -> None:
    values = RNG.normal(size=50)
    ours = of_set(lambda chosen: float(values[chosen].std()), 50, draws=8000)
    theirs = bootstrap((values,), np.std, n_resamples=8000, method="basic", rng=np.random.default_rng(2))
    np.testing.assert_allclose([ours.low, ours.high],
                               [theirs.confidence_interval.low, theirs.confidence_interval.high], atol=0.02)


def test_clips_of_one_group_are_drawn_together() -> None:
    """Twenty copies of each of four values say no more than the four."""
    values = np.array([1.0, 2.0, 4.0, 9.0])
    copies = mean_interval(np.repeat(values, 20), groups=[str(k) for k in np.repeat(np.arange(4), 20)])
    alone, naive = mean_interval(values), mean_interval(np.repeat(values, 20))
    assert copies == alone and copies.n == 4 and naive.high - naive.low < 0.5 * (alone.high - alone.low)


def test_raters_and_clips_both_move_a_crossed_mean_and_systems_are_paired() -> None:
    """The variance of a crossed mean is that of its rows plus that of its columns (for values that add both)."""
    rows, columns = RNG.normal(0, 3, 40), RNG.normal(0, 1, 50)
    drawn = crossed_means((rows[:, None] + columns)[:, :, None], draws=20_000)[:, 0]
    assert drawn.std() == pytest.approx(math.sqrt(rows.var() / 40 + columns.var() / 50), rel=0.03)
    means = crossed_means(np.stack([np.ones((3, 4)), np.full((3, 4), 2.0)], axis=2), draws=10)
    assert means.shape == (10, 2) and (means[:, 1] - means[:, 0] == 1).all()


def test_the_same_seed_gives_what_results_were_computed_with() -> None:
    """Bounds of the bootstrap that stood here before, for the seed 0; the order of draws may not change."""
    values = np.arange(12.0) ** 1.5
    index = np.random.default_rng(0).integers(12, size=(2000, 12))
    low, high = np.percentile(values[index].mean(axis=1), [2.5, 97.5])
    found = mean_interval(values)
    assert (found.low, found.high) == pytest.approx((low, high), rel=1e-12)


def test_the_jackknife_of_a_mean_is_the_values_and_takes_the_bias_off_a_variance() -> None:
    values = RNG.normal(size=9)
    np.testing.assert_allclose(jackknife(lambda k: float(values[k].mean()), 9), values)
    assert jackknife(lambda k: float(values[k].var()), 9).mean() == pytest.approx(values.var(ddof=1))
    assert jackknife(lambda k: 3.0, 1).tolist() == [3.0]


def test_a_pair_of_rows_is_compared_clip_by_clip() -> None:
    first, noise = RNG.normal(size=30), RNG.normal(scale=1e-3, size=30)
    assert paired(first + 0.1 + noise, first).above() and not mean_interval(first + 0.1 + noise).above(first.mean())


def test_what_is_undefined_is_left_out_or_nan() -> None:
    assert math.isnan(mean_interval([float("nan")]).mean) and mean_interval([], []).n == 0
    got = mean_interval([1.0, 50.0, 2.0, float("nan")], [3, 0, 3, 3])
    assert got.mean == 1.5 and got.n == 2 and 1.0 <= got.low <= got.high <= 2.0
    assert math.isnan(of_set(lambda chosen: 2.0, 1).low) and math.isnan(limits(1.0, [math.nan], 3).low)
    assert of_set(lambda chosen: 0.0 if len(set(chosen)) == 5 else 1.0, 5, least=0.0).low == 0.0


@pytest.mark.parametrize(("values", "weights"), [
    ([1.0, float("inf")], None), ([[1.0, 2.0]], None), ([1.0, 2.0], [1.0]), ([1.0, 2.0], [1.0, -1.0]),
    ([1.0, 2.0], [1.0, float("nan")])])
def test_nonsense_is_refused(values: list[float], weights: list[float] | None) -> None:
    with pytest.raises(ValueError):
        mean_interval(values, weights)


def test_an_interval_is_shown_and_kept() -> None:
    own = Interval(1.234, 1.0, 1.5, 4)
    assert own.text() == "1.23 [1.00, 1.50]" and own.text(1, sign=True) == "+1.2 [1.0, 1.5]"
    assert Interval.exact(2.0, 1).text(0) == "2" and Interval.undefined().text() == "-"
    assert Interval.from_dict(own.to_dict()) == own
    assert own.above(0.9) and not own.above(1.0) and own.below(1.6) and not own.below(1.5)
