"""Rotations against scipy, and what scipy does not do: continuity, the removal of yaw, interpolation in bulk."""

import itertools
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from data_module.motion import rotation
from data_module.types import Array

ORDERS = ["".join(order) for order in itertools.permutations("XYZ")]
vectors = arrays(np.float64, 3, elements=st.floats(-10, 10))


def random_turns(*shape: int, seed: int = 0) -> Array:
    count = int(np.prod(shape))
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_quat(scalar_first=True).reshape(*shape, 4)


def as_scipy(q: Array) -> Rotation:
    return Rotation.from_quat(q.reshape(-1, 4), scalar_first=True)


def apart(a: Array, b: Array) -> float:
    """The largest angle between two sets of rotations, by scipy."""
    return float((as_scipy(a).inv() * as_scipy(b)).magnitude().max())


def test_products_inverses_and_turned_vectors_are_scipys() -> None:
    a, b = random_turns(7, 5, seed=1), random_turns(7, 5, seed=2)
    v = np.random.default_rng(3).normal(size=(7, 5, 3))
    product = (as_scipy(a) * as_scipy(b)).as_matrix()
    assert np.allclose(as_scipy(rotation.multiply(a, b)).as_matrix(), product, atol=1e-12)
    assert np.allclose(as_scipy(rotation.conjugate(a)).as_matrix(), as_scipy(a).inv().as_matrix(), atol=1e-12)
    assert np.allclose(rotation.rotate(a, v).reshape(-1, 3), as_scipy(a).apply(v.reshape(-1, 3)), atol=1e-12)


_VECTORS = st.sampled_from([np.float32, np.float64]).flatmap(
    lambda kind: arrays(kind, (3,), elements=st.floats(-1e6, 1e6, width=32)))


@given(arrays(np.float64, (4, 1, 3), elements=st.floats(-1e6, 1e6)), _VECTORS)
def test_the_cross_product_is_numpys_bit_for_bit(many: Array, one: Array) -> None:
    for a, b in ((many, one), (one, many), (one, one), (many[:, 0], many[::-1, 0])):
        ours, theirs = rotation.cross(a, b), np.cross(a, b)
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)


def test_matrices_are_scipys() -> None:
    q = Rotation.random(60, rng=np.random.default_rng(4)).as_quat(scalar_first=True)
    assert np.allclose(rotation.to_matrix(q), Rotation.from_quat(q, scalar_first=True).as_matrix(), atol=1e-14)
    assert np.array_equal(rotation.to_matrix(q.reshape(3, 4, 5, 4)), rotation.to_matrix(q).reshape(3, 4, 5, 3, 3))


@given(arrays(np.float64, (5, 3), elements=st.floats(-20, 20)) | arrays(
    np.float64, (5, 3), elements=st.sampled_from([-np.pi, -1e-9, 0.0, 1e-200, 1e-5, np.pi / 2, np.pi])),
       st.sampled_from(ORDERS))
def test_conversions_are_scipys(values: Array, order: str) -> None:
    theirs = Rotation.from_rotvec(values)
    q = theirs.as_quat(scalar_first=True)
    np.testing.assert_allclose(rotation.from_exponential_map(values), q, atol=1e-12)
    # A sign of rounding decides of which half turn q is: the axes of both are of one rotation.
    vectors, expected = rotation.to_exponential_map(q), theirs.as_rotvec()
    assert np.linalg.norm(vectors, axis=-1).max() <= np.pi + 1e-12
    np.testing.assert_allclose(vectors, expected, atol=1e-12)
    np.testing.assert_allclose(rotation.from_matrix(theirs.as_matrix()),
                               Rotation.from_matrix(theirs.as_matrix()).as_quat(scalar_first=True), atol=1e-12)
    np.testing.assert_allclose(rotation.from_euler(values, order),
                               Rotation.from_euler(order, values).as_quat(scalar_first=True), atol=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        angles = rotation.to_euler(q, order)
    gap = angles - theirs.as_euler(order, suppress_warnings=True)
    np.testing.assert_allclose((gap + np.pi) % (2 * np.pi) - np.pi, 0.0, atol=1e-12)
    # At a pole, the third angle of those within 1e-7 radians is left out.
    assert apart(rotation.from_euler(angles, order), q) < 2e-7


@given(arrays(np.float64, (4, 3, 3), elements=st.floats(-3, 3)))
def test_any_matrix_becomes_the_nearest_rotation(matrices: Array) -> None:
    if (np.linalg.det(matrices) < 1e-3).any():
        with pytest.raises(ValueError, match="no rotation"):
            rotation.from_matrix(-np.abs(np.eye(3)))
        return
    found = rotation.to_matrix(rotation.from_matrix(matrices))
    np.testing.assert_allclose(found, Rotation.from_matrix(matrices).as_matrix(), atol=1e-9)


def test_the_mean_is_scipys() -> None:
    q = rotation.multiply(random_turns(1), rotation.from_exponential_map(
        np.random.default_rng(1).normal(size=(50, 3))))
    q[::3] *= -1
    assert apart(rotation.mean(q)[None], as_scipy(q).mean().as_quat(scalar_first=True)[None]) < 1e-12


@given(vectors, st.floats(0.01, 3.0), st.integers(0, 4))
def test_unrolling_follows_a_joint_through_any_number_of_turns(axis: Array, step: float, turns_before: int) -> None:
    length = np.linalg.norm(axis)
    axis = axis / length if length > 1e-3 else np.array([0.0, 1.0, 0.0])
    angles = 0.1 + step * np.arange(40) + 2 * np.pi * turns_before
    truth = angles[:, None] * axis
    wrapped = rotation.to_exponential_map(rotation.from_exponential_map(truth))
    smooth = rotation.unroll(wrapped)
    assert np.allclose(smooth - smooth[0], truth - truth[0], atol=1e-6)
    assert apart(rotation.from_exponential_map(smooth), rotation.from_exponential_map(truth)) < 1e-6


def test_neighbours_lie_on_one_half_sphere() -> None:
    q = rotation.from_exponential_map(np.linspace(0, 20, 200)[:, None] * np.array([0.6, 0.0, 0.8]))
    q[::3] *= -1
    smooth = rotation.continuous(q)
    assert (np.sum(smooth[1:] * smooth[:-1], axis=-1) > 0).all()
    assert apart(smooth, q) < 1e-12
    assert np.array_equal(smooth[0], q[0])


@given(vectors, vectors)
def test_between_turns_one_direction_onto_the_other_by_the_shortest_way(a: Array, b: Array) -> None:
    if min(np.linalg.norm(a), np.linalg.norm(b)) < 1e-3:
        return
    q = rotation.between(a, b)
    ua, ub = a / np.linalg.norm(a), b / np.linalg.norm(b)
    assert np.allclose(rotation.rotate(q, ua), ub, atol=1e-4)
    # arccos of a cosine near +-1 knows the angle to 1e-7 only.
    assert as_scipy(q).magnitude()[0] == pytest.approx(np.arccos(np.clip(ua @ ub, -1, 1)), abs=2e-4)


def test_the_angle_between_is_scipys_magnitude_and_blind_to_signs() -> None:
    a, b = random_turns(40, seed=5), random_turns(40, seed=6)
    expected = (as_scipy(a).inv() * as_scipy(b)).magnitude()
    assert np.allclose(rotation.angle_between(a, b), expected, atol=1e-9)
    assert np.allclose(rotation.angle_between(a, -b), expected, atol=1e-9)
    assert np.allclose(rotation.angle_between(a, -a), 0.0, atol=1e-7)


def test_interpolation_is_scipys_slerp() -> None:
    q = random_turns(9, 2, seed=8)
    q[4] = q[3]
    q[6] = -q[5]
    where = np.random.default_rng(1).uniform(0, 8, 60)
    ours = rotation.interpolate(q, where)
    for joint in range(2):
        expected = Slerp(np.arange(9), as_scipy(q[:, joint]))(where)
        # Slerp between almost opposite rotations is ill-posed; random ones never are.
        assert (as_scipy(ours[:, joint]).inv() * expected).magnitude().max() < 1e-7
