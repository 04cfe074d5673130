"""Motion beats: known moments of known movements."""

import numpy as np
import pytest
from bursts import turned

from data_module.motion.motion_beats import acting_speed, motion_beats
from data_module.types import Array, Motion, Skeleton

BRAKE = (3 + np.sqrt(3)) / 6
"""Where a minimum-jerk movement brakes hardest: the larger root of 1 - 6 u + 6 u^2, of its duration."""


def reach(time: Array, start: float, duration: float, size: float) -> Array:
    u = np.clip((time - start) / duration, 0, 1)
    return size * (10 * u ** 3 - 15 * u ** 4 + 6 * u ** 5)


def arm_motion(angle: Array, fps: float, joint: str = "RightArm", yaw: float = 0.0) -> Motion:
    """One joint turns about Z by `angle` [T]; elbow and wrist go round circles, so their speeds follow the angle's."""
    return turned(len(angle), fps, {joint: np.outer(angle, [0, 0, 1]), "Hips": [0, yaw, 0]})


STARTS = np.array([0.8, 2.1, 3.4, 4.7, 6.0])


def reaches(fps: float, duration: float = 0.6, size: float = 1.0) -> Array:
    time = np.arange(round(8 * fps)) / fps
    return sum((reach(time, start, duration, size * (-1) ** i) for i, start in enumerate(STARTS)), np.zeros(len(time)))


@pytest.mark.parametrize(("fps", "tolerance"), [(20.0, 0.02), (30.0, 0.015), (60.0, 0.012), (120.0, 0.012)])
@pytest.mark.parametrize("duration", [0.4, 0.6, 0.9])
def test_a_reach_beats_where_it_brakes_hardest(fps: float, tolerance: float, duration: float) -> None:
    beats = motion_beats(arm_motion(reaches(fps, duration), fps))
    assert len(beats) == len(STARTS)
    assert np.abs(beats - (STARTS + BRAKE * duration)).max() < tolerance


def test_beats_lie_between_frames() -> None:
    """At 20 fps frames are 50 ms apart; reaches that start anywhere are found far closer than half of that."""
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(20):
        start = rng.uniform(1, 1.5)
        angle = reach(np.arange(60) / 20, start, 0.6, 1.0)
        errors.append(motion_beats(arm_motion(angle, 20.0))[0] - start - BRAKE * 0.6)
    assert np.std(errors) < 0.006


def test_mode_b_finds_the_stillness_between_movements() -> None:
    fps = 60.0
    time = np.arange(round(6 * fps)) / fps
    beats = motion_beats(arm_motion(0.8 * np.sin(2 * np.pi * 0.5 * time), fps), "B")
    turning = np.arange(0.5, 6, 1.0)  # where the sine turns back its speed is 0
    assert len(beats) == len(turning)
    assert np.abs(beats - turning).max() < 0.01


def test_neither_the_skeleton_nor_its_heading_matters() -> None:
    motion = arm_motion(reaches(60.0), 60.0)
    expected = motion_beats(motion)
    assert np.allclose(motion_beats(arm_motion(reaches(60.0), 60.0, yaw=2.0)), expected, atol=1e-6)
    named = Skeleton(tuple(f"mixamorig:{name}" for name in motion.skeleton.names), motion.skeleton.parents,
                     motion.skeleton.offsets)
    walking = np.cumsum(np.random.default_rng(0).normal(0, 0.1, (len(motion), 3)), axis=0)
    assert np.allclose(motion_beats(Motion(named, motion.rotations, walking, 60.0)), expected, atol=1e-6)


def test_acting_speed_is_the_sum_of_speeds_in_metres_per_second() -> None:
    time = np.arange(120) / 60
    positions = np.stack([np.outer(time, [3, 4, 0]), np.outer(time, [0, 0, -2])], axis=1)
    assert np.allclose(acting_speed(positions, 60.0), 7.0)
    assert acting_speed(positions[:1], 60.0).tolist() == [0.0]
