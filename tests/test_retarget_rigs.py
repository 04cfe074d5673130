"""Two hundred characters without a mapping by hand: their joints are found, and their bones point as ours do.

The rigs come from `tests/rigs.py` (see `SEEDS`).
"""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from performances import example, turned
from scipy.spatial.transform import Rotation

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import WHOLE_BODY
from data_module.types import Motion
from gesticulator import Gesticulator
from gesticulator.characters.joints import find_joints
from gesticulator.characters.mapping import SURE
from gesticulator.characters.retarget import Retargeter
from tests.rig_errors import LIMITS, depth_in_column, inside, worst
from tests.rigs import PLACES, Rig, draw, placed

SEEDS = range(200, 400)
"""Two hundred in a row: none was left out."""
FRAMES = 16
"""Frames of the source that are compared, evenly over the clip."""
SECONDS = 12.0
"""Of the example that is gestured."""


@functools.cache
def drawn(seed: int) -> Rig:
    """The rig of a seed, drawn once for all tests."""
    return draw(seed)


@pytest.fixture(scope="module")
def performed(system: Gesticulator) -> Motion:
    """What the shipped system makes of the shipped example, on legs: a few frames of it."""
    motion = _gestured(system)
    return _some(motion, np.linspace(10, len(motion) - 10, FRAMES).astype(int))


@pytest.fixture(scope="module")
def near(system: Gesticulator) -> Motion:
    """The same with hands that keep close to the body: the frames in which one is nearest to it."""
    motion = _gestured(system, hand_radius="low")
    inside_of_wider = np.where(_ours_inside(motion) == 0.0, _ours_inside(motion, (0.29, 0.23)), 0.0)
    return _some(motion, np.sort(np.argsort(-inside_of_wider)[:FRAMES]))


def _gestured(system: Gesticulator, **knobs: str) -> Motion:
    return system(example(SECONDS), fps=20.0, legs=True, **knobs).motion


def _some(motion: Motion, kept: np.ndarray) -> Motion:
    return replace(motion, rotations=motion.rotations[kept], root_positions=motion.root_positions[kept])


def test_the_joints_of_two_hundred_rigs_are_found() -> None:
    wrong = {}
    for seed in SEEDS:
        rig = drawn(seed)
        found = find_joints(rig.character)
        if dict(found.joints) != rig.truth or list(found.spine) != rig.spine or list(found.neck) != rig.neck \
                or found.confidence < SURE:
            wrong[seed] = rig.style, rig.pose, found.confidence, found.doubts
    assert not wrong


def test_the_bones_of_two_hundred_rigs_point_as_ours(performed: Motion) -> None:
    bad = {}
    for seed in SEEDS:
        rig = drawn(seed)
        moved = Retargeter(rig.character, contacts=False)(performed)
        found = worst(rig, performed, moved)
        over = {name: round(value, 3) for name, value in found.items() if value > LIMITS[name]}
        if over:
            bad[seed, rig.style, rig.pose] = over
    assert not bad


@pytest.mark.parametrize("place", PLACES)
def test_files_that_stand_or_are_placed_otherwise_come_out_as_bound(place: str, performed: Motion, tmp_path: Path
                                                                    ) -> None:
    """Through a file, with a mesh: the pose at rest, and where the file puts it, change nothing of what is moved."""
    made = 0
    for seed in SEEDS[:40]:
        rig = drawn(seed)
        if rig.character.kind != "glb" or made == 3:
            continue
        made += 1
        there = placed(rig, place, np.random.default_rng(seed), tmp_path / "rig.glb")
        found = find_joints(there.character)
        assert dict(found.joints) == there.truth and list(found.spine) == there.spine, (seed, rig.style)
        errors = worst(there, performed, Retargeter(there.character, found, contacts=False)(performed))
        assert {name: value for name, value in errors.items() if value > LIMITS[name]} == {}, (seed, rig.style)
    assert made == 3


@pytest.mark.parametrize("style", ["ethan", "mixamo", "vrm"])
def test_palms_face_as_ours_do_where_knuckles_are_arched(style: str, performed: Motion) -> None:
    """The palm is the plane of the wrist and the knuckles of index and little finger; that of the middle finger lies 3
    cm above it, and each hand's axes are rolled by the generator against the palm."""
    rig = draw(5, style, "twisted", arch=0.03)
    assert {"LeftHandIndex1", "LeftHandMiddle1", "LeftHandPinky1"} <= rig.truth.keys()
    errors = worst(rig, performed, Retargeter(rig.character, contacts=False)(performed))
    assert errors["palms"] < 1.0 and errors["fingers"] <= LIMITS["fingers"]


def _ours_inside(motion: Motion, torso: tuple[float, float] = (0.145, 0.115)) -> np.ndarray:
    places = kinematics.positions_of(motion)
    world = kinematics.global_rotations(WHOLE_BODY, motion.rotations)[:, WHOLE_BODY.index("Spine3")]
    left = rotation.rotate(world, np.array([1.0, 0.0, 0.0]))
    hips, neck = places[:, 0], places[:, WHOLE_BODY.index("Neck")]
    return np.max([depth_in_column(places[:, WHOLE_BODY.index(side + part)], hips, neck, left, torso)
                   for side in ("Left", "Right") for part in ("Hand", "HandMiddle1")], axis=0)


@pytest.mark.parametrize(("size", "stout"), [(1.0, True), (0.55, True), (0.55, False), (1.25, True)])
def test_hands_stay_outside_a_trunk_of_any_width(near: Motion, size: float, stout: bool) -> None:
    free = _ours_inside(near) == 0.0
    assert free.sum() > FRAMES / 2
    seen = 0.0
    for seed in range(4):
        rig = draw(seed, "mixamo", "A", stout, size)
        if "LeftHandMiddle1" not in rig.truth:
            continue
        bare = Retargeter(rig.character, contacts=False)(near)
        kept = Retargeter(rig.character)(near)
        seen = max(seen, float(inside(rig, bare, rig.torso)[free].max()))
        assert inside(rig, kept, rig.torso)[free].max() < 0.02  # of the way from the skin to the axis
        # Palms and fingers keep pointing as they did.
        errors = worst(rig, near, kept)
        assert errors["fingers"] < LIMITS["fingers"] and errors["palms"] < LIMITS["palms"]
    assert seen > 0.05 or not stout


@pytest.mark.parametrize("style", ["manny", "metahuman", "daz", "blender"])
@pytest.mark.parametrize("pose", ["T", "down"])
def test_twist_bones_take_their_share_of_a_hands_roll(style: str, pose: str) -> None:
    rig = next(rig for rig in (draw(seed, style, pose) for seed in range(20)) if _twist_bones(rig))
    degrees_rolled = np.linspace(0.0, 80.0, 9)
    roll = np.radians(degrees_rolled)[:, None] * [1.0, 0.0, 0.0]  # about the arm, which points to the side at rest
    motion = turned(WHOLE_BODY, len(roll), 30.0, LeftHand=roll, RightHand=roll)
    moved = Retargeter(rig.character, contacts=False)(motion)
    world = moved.world_matrices()[..., :3, :3]
    world = world / np.linalg.norm(world[0, :, :, 0], axis=-1)[:, None, None]
    for node, side, share in _twist_bones(rig):
        fore, hand = rig.truth[side + "ForeArm"], rig.truth[side + "Hand"]
        places = moved.world_matrices()[..., :3, 3]
        way = places[0, hand] - places[0, fore]
        way = way / np.linalg.norm(way)
        for one, expected in ((node, share), (hand, 1.0), (fore, 0.0)):
            spin = Rotation.from_matrix(world[:, one] @ world[0, one].T).as_rotvec(degrees=True)
            np.testing.assert_allclose(np.abs(spin @ way), expected * degrees_rolled, atol=0.5)
            np.testing.assert_allclose(np.linalg.norm(spin, axis=1), np.abs(spin @ way), atol=0.5)


def _twist_bones(rig: Rig) -> list[tuple[int, str, float]]:
    """Node, side and share of the way from elbow to wrist of the bones between them: the rigs have theirs halfway."""
    names = rig.character.names
    return [(node, side, 0.5) for side in ("Left", "Right") for node, name in enumerate(names) if name in (
        f"lowerarm_twist_01_{side[0].lower()}", f"{side[0].lower()}ForearmTwist", f"DEF-forearm.{side[0]}.001")]


def test_a_hand_that_goes_all_the_way_round_makes_no_twist_bone_jump() -> None:
    rig = next(rig for rig in (draw(seed, "manny", "T") for seed in range(20)) if _twist_bones(rig))
    turns = Rotation.from_euler("X", np.linspace(-360.0, 360.0, 721)[:, None], degrees=True)
    motion = turned(WHOLE_BODY, 721, 30.0, LeftHand=turns.as_quat(scalar_first=True))
    moved = Retargeter(rig.character, contacts=False)(motion)
    node = _twist_bones(rig)[0][0]
    steps = Rotation.from_quat(moved.rotations[1:, node], scalar_first=True) * Rotation.from_quat(
        moved.rotations[:-1, node], scalar_first=True).inv()
    assert np.degrees(steps.magnitude()).max() < 4.0, "half of a degree a frame, and faster past 149 degrees"
    part = Retargeter(rig.character, contacts=False)(replace(
        motion, rotations=motion.rotations[100:101], root_positions=np.zeros((1, 3))))
    apart = np.abs(np.sum(part.rotations[0] * moved.rotations[100], axis=-1))
    np.testing.assert_allclose(apart, 1.0, atol=1e-9, err_msg="one frame alone is as it is in the whole")
