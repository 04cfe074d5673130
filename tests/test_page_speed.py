"""What the measure of the page's pictures counts."""

from __future__ import annotations

import numpy as np
import pytest
from benchmark_files import benchmark
from hypothesis import given
from hypothesis import strategies as st

page_speed = benchmark("page_speed")


def test_even_pictures_give_their_rate() -> None:
    made = page_speed.speed([100.0 * at for at in range(61)], [50.0] * 10)
    assert made.rate == pytest.approx(10.0) and made.median == made.slowest == pytest.approx(0.1)
    assert made.wait == pytest.approx(0.05) and made.suffices
    assert not page_speed.speed([101.0 * at for at in range(61)]).suffices, "9.9 a second"
    assert not page_speed.speed([20.0 * at for at in range(61)], [250.0] * 10).suffices, "the desk is slow"


def test_a_page_that_stands_still_for_a_second_is_not_fast_by_its_median() -> None:
    times = np.concatenate([np.arange(10) * 16.0, 2000.0 + np.arange(10) * 16.0])
    made = page_speed.speed(times)
    assert made.median == pytest.approx(0.016) and made.rate < 10.0 and not made.suffices


@given(st.lists(st.floats(1.0, 500.0), min_size=1, max_size=60), st.floats(0.0, 1e6))
def test_the_rate_is_that_of_the_mean_step_wherever_time_begins(steps: list[float], begin: float) -> None:
    made = page_speed.speed(begin + np.cumsum([0.0, *steps]))
    assert made.rate == pytest.approx(1000.0 / np.mean(steps), rel=1e-4)
    assert made.slowest >= made.median * 0.999


@pytest.mark.parametrize("times", [[], [1.0], [1.0, 1.0], [2.0, 1.0]])
def test_no_rate_without_two_pictures_in_their_order(times: list[float]) -> None:
    with pytest.raises(ValueError, match="rising"):
        page_speed.speed(times)


def test_a_row_has_a_cell_for_each_head() -> None:
    made = page_speed.row("talk.html", (960, 540), page_speed.speed([0.0, 50.0, 100.0], [30.0]))
    assert made.count("|") == page_speed.HEAD.splitlines()[0].count("|")
    assert "| 960 x 540 | 20.0 | 0.050 | 0.050 | 0.030 |" in made
