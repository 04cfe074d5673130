"""Ten joints in space and back: bones point where they pointed, limbs turn as limbs do, and nothing flips."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from bursts import blocks_of, waving
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from data_module.blocks import denormalise, first_pose, normalise_motion
from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.bvh import BvhWarning, read_bvh
from data_module.motion.representation import (
    POSITIONS,
    REPRESENTATIONS,
    ROTATIONS,
    TED_ABSENT,
    TED_BONES,
    TED_JOINTS,
    Representation,
    bone_directions,
    rotations_from_positions,
    ted_positions,
)
from data_module.motion.skeletons import CHARACTER, JOINTS
from data_module.types import Array, Blocks, Motion

NOSE_TO_CROWN = TED_BONES.index((TED_JOINTS.index("nose"), TED_JOINTS.index("head")))
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
SIDES = {"Left": 1.0, "Right": -1.0}


def turn(axis: list[float], degrees: float) -> Array:
    unit = np.array(axis) / np.linalg.norm(axis)
    return Rotation.from_rotvec(np.radians(degrees) * unit).as_quat(scalar_first=True)


def posed(world: dict[str, Array], frames: int = 1, fps: float = 20.0) -> Motion:
    """The character with these world rotations, [4] or [T, 4]; a joint not named follows its parent."""
    turns = np.tile(IDENTITY, (frames, len(CHARACTER), 1))
    for joint, name in enumerate(JOINTS):
        turns[:, joint] = world[name] if name in world else turns[:, max(CHARACTER.parents[joint], 0)]
    return Motion(CHARACTER, kinematics.local_rotations(CHARACTER, turns), np.zeros((frames, 3)), fps)


def world_of(motion: Motion) -> Array:
    return kinematics.global_rotations(motion.skeleton, motion.rotations)


def apart(one: Motion, two: Motion) -> Array:
    """[T, J] degrees between the world rotations of two motions."""
    return np.degrees(rotation.angle_between(world_of(one), world_of(two)))


def steps(motion: Motion) -> Array:
    """[T - 1, J] degrees that each joint turns from frame to frame in the world."""
    turns = world_of(motion)
    return np.degrees(rotation.angle_between(turns[1:], turns[:-1]))


def chained(directions: Array, lengths: Array | float = 0.3) -> Array:
    """Positions [T, 10, 3] of bones [T, 9, 3] that have these directions."""
    points = np.zeros((len(directions), len(TED_JOINTS), 3))
    for bone, (start, end) in enumerate(TED_BONES):
        points[:, end] = points[:, start] + np.broadcast_to(lengths, (len(TED_BONES),))[bone] * directions[:, bone]
    return points


def real(folder: Path, clip: str) -> Motion:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BvhWarning)
        if clip == "take":
            (path,) = (folder / "takes" / "beat_scott").glob("*.bvh")
            return skeletons.to_character(read_bvh(path, fps=15.0))
        return skeletons.to_character(read_bvh(folder / "strokes" / clip))


def random_directions(frames: int) -> st.SearchStrategy[Array]:
    def unit(values: Array) -> Array:
        short = np.linalg.norm(values, axis=-1, keepdims=True) < 1e-3
        values = np.where(short, [0.0, 0.0, 1.0], values)
        return values / np.linalg.norm(values, axis=-1, keepdims=True)

    return arrays(np.float64, (frames, len(TED_BONES), 3), elements=st.floats(-1, 1, width=32)).map(unit)


# The two representations


def test_the_rest_pose_is_where_a_ruler_puts_it() -> None:
    points = dict(zip(TED_JOINTS, ted_positions(posed({}))[0], strict=True))
    assert np.allclose(points["spine"], 0)
    assert np.allclose(points["neck"], [0, 0.235, 0.010])
    assert np.allclose(points["left elbow"], [0.03 + 0.15 + 0.28, 0.1 + 0.09, 0.005 + 0.02 - 0.03])
    assert np.allclose(points["right wrist"], [-0.03 - 0.15 - 0.28 - 0.25, 0.19, -0.005])
    assert points["nose"][2] > points["head"][2] > points["neck"][2]
    assert np.allclose(points["head"] - points["neck"], [0, 0.25, 0.036])


@pytest.mark.parametrize("own", REPRESENTATIONS.values(), ids=REPRESENTATIONS)
def test_yaw_and_place_do_not_count_and_the_ends_are_held(own: Representation) -> None:
    motion = waving()
    away = motion.rotations.copy()
    away[:, 0] = rotation.multiply(turn([0, 1, 0], 110), away[:, 0])
    walked = Motion(CHARACTER, away, motion.root_positions + np.array([3.0, 0.0, -2.0]), motion.fps)
    times = np.array([0.0, 0.31, 1.62, 2.95])
    assert np.allclose(own.vectors(walked, times), own.vectors(motion, times), atol=1e-9)
    beyond = own.vectors(motion, np.array([-1.0, 0.0, 59 / 20, 60 / 20, 99.0]))
    assert np.allclose(beyond[0], beyond[1], atol=1e-9)
    assert np.allclose(beyond[3:], beyond[2], atol=1e-9)


def test_a_source_without_a_joint_lacks_what_hangs_on_it() -> None:
    def lacking(absent: tuple[str, ...]) -> set[str]:
        known = POSITIONS.present(absent).reshape(10, 3)
        assert (known == known[:, :1]).all()
        return {joint for joint, here in zip(TED_JOINTS, known[:, 0], strict=True) if not here}

    assert lacking(()) == {"spine"}  # the origin is the same for all
    assert lacking(TED_ABSENT) == {"spine"}  # all that TED itself has
    assert lacking(("Spine3", "Neck1", "LeftShoulder")) == {"spine"}
    assert lacking(("Head",)) == {"spine", "nose", "head"}
    assert lacking(("LeftForeArm",)) == {"spine", "left wrist"}
    assert lacking(("RightArm",)) == {"spine", "right elbow", "right wrist"}
    told = ROTATIONS.present(("Hips", "LeftHand")).reshape(16, 3)
    assert [name for name, here in zip(JOINTS, told, strict=True) if not here.any()] == ["Hips", "LeftHand"]
    assert told.sum() == 14 * 3


# Directions


def test_a_bone_without_length_points_where_it_did() -> None:
    points = ted_positions(waving())[:5].copy()
    whole = bone_directions(points)
    for frame in (0, 2, 3):
        points[frame, 6] = points[frame, 5]
    found = bone_directions(points)
    assert np.allclose(found[0, 5], [1, 0, 0])  # not known yet: the level arm of the rest pose
    assert np.allclose(found[[1, 2, 3, 4], 5], whole[[1, 1, 1, 4], 5])
    assert np.allclose(np.delete(found, 5, axis=1), np.delete(whole, 5, axis=1))
    assert np.isfinite(rotations_from_positions(np.zeros((3, 10, 3)), 15.0).rotations).all()


@pytest.mark.parametrize("bad", [np.zeros((4, 30)), np.zeros((4, 9, 3)), np.full((4, 10, 3), np.nan)])
def test_what_is_not_ten_joints_in_space_is_refused(bad: Array) -> None:
    with pytest.raises(ValueError, match="positions must be"):
        rotations_from_positions(bad, 15.0)


@given(random_directions(1), st.floats(30.0, 117.0))
def test_a_head_that_bends_as_heads_do_keeps_all_directions(directions: Array, bend: float) -> None:
    to_nose, other = directions[0, 1], directions[0, 0]
    normal = np.cross(to_nose, other) if np.linalg.norm(np.cross(to_nose, other)) > 1e-3 else np.cross(
        to_nose, np.eye(3)[np.argmin(np.abs(to_nose))])
    directions[0, NOSE_TO_CROWN] = rotation.rotate(turn(normal.tolist(), bend), to_nose)
    found = bone_directions(ted_positions(rotations_from_positions(chained(directions), 20.0)))
    assert np.abs(found - directions).max() < 1e-6


@given(st.integers(0, 99))
def test_any_pose_of_the_character_keeps_all_directions(seed: int) -> None:
    motion = waving(frames=20, seed=seed, size=0.7)
    wanted = bone_directions(ted_positions(motion))
    found = bone_directions(ted_positions(rotations_from_positions(ted_positions(motion), motion.fps)))
    assert np.abs(found - wanted).max() < 1e-6


# Rotations


@given(st.integers(0, 99), st.floats(30, 140), st.floats(30, 140))
def test_limbs_turn_as_they_were_turned(seed: int, left: float, right: float) -> None:
    """A pose of which ten points tell all: a spine bent evenly, elbows that are hinges, a nose in the head's plane."""
    rng = np.random.default_rng(seed)
    third = Rotation.from_rotvec(rng.uniform(-0.2, 0.2, 3)).as_quat(scalar_first=True)
    torso = rotation.multiply(third, rotation.multiply(third, third))
    world = {"Spine": third, "Spine1": rotation.multiply(third, third), "Spine2": torso}
    head = Rotation.from_rotvec(rng.uniform(-0.9, 0.9, 3)).as_quat(scalar_first=True)
    world["Neck"] = rotation.multiply(head, turn([1, 0, 0], rng.uniform(-20, 20)))
    world["Head"] = head
    for (side, sign), bend in zip(SIDES.items(), (left, right), strict=True):
        # Within a right angle of the level arm: the other half is behind the back and through the head.
        swing = turn([0, *rng.uniform(-1, 1, 2)], rng.uniform(0, 90))
        world[side + "Arm"] = rotation.multiply(torso, rotation.multiply(swing, turn([1, 0, 0], rng.uniform(-90, 90))))
        hinge = [0.0, -sign * np.cos(np.radians(12)), -sign * np.sin(np.radians(12))]
        world[side + "ForeArm"] = rotation.multiply(world[side + "Arm"], turn(hinge, bend))
    pose = posed(world)
    errors = dict(zip(JOINTS, apart(rotations_from_positions(ted_positions(pose), 20.0), pose)[0], strict=True))
    # The neck may turn about its own length: no point of the ten would move.
    assert {joint: error for joint, error in errors.items() if error > 1e-3 and joint not in ("Neck", "Neck1")} == {}


@given(st.integers(0, 30))
def test_a_mirrored_speaker_makes_mirrored_gestures(seed: int) -> None:
    points = ted_positions(waving(seed=seed))
    other = points[:, [0, 1, 2, 3, 7, 8, 9, 4, 5, 6]] * [-1.0, 1.0, 1.0]
    swapped = [JOINTS.index(name.replace("Left", "#").replace("Right", "Left").replace("#", "Right"))
               for name in JOINTS]
    plain = rotations_from_positions(points, 20.0)
    there = rotations_from_positions(other, 20.0).rotations[:, swapped] * [1.0, 1.0, -1.0, -1.0]
    assert np.degrees(rotation.angle_between(there, plain.rotations)).max() < 1e-3


def test_a_frame_depends_on_those_before_it_alone() -> None:
    points = ted_positions(waving(size=0.8))
    whole = rotations_from_positions(points, 20.0).rotations
    for count in (1, 2, 17, 40):
        assert np.allclose(rotations_from_positions(points[:count], 20.0).rotations, whole[:count], atol=1e-9)


@pytest.mark.parametrize("fps", [15.0, 60.0])
def test_an_elbow_that_passes_straight_does_not_flip(fps: float) -> None:
    """The forearm swings through the line of the upper arm and out on the other side, while the arm is raised."""
    time = np.arange(round(3 * fps)) / fps
    directions = np.repeat(bone_directions(ted_positions(posed({}))), len(time), axis=0)
    lift = Rotation.from_rotvec(np.outer(0.5 * time, [0, 0, -1.0]))
    for bone, bend in ((4, 0 * time), (5, np.radians(60 * np.cos(np.pi * time / 1.5)))):
        flat = np.stack([np.cos(bend), 0 * bend, np.sin(bend)], axis=1)
        directions[:, bone] = lift.apply(flat)
    motion = rotations_from_positions(chained(directions), fps)
    joint = JOINTS.index("LeftArm")
    fastest = np.degrees(0.5 + 12.0) / fps
    assert steps(motion)[:, joint].max() < fastest + 1e-6
    assert np.abs(bone_directions(ted_positions(motion)) - directions).max() < 1e-6


def test_a_straight_arm_keeps_its_turn() -> None:
    """The arm bends, straightens, trembles by some degrees for two seconds, and is no more twisted than before."""
    rng = np.random.default_rng(0)
    bend = np.radians(np.concatenate([np.full(10, 60.0), np.linspace(60, 0, 20), np.zeros(40)]))
    tremble = np.where((bend == 0)[:, None], np.radians(2.0) * rng.normal(size=(70, 2)).clip(-2, 2), 0.0)
    directions = np.repeat(bone_directions(ted_positions(posed({}))), 70, axis=0)
    fore = np.stack([np.cos(bend), np.sin(bend) + tremble[:, 0], tremble[:, 1]], axis=1)
    directions[:, 5] = fore / np.linalg.norm(fore, axis=1, keepdims=True)
    turns = world_of(rotations_from_positions(chained(directions), 20.0))[:, JOINTS.index("LeftArm")]
    assert np.degrees(rotation.angle_between(turns, turns[:1])).max() < 1e-4
    # Bent upwards from the level, the hinge points forward: the upper arm is turned by a right angle less its tilt.
    assert np.degrees(rotation.angle_between(turns[0], IDENTITY)) == pytest.approx(90 + 12, abs=1e-6)


# Through the pipeline


def regular(motion: Motion, seed: int = 0) -> Blocks:
    """Blocks between 0.2 and 0.5 s that fill the motion."""
    rng = np.random.default_rng(seed)
    last = (len(motion) - 1) / motion.fps
    edges = np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 0.5, 1000))])
    edges = np.append(edges[edges < last - 0.2], last)
    return blocks_of(edges, 10)


@pytest.mark.parametrize("clip", ["brad/brad_Idle01_IndicateLeftBt01.bvh", "garza/garza_IdleStand01_ChopRt01.bvh"])
def test_real_gestures_go_through_blocks_and_back(outside_data: Path, clip: str) -> None:
    motion = real(outside_data, clip)
    blocks = regular(motion)
    frames = denormalise(normalise_motion(motion, blocks, POSITIONS), first_pose(motion, POSITIONS), blocks, motion.fps)
    found = POSITIONS.motion(frames, motion.fps)
    assert abs(len(found) - len(motion)) <= 1
    wanted = bone_directions(ted_positions(motion))[:len(found)]
    error = np.degrees(np.linalg.norm(bone_directions(ted_positions(found))[:len(wanted)] - wanted, axis=-1))
    assert np.median(error) < 1.0
    assert error.max() < 12.0  # the Gaussian of 50 ms takes the edge off the fastest strokes


def test_sides_and_axes_are_those_of_the_ted_data(outside_data: Path) -> None:
    """TED's own mean directions have Y down and the left at -X: half a turn about Z makes them ours."""
    told = json.loads((outside_data / "fgd" / "h36m_gesture_encoder.json").read_text())
    theirs = np.array(told["mean_dir_vec"]).reshape(9, 3) * [-1.0, -1.0, 1.0]
    theirs /= np.linalg.norm(theirs, axis=1, keepdims=True)
    ours = bone_directions(ted_positions(real(outside_data, "take"))).mean(axis=0)
    ours /= np.linalg.norm(ours, axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(np.sum(theirs * ours, axis=1), -1, 1)))
    assert angles[:5].max() < 25 and angles[6:8].max() < 25
    assert angles.max() < 45  # forearms lie where the gestures are
    rest = bone_directions(ted_positions(posed({})))[0]
    bend = [np.degrees(np.arccos(own[1] @ own[2])) for own in (theirs, rest)]
    assert bend[1] == pytest.approx(bend[0], abs=2)
