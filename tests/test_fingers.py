"""Fingers: names, the way onto the character and back, the vectors of 46 joints, and the relaxed hand."""

from pathlib import Path

import numpy as np
import pytest
from bursts import waving
from hypothesis import given, settings
from hypothesis import strategies as st

from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.relaxed_hands import with_relaxed_hands
from data_module.motion.representation import Rotations, representation
from data_module.motion.skeletons import (
    CHARACTER,
    CHARACTERS,
    FINGER_JOINTS,
    FINGERED,
    LEG_JOINTS,
    WHOLE_BODY,
    find_table,
    from_vector,
    resized,
    to_character,
)
from data_module.motion.smplx import read_smplx
from data_module.types import Array, Motion, Skeleton


def angles(a: Motion, b: Motion) -> Array:
    """Degrees between two motions' joints, [T, J]."""
    return np.degrees(rotation.angle_between(a.rotations, b.rotations))


def test_each_size_begins_with_the_one_before() -> None:
    assert [len(skeleton) for skeleton in CHARACTERS.values()] == [16, 46, 54] == list(CHARACTERS)
    for small, large in ((CHARACTER, FINGERED), (FINGERED, WHOLE_BODY)):
        assert large.names[:len(small)] == small.names and large.parents[:len(small)] == small.parents
        assert np.array_equal(large.offsets[:len(small)], small.offsets)
    assert set(FINGERED.names[16:]) == set(FINGER_JOINTS) and set(WHOLE_BODY.names[46:]) == set(LEG_JOINTS)


UNREAL = {"RightHandThumb1": "thumb_01_r", "LeftHandPinky3": "pinky_03_l", "RightLeg": "calf_r"}
SMPLX = {"LeftHandIndex2": "left_index2", "RightHandRing3": "right_ring3", "LeftToeBase": "left_foot"}
UNITY = {"RightHandMiddle1": "RightMiddleProximal", "LeftHandPinky2": "LeftLittleIntermediate", "LeftUpLeg":
         "LeftUpperLeg"}
VRM = {"LeftHandThumb3": "J_Bip_L_Thumb3", "RightHandPinky1": "J_Bip_R_Little1", "RightFoot": "J_Bip_R_Foot"}
ROCKETBOX = {"RightHandThumb1": "Bip01_R_Finger0", "LeftHandIndex3": "Bip01_L_Finger12", "RightLeg": "Bip01_R_Calf"}
MIXAMO = {"RightHandThumb1": "RightHandThumb1", "LeftHandPinky3": "LeftHandPinky3", "LeftToeBase": "LeftToeBase"}


@pytest.mark.parametrize(("family", "some"), [("unreal", UNREAL), ("smplx", SMPLX), ("unity", UNITY), ("vrm", VRM),
                                              ("rocketbox", ROCKETBOX), ("mixamo", MIXAMO)])
def test_fingers_and_legs_are_known_by_each_familys_names(family: str, some: dict[str, str]) -> None:
    table = skeletons.NAME_TABLES[family]
    assert {ours: table[ours] for ours in some} == some
    assert set(FINGER_JOINTS) | set(LEG_JOINTS) <= set(table) and len(set(table.values())) == len(table)
    names = ["prefix:" + name.replace("_", " ") for name in table.values()]
    assert {ours: names[place] for ours, place in find_table(names).items()} == {
        ours: "prefix:" + name.replace("_", " ") for ours, name in table.items()}


def test_fingers_of_another_rest_pose_point_where_the_sources_do() -> None:
    """Arms hang at 45 degrees and fingers are half bent at the source's rest; in space nothing changes."""
    motion = waving(FINGERED)
    rest = np.tile([1.0, 0.0, 0.0, 0.0], (46, 1))
    for side, way in (("Left", -1.0), ("Right", 1.0)):
        rest[FINGERED.index(side + "Arm")] = rotation.from_exponential_map(np.array([0, 0, way * np.pi / 4]))
        for name in FINGER_JOINTS:
            if name.startswith(side):
                rest[FINGERED.index(name)] = rotation.from_exponential_map(np.array([0, 0, way * 0.3]))
    world = kinematics.global_rotations(FINGERED, rest)
    offsets = FINGERED.offsets.copy()
    for joint, parent in enumerate(FINGERED.parents):
        if parent >= 0:
            offsets[joint] = rotation.rotate(world[parent], FINGERED.offsets[joint])
    tips = {joint: rotation.rotate(world[joint], tip) for joint, tip in FINGERED.end_sites.items()}
    turned = rotation.multiply(kinematics.global_rotations(FINGERED, motion.rotations), rotation.conjugate(world))
    other = Skeleton(FINGERED.names, FINGERED.parents, offsets, tips)
    source = Motion(other, kinematics.local_rotations(other, turned), motion.root_positions, motion.fps)
    assert np.allclose(kinematics.positions_of(source), kinematics.positions_of(motion)), "the same in space"
    there = to_character(source, skeleton=FINGERED)
    fingers = [FINGERED.index(name) for name in FINGER_JOINTS]
    assert np.abs(kinematics.positions_of(there) - kinematics.positions_of(motion))[:, fingers].max() < 1e-6


@pytest.mark.parametrize(("columns", "first"), [(55, 25), (52, 22), (22, None)])
def test_smplx_fingers_are_read_where_the_file_has_them(columns: int, first: int | None, tmp_path: Path) -> None:
    poses = np.zeros((5, columns, 3))
    if first is not None:
        poses[:, first + 7, 2] = -0.6  # left_pinky2
        poses[:, first + 27, 1] = 0.4  # right_thumb1
    np.savez(tmp_path / "a.npz", poses=poses.reshape(5, -1), trans=np.zeros((5, 3)), mocap_frame_rate=30.0)
    there = to_character(read_smplx(tmp_path / "a.npz"), skeleton=FINGERED)
    maps = rotation.to_exponential_map(there.rotations)
    if first is None:
        assert set(there.absent) >= set(FINGER_JOINTS) and not np.abs(maps).max() > 1e-9
        return
    assert not set(there.absent) & set(FINGER_JOINTS)
    assert np.allclose(maps[:, FINGERED.index("LeftHandPinky2")], [0.0, 0.0, -0.6])
    assert np.allclose(maps[:, FINGERED.index("RightHandThumb1")], [0.0, 0.4, 0.0])
    assert np.count_nonzero(np.abs(maps).max(axis=(0, 2)) > 1e-9) == 2


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), joints=st.sampled_from([16, 46, 54]))
def test_vectors_of_any_size_come_back(seed: int, joints: int) -> None:
    motion = waving(CHARACTERS[joints], fps=30.0, seed=seed)
    faced = skeletons.facing(motion)
    told = Rotations(joints)
    vectors = told.vectors(motion, np.arange(len(motion)) / motion.fps)
    assert vectors.shape == (60, told.width) == (60, 3 * joints)
    assert angles(told.motion(vectors, 30.0), faced).max() < 1e-4
    assert angles(from_vector(vectors, 30.0), faced).max() < 1e-4
    # The first 48 numbers are the papers', whatever follows.
    assert np.allclose(vectors[:, :48], Rotations().vectors(motion, np.arange(60) / 30.0))


def test_what_a_source_lacks_is_masked_and_at_rest() -> None:
    told = Rotations(46)
    small = waving(CHARACTER)
    grown = resized(small, FINGERED)
    mask = told.present(grown.absent)
    assert mask.tolist() == [True] * 48 + [False] * 90
    assert not told.vectors(small, np.arange(10) / 30.0)[:, 48:].any()
    assert told.present(("LeftHandIndex2",)).reshape(46, 3).all(axis=1).sum() == 45
    assert (representation("rotations", 46).width, representation("positions", 46).width) == (138, 30)


# ---------------------------------------------------------------------------------------------------- relaxed hands


def lifting(height: float, wave: float = 0.0, seconds: float = 4.0) -> Motion:
    """Arms that hang; the left hand is lifted to `height` metres over the hips and waves at 1 Hz by `wave` radians."""
    fps = 30.0
    times = np.arange(round(seconds * fps)) / fps
    maps = np.zeros((len(times), 46, 3))
    maps[:, FINGERED.index("RightArm"), 2] = np.pi / 2
    shoulder = 0.49
    maps[:, FINGERED.index("LeftArm"), 2] = -np.arcsin(np.clip((shoulder - height) / 0.53, -1, 1))
    maps[:, FINGERED.index("LeftArm"), 1] = wave * np.sin(2 * np.pi * times)
    return resized(Motion(CHARACTER, rotation.from_exponential_map(maps[:, :16]), np.zeros((len(times), 3)), fps),
                   FINGERED)


def bend(motion: Motion, finger: str, side: str = "Left") -> Array:
    """Degrees that a finger is bent to the palm, [T]: its three joints about the axis across the palm."""
    maps = rotation.to_exponential_map(motion.rotations)
    way = -1.0 if side == "Left" else 1.0
    return np.degrees(way * sum(maps[:, FINGERED.index(f"{side}Hand{finger}{n}"), 2] for n in (1, 2, 3)))


def test_a_hanging_hand_is_half_closed_and_a_lifted_one_opens() -> None:
    low, high = with_relaxed_hands(lifting(0.02)), with_relaxed_hands(lifting(0.2, seconds=60.0))
    assert low.absent == () and low.filled == FINGERED.names[16:]
    for finger in ("Index", "Middle", "Ring", "Pinky"):
        assert 60 < bend(with_relaxed_hands(lifting(-0.2)), finger).mean() < 105
    assert bend(low, "Pinky").mean() > bend(low, "Index").mean(), "the little finger closes most"
    assert bend(high, "Index").mean() < 0.75 * bend(with_relaxed_hands(lifting(-0.2)), "Index").mean()
    # Bent means to the palm: the tips of a hand at the level of the arm lie under the knuckles.
    places = kinematics.positions_of(high)
    assert (places[:, FINGERED.index("LeftHandMiddle3"), 1] < places[:, FINGERED.index("LeftHandMiddle1"), 1]).all()


def test_relaxed_hands_are_mirrored_alive_smooth_and_the_same_every_time() -> None:
    motion = lifting(0.25, wave=0.5)
    one, two = with_relaxed_hands(motion), with_relaxed_hands(motion)
    assert np.array_equal(one.rotations, two.rotations)
    assert np.array_equal(one.rotations[:, :16], motion.rotations[:, :16])
    speed = np.degrees(rotation.angle_between(one.rotations[1:, 16:], one.rotations[:-1, 16:])) * 30.0
    assert speed.max() < 200.0 and (speed.max(axis=0) > 0.2).all(), "no joint jumps and none is frozen"
    hanging = with_relaxed_hands(lifting(-0.25))
    assert abs(bend(hanging, "Ring", "Left").mean() - bend(hanging, "Ring", "Right").mean()) < 8


def test_recorded_fingers_are_left_alone() -> None:
    motion = waving(FINGERED)
    assert with_relaxed_hands(motion) is motion
    right = tuple(name for name in FINGER_JOINTS if name.startswith("Right"))
    half = with_relaxed_hands(Motion(FINGERED, motion.rotations, motion.root_positions, 30.0, right))
    assert half.filled == right and half.absent == ()
    left = [FINGERED.index(name) for name in FINGER_JOINTS if name.startswith("Left")]
    assert np.array_equal(half.rotations[:, left], motion.rotations[:, left])
