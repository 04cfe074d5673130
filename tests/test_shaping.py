"""Shaping of finished poses, by hand: levels that blend between blocks, mirror images, gestures that are laid over."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTERS
from data_module.types import Motion
from gesticulator.body.clips import exchanged_joints, mirrored_motion
from gesticulator.directing.shaping import levels_at

RNG = np.random.default_rng(4)


def test_levels_blend_along_a_smooth_step() -> None:
    """From 1 to 3 within 0.2 s to both sides of a beat at 1 s: 3 u^2 - 2 u^3 of the way at quarters."""
    edges, levels = np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0])
    got = levels_at(edges, levels, np.array([0.8, 0.9, 1.0, 1.1, 1.2]), 0.2)
    np.testing.assert_allclose(got, [1.0, 1.3125, 2.0, 2.6875, 3.0])
    before = levels_at(edges, levels, np.array([0.8, 0.85, 0.9, 0.95, 1.0, 1.01]), 0.2, np.array([False, True]))
    np.testing.assert_allclose(before, [1.0, 1.3125, 2.0, 2.6875, 3.0, 3.0], err_msg="a locked block is not touched")


@pytest.mark.parametrize("size", [16, 46])
def test_a_mirror_image_has_its_joints_across_the_middle_and_is_its_own_inverse(size: int) -> None:
    skeleton = CHARACTERS[size]
    turns = Rotation.from_rotvec(0.8 * RNG.normal(size=(5 * size, 3))).as_quat(scalar_first=True).reshape(5, size, 4)
    motion = Motion(skeleton, turns, RNG.normal(size=(5, 3)), 25.0)
    mirrored = mirrored_motion(motion)
    across = positions_of(motion)[:, exchanged_joints(skeleton.names)] * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(positions_of(mirrored), across, atol=1e-9)
    assert np.array_equal(mirrored_motion(mirrored).rotations, motion.rotations)
