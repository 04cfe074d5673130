"""Two bones that reach a goal: by the law of cosines, in the plane that they bend in, and no farther than they are."""

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_module.types import Array
from gesticulator.contacts.limbs import bend, swing, swivelled

UPPER, LOWER = 0.4, 0.3
SOCKET = np.array([0.2, 1.4, 0.0])
BELOW = SOCKET + np.array([0.0, -0.5, 0.0])
CHAIN = (0, 1, 2)


class Arm:
    """A socket, an upper bone and a lower one, both straight down at rest."""

    def place(self, turns: Mapping[int, Array], node: int) -> Array:
        """[T, 3] where a node is."""
        place = np.broadcast_to(SOCKET, (len(turns[0]), 3))
        for joint, length in ((0, UPPER), (1, LOWER))[:node]:
            place = place + turns[joint] @ np.array([0.0, -length, 0.0])
        return place


def bent(goals: Array, pole: Array, first: Rotation | None = None, where: Array | None = None) -> dict[int, Array]:
    """World rotations of the chain that was told to reach goals [T, 3]; before, its elbow is bent by 50 degrees."""
    count = len(goals)
    upper = np.tile((first or Rotation.identity()).as_matrix(), (count, 1, 1))
    turns = {0: upper, 1: upper @ Rotation.from_euler("x", -50, degrees=True).as_matrix(), 2: upper}
    bend(turns, Arm(), CHAIN, goals, pole, where)
    return turns


def random_goals(count: int, least: float, most: float) -> Array:
    """[T, 3] places at these distances from the socket, all around."""
    rng = np.random.default_rng(3)
    ways = rng.normal(size=(count, 3))
    return SOCKET + ways / np.linalg.norm(ways, axis=1, keepdims=True) * rng.uniform(least, most, (count, 1))


def test_the_tip_is_at_the_goal_and_the_elbow_bends_by_the_law_of_cosines() -> None:
    goals = random_goals(200, 0.15, 0.65)
    turns, arm = bent(goals, np.array([0.0, 0.0, -1.0])), Arm()
    np.testing.assert_allclose(arm.place(turns, 2), goals, atol=1e-6)
    for node in CHAIN:
        assert np.linalg.det(turns[node]) == pytest.approx(1.0)
    far = np.linalg.norm(goals - SOCKET, axis=1)
    bones = [arm.place(turns, node) - arm.place(turns, node - 1) for node in (1, 2)]
    inside = np.arccos(-np.sum(bones[0] * bones[1], axis=1) / (UPPER * LOWER))
    np.testing.assert_allclose(inside, np.arccos((UPPER**2 + LOWER**2 - far**2) / (2 * UPPER * LOWER)), atol=1e-6)


def test_the_elbow_stays_in_its_plane_and_a_straight_limb_bends_towards_the_pole() -> None:
    goals = SOCKET + np.array([[0.0, -0.5, 0.0], [0.0, -0.3, 0.0]])
    turns = {node: np.tile(np.eye(3), (2, 1, 1)) for node in CHAIN}
    bend(turns, Arm(), CHAIN, goals, np.array([1.0, 0.0, 0.0]))
    elbows = Arm().place(turns, 1) - SOCKET
    assert (elbows[:, 0] > 0.1).all() and np.abs(elbows[:, 2]).max() < 1e-9
    forward = bent(goals, np.array([1.0, 0.0, 0.0]), Rotation.from_euler("x", 20, degrees=True))
    assert np.abs((Arm().place(forward, 1) - SOCKET)[:, 0]).max() < 1e-9, "what is bent has a plane of its own"


@pytest.mark.parametrize("distance", [0.8, 5.0])
def test_what_is_out_of_reach_is_pointed_at_by_a_limb_that_hardly_bends(distance: float) -> None:
    goals = SOCKET + distance * np.array([[0.0, 0.0, 1.0], [0.6, 0.8, 0.0]])
    tips = Arm().place(bent(goals, np.array([0.0, -1.0, 0.0])), 2) - SOCKET
    far = np.linalg.norm(tips, axis=1)
    assert (far > 0.999 * (UPPER + LOWER)).all() and (far < UPPER + LOWER).all()
    np.testing.assert_allclose(tips / far[:, None], (goals - SOCKET) / distance, atol=1e-6)


def test_frames_that_are_not_meant_stay_as_they_are() -> None:
    goals, where = random_goals(6, 0.3, 0.6), np.array([True, False] * 3)
    before, after = bent(goals, np.array([0.0, 0.0, -1.0]), where=np.zeros(6, bool)), bent(
        goals, np.array([0.0, 0.0, -1.0]), where=where)
    for node in CHAIN:
        assert np.array_equal(after[node][~where], before[node][~where])
    np.testing.assert_allclose(Arm().place(after, 2)[where], goals[where], atol=1e-6)


def swung(angles: Array, shift: float, iterations: int) -> tuple[dict[int, Array], Array]:
    """An arm whose wrist is straight below its socket and whose elbow lies at angles [T] about that line, moved towards
    angle 0 by `shift` in each iteration; the arm, and the angles afterwards."""
    turn = Rotation.from_euler("y", angles[:, None]).as_matrix()
    turns = {node: turn @ matrices for node, matrices in bent(
        np.tile(BELOW, (len(angles), 1)), np.array([0.0, 0.0, 1.0])).items()}
    for _ in range(iterations):
        socket, hinge, tip = (Arm().place(turns, node) for node in CHAIN)
        upper = swivelled(hinge - socket, tip - hinge, np.tile([0.0, 0.0, shift], (len(angles), 1)))
        turns[0] = swing(hinge - socket, upper) @ turns[0]
        turns[1] = swing(tip - hinge, tip - socket - upper) @ turns[1]
    elbow = Arm().place(turns, 1) - SOCKET
    return turns, np.arctan2(elbow[:, 0], elbow[:, 2])


def test_an_elbow_swings_to_where_it_should_and_the_tip_stays() -> None:
    angles = np.radians([0.0, 60.0, -90.0, 180.0])
    np.testing.assert_allclose(np.cos(swung(angles, 0.0, 1)[1]), np.cos(angles), atol=1e-9)
    turns, after = swung(angles, 0.05, 40)
    np.testing.assert_allclose(Arm().place(turns, 2), np.tile(BELOW, (4, 1)), atol=1e-9)
    np.testing.assert_allclose(np.abs(after), [0.0, 0.0, 0.0, np.pi], atol=0.01)


def test_elbows_on_both_sides_of_the_opposite_of_where_they_should_go_stay_neighbours() -> None:
    """Without the damping, iterations of 0.3 of the radius increase a difference there twelvefold."""
    angles = np.linspace(-np.pi, np.pi, 721)
    _, after = swung(angles, 0.3 * 0.24, 7)
    growth = np.diff(np.unwrap(after)) / np.diff(angles)
    assert 0.0 < growth.min() < 0.3, "those that are ahead gather"
    assert growth.max() < 5.0
