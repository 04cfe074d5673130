"""Means over seeds and clips: the classical formulas, and intervals that hold the true mean as often as they say."""

import math

import numpy as np
import pytest
from scipy.stats import t

from data_module.types import Array
from eval.crossed import components, crossed, satterthwaite

RNG = np.random.default_rng(11)


def test_a_full_table_gives_the_mean_squares_of_the_text_books() -> None:
    table = RNG.normal(0, 3, (4, 1)) + RNG.normal(0, 2, (1, 9)) + RNG.normal(0, 1, (4, 9))
    seeds, clips, mean = table.mean(1), table.mean(0), table.mean()
    between_seeds, between_clips = 9 * seeds.var(ddof=1), 4 * clips.var(ddof=1)
    rest = ((table - seeds[:, None] - clips + mean) ** 2).sum() / (3 * 8)
    found = components(table)
    assert (found.seed, found.clip, found.rest) == pytest.approx(
        ((between_seeds - rest) / 9, (between_clips - rest) / 4, rest))
    total = between_seeds + between_clips - rest
    assert found.error ** 2 == pytest.approx(total / 36)
    freedom = total ** 2 / (between_seeds ** 2 / 3 + between_clips ** 2 / 8 + rest ** 2 / 24)
    assert found.freedom == pytest.approx(freedom)
    error, projected = satterthwaite(found.seed, found.clip, found.rest, np.array([4.0]), np.array([9.0]))
    assert (error[0], projected[0]) == pytest.approx((found.error, freedom))


def test_one_seed_is_students_interval_over_clips_and_one_clip_over_seeds() -> None:
    values = RNG.normal(2, 1, 12)
    error = values.std(ddof=1) / math.sqrt(12)
    low, high = t.interval(0.95, 11, values.mean(), error)
    for table in (values[None], values[:, None]):
        found = crossed(table)
        assert (found.mean, found.low, found.high) == pytest.approx((values.mean(), low, high))
        narrow = components(table).interval(0.9)
        assert (narrow.low, narrow.high) == pytest.approx(t.interval(0.9, 11, values.mean(), error))
    assert (crossed(values[None]).n, crossed(values[:, None]).n) == (12, 1)


def test_what_is_undefined_is_left_out_and_clips_are_weighed() -> None:
    with_gap = crossed([[1.0, np.nan], [3.0, np.nan]])
    assert (with_gap.mean, with_gap.n) == (2.0, 1) and with_gap.high - 2 == pytest.approx(t.ppf(0.975, 1))
    assert crossed([[1.0, 3.0]], [3, 1]).mean == 1.5
    assert crossed([[np.nan]]).n == 0 and math.isnan(crossed([[np.nan]]).mean)
    assert crossed([[4.0]]).text(1) == "4.0", "a single value has no bounds"
    same = crossed(np.full((3, 5), 2.0))
    assert (same.mean, same.low, same.high, same.n) == pytest.approx((2, 2, 2, 5), abs=1e-6)
    apart = crossed([[1.0, np.nan, np.nan], [np.nan, 2.0, np.nan], [np.nan, np.nan, 6.0]])
    assert apart.mean == 3 and apart.low < 0 < 6 < apart.high
    doubled = crossed(np.repeat(RNG.normal(size=(1, 5)), 3, axis=0))
    assert doubled.high > doubled.mean, "copies of a seed leave what clips differ by"


def test_the_interval_moves_and_scales_with_the_values() -> None:
    table = RNG.normal(size=(3, 8))
    table[1, 2] = np.nan
    found, other = components(table), components(5 - 2 * table)
    assert (other.mean, other.error, other.freedom) == pytest.approx((5 - 2 * found.mean, 2 * found.error,
                                                                      found.freedom))


def draw(rng: np.random.Generator, shape: tuple[int, int], sizes: tuple[float, float, float]) -> Array:
    """[seeds, clips] of mean 0; sizes: standard deviations of seeds, clips and rest."""
    seeds, clips = shape
    return np.asarray(sizes[0] * rng.normal(size=(seeds, 1)) + sizes[1] * rng.normal(size=clips)
                      + sizes[2] * rng.normal(size=shape))


def heavy(rng: np.random.Generator) -> Array:
    """One clip in fifteen is a hundred times as far out."""
    return draw(rng, (3, 15), (0.3, 0.0, 0.5)) + rng.normal(size=15) * np.where(rng.random(15) < 1 / 15, 100.0, 1.0)


def gaps(rng: np.random.Generator) -> Array:
    """Three in ten are missing."""
    table = draw(rng, (4, 18), (0.5, 1.0, 1.0))
    table[rng.random(table.shape) < 0.3] = np.nan
    return table


CASES = {
    "seeds dominate": lambda rng: draw(rng, (3, 15), (3.0, 0.5, 0.5)),
    "clips dominate": lambda rng: draw(rng, (3, 15), (0.1, 3.0, 1.0)),
    "both": lambda rng: draw(rng, (3, 15), (1.0, 3.0, 1.0)),
    "few seeds": lambda rng: draw(rng, (2, 15), (0.5, 1.0, 1.0)),
    "unbalanced": gaps,
}


@pytest.mark.parametrize("case", CASES)
def test_an_interval_of_95_in_100_holds_the_mean_in_93_to_97(case: str) -> None:
    rng = np.random.default_rng(5)
    found = [components(CASES[case](rng)).interval() for _ in range(1000)]
    assert 0.93 <= np.mean([interval.low <= 0 <= interval.high for interval in found]) <= 0.97


def test_where_one_clip_is_far_out_the_interval_is_rather_too_wide() -> None:
    rng = np.random.default_rng(5)
    found = [components(heavy(rng)).interval() for _ in range(1000)]
    assert 0.96 <= np.mean([interval.low <= 0 <= interval.high for interval in found]) <= 0.99
