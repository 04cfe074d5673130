"""Any upper body is brought onto the character by its joints' names; poses, axes and units vary, the gesture stays."""

from collections.abc import Mapping

import numpy as np
import pytest
from bursts import waving
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.representation import ROTATIONS
from data_module.motion.skeletons import CHARACTER, JOINTS, NAME_TABLES, REQUIRED, find_table, to_character
from data_module.types import Array, Motion, Skeleton


def re_rested(motion: Motion, by: Mapping[str, Array]) -> Motion:
    """The same movement in space, told on a skeleton whose rest pose is another.

    by: joint -> the rotation of its bones at the new rest pose, against the old one, in world axes.
    """
    old = motion.skeleton
    world = kinematics.global_rotations(old, motion.rotations)
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (len(old), 1))
    for joint, name in enumerate(old.names):
        turn[joint] = by.get(name, turn[joint])
    offsets = old.offsets.copy()
    for joint, parent in enumerate(old.parents):
        if parent >= 0:
            offsets[joint] = rotation.rotate(turn[parent], old.offsets[joint])
    # The bone in space is world * old offset = (world * turn^-1) * new offset.
    local = kinematics.local_rotations(old, rotation.multiply(world, rotation.conjugate(turn)))
    return Motion(Skeleton(old.names, old.parents, offsets), local, motion.root_positions, motion.fps)


def own_table() -> dict[str, int]:
    return {name: index for index, name in enumerate(JOINTS)}


def renamed(motion: Motion, names: Mapping[str, str], prefix: str = "") -> Motion:
    """The motion with only the joints in `names`, so called; a joint left out is folded into its parent."""
    kept = [index for index, name in enumerate(JOINTS) if name in names]
    world = kinematics.global_rotations(CHARACTER, motion.rotations)[:, kept]
    rest = kinematics.joint_positions(CHARACTER, np.tile([1.0, 0, 0, 0], (len(JOINTS), 1)))
    parents, offsets = [], []
    for index in kept:
        above = CHARACTER.parents[index]
        while above >= 0 and above not in kept:
            above = CHARACTER.parents[above]
        parents.append(kept.index(above) if above >= 0 else -1)
        offsets.append(rest[index] - rest[max(above, 0)])
    skeleton = Skeleton(tuple(prefix + names[JOINTS[index]] for index in kept), tuple(parents), np.array(offsets))
    return Motion(skeleton, kinematics.local_rotations(skeleton, world), motion.root_positions, motion.fps)


@pytest.mark.parametrize("droop", [20.0, 45.0, 80.0])
def test_an_a_pose_and_a_t_pose_source_agree(droop: float) -> None:
    motion = waving()
    down = np.radians(droop)
    # The character's left is +X: turning +X down is a negative turn about Z; the right arm mirrors it.
    turns = {side + bone: rotation.from_euler(np.array([sign * down, 0, 0]), "ZXY")
             for side, sign in (("Left", -1), ("Right", 1)) for bone in ("Arm", "ForeArm", "Hand")}
    a_pose = re_rested(motion, turns)
    rest = kinematics.joint_positions(a_pose.skeleton, np.tile([1.0, 0, 0, 0], (16, 1)))
    assert rest[JOINTS.index("LeftHand"), 1] < rest[JOINTS.index("LeftArm"), 1] - 0.5 * np.sin(down)
    assert np.allclose(kinematics.positions_of(a_pose), kinematics.positions_of(motion), atol=1e-9)
    there = to_character(a_pose)
    assert rotation.angle_between(there.rotations, motion.rotations).max() < 1e-6


@pytest.mark.parametrize(("euler", "axes"), [((90.0, 0, 0), "z up"), ((0, 180.0, 0), "facing -Z"),
                                             ((90.0, 0, 90.0), "z up, facing X")])
def test_other_axes_are_brought_onto_ours(euler: tuple[float, float, float], axes: str) -> None:
    motion = waving()
    change = Rotation.from_euler("xyz", euler, degrees=True).as_quat(scalar_first=True)
    back = rotation.conjugate(change)
    skeleton = Skeleton(JOINTS, CHARACTER.parents, rotation.rotate(change, CHARACTER.offsets))
    turned = Motion(skeleton, rotation.multiply(rotation.multiply(change, motion.rotations), back),
                    rotation.rotate(change, motion.root_positions), motion.fps)
    there = to_character(turned)
    assert rotation.angle_between(there.rotations, motion.rotations).max() < 1e-7, axes
    assert np.allclose(there.root_positions, motion.root_positions, atol=1e-9)


@pytest.mark.parametrize("source", NAME_TABLES)
@pytest.mark.parametrize("prefix", ["", "mixamorig:", "scene:Actor1:"])
def test_every_table_of_names_brings_its_joints_back(source: str, prefix: str) -> None:
    names = NAME_TABLES[source]
    motion = waving()
    there = to_character(renamed(motion, names, prefix))
    lacking = [name for name in JOINTS if name not in names]
    assert list(there.absent) == lacking
    world = kinematics.global_rotations(CHARACTER, motion.rotations)
    ours = kinematics.global_rotations(CHARACTER, there.rotations)
    kept = [index for index, name in enumerate(JOINTS) if name in names]
    assert rotation.angle_between(world[:, kept], ours[:, kept]).max() < 1e-6
    absent = [JOINTS.index(name) for name in lacking]
    assert rotation.angle_between(there.rotations[:, absent], np.array([1.0, 0, 0, 0])).max(initial=0.0) < 1e-7


@pytest.mark.parametrize("missing", REQUIRED)
def test_a_joint_that_must_be_there_is_named_when_it_is_not(missing: str) -> None:
    names = ["Elbow_7" if name == missing else name for name in JOINTS]
    with pytest.raises(InputError) as failure:
        find_table(names)
    assert missing in str(failure.value)
    assert "unknown names are Elbow_7" in str(failure.value)


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001])
def test_the_unit_is_guessed_from_hips_to_head(unit: float) -> None:
    for size in (0.7, 1.0, 1.3):
        skeleton = Skeleton(JOINTS, CHARACTER.parents, CHARACTER.offsets * size / unit)
        assert skeletons.guess_unit(skeleton, own_table()) == unit


@given(st.integers(0, 10_000))
def test_vectors_and_motion_go_there_and_back(seed: int) -> None:
    faced = skeletons.facing(waving(frames=30, seed=seed))
    times = np.arange(30) / faced.fps
    vectors = ROTATIONS.vectors(faced, times)
    assert vectors.shape == (30, 48)
    back = skeletons.from_vector(vectors, faced.fps)
    assert rotation.angle_between(back.rotations, faced.rotations).max() < 1e-6
    assert np.allclose(ROTATIONS.vectors(back, times), vectors, atol=1e-6)
