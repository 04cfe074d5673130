"""How far a hand is from a trunk: known answers of an ellipse, the way out."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, Motion
from gesticulator.contacts.columns import Column
from gesticulator.contacts.limbs import pose_of

WIDTH, DEPTH, HEIGHT = 0.2, 0.1, 0.5
COLUMN = Column(np.array([0.0, 1.0]), np.full(2, WIDTH), np.full(2, DEPTH))
COUNT = 2000


def test_distances_by_hand() -> None:
    points = np.array([[WIDTH + 0.1, 0.25, 0.0], [0.0, 0.25, -DEPTH - 0.05], [-WIDTH + 0.02, 0.1, 0.0],
                       [0.0, HEIGHT + 0.1, 0.0], [WIDTH + 0.03, -0.04, 0.0]])
    neck, upright = np.tile([0.0, HEIGHT, 0.0], (5, 1)), np.tile(np.eye(3), (5, 1, 1))
    gap, out = COLUMN.distance(points, np.zeros((5, 3)), neck, upright)
    np.testing.assert_allclose(gap, [0.1, 0.05, -0.02, 0.1, 0.05], atol=1e-12)
    np.testing.assert_allclose(out[[0, 1, 2]], [[1, 0, 0], [0, 0, -1], [-1, 0, 0]], atol=1e-12)


def columns(above: tuple[float, float]) -> tuple[Array, Array, Array, Array, Array]:
    """Points [COUNT, 3] about leaning columns (hips, neck [COUNT, 3], chest [COUNT, 3, 3]) with their places across
    and along them [COUNT, 3]: left and ahead in metres, along as a share drawn between `above`."""
    rng = np.random.default_rng(7)
    chest = Rotation.random(COUNT, rng=rng).as_matrix()
    hips, length = rng.normal(size=(COUNT, 3)), rng.uniform(0.3, 0.7, COUNT)
    across, share = rng.uniform(-0.5, 0.5, (COUNT, 2)), rng.uniform(*above, COUNT)
    local = np.stack([across[:, 0], share * length, across[:, 1]], axis=1)
    points = hips + np.einsum("nij,nj->ni", chest, local)
    return points, hips, hips + length[:, None] * chest[..., 1], chest, np.insert(across, 1, share, axis=1)


def radial(local: Array) -> Array:
    """[COUNT] metres from the surface on the ray from the axis: r (1 - 1 / |(x / width, z / depth)|)."""
    x, z = local[:, 0], local[:, 2]
    return np.hypot(x, z) * (1.0 - 1.0 / np.hypot(x / WIDTH, z / DEPTH))


def test_between_its_ends_the_distance_is_that_from_the_ellipse() -> None:
    points, hips, neck, chest, local = columns((0.01, 0.99))
    gap, out = COLUMN.distance(points, hips, neck, chest)
    expected = radial(local)
    # Sums of a few numbers about 1 in double precision. One point in three thought itself beyond an end, and so at
    # the surface, by 1e-17 m of rounding.
    np.testing.assert_allclose(gap, expected, atol=1e-12)
    assert (expected < -0.05).sum() > 30
    np.testing.assert_allclose(COLUMN.distance(points - gap[:, None] * out, hips, neck, chest)[0], 0.0, atol=1e-12)


def test_a_rounding_of_the_pose_moves_the_distance_by_no_more() -> None:
    points, hips, neck, chest, _ = columns((0.01, 0.99))
    near = points + np.random.default_rng(8).normal(size=points.shape) * 1e-7
    change = COLUMN.distance(near, hips, neck, chest)[0] - COLUMN.distance(points, hips, neck, chest)[0]
    assert np.abs(change).max() < 2e-6


def test_beyond_its_ends_the_distance_grows_from_that_of_the_rim() -> None:
    points, hips, neck, chest, local = columns((1.05, 1.5))
    length = np.linalg.norm(neck - hips, axis=1)
    expected = np.hypot(np.maximum(radial(local), 0.0), (local[:, 1] - 1.0) * length)
    np.testing.assert_allclose(COLUMN.distance(points, hips, neck, chest)[0], expected, atol=1e-12)


def test_a_pose_of_some_joints_has_them_and_those_above_as_that_of_all() -> None:
    turns = Rotation.random(5 * len(CHARACTER), rng=np.random.default_rng(1)).as_quat(scalar_first=True)
    motion = Motion(CHARACTER, turns.reshape(5, -1, 4), np.random.default_rng(2).normal(size=(5, 3)), 60.0)
    some, every = pose_of(motion, ("LeftHand", "Head")), pose_of(motion)
    assert {"Hips", "LeftArm", "LeftForeArm", "LeftHand", "Neck", "Head"} <= set(some.places)
    assert "RightArm" not in some.places
    for name, place in some.places.items():
        assert np.array_equal(place, every.places[name]) and np.array_equal(some.turns[name], every.turns[name])
    np.testing.assert_allclose(every.places["LeftHand"], positions_of(motion)[:, CHARACTER.index("LeftHand")],
                               atol=1e-12)
