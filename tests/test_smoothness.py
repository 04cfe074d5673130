"""Jerk and acceleration against circles and polynomials worked by hand; the histogram distance against scipy."""

import numpy as np
import pytest
from bursts import turned
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import jensenshannon

from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER, facing
from data_module.types import Motion
from eval.metrics.smoothness import BIN, BINS, derivative, hand_figures, hellinger, speed_histogram


def waving(fps: float) -> Motion:
    time = np.arange(round(6.0 * fps)) / fps
    return turned(len(time), fps, {"RightArm": np.outer(np.sin(2 * np.pi * 0.7 * time), [0, 0, 0.5]),
                                   "LeftForeArm": np.outer(np.sin(2 * np.pi * 1.1 * time), [0, 0.4, 0])})


@pytest.mark.parametrize("fps", [60.0, 200.0])
def test_a_point_on_a_circle(fps: float) -> None:
    """Speed r w, acceleration r w^2, jerk r w^3."""
    radius, w = 0.3, 2 * np.pi * 0.8
    angle = w * np.arange(round(4 * fps)) / fps
    circle = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)[:, None]
    for order in (1, 2, 3):
        np.testing.assert_allclose(derivative(circle, fps, order), radius * w ** order, rtol=0.01)


def test_figures_are_means_over_both_hands() -> None:
    """By hand from the places of both wrists."""
    motion = waving(60.0)
    got, places = hand_figures(motion), positions_of(facing(motion))
    right, left = (derivative(places[:, [CHARACTER.index(f"{side}Hand")]], 60.0, 2) for side in ("Right", "Left"))
    assert got["acceleration_hands"] == pytest.approx((right.mean() + left.mean()) / 2)
    short = hand_figures(motion.crop(0, 3))
    assert np.isnan(short["jerk_hands"]) and short["acceleration_hands"] > 0


@given(st.lists(st.floats(0, 6), min_size=1, max_size=80))
def test_the_histogram_is_numpys(speeds: list[float]) -> None:
    own = np.asarray(speeds)
    own = own[np.abs(own / BIN - np.round(own / BIN)) > 1e-6]
    edges = np.append(BIN * np.arange(BINS), np.inf)
    np.testing.assert_array_equal(speed_histogram(own), np.histogram(own, edges)[0])
    assert speed_histogram(np.array([0.15]))[3] == 1, "0.15 / 0.05 is a hair under 3"


@given(st.integers(0, 2 ** 16))
def test_hellinger_by_the_printed_formula(seed: int) -> None:
    p, q = np.random.default_rng(seed).integers(0, 9, (2, 12)) + np.eye(1, 12, 0)
    assert hellinger(p, q) == pytest.approx(np.sqrt(max(0.0, 1 - np.sum(np.sqrt(p / p.sum() * q / q.sum())))), abs=1e-7)
    # A known bound of the Jensen-Shannon divergence, in nats.
    assert jensenshannon(p, q) ** 2 <= 2 * np.log(2) * hellinger(p, q) ** 2 + 1e-9


def test_empty_is_undefined_and_strangers_are_at_1() -> None:
    assert np.isnan(hellinger(np.ones(3), np.zeros(3)))
    assert hellinger(np.array([3.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 3.0])) == pytest.approx(1.0)
