"""Hands of the default character outside its trunk and face, elbows off its back: known answers, speeds, the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from performances import example

from data_module.motion import rotation
from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER, FINGERED
from data_module.types import Array, Motion
from eval.metrics.eye.body import common_body
from eval.metrics.eye.trunk import elbow_behind, fastest_elbow
from gesticulator import Gesticulator
from gesticulator.body.clips import mirrored_motion
from gesticulator.contacts.columns import TRUNK
from gesticulator.contacts.default_body import (
    HEM,
    STEEPEST,
    cleared,
    front_at,
    shirt_at,
)
from gesticulator.contacts.limbs import pose_of

FPS = 60.0


def reaching(angles: Array, elbow: Array) -> Motion:
    """An arm swung across the body by `angles` [T] and bent by `elbow` [T], radians, from a T-pose, half lowered."""
    turns = np.zeros((len(angles), len(FINGERED), 4))
    turns[..., 0] = 1.0
    down = rotation.from_exponential_map(np.tile([0.0, 0.0, -1.1], (len(angles), 1)))
    across = rotation.from_exponential_map(angles[:, None] * [0.0, -1.0, 0.0])
    turns[:, FINGERED.index("LeftArm")] = rotation.multiply(across, down)
    turns[:, FINGERED.index("LeftForeArm")] = rotation.from_exponential_map(elbow[:, None] * [0.0, -1.0, 0.0])
    return Motion(FINGERED, turns, np.zeros((len(angles), 3)), FPS)


def test_a_shirt_hangs_over_hips_that_are_wider_than_the_trunk() -> None:
    """The shirt of the figure in pages: at its hem 0.176 and 0.129 m, where the trunk has 0.145 and 0.115."""
    across, length = np.linspace(-0.3, 0.3, 601), np.full(601, 0.53)
    at = [shirt_at(across, np.full(601, along), length) for along in (-HEM, -0.04, 0.0)]
    for front in at:
        np.testing.assert_allclose(front, at[0])
        assert np.abs(np.diff(front) / np.diff(across)).max() <= STEEPEST + 1e-6
    # The superellipse of the page, seven millimetres within its surface.
    angle = np.linspace(0.3, 0.5 * np.pi, 50)
    x, z = 0.168 * np.cos(angle) ** 0.86, 0.122 * np.sin(angle) ** 0.86 - 0.006
    assert (np.interp(x, across, at[0]) > z - 0.001).all()
    high = np.full(601, 0.2)
    np.testing.assert_array_equal(shirt_at(across, high, length), front_at(across, high, length))
    heights = np.linspace(-HEM - 0.04, 0.4, 1401)
    profile = shirt_at(np.full(1401, 0.14), heights, np.full(1401, 0.53))
    assert np.abs(np.diff(profile) / np.diff(heights)).max() < STEEPEST, "no step where it begins and ends"


def test_a_hand_that_goes_through_the_trunk_passes_in_front_of_it() -> None:
    time = np.arange(120) / FPS
    motion = reaching(1.2 + 0.9 * np.sin(2 * np.pi * time), np.full(120, 1.9))
    before, free = TRUNK.distances(pose_of(motion))["Left"], cleared(motion)
    assert before.min() < -0.05, "it does go through"
    assert TRUNK.distances(pose_of(free))["Left"].min() > 0.0
    hand = FINGERED.index("LeftHand")
    speeds = [np.linalg.norm(np.diff(positions_of(one)[:, hand], axis=0), axis=1) * FPS for one in (motion, free)]
    assert speeds[1].max() < 2.0 * speeds[0].max(), "no jump"
    clear = before > 0.06
    still = [FINGERED.index(name) for name in ("Head", "RightArm", "LeftShoulder")]
    np.testing.assert_array_equal(free.rotations[:, still], motion.rotations[:, still])
    assert clear.any()


def test_a_pose_that_is_clear_stays_bit_for_bit() -> None:
    motion = reaching(np.zeros(5), np.zeros(5))
    assert cleared(motion) is motion
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (4, len(CHARACTER), 1))
    tee = Motion(CHARACTER, turns, np.zeros((4, 3)), FPS)
    assert cleared(tee) is tee, "16 joints, without knuckles"


@settings(max_examples=25)
@given(st.floats(0.2, 2.4), st.floats(0.0, 2.4), st.floats(-0.02, 0.02))
def test_a_small_step_of_the_arm_is_a_small_step_after_it(swing: float, elbow: float, step: float) -> None:
    pair = cleared(reaching(np.array([swing, swing + step]), np.array([elbow, elbow + step])))
    places = positions_of(pair)[:, FINGERED.index("LeftHand")]
    assert np.linalg.norm(places[1] - places[0]) < 0.004 + 3.0 * abs(step)


def test_both_sides_are_mirror_images() -> None:
    time = np.arange(30) / FPS
    motion = reaching(1.2 + 0.9 * np.sin(4 * np.pi * time), np.full(30, 1.9))
    other = cleared(mirrored_motion(motion))
    assert rotation.angle_between(mirrored_motion(other).rotations, cleared(motion).rotations).max() < 1e-6


def drawn_back(back: Array) -> Motion:
    """A left arm whose hand is beside the belly, with its elbow turned behind the back by `back` [T], radians."""
    turns = np.zeros((len(back), len(FINGERED), 4))
    turns[..., 0] = 1.0
    down = rotation.from_exponential_map(np.tile([0.0, 0.0, -1.45], (len(back), 1)))
    behind = rotation.from_exponential_map(back[:, None] * [1.0, 0.0, -0.35])
    turns[:, FINGERED.index("LeftArm")] = rotation.multiply(behind, down)
    turns[:, FINGERED.index("LeftForeArm")] = rotation.from_exponential_map(np.tile([0.0, -1.3, 0.0], (len(back), 1)))
    return Motion(FINGERED, turns, np.zeros((len(back), 3)), FPS)


def test_an_elbow_behind_the_back_swings_outward_and_the_hand_stays() -> None:
    time = np.arange(60) / FPS
    motion = drawn_back(0.45 + 0.45 * np.sin(2 * np.pi * time))
    free = cleared(motion)
    elbow, hand = FINGERED.index("LeftForeArm"), FINGERED.index("LeftHand")
    before, after = (positions_of(one) for one in (motion, free))
    hips = before[0, 0]
    hidden = before[:, elbow] - hips
    assert ((hidden[:, 2] < -0.08) & (hidden[:, 0] < 0.2)).any(), "it was hidden"
    there = after[:, elbow] - hips
    assert not ((there[:, 2] < -0.08) & (there[:, 0] < 0.2)).any()
    moved = np.linalg.norm(after[:, elbow] - before[:, elbow], axis=1)
    steps = [np.linalg.norm(np.diff(places[:, elbow], axis=0), axis=1).max() for places in (before, after)]
    assert moved.max() > 0.03 and steps[1] < 2.5 * steps[0], "no jump"
    alone = TRUNK.distances(pose_of(motion))["Left"] > 0.08  # frames in which the hand is clear
    assert alone.any()
    np.testing.assert_allclose(after[alone][:, hand], before[alone][:, hand], atol=1e-6)
    turns = [rotation.from_exponential_map(np.zeros(3))]
    for one in (motion, free):
        world = turns[0]
        for joint in ("LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"):
            world = rotation.multiply(world, one.rotations[:, FINGERED.index(joint)])
        turns.append(world)
    assert rotation.angle_between(turns[1], turns[2]).max() < 1e-6, "the palm stays as it was"


def test_a_hand_folded_to_its_shoulder_takes_its_knuckles_out_of_the_trunk_by_the_wrist() -> None:
    """A pose of twice the intensity with the hands near the body: the knuckles were 3 cm inside."""
    share = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(60) / 60)
    turns = np.zeros((60, len(FINGERED), 4))
    turns[..., 0] = 1.0
    for joint, turn in (("LeftShoulder", (0.0, -0.1, 0.17)), ("LeftArm", (0.43, -0.88, -1.29)),
                        ("LeftForeArm", (-0.34, -2.84, 0.1))):
        turns[:, FINGERED.index(joint)] = rotation.from_exponential_map(np.tile(turn, (60, 1)))
    turns[:, FINGERED.index("LeftHand")] = rotation.from_exponential_map(share[:, None] * [0.0, 0.7, -1.6])
    motion = Motion(FINGERED, turns, np.zeros((60, 3)), FPS)
    free = cleared(motion)
    before, after = (TRUNK.distances(pose_of(one))["Left"] for one in (motion, free))
    assert before.min() < -0.015 and after.min() > -0.01
    places = [positions_of(one) for one in (motion, free)]
    for joint in ("LeftForeArm", "LeftHand"):
        np.testing.assert_allclose(*(place[:, FINGERED.index(joint)] for place in places), atol=0.015)
    knuckles = FINGERED.index("LeftHandMiddle1")
    steps = [np.linalg.norm(np.diff(place[:, knuckles], axis=0), axis=1).max() for place in places]
    assert steps[1] < 1.5 * steps[0], "no jump"


@pytest.mark.parametrize("knobs", [{}, {"intensity": 2.0, "legs": True}, {"energy": "lively", "mirror": True},
                                   {"hand_radius": 0.15, "hold_still": ((3.2, 5.0),)}])
@pytest.mark.filterwarnings("ignore:hand_radius")
def test_no_hand_is_in_the_trunk_and_no_elbow_behind_it_at_any_knob(knobs: dict, system: Gesticulator) -> None:
    motion = system(example(10.0), seed=1, **knobs).motion
    for gap in TRUNK.distances(pose_of(replace(motion, root_positions=np.zeros_like(motion.root_positions)))).values():
        assert gap.min() > -0.01
    body = common_body(motion)
    assert max(elbow_behind(body, side) for side in ("Left", "Right")) <= 1.0


def test_a_hand_that_is_moved_turns_to_the_same_side_as_its_neighbours() -> None:
    time = np.arange(120) / FPS
    motion = reaching(1.2 + 0.9 * np.sin(2 * np.pi * time), np.full(120, 1.9))
    # The forearm is turned by more than half a turn, where the quaternion of a matrix may lie on the other side.
    twist = rotation.from_exponential_map((2.9 + 0.4 * np.sin(3 * time))[:, None] * [1.0, 0.0, 0.0])
    arm = FINGERED.index("LeftForeArm")
    turns = motion.rotations.copy()
    turns[:, arm] = rotation.continuous(rotation.multiply(turns[:, arm], twist))
    free = cleared(replace(motion, rotations=turns))
    assert (free.rotations != turns).any()
    assert (np.sum(free.rotations[1:] * free.rotations[:-1], axis=-1) > 0).all()


@pytest.mark.parametrize("seed", [2, 7])
def test_no_elbow_jumps_in_the_example(seed: int, system: Gesticulator) -> None:
    """Seeds in which an elbow once jumped at 12 and 9 m/s."""
    motion = system(example(), seed=seed).motion
    assert fastest_elbow(common_body(motion)) < 4.0
