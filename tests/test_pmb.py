"""Matched beats: by hand, against a maximum matching, and against chance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from data_module.types import Array
from eval.pmb import DELTAS, above_chance, chance, delta_curve, matched, pmb

TIMES = st.lists(st.floats(0, 8), min_size=1, max_size=25).map(lambda values: np.sort(np.array(values)))


def test_by_hand() -> None:
    beats = np.array([1.0, 2.0, 3.0])
    assert pmb(beats, beats) == 100.0
    assert pmb(beats, beats + 0.11) == 0.0
    assert pmb(beats, beats - 0.09) == 100.0
    # three onsets near one motion beat are one match, not three
    assert pmb(np.array([1.0]), np.array([0.93, 1.0, 1.07]), 0.2) == 100.0
    # two motion beats near one onset: the onset is used once
    assert pmb(np.array([0.95, 1.05]), np.array([1.0])) == 50.0
    # the earliest free onset: taking the nearest would leave the second beat with none
    assert pmb(np.array([1.0, 1.1]), np.array([0.92, 1.02]), 0.1) == 100.0
    # two onsets 30 ms apart are one event
    assert pmb(np.array([1.0, 1.05]), np.array([1.0, 1.03])) == 50.0
    assert pmb(beats, np.zeros(0)) == 0.0
    assert math.isnan(pmb(np.zeros(0), beats))
    assert pmb(beats[::-1], np.array([3.0, 1.0])) == pytest.approx(200 / 3)


@given(beats=TIMES, onsets=TIMES, delta=st.sampled_from([0.05, 0.1, 0.2, 0.5]))
def test_greedy_in_order_finds_as_many_as_any_matching(beats: Array, onsets: Array, delta: float) -> None:
    pairs = matched(beats, onsets, delta)
    allowed = (onsets[None] > beats[:, None] - delta) & (onsets[None] < beats[:, None] + delta)
    best = maximum_bipartite_matching(csr_matrix(allowed), perm_type="column")
    assert np.count_nonzero(pairs >= 0) == np.count_nonzero(best >= 0)
    used = pairs[pairs >= 0]
    assert (np.diff(used) > 0).all()
    assert allowed[np.flatnonzero(pairs >= 0), used].all()


@given(beats=TIMES, onsets=TIMES)
def test_a_wider_tolerance_never_matches_less(beats: Array, onsets: Array) -> None:
    curve = delta_curve(beats, onsets)
    assert (np.diff(curve.percent) >= 0).all()
    assert 0 <= curve.area <= curve.percent[-1] <= 100
    assert curve.percent[3] == pmb(beats, onsets, DELTAS[3])


def test_the_area_is_the_mean_height() -> None:
    curve = delta_curve(np.array([1.0, 2.0]), np.array([1.0, 2.1]), (0.05, 0.1, 0.2))
    assert curve.percent.tolist() == [50, 50, 100]
    assert curve.area == pytest.approx((0.05 * 25 + 0.05 * 50 + 0.1 * 75) / 0.2)


@pytest.mark.parametrize(("delta", "expected"), [(0.05, 28), (0.1, 56), (0.2, 95)])
def test_chance_is_what_unrelated_beats_reach(delta: float, expected: float) -> None:
    rng = np.random.default_rng(0)
    onsets = np.cumsum(rng.uniform(0.2, 0.5, 1500))
    beats = np.cumsum(rng.uniform(0.5, 1.5, 500))
    level = chance(beats[beats < onsets[-1]], onsets, float(onsets[-1]), delta, shifts=40)
    assert abs(level.mean - expected) < 4
    assert level.p_value > 0.02


def test_beats_in_time_stand_out_and_the_seed_decides() -> None:
    rng = np.random.default_rng(1)
    onsets = np.cumsum(rng.uniform(0.25, 0.8, 150))
    beats = onsets[::3] + rng.normal(0, 0.03, 50)
    duration = float(onsets[-1]) + 0.5
    level = chance(beats, onsets, duration)
    assert level == chance(beats, onsets, duration)
    assert level != chance(beats, onsets, duration, seed=1)
    assert level.p_value == 1 / 201
    assert above_chance(pmb(beats, onsets), level.mean) > 0.8
    assert math.isnan(chance(np.zeros(0), onsets, duration).mean)


def test_above_chance_by_hand() -> None:
    assert above_chance(75.0, 50.0) == 0.5
    assert above_chance(50.0, 50.0) == 0.0
    assert above_chance(100.0, 50.0) == 1.0
    assert math.isnan(above_chance(100.0, 100.0))
    assert math.isnan(above_chance(float("nan"), 50.0))
