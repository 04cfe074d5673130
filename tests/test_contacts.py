"""How far a hand is from a trunk: an ellipse with known answers, rounded ends, and the way out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_module.types import Array
from gesticulator.characters.contacts import Trunk, plain_trunk

WIDTH, DEPTH, HEIGHT = 0.2, 0.1, 0.5


def measured(points: Array, trunk: Trunk | None = None, turn: Rotation | None = None) -> tuple[Array, Array]:
    """Distance [T] and way out [T, 3] of points from a column of HEIGHT over the origin, the whole turned."""
    turned, count = turn or Rotation.identity(), len(points)
    neck = np.tile(turned.apply([0.0, HEIGHT, 0.0]), (count, 1))
    gap, out = (trunk or plain_trunk(WIDTH, DEPTH)).distance(
        turned.apply(points), np.zeros((count, 3)), neck, np.tile(turned.as_matrix(), (count, 1, 1)))
    return gap, turned.inv().apply(out)


def test_distances_by_hand() -> None:
    points = np.array([[WIDTH + 0.1, 0.25, 0.0], [0.0, 0.25, -DEPTH - 0.05], [-WIDTH + 0.02, 0.1, 0.0],
                       [0.0, HEIGHT + 0.1, 0.0], [WIDTH + 0.03, -0.04, 0.0]])
    gap, out = measured(points)
    np.testing.assert_allclose(gap, [0.1, 0.05, -0.02, 0.1, 0.05], atol=1e-12)
    np.testing.assert_allclose(out[[0, 1, 2]], [[1, 0, 0], [0, 0, -1], [-1, 0, 0]], atol=1e-12)


@pytest.mark.parametrize("turn", [None, Rotation.from_euler("ZXY", [20, -35, 110], degrees=True)])
def test_the_surface_is_an_ellipse_however_the_trunk_is_turned(turn: Rotation | None) -> None:
    angles = np.linspace(0, 2 * np.pi, 40)
    around = np.stack([WIDTH * np.cos(angles), np.full(40, 0.3), DEPTH * np.sin(angles)], axis=-1)
    np.testing.assert_allclose(measured(around, turn=turn)[0], 0.0, atol=1e-9)
    axis = np.array([0.0, 0.3, 0.0])
    for scale in (0.5, 1.5):  # measured along the ray from the middle
        gap, _ = measured(axis + scale * (around - axis), turn=turn)
        np.testing.assert_allclose(gap, (scale - 1) * np.linalg.norm(around - axis, axis=1), atol=1e-9)


def test_flesh_that_lies_ahead_and_widens_is_followed_along_the_trunk() -> None:
    trunk = Trunk(np.array([0.0, 1.0]), np.array([0.1, 0.3]), np.array([0.1, 0.1]), np.array([0.0, 0.04]))
    gap, _ = measured(np.array([[0.5, HEIGHT / 2, 0.02], [0.0, HEIGHT / 2, 0.2]]), trunk)
    np.testing.assert_allclose(gap, [0.5 - 0.2, 0.2 - 0.12], atol=1e-12)
