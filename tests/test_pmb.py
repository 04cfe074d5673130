"""Matched beats: by hand, against a maximum matching, and against chance."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from data_module.motion import rotation, skeletons
from data_module.motion.motion_beats import motion_beats
from data_module.types import Array, Motion
from eval.metrics.pmb import DELTAS, above_chance, chance, delta_curve, matched, pmb, wrapped

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
    assert (np.diff(curve) >= 0).all() and curve[0] >= 0 and curve[-1] <= 100
    assert curve[3] == pmb(beats, onsets, DELTAS[3])


@pytest.mark.parametrize(("delta", "expected"), [(0.05, 28), (0.1, 56), (0.2, 95)])
def test_chance_is_what_unrelated_beats_reach(delta: float, expected: float) -> None:
    rng = np.random.default_rng(0)
    onsets = np.cumsum(rng.uniform(0.2, 0.5, 1500))
    beats = np.cumsum(rng.uniform(0.5, 1.5, 500))
    level = chance(beats[beats < onsets[-1]], onsets, float(onsets[-1]), delta, shifts=40)
    assert abs(level - expected) < 4


def test_beats_in_time_stand_out_and_the_seed_decides() -> None:
    rng = np.random.default_rng(1)
    onsets = np.cumsum(rng.uniform(0.25, 0.8, 150))
    beats = onsets[::3] + rng.normal(0, 0.03, 50)
    duration = float(onsets[-1]) + 0.5
    level = chance(beats, onsets, duration)
    assert level == chance(beats, onsets, duration)
    assert level != chance(beats, onsets, duration, seed=1)
    assert above_chance(pmb(beats, onsets), level) > 0.8


def test_above_chance_by_hand() -> None:
    assert above_chance(75.0, 50.0) == 0.5
    assert above_chance(50.0, 50.0) == 0.0
    assert above_chance(100.0, 50.0) == 1.0
    assert math.isnan(above_chance(100.0, 100.0))
    assert math.isnan(above_chance(float("nan"), 50.0))


@pytest.mark.parametrize(("mode", "at"), [("A", (3 + math.sqrt(3)) / 6), ("B", 1.0)])
def test_the_beats_of_either_mode_are_where_a_known_movement_has_them(mode: str, at: float) -> None:
    """The right arm swings there and back, each time along 10 u^3 - 15 u^4 + 6 u^5 in 0.7 s: it brakes hardest at the
    larger root of 1 - 6 u + 6 u^2, and stands still where it turns back."""
    fps, swings = 60.0, 6
    u = np.arange(round(0.7 * fps)) / round(0.7 * fps)
    there = 10 * u ** 3 - 15 * u ** 4 + 6 * u ** 5
    angles = np.zeros((swings * len(u), len(skeletons.CHARACTER), 3))
    angles[:, skeletons.CHARACTER.index("RightArm"), 2] = np.concatenate([there, 1 - there] * (swings // 2))
    motion = Motion(skeletons.CHARACTER, rotation.from_exponential_map(angles), np.zeros((len(angles), 3)), fps)
    beats = motion_beats(motion, mode)
    onsets = 0.7 * (np.arange(swings if mode == "A" else swings - 1) + at)
    assert len(beats) == len(onsets)
    assert pmb(beats, onsets, 0.03) == 100.0
    assert pmb(beats, onsets + 0.2, 0.1) == 0.0


def test_undefined_is_nan_and_without_onsets_it_is_zero() -> None:
    none, some = np.zeros(0), np.array([1.0, 2.0])
    assert math.isnan(chance(none, some, 5.0)) and np.isnan(delta_curve(none, some)).all()
    assert not delta_curve(some, none).any() and chance(some, none, 5.0) == 0.0


def test_nonsense_is_refused() -> None:
    good = np.array([1.0, 2.0])
    for bad in (np.array([np.nan, 1.0]), np.array([np.inf]), np.ones((2, 2))):
        for pair in ((bad, good), (good, bad)):
            for measure in (pmb, delta_curve, lambda beats, onsets: chance(beats, onsets, 5.0)):
                with pytest.raises(ValueError):
                    measure(*pair)
    for delta in (0.0, -0.1, float("nan"), float("inf")):
        with pytest.raises(ValueError):
            pmb(good, good, delta)
    for duration, shifts in ((0.0, 9), (float("nan"), 9), (5.0, 0)):
        with pytest.raises(ValueError):
            chance(good, good, duration, shifts=shifts)


def test_speech_goes_round() -> None:
    onsets = np.array([0.5, 1.5])
    np.testing.assert_allclose(wrapped(onsets, 2.0, 5.0), [0.5, 1.5, 2.5, 3.5, 4.5])
    np.testing.assert_allclose(wrapped(onsets, 2.0, 1.0), [0.5])
    assert len(wrapped(np.zeros(0), 2.0, 5.0)) == 0
