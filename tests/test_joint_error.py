"""MAJE and MAD against plain loops and scikit-learn, and what they leave out."""

import math
from dataclasses import replace

import numpy as np
import pytest
from bursts import turned
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import mean_absolute_error

from data_module.motion import rotation
from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER, facing
from data_module.types import Array, Motion
from eval.metrics.joint_error import joint_error, motion_error


def waving(frames: int, phase: float = 0.0, fps: float = 20.0, joint: str = "LeftArm", size: float = 0.6) -> Motion:
    """The character with one joint that swings about the forward axis once a second."""
    angle = size * np.sin(2 * np.pi * (np.arange(frames) / fps + phase))
    return turned(frames, fps, {joint: np.outer(angle, [0, 0, 1])})


def test_nothing_to_compare_is_nan_with_a_reason_never_zero() -> None:
    some = np.zeros((5, 2, 3))
    nothing = joint_error(some[:, :0], some[:, :0], 20)
    assert math.isnan(nothing.maje) and math.isnan(nothing.mad) and "any frame" in nothing.reason
    brief = joint_error(some[:2], some[:2], 20)
    assert brief.maje == 0 and math.isnan(brief.mad) and "three frames" in brief.reason
    assert math.isnan(joint_error(some[:0], some[:0], 20).maje)
    assert joint_error(some, some, 20).reason == ""


@pytest.mark.parametrize(("generated", "truth", "fps"), [
    (np.zeros((3, 2, 3)), np.zeros((4, 2, 3)), 20.0), (np.zeros((3, 6)), np.zeros((3, 6)), 20.0),
    (np.zeros((3, 2, 3)), np.zeros((3, 2, 3)), 0.0), (np.zeros((3, 2, 3)), np.zeros((3, 2, 3)), float("nan")),
    (np.full((3, 2, 3), np.nan), np.zeros((3, 2, 3)), 20.0),
])
def test_what_cannot_be_compared_is_refused(generated: Array, truth: Array, fps: float) -> None:
    with pytest.raises(ValueError):
        joint_error(generated, truth, fps)


def test_motions_are_compared_in_their_facing_frames_without_the_root() -> None:
    truth = waving(40)
    turn = rotation.from_exponential_map(np.array([0.0, 1.1, 0.0]))
    elsewhere = replace(truth, root_positions=truth.root_positions + 3.0, rotations=truth.rotations.copy())
    elsewhere.rotations[:, 0] = rotation.multiply(turn, truth.rotations[:, 0])
    assert motion_error(elsewhere, truth).maje == pytest.approx(0, abs=1e-6)
    got = motion_error(waving(40, phase=0.5), truth)
    # By hand: only the left forearm and hand move.
    places = [positions_of(facing(m)) for m in (waving(40, phase=0.5), truth)]
    assert got.maje == pytest.approx(1000 * np.abs(places[0] - places[1]).sum() / (40 * 15 * 3))


def test_absent_joints_do_not_count() -> None:
    truth, other = waving(40), waving(40, phase=0.25)
    lacking = replace(truth, absent=("LeftForeArm", "LeftHand"))
    # With what moves masked, nothing is wrong; with the whole body masked, nothing is known.
    assert motion_error(other, lacking).maje == pytest.approx(0, abs=1e-9)
    assert math.isnan(motion_error(other, replace(truth, absent=CHARACTER.names)).maje)


def test_motions_that_do_not_fit_are_refused() -> None:
    truth = waving(40)
    longer_arms = replace(CHARACTER, offsets=CHARACTER.offsets * 1.1)
    for other in (waving(39), waving(40, fps=30.0), replace(truth, skeleton=longer_arms)):
        with pytest.raises(ValueError):
            motion_error(other, truth)


@given(frames=st.integers(3, 12), joints=st.integers(1, 5), seed=st.integers(0, 99),
       fps=st.sampled_from([15.0, 20.0, 60.0]))
def test_every_convention_agrees_with_scikit_learn_and_plain_loops(frames: int, joints: int, seed: int, fps: float
                                                                   ) -> None:
    ours, theirs = np.random.default_rng(seed).normal(size=(2, frames, joints, 3))
    got = joint_error(ours, theirs, fps)
    assert got.maje == pytest.approx(1000 * mean_absolute_error(theirs.ravel(), ours.ravel()))

    def braking(places: Array, t: int, j: int) -> Array:  # mm per squared frame, of each motion by itself
        return 1000 * ((places[t + 1, j] - places[t, j]) - (places[t, j] - places[t - 1, j]))

    apart = [braking(ours, t, j) - braking(theirs, t, j) for t in range(1, frames - 1) for j in range(joints)]
    length = math.fsum(math.hypot(*vector) for vector in apart) / len(apart)
    assert got.mad_per_frame == pytest.approx(length)
    assert got.mad * (1 / fps) ** 2 == pytest.approx(length)
