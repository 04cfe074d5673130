"""Hands outside the trunk of a character of any shape: known answers, no jump on the way, the same on the page."""

from pathlib import Path

import numpy as np
import pytest

from data_module.types import Array
from gesticulator.characters.body_surface import outline_of
from gesticulator.characters.reading import read_character
from gesticulator.characters.retarget import Retargeter
from gesticulator.contacts.limbs import MARGIN, OURS, TrunkAxes
from gesticulator.contacts.other_bodies import HandLimit, Outline, Trunk, displacement, ellipse, spread
from tests.awkward import figure, write
from tests.rigs import draw

STOUT = (0.24, 0.25)
LENGTH, FPS = 0.5, 60.0


def upright(outline: Outline, frames: int) -> Trunk:
    """An upright trunk over some frames, of a body with an arm of our length."""
    return Trunk(TrunkAxes(np.tile(np.eye(3), (frames, 1, 1)), np.full(frames, LENGTH)), outline, 1.0)


def limited(our: Array, their: Array, outline: Outline) -> HandLimit:
    """The limit of points [3, T] left, up and ahead of the hips, of an upright body."""
    return upright(outline, our.shape[1]).limit(our, their.T)


def beside(places: Array, width: float, depth: float) -> Array:
    """[T] of points [3, T]: 1 on the surface of an elliptic column, less inside."""
    return np.asarray(np.hypot(places[0] / width, places[2] / depth))


def test_how_much_a_hand_lacks_by_hand() -> None:
    our = np.array([[0.0, 0.2, OURS[1] + 0.05], [OURS[0] + 0.1, 0.2, 0.0], [0.0, 0.2, OURS[1]]]).T
    their = np.array([[0.0, 0.2, 0.15], [0.2, 0.2, 0.0], [0.0, 0.2, 0.1]]).T
    limit = limited(our, their, ellipse(*STOUT))
    np.testing.assert_allclose(limit.normal, [[0, 0, 1], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    near = 0.05 - 0.05 ** 2 / (4 * MARGIN)  # less than the margin by little
    np.testing.assert_allclose(limit.lack, [0.25 + near - 0.15, 0.24 + MARGIN - 0.2, 0.25 - 0.1], atol=1e-9)


def test_a_hand_that_is_clear_is_left_and_so_is_that_of_the_default_trunk() -> None:
    angles = np.linspace(0, 2 * np.pi, 200)
    for far in (0.0, 0.01, 0.1, 0.4):
        our = np.stack([(OURS[0] + far) * np.cos(angles), np.full(200, 0.2), (OURS[1] + far) * np.sin(angles)])
        # Between two of the 36 directions the tangents of an ellipse are off by a quarter of a millimetre.
        assert limited(our, our, ellipse(*OURS)).lack.max() < 3e-4
    assert limited(our, our, ellipse(*STOUT)).lack.max() == 0.0, "a hand's length away from the stout one"


def test_a_hand_that_is_led_around_a_stout_trunk_starts_early_and_is_not_hasty() -> None:
    """Ours crosses at the speed of a stroke; frame by frame theirs would be twice as fast, which is the control. The
    way around is longer, too."""
    time = np.arange(1200) / 400.0
    across = 0.35 - 0.55 / (1.0 + np.exp(-12.0 * (time - 1.5)))
    our = np.stack([across, np.full(1200, 0.25), np.where(np.abs(across) < OURS[0], 0.125, 0.125
                                                         - 0.5 * (np.abs(across) - OURS[0]))])
    their = our * np.array([[0.9], [1.0], [0.5]])
    limit = limited(our, their, ellipse(*STOUT))
    framed = limit.lack[:, None] * limit.normal
    push = spread(framed, [limit], upright(ellipse(*STOUT), 1200), (their.T, 1.0), 400.0)
    speeds = [np.linalg.norm(np.diff(their.T + moved, axis=0), axis=1).max() * 400.0 for moved in (0.0, push, framed)]
    assert beside((their.T + push).T, *STOUT).min() > 0.99, "36 tangents are up to 0.4 % outside of an ellipse"
    assert speeds[1] < 1.65 * speeds[0] and speeds[2] > 1.95 * speeds[0]
    np.testing.assert_allclose(push[[0, -1]], framed[[0, -1]], atol=2e-3)


@pytest.mark.parametrize("fps", [24.0, 120.0])
def test_displacements_of_a_loop_stay_a_loop_at_any_frame_rate(fps: float) -> None:
    """A turn of the hand about our trunk, slower and faster by turns: displacements meet at the seam as elsewhere."""
    time = np.arange(round(4.0 * fps)) / (4.0 * fps)
    angle = 2.0 * np.pi * time + 0.8 * np.sin(2.0 * np.pi * time)
    our = np.stack([(OURS[0] + 0.02) * np.cos(angle), np.full(len(time), 0.25), (OURS[1] + 0.02) * np.sin(angle)])
    limit = limited(our, our, ellipse(*STOUT))
    push = spread(limit.lack[:, None] * limit.normal, [limit], upright(ellipse(*STOUT), len(time)), (our.T, 1.0), fps)
    around = np.concatenate([push, push[:2]])
    jerks = np.linalg.norm(np.diff(around, 2, axis=0), axis=1)
    assert jerks[-2:].max() <= 1.1 * np.percentile(jerks[:-2], 99)
    assert beside((our.T + push).T, *STOUT).min() > 0.99


def test_an_arm_that_is_too_short_for_a_goal_reaches_another_outside() -> None:
    reached, arm = np.array([[0.1, -0.3, 0.1]]), 0.4
    ahead = HandLimit(reached, np.array([[0.0, 0.0, 1.0]]), np.array([0.2]), np.zeros(1))
    aside = HandLimit(reached, np.array([[0.8, 0.0, 0.6]]), np.array([0.05]), np.zeros(1))
    push = displacement([ahead, aside], reached, arm)
    assert np.linalg.norm(reached + push) <= arm + 1e-9
    assert push[0, 2] > 0.199 and push[0] @ [0.8, 0.0, 0.6] >= 0.05


def test_the_outline_of_a_mesh_is_that_of_the_column_it_was_made_of() -> None:
    drawn = (draw(seed, "mixamo", "A", True, 1.0) for seed in range(9))
    rig = next(rig for rig in drawn if rig.character.kind == "glb")
    outline = outline_of(Retargeter(rig.character).body)
    assert ((outline.steps > -0.1) & (outline.steps < 1.0)).all()
    column = np.tile(ellipse(*rig.torso).reach[0], (len(outline.steps), 1))
    np.testing.assert_allclose(outline.reach, column, atol=0.012)


def test_thighs_that_stand_leave_room_to_give(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of the trunk's length below the hips, a thigh that is a quarter of a radian ahead of where it hangs is
    ahead by a sixteenth of it; nothing changes behind, beside, and above the hips."""
    retargeter = Retargeter(read_character(write(tmp_path / "stands.glb", figure(lambda key: f"mixamorig:{key}", "A"))))
    with_room = outline_of(retargeter.body)
    monkeypatch.setattr("gesticulator.characters.body_surface.FLEXED", 0.0)
    without = outline_of(retargeter.body)
    body = retargeter.body
    long = body.unit * float(np.linalg.norm(body.rest_places[body.mapping.neck[0]]
                                            - body.rest_places[body.mapping.joints["Hips"]]))
    more = with_room.reach - without.reach
    below = without.steps < 0.0
    assert below.any() and (more[~below] == 0.0).all() and (np.abs(more[:, 18:]) < 1e-12).all()
    np.testing.assert_allclose(more[below, 9], -0.25 * without.steps[below] * long, rtol=0.02)
    np.testing.assert_allclose(more[:, 0], 0.0, atol=1e-12)


def test_the_outline_of_a_figure_of_few_large_triangles_has_no_gaps(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A trunk of one box, whose corners are all at its ends: between them hands were 2 cm inside of such a body. The
    control measures the corners alone."""
    body = figure(lambda key: f"mixamorig:{key}", "A")
    body.widths |= {key: 0.0 for key in body.places if key.startswith("Spine")}
    body.places["Spine"] = body.places["Neck"] - [0.0, 0.3, 0.0]  # the box of the hips reaches up to here
    retargeter = Retargeter(read_character(write(tmp_path / "boxes.glb", body)))
    outline = outline_of(retargeter.body)
    step = np.diff(outline.steps)
    np.testing.assert_allclose(step, 1.0 / 12.0)
    length = float(body.places["Neck"][1] - body.places["Hips"][1])
    inside_box = (outline.steps > 0.05) & (outline.steps < (body.places["Spine"][1] - body.places["Hips"][1]) / length)
    assert inside_box.sum() >= 3 and (outline.reach[inside_box].min(axis=1) > 0.12).all(), "a box of 28 cm"
    monkeypatch.setattr("gesticulator.characters.body_surface.SPARSE", 0)
    assert len(outline_of(retargeter.body).steps) < len(outline.steps)
