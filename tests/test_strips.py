"""Strips: what is drawn lies where the motion says."""

import numpy as np
import pytest
from performances import perform

from data_module.motion import bvh, kinematics, rotation
from data_module.motion.skeletons import CHARACTER, HIP_HEIGHT, facing
from data_module.types import Motion
from eval.commands import PLOT
from eval.pictures import PLOTS, strips
from gesticulator.export import figure

pytest.importorskip("matplotlib", reason="matplotlib is not installed")


def test_points_are_the_joints_of_the_facing_character() -> None:
    motion = perform().motion
    times = np.array([5, 40]) / motion.fps
    points = figure.figure_points(motion, times)
    told = kinematics.positions_of(facing(motion))[[5, 40]] + [0, HIP_HEIGHT, 0]
    for joint, name in enumerate(CHARACTER.names):
        np.testing.assert_allclose(points[name], told[:, joint], atol=1e-9)
    reach = np.linalg.norm(points["LeftHandTip"] - points["LeftHand"], axis=1)
    np.testing.assert_allclose(reach, 0.16, atol=1e-9)


def test_outline_is_a_hull_around_both_circles() -> None:
    start, end = np.array([[0.0, 0.0]]), np.array([[3.0, 4.0]])
    outline = figure.outlines(start, end, np.array([1.0]), np.array([0.5]))[0]
    on_first = np.isclose(np.linalg.norm(outline - start, axis=1), 1.0)
    on_second = np.isclose(np.linalg.norm(outline - end, axis=1), 0.5)
    assert (on_first | on_second).all() and on_first.any() and on_second.any()
    # No point of either circle lies outside: the shoelace area is the hull's, from its parts.
    x, y = outline.T
    area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    touch = np.arccos(0.5 / 5.0)
    sides = np.sqrt(25 - 0.25) * (1.0 + 0.5)
    caps = (np.pi - touch) * 1.0**2 + touch * 0.5**2
    assert area == pytest.approx(sides + caps, rel=1e-2)
    inside = figure.outlines(start, start + 0.1, np.array([1.0]), np.array([0.2]))[0]
    assert (np.linalg.norm(inside, axis=1) <= 1.0 + 1e-9).all()
    assert np.isclose(np.linalg.norm(inside, axis=1), 1.0).sum() == figure.ROUND


@pytest.mark.parametrize("view", ["front", "side"])
def test_what_is_nearer_is_drawn_later(view: str) -> None:
    """In the rest pose, arms to the sides."""
    turns = np.zeros((2, len(CHARACTER), 3))
    motion = Motion(CHARACTER, rotation.from_exponential_map(turns), np.zeros((2, 3)), 30.0)
    parts = strips.seen(figure.figure_points(motion, np.zeros(1)), strips.VIEWS[view], "white")
    order = [part.hand for part in parts if part.hand]
    assert sorted(order) == ["Left", "Right"] and parts[0].polygons[-1][1] == figure.INK
    assert [part.near[0] for part in parts[1:]] == sorted(part.near[0] for part in parts[1:])
    # From her left, the right hand is far and the left one near; from the front, her left is at the right.
    places = {part.hand: part.polygons[-1][0][0].mean(axis=0) for part in parts if part.hand}
    assert order == ["Right", "Left"] if view == "side" else places["Left"][0] > 0 > places["Right"][0]


def test_command_draws_a_picture(tmp_path, refused, capfd) -> None:
    bvh.write_bvh(tmp_path / "m.bvh", perform().motion)
    given = ["strip", str(tmp_path / "m.bvh"), "--seconds", "0.75", "--out", str(tmp_path / "m.png")]
    PLOT.main("gesticulator plot", given)
    assert capfd.readouterr().out.strip() == str(tmp_path / "m.png")
    from matplotlib.image import imread

    picture = imread(tmp_path / "m.png")
    # Three figures leave ink in the left, the middle and the right third of both rows.
    ink = (picture[..., :3] < 0.9).any(axis=-1)
    for third in np.array_split(ink, 3, axis=1):
        assert all(part.mean() > 0.05 for part in np.array_split(third, 2, axis=0))
    assert "picture" in refused("plot", *given[:-1], tmp_path / "m.doc")
    assert not (tmp_path / "m.doc").exists()


def test_the_list_names_every_plot_and_an_unknown_name_is_refused(refused, capfd) -> None:
    assert PLOT.main("gesticulator plot", ["--list"]) == 0
    assert [line.split()[0] for line in capfd.readouterr().out.splitlines()] == list(PLOTS)
    for name in (["nothing"], []):
        assert "strip, lexicon" in refused("plot", *name)
