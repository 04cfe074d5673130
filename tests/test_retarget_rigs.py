"""Two hundred characters that nobody mapped by hand: their joints are found, and their bones point as ours do.

The rigs come from `tests/rigs.py`. Their seeds were drawn after the code that is tested was frozen (see `SEEDS`).
"""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from scipy.spatial.transform import Rotation

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import WHOLE_BODY
from data_module.types import Motion
from gesticulator.characters.joints import find_joints
from gesticulator.characters.mapping import SURE
from gesticulator.retarget import CharacterMotion, Retargeter
from tests.rig_errors import LIMITS, places_of, worst
from tests.rigs import NAMED, POSES, STYLES, Rig, draw

SEEDS: tuple[int, ...] = (
    2492930, 3539813, 16409091, 17511786, 25932629, 40121772, 41795796, 44168330, 49124220, 53558758, 55018161,
    58770523, 81007510, 85525771, 86051730, 93635069, 104041489, 108656111, 122477317, 123535363, 124994198,
    128307595, 131295651, 133069902, 144540154, 145571004, 151091178, 169474306, 177172087, 177536779, 179432084,
    184065354, 194778689, 206894787, 209589691, 213535366, 222918144, 223228556, 232881471, 233012609, 240500462,
    241006673, 246396870, 248244470, 250945808, 252974395, 255144893, 255781190, 258514810, 264387176, 273894039,
    275640176, 284379763, 284396805, 287054141, 294726393, 297686948, 308491452, 312479511, 318746852, 322448693,
    328413639, 339996241, 343407443, 344252999, 347518818, 347718780, 355917651, 357232227, 357460076, 370920790,
    371318937, 374780785, 378255629, 387189578, 391543807, 394078080, 398890860, 412382930, 413724105, 414233986,
    444093880, 449804416, 452901076, 454920993, 455470761, 457890460, 459903098, 461516565, 463336225, 468026089,
    470877623, 487308963, 493278241, 493831716, 498878621, 503593240, 504298116, 513771555, 520540528, 523950510,
    526279918, 529186152, 541961826, 542419100, 544346459, 548972205, 555474358, 560729191, 561821767, 563497648,
    567878953, 573897858, 575804211, 580914323, 581487500, 583209121, 586489451, 595352703, 614722080, 615436611,
    618010952, 624190096, 629286779, 634382621, 636197550, 636716232, 638726825, 647175379, 648060895, 650372531,
    660962784, 663214027, 665095822, 668866288, 669949077, 674036032, 679010899, 688521184, 697878128, 698788636,
    700299012, 700909576, 701679020, 705677361, 708166540, 713876340, 717043627, 718868090, 722339254, 728642613,
    735595202, 736423726, 742055870, 744887803, 754465570, 759232949, 767388414, 771867189, 782671209, 802481719,
    805420658, 813033511, 816728528, 820742570, 824404577, 825772063, 826578084, 827145101, 848991428, 849223032,
    857385205, 865477521, 868465229, 869545807, 881332140, 881565259, 891159563, 893054592, 893608085, 896446570,
    900374021, 906008129, 914064951, 920620468, 922370214, 923150958, 934687065, 942359512, 948107955, 959458980,
    961054898, 962802071, 970186777, 976441529, 977290903, 983133179, 986380140, 990503730, 993587787,
)
"""Drawn by the system's random numbers after the code was committed; none was exchanged since."""
FRAMES = 16
"""Frames of the source that are compared, evenly over the clip."""
SECONDS = 12.0
"""Of the example that is gestured."""


@functools.cache
def drawn(seed: int) -> Rig:
    """The rig of a seed, drawn once for all tests."""
    return draw(seed)


@pytest.fixture(scope="module")
def performed() -> Motion:
    """What the shipped system makes of the shipped example, on legs: a few frames of it."""
    from gesticulator.pipeline import Gesticulator

    speech = Path(__file__).parent.parent / "examples" / "speech.flac"
    samples, rate = soundfile.read(speech, frames=round(SECONDS * 16000))
    motion = Gesticulator.from_pretrained()(samples, rate, fps=20.0, legs=True).motion
    kept = np.linspace(10, len(motion) - 10, FRAMES).astype(int)
    return replace(motion, rotations=motion.rotations[kept], root_positions=motion.root_positions[kept])


def test_the_generator_makes_what_it_says() -> None:
    rigs = [drawn(seed) for seed in SEEDS]
    assert {rig.style for rig in rigs} == set(STYLES) and {rig.pose for rig in rigs} == set(POSES)
    assert {rig.character.kind for rig in rigs} == {"bvh", "glb"}
    assert len({rig.size for rig in rigs}) == 6 and {rig.unit for rig in rigs} >= {1.0, 0.01}
    turned = [not np.allclose(rig.character.world_turns()[rig.truth["LeftArm"]], np.eye(3)) for rig in rigs]
    assert 0.3 < np.mean(turned) < 0.95


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


@pytest.mark.parametrize("style", NAMED)
def test_no_tool_needs_a_mapping_by_hand(style: str) -> None:
    for seed in (1, 2):
        found = find_joints(draw(seed, style).character)
        assert found.confidence > 0.9, (style, found.doubts)


def inside(rig: Rig, moved: CharacterMotion, torso: tuple[float, float]) -> np.ndarray:
    """[T] how deep her wrists and knuckles are in an elliptic column from hips to neck: 1 at its axis, 0 outside."""
    places, turns = places_of(rig, moved), moved.world_matrices()[:, rig.spine[-1], :3, :3]
    rest = rig.character.world_matrices()[rig.spine[-1], :3, :3]
    left = turns @ np.linalg.inv(rest) @ rig.axes[0] @ rig.axes.T
    hips, neck = places[:, rig.truth["Hips"]], places[:, rig.neck[0]]
    names = [side + part for side in ("Left", "Right") for part in ("Hand", "HandMiddle1")]
    return np.max([_depth(places[:, rig.truth[name]], hips, neck, left, torso) for name in names], axis=0)


def _depth(point: np.ndarray, hips: np.ndarray, neck: np.ndarray, left: np.ndarray, torso: tuple[float, float]
           ) -> np.ndarray:
    axis = neck - hips
    height = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = axis / height
    left = left - np.sum(left * axis, axis=-1, keepdims=True) * axis
    left = left / np.linalg.norm(left, axis=-1, keepdims=True)
    own = point - hips
    x, y, z = (np.sum(own * way, axis=-1) for way in (left, axis, np.cross(left, axis)))
    within = (y > 0) & (y < height[:, 0])
    return np.where(within, np.maximum(1.0 - np.hypot(x / torso[0], z / torso[1]), 0.0), 0.0)


def _ours_inside(motion: Motion) -> np.ndarray:
    places = kinematics.positions_of(motion)
    world = kinematics.global_rotations(WHOLE_BODY, motion.rotations)[:, WHOLE_BODY.index("Spine3")]
    left = rotation.rotate(world, np.array([1.0, 0.0, 0.0]))
    hips, neck = places[:, 0], places[:, WHOLE_BODY.index("Neck")]
    return np.max([_depth(places[:, WHOLE_BODY.index(side + part)], hips, neck, left, (0.145, 0.115))
                   for side in ("Left", "Right") for part in ("Hand", "HandMiddle1")], axis=0)


@pytest.mark.parametrize(("size", "stout"), [(1.0, True), (0.55, True), (0.55, False), (1.25, True)])
def test_hands_stay_outside_a_trunk_of_any_width(performed: Motion, size: float, stout: bool) -> None:
    free = _ours_inside(performed) == 0.0
    assert free.sum() > FRAMES / 2
    seen = 0.0
    for seed in range(4):
        rig = draw(seed, "mixamo", "A", stout, size)
        if "LeftHandMiddle1" not in rig.truth:
            continue
        bare = Retargeter(rig.character, contacts=False)(performed)
        kept = Retargeter(rig.character)(performed)
        seen = max(seen, float(inside(rig, bare, rig.torso)[free].max()))
        assert inside(rig, kept, rig.torso)[free].max() < 0.02  # of the way from the skin to the axis
        # Palms and fingers keep pointing as they did.
        errors = worst(rig, performed, kept)
        assert errors["fingers"] < LIMITS["fingers"] and errors["palms"] < LIMITS["palms"]
    assert seen > 0.05 or not stout


@pytest.mark.parametrize("style", ["manny", "metahuman", "daz", "blender"])
@pytest.mark.parametrize("pose", ["T", "down"])
def test_twist_bones_take_their_share_of_a_hands_roll(style: str, pose: str) -> None:
    rig = next(rig for rig in (draw(seed, style, pose) for seed in range(20)) if _twist_bones(rig))
    degrees_rolled = np.linspace(0.0, 80.0, 9)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (len(degrees_rolled), len(WHOLE_BODY), 1))
    for side in ("Left", "Right"):  # about the arm, which points to the side at rest
        turns[:, WHOLE_BODY.index(side + "Hand")] = Rotation.from_euler(
            "X", degrees_rolled[:, None], degrees=True).as_quat(scalar_first=True)
    motion = Motion(WHOLE_BODY, turns, np.zeros((len(turns), 3)), 30.0)
    moved = Retargeter(rig.character, contacts=False)(motion)
    world = moved.world_matrices()[..., :3, :3]
    world = world / np.linalg.norm(world[0, :, :, 0], axis=-1)[:, None, None]
    for node, side, share in _twist_bones(rig):
        fore, hand = rig.truth[side + "ForeArm"], rig.truth[side + "Hand"]
        places = moved.world_matrices()[..., :3, 3]
        way = places[0, hand] - places[0, fore]
        way = way / np.linalg.norm(way)
        for one, expected in ((node, share), (hand, 1.0), (fore, 0.0)):
            turned = Rotation.from_matrix(world[:, one] @ world[0, one].T).as_rotvec(degrees=True)
            np.testing.assert_allclose(np.abs(turned @ way), expected * degrees_rolled, atol=0.5)
            np.testing.assert_allclose(np.linalg.norm(turned, axis=1), np.abs(turned @ way), atol=0.5)


def _twist_bones(rig: Rig) -> list[tuple[int, str, float]]:
    """Node, side and share of the way from elbow to wrist of the bones between them: the rigs have theirs halfway."""
    names = rig.character.names
    return [(node, side, 0.5) for side in ("Left", "Right") for node, name in enumerate(names) if name in (
        f"lowerarm_twist_01_{side[0].lower()}", f"{side[0].lower()}ForearmTwist", f"DEF-forearm.{side[0]}.001")]


def test_a_hand_that_goes_all_the_way_round_makes_no_twist_bone_jump() -> None:
    rig = next(rig for rig in (draw(seed, "manny", "T") for seed in range(20)) if _twist_bones(rig))
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (721, len(WHOLE_BODY), 1))
    turns[:, WHOLE_BODY.index("LeftHand")] = Rotation.from_euler(
        "X", np.linspace(-360.0, 360.0, 721)[:, None], degrees=True).as_quat(scalar_first=True)
    motion = Motion(WHOLE_BODY, turns, np.zeros((721, 3)), 30.0)
    moved = Retargeter(rig.character, contacts=False)(motion)
    node = _twist_bones(rig)[0][0]
    steps = Rotation.from_quat(moved.rotations[1:, node], scalar_first=True) * Rotation.from_quat(
        moved.rotations[:-1, node], scalar_first=True).inv()
    assert np.degrees(steps.magnitude()).max() < 4.0, "half of a degree a frame, and faster past 149 degrees"
    part = Retargeter(rig.character, contacts=False)(replace(
        motion, rotations=turns[100:101], root_positions=np.zeros((1, 3))))
    apart = np.abs(np.sum(part.rotations[0] * moved.rotations[100], axis=-1))
    np.testing.assert_allclose(apart, 1.0, atol=1e-9, err_msg="one frame alone is as it is in the whole")
