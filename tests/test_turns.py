"""What the measure of turns in channels counts."""

from __future__ import annotations

import numpy as np
import pytest
from benchmark_files import benchmark

from data_module.motion import rotation

turns = benchmark("turns")


def channels(path: np.ndarray) -> np.ndarray:
    return np.unwrap(rotation.to_euler(path, "zxy"), axis=0)


def about(axis: int, angles: np.ndarray) -> np.ndarray:
    return rotation.from_exponential_map(angles[:, None] * np.eye(3)[axis])


def test_channels_that_come_back_need_no_larger_step() -> None:
    angles = channels(about(0, np.radians(60.0) * np.sin(np.linspace(0.0, np.pi, 40))))
    assert turns.least_step(angles, angles[-1]) == pytest.approx(np.abs(np.diff(angles, axis=0)).max())


def test_a_full_turn_about_one_axis_jumps_by_the_half_of_it_where_the_poles_are_far() -> None:
    angles = channels(about(2, np.linspace(0.0, 2.0 * np.pi, 73)))
    end = angles[0]
    assert angles[-1] - end == pytest.approx([2.0 * np.pi, 0.0, 0.0])
    # Half a turn of all angles, to the other triple, and half a turn back.
    assert np.degrees(turns.least_step(angles, end)) == pytest.approx(180.0 - 5.0, abs=6.0)
    assert np.isinf(turns.least_step(angles, end + 0.5)), "other rotations"


def test_near_the_pole_the_same_turn_is_written_with_small_steps() -> None:
    lead = about(0, np.radians(89.0) * np.linspace(0.0, 1.0, 60) ** 0.5)
    over = rotation.multiply(np.repeat(lead[-1:], 60, axis=0), about(1, np.linspace(0.0, np.pi, 60)))
    angles = channels(np.concatenate([lead, over]))
    assert turns.least_step(angles, angles[-1]) <= np.abs(np.diff(angles, axis=0)).max() + 1e-9
