"""Forward kinematics against hand calculation and against upc-pymotion."""

import numpy as np
import pytest
from pymotion.ops import skeleton as oracle
from scipy.spatial.transform import Rotation

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, Motion, Skeleton

ARM = Skeleton(("shoulder", "elbow", "wrist"), (-1, 0, 1), np.array([[0.0, 0, 0], [0.3, 0, 0], [0.25, 0, 0]]))


def random_pose(frames: int, joints: int, seed: int = 0) -> Array:
    q = Rotation.random(frames * joints, rng=np.random.default_rng(seed)).as_quat(scalar_first=True)
    return q.reshape(frames, joints, 4)


def test_positions_and_world_rotations_are_pymotions() -> None:
    pose, root = random_pose(20, len(CHARACTER)), np.random.default_rng(1).normal(size=(20, 3))
    parents = np.array([max(parent, 0) for parent in CHARACTER.parents])  # pymotion's root is its own parent
    expected, matrices = oracle.fk(pose, root, CHARACTER.offsets, parents)
    # pymotion adds 1e-8 to the length of a quaternion, which shows in the seventh digit down a chain.
    assert np.allclose(kinematics.joint_positions(CHARACTER, pose, root), expected, atol=1e-6)
    world = kinematics.global_rotations(CHARACTER, pose)
    ours = Rotation.from_quat(world.reshape(-1, 4), scalar_first=True).as_matrix().reshape(20, -1, 3, 3)
    assert np.allclose(ours, matrices, atol=1e-6)


def test_local_rotations_undo_global_rotations() -> None:
    pose = random_pose(10, len(CHARACTER), seed=3)
    back = kinematics.local_rotations(CHARACTER, kinematics.global_rotations(CHARACTER, pose))
    assert rotation.angle_between(back, pose).max() < 1e-7


def swing(fps: float, seconds: float) -> Motion:
    """An arm that turns at one radian a second while it travels at half a metre a second."""
    time = np.arange(round(fps * seconds) + 1) / fps
    vectors = np.zeros((len(time), 3, 3))
    vectors[:, 0, 2] = time
    root = np.stack([time / 2, 0 * time, 0 * time], axis=-1)
    return Motion(ARM, rotation.from_exponential_map(vectors), root, fps)


@pytest.mark.parametrize("fps", [10.0, 20.0, 45.0, 120.0])
def test_resampling_an_even_swing_is_exact(fps: float) -> None:
    there, truth = kinematics.resample(swing(30.0, 4.0), fps), swing(fps, 4.0)
    assert there.fps == fps
    assert len(there) == len(truth)
    assert np.allclose(kinematics.positions_of(there), kinematics.positions_of(truth), atol=1e-9)


def test_some_joints_are_where_all_of_them_are() -> None:
    rng = np.random.default_rng(3)
    motion = Motion(CHARACTER, random_pose(7, len(CHARACTER)), rng.normal(size=(7, 3)), 60.0)
    joints = [CHARACTER.index(name) for name in ("LeftHand", "Head", CHARACTER.names[0], "RightHand")]
    # One multiplies matrices, the other quaternions.
    np.testing.assert_allclose(kinematics.positions_of_some(motion, joints),
                               kinematics.positions_of(motion)[:, joints], atol=1e-12)


def test_the_chains_to_some_joints_move_them_as_the_whole_body_does() -> None:
    motion = Motion(CHARACTER, random_pose(7, len(CHARACTER)), np.zeros((7, 3)), 60.0)
    ends = [CHARACTER.index(name) for name in ("RightHand", "LeftForeArm")]
    skeleton, joints = kinematics.chains(CHARACTER, ends)
    assert skeleton.names[0] == CHARACTER.names[0] and "Head" not in skeleton.names and len(skeleton) < len(CHARACTER)
    few = Motion(skeleton, motion.rotations[:, joints], motion.root_positions, 60.0)
    np.testing.assert_array_equal(kinematics.positions_of(few)[:, [joints.index(end) for end in ends]],
                                  kinematics.positions_of(motion)[:, ends])


def test_what_is_left_of_a_motion_dies_away_smoothly() -> None:
    time = np.arange(-3, 60) / 60.0
    old, new = 0.2 * np.sin(3 * time)[:, None], (0.5 + 0.1 * time)[:, None]
    out = new[3:] + kinematics.quintic_offset(old[:3], new[:3], time[3:], 0.5, 60.0)
    joined = np.concatenate([old[:3], out])
    assert out[-1] == pytest.approx(new[-1])
    assert np.abs(out[31:] - new[34:]).max() < 1e-12, "nothing is left after the fade"
    # Place, velocity and acceleration pass over: the third difference has no spike at the seam.
    third = np.abs(np.diff(joined[:, 0], 3)) * 60.0 ** 3
    assert third[:3].max() < 3.0 * third[3:30].max()
    assert kinematics.quintic_offset(old[:2], new[:2], time[3:], 0.5, 60.0) == pytest.approx(0.0)
