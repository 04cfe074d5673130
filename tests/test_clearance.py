"""How far a hand is from a trunk, by known answers of an ellipse; hands of the default character outside its trunk and
face and elbows off its back: known answers, speeds, the whole."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from performances import example, turned
from scipy.spatial.transform import Rotation

from data_module.motion import rotation
from data_module.motion.kinematics import positions_of
from data_module.motion.representation import Rotations
from data_module.motion.skeletons import CHARACTER, FINGERED
from data_module.types import Array, Motion
from eval.metrics.eye.body import CommonBody, chest_left, common_body, unit
from gesticulator import Gesticulator
from gesticulator.body.clips import mirrored_motion
from gesticulator.body.motion_path import ClearedPath
from gesticulator.contacts.columns import TRUNK
from gesticulator.contacts.default_body import HEM, STEEPEST, cleared, cleared_poses, front_at, shirt_at
from gesticulator.contacts.limbs import pose_of

FPS = 60.0


def reaching(angles: Array, elbow: Array) -> Motion:
    """An arm swung across the body by `angles` [T] and bent by `elbow` [T], radians, from a T-pose, half lowered."""
    down = rotation.from_exponential_map(np.tile([0.0, 0.0, -1.1], (len(angles), 1)))
    across = rotation.from_exponential_map(angles[:, None] * [0.0, -1.0, 0.0])
    return turned(FINGERED, len(angles), LeftArm=rotation.multiply(across, down),
                  LeftForeArm=elbow[:, None] * [0.0, -1.0, 0.0])


def behind(body: CommonBody, side: str, sign: float) -> NDArray[np.bool_]:
    """[T] whether the trunk hides the elbow of a side while its hand is ahead of the trunk's line or raised."""
    up, left = unit(body.points["Chest"]), chest_left(body)
    left = unit(left - (left * up).sum(axis=1, keepdims=True) * up)
    ahead, elbow, hand = np.cross(left, up), body.points[side + "ForeArm"], body.points[side + "Hand"]
    hidden = ((elbow * ahead).sum(axis=1) < -0.08) & (sign * (elbow * left).sum(axis=1) < 0.20)
    return np.asarray(hidden & (((hand * ahead).sum(axis=1) > 0.05) | (hand[:, 1] > 0.06)))


def test_a_shirt_hangs_over_hips_that_are_wider_than_the_trunk() -> None:
    """The shirt of the figure in pages: at its hem 0.176 and 0.129 m, where the trunk has 0.145 and 0.115."""
    across, length = np.linspace(-0.3, 0.3, 601), np.full(601, 0.53)
    at = [shirt_at(across, np.full(601, along), length) for along in (-HEM, -0.04, 0.0)]
    for front in at:
        np.testing.assert_allclose(front, at[0])
        assert np.abs(np.diff(front) / np.diff(across)).max() <= STEEPEST + 1e-6
    # The superellipse of the page, seven millimetres within its surface.
    angle = np.linspace(0.3, 0.5 * np.pi, 50)
    x, z = 0.168 * np.cos(angle) ** 0.86, 0.122 * np.sin(angle) ** 0.86 - 0.006
    assert (np.interp(x, across, at[0]) > z - 0.001).all()
    high = np.full(601, 0.2)
    np.testing.assert_array_equal(shirt_at(across, high, length), front_at(across, high, length))
    heights = np.linspace(-HEM - 0.04, 0.4, 1401)
    profile = shirt_at(np.full(1401, 0.14), heights, np.full(1401, 0.53))
    assert np.abs(np.diff(profile) / np.diff(heights)).max() < STEEPEST, "no step where it begins and ends"


def test_a_hand_that_goes_through_the_trunk_passes_in_front_of_it() -> None:
    time = np.arange(120) / FPS
    motion = reaching(1.2 + 0.9 * np.sin(2 * np.pi * time), np.full(120, 1.9))
    before, free = TRUNK.distances(pose_of(motion))["Left"], cleared(motion)
    assert before.min() < -0.05, "it does go through"
    assert TRUNK.distances(pose_of(free))["Left"].min() > 0.0
    hand = FINGERED.index("LeftHand")
    speeds = [np.linalg.norm(np.diff(positions_of(one)[:, hand], axis=0), axis=1) * FPS for one in (motion, free)]
    assert speeds[1].max() < 2.0 * speeds[0].max(), "no jump"
    clear = before > 0.06
    still = [FINGERED.index(name) for name in ("Head", "RightArm", "LeftShoulder")]
    np.testing.assert_array_equal(free.rotations[:, still], motion.rotations[:, still])
    assert clear.any()


def test_a_pose_that_is_clear_stays_bit_for_bit() -> None:
    motion = reaching(np.zeros(5), np.zeros(5))
    assert cleared(motion) is motion
    tee = turned(CHARACTER, 4)
    assert cleared(tee) is tee, "16 joints, without knuckles"


def test_a_path_knows_whether_its_frames_were_clear() -> None:
    def path_of(swing: float) -> tuple[ClearedPath, Array]:
        motion = reaching(np.full(40, swing), np.full(40, 1.9))
        poses = rotation.to_exponential_map(motion.rotations).reshape(40, -1)
        path = ClearedPath(poses[0], FPS, 0.05, cleared_poses)
        return path, path.push(np.arange(1, 41) / 20.0, poses)

    for swing in (-0.5, 0.3, 1.9):
        path, frames = path_of(swing)
        body = Rotations(len(FINGERED)).motion(frames, FPS)
        if path.free:
            assert cleared(body) is body
    assert path_of(-0.5)[0].free, "the arm is beside the body"
    assert not path_of(1.9)[0].free, "the hand is in the trunk"


@settings(max_examples=25)
@given(st.floats(0.2, 2.4), st.floats(0.0, 2.4), st.floats(-0.02, 0.02))
def test_a_small_step_of_the_arm_is_a_small_step_after_it(swing: float, elbow: float, step: float) -> None:
    pair = cleared(reaching(np.array([swing, swing + step]), np.array([elbow, elbow + step])))
    places = positions_of(pair)[:, FINGERED.index("LeftHand")]
    assert np.linalg.norm(places[1] - places[0]) < 0.004 + 3.0 * abs(step)


def test_both_sides_are_mirror_images() -> None:
    time = np.arange(30) / FPS
    motion = reaching(1.2 + 0.9 * np.sin(4 * np.pi * time), np.full(30, 1.9))
    other = cleared(mirrored_motion(motion))
    assert rotation.angle_between(mirrored_motion(other).rotations, cleared(motion).rotations).max() < 1e-6


def drawn_back(back: Array) -> Motion:
    """A left arm whose hand is beside the belly, with its elbow turned behind the back by `back` [T], radians."""
    down = rotation.from_exponential_map(np.tile([0.0, 0.0, -1.45], (len(back), 1)))
    behind = rotation.from_exponential_map(back[:, None] * [1.0, 0.0, -0.35])
    return turned(FINGERED, len(back), LeftArm=rotation.multiply(behind, down), LeftForeArm=np.array([0.0, -1.3, 0.0]))


def test_an_elbow_behind_the_back_swings_outward_and_the_hand_stays() -> None:
    time = np.arange(60) / FPS
    motion = drawn_back(0.45 + 0.45 * np.sin(2 * np.pi * time))
    free = cleared(motion)
    elbow, hand = FINGERED.index("LeftForeArm"), FINGERED.index("LeftHand")
    before, after = (positions_of(one) for one in (motion, free))
    hips = before[0, 0]
    hidden = before[:, elbow] - hips
    assert ((hidden[:, 2] < -0.08) & (hidden[:, 0] < 0.2)).any(), "it was hidden"
    there = after[:, elbow] - hips
    assert not ((there[:, 2] < -0.08) & (there[:, 0] < 0.2)).any()
    moved = np.linalg.norm(after[:, elbow] - before[:, elbow], axis=1)
    steps = [np.linalg.norm(np.diff(places[:, elbow], axis=0), axis=1).max() for places in (before, after)]
    assert moved.max() > 0.03 and steps[1] < 2.5 * steps[0], "no jump"
    alone = TRUNK.distances(pose_of(motion))["Left"] > 0.08  # frames in which the hand is clear
    assert alone.any()
    np.testing.assert_allclose(after[alone][:, hand], before[alone][:, hand], atol=1e-6)
    turns = [rotation.from_exponential_map(np.zeros(3))]
    for one in (motion, free):
        world = turns[0]
        for joint in ("LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"):
            world = rotation.multiply(world, one.rotations[:, FINGERED.index(joint)])
        turns.append(world)
    assert rotation.angle_between(turns[1], turns[2]).max() < 1e-6, "the palm stays as it was"


def test_a_hand_folded_to_its_shoulder_takes_its_knuckles_out_of_the_trunk_by_the_wrist() -> None:
    """A pose of twice the intensity with the hands near the body: the knuckles were 3 cm inside."""
    share = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(60) / 60)
    motion = turned(FINGERED, 60, LeftShoulder=np.array([0.0, -0.1, 0.17]), LeftArm=np.array([0.43, -0.88, -1.29]),
                    LeftForeArm=np.array([-0.34, -2.84, 0.1]), LeftHand=share[:, None] * [0.0, 0.7, -1.6])
    free = cleared(motion)
    before, after = (TRUNK.distances(pose_of(one))["Left"] for one in (motion, free))
    assert before.min() < -0.015 and after.min() > -0.01
    places = [positions_of(one) for one in (motion, free)]
    for joint in ("LeftForeArm", "LeftHand"):
        np.testing.assert_allclose(*(place[:, FINGERED.index(joint)] for place in places), atol=0.015)
    knuckles = FINGERED.index("LeftHandMiddle1")
    steps = [np.linalg.norm(np.diff(place[:, knuckles], axis=0), axis=1).max() for place in places]
    assert steps[1] < 1.5 * steps[0], "no jump"


@pytest.mark.parametrize("knobs", [{}, {"intensity": 2.0, "legs": True}, {"energy": "lively", "mirror": True},
                                   {"hand_radius": 0.15, "hold_still": ((3.2, 5.0),)}])
@pytest.mark.filterwarnings("ignore:hand_radius")
def test_no_hand_is_in_the_trunk_and_no_elbow_behind_it_at_any_knob(knobs: dict, system: Gesticulator) -> None:
    motion = system(example(10.0), seed=1, **knobs).motion
    for gap in TRUNK.distances(pose_of(replace(motion, root_positions=np.zeros_like(motion.root_positions)))).values():
        assert gap.min() > -0.01
    body = common_body(motion)
    assert max(behind(body, side, sign).mean() for side, sign in (("Left", 1.0), ("Right", -1.0))) <= 0.01


def test_a_hand_that_is_moved_turns_to_the_same_side_as_its_neighbours() -> None:
    time = np.arange(120) / FPS
    motion = reaching(1.2 + 0.9 * np.sin(2 * np.pi * time), np.full(120, 1.9))
    # The forearm is turned by more than half a turn, where the quaternion of a matrix may lie on the other side.
    twist = rotation.from_exponential_map((2.9 + 0.4 * np.sin(3 * time))[:, None] * [1.0, 0.0, 0.0])
    arm = FINGERED.index("LeftForeArm")
    turns = motion.rotations.copy()
    turns[:, arm] = rotation.continuous(rotation.multiply(turns[:, arm], twist))
    free = cleared(replace(motion, rotations=turns))
    assert (free.rotations != turns).any()
    assert (np.sum(free.rotations[1:] * free.rotations[:-1], axis=-1) > 0).all()


@pytest.mark.parametrize("seed", [2, 7])
def test_no_elbow_jumps_in_the_example(seed: int, system: Gesticulator) -> None:
    """Seeds in which an elbow once jumped at 12 and 9 m/s."""
    points = common_body(system(example(), seed=seed).motion).points
    ways = np.stack([points[f"{side}ForeArm"] - points[f"{side}Arm"] for side in ("Left", "Right")])
    assert 60.0 * np.linalg.norm(np.diff(ways, axis=1), axis=-1).max() < 4.0, "m/s about the shoulder"


# ------------------------------------------------------------------------------------------------------------ distances

WIDTH, DEPTH = 0.2, 0.1
COLUMN = replace(TRUNK, width=np.full(2, WIDTH), depth=np.full(2, DEPTH))
COUNT = 2000


def columns(above: tuple[float, float]) -> tuple[Array, Array, Array, Array, Array]:
    """Points [COUNT, 3] about leaning columns (hips, neck [COUNT, 3], chest [COUNT, 3, 3]) with their places across
    and along them [COUNT, 3]: left and ahead in metres, along as a share drawn between `above`."""
    rng = np.random.default_rng(7)
    chest = Rotation.random(COUNT, rng=rng).as_matrix()
    hips, length = rng.normal(size=(COUNT, 3)), rng.uniform(0.3, 0.7, COUNT)
    across, share = rng.uniform(-0.5, 0.5, (COUNT, 2)), rng.uniform(*above, COUNT)
    local = np.stack([across[:, 0], share * length, across[:, 1]], axis=1)
    points = hips + np.einsum("nij,nj->ni", chest, local)
    return points, hips, hips + length[:, None] * chest[..., 1], chest, np.insert(across, 1, share, axis=1)


def radial(local: Array) -> Array:
    """[COUNT] metres from the surface on the ray from the axis: r (1 - 1 / |(x / width, z / depth)|)."""
    x, z = local[:, 0], local[:, 2]
    return np.hypot(x, z) * (1.0 - 1.0 / np.hypot(x / WIDTH, z / DEPTH))


def test_between_its_ends_the_distance_is_that_from_the_ellipse() -> None:
    points, hips, neck, chest, local = columns((0.01, 0.99))
    gap, out = COLUMN.distance(points, hips, neck, chest)
    expected = radial(local)
    # Sums of a few numbers about 1 in double precision. One point in three thought itself beyond an end, and so at
    # the surface, by 1e-17 m of rounding.
    np.testing.assert_allclose(gap, expected, atol=1e-12)
    assert (expected < -0.05).sum() > 30
    np.testing.assert_allclose(COLUMN.distance(points - gap[:, None] * out, hips, neck, chest)[0], 0.0, atol=1e-12)


def test_beyond_its_ends_the_distance_grows_from_that_of_the_rim() -> None:
    points, hips, neck, chest, local = columns((1.05, 1.5))
    length = np.linalg.norm(neck - hips, axis=1)
    expected = np.hypot(np.maximum(radial(local), 0.0), (local[:, 1] - 1.0) * length)
    np.testing.assert_allclose(COLUMN.distance(points, hips, neck, chest)[0], expected, atol=1e-12)


def test_a_pose_of_some_joints_has_them_and_those_above_as_that_of_all() -> None:
    turns = Rotation.random(5 * len(CHARACTER), rng=np.random.default_rng(1)).as_quat(scalar_first=True)
    motion = Motion(CHARACTER, turns.reshape(5, -1, 4), np.random.default_rng(2).normal(size=(5, 3)), 60.0)
    some, every = pose_of(motion, ("LeftHand", "Head")), pose_of(motion)
    assert {"Hips", "LeftArm", "LeftForeArm", "LeftHand", "Neck", "Head"} <= set(some.places)
    assert "RightArm" not in some.places
    for name, place in some.places.items():
        assert np.array_equal(place, every.places[name]) and np.array_equal(some.turns[name], every.turns[name])
    np.testing.assert_allclose(every.places["LeftHand"], positions_of(motion)[:, CHARACTER.index("LeftHand")],
                               atol=1e-12)
