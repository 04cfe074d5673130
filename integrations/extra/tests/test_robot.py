"""The Unitree G1: its table, its limits, and the angles that it is given, in MuJoCo where that is installed."""

from __future__ import annotations

import argparse
import csv
import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from gesticulator_extra.robots import g1
from gesticulator_extra.robots.angles import to_robot
from gesticulator_extra.robots.limits import SPEED_SHARE, slowed
from gesticulator_extra.robots.pan_tilt import pan_over_time, tilt_at
from gesticulator_extra.robots.table import COLUMNS, RobotWarning
from hypothesis import given, settings
from hypothesis import strategies as st
from performances import perform, write
from scipy.spatial.transform import Rotation

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import CHARACTER, CHARACTERS
from data_module.types import Array, Motion
from gesticulator.export.writers import suffix_of
from gesticulator.jobs import infer_arguments, jobs_of
from gesticulator.performance import Performance

MODEL = "asset_zoo/robots/unitree_g1/xmls/g1.xml"
"""Inside the package `mjlab`, which is not imported."""
TO_ROBOT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


# ------------------------------------------------------------------------------------------------------ known answers

def posed(world: dict[str, Rotation], frames: int = 3) -> Motion:
    """The 16 joints, still, with these world rotations; the other joints as the one above them."""
    turns = np.zeros((1, len(CHARACTER), 4))
    for joint, (name, parent) in enumerate(zip(CHARACTER.names, CHARACTER.parents, strict=True)):
        above = turns[:, parent] if parent >= 0 else np.array([[1.0, 0.0, 0.0, 0.0]])
        turns[:, joint] = world[name].as_quat(scalar_first=True) if name in world else above
    local = np.repeat(kinematics.local_rotations(CHARACTER, turns), frames, axis=0)
    return Motion(CHARACTER, local, np.zeros((frames, 3)), 30.0)


def arms(left: tuple[Rotation, Rotation, Rotation]) -> dict[str, Rotation]:
    """World rotations of both arms, hands included; the right one is the mirror image."""
    out = {}
    for part, turn in zip(("Arm", "ForeArm", "Hand"), left, strict=True):
        x, y, z = turn.as_rotvec()
        out |= {"Left" + part: turn, "Right" + part: Rotation.from_rotvec([x, -y, -z])}
    return out


def angles_of(motion: Motion) -> dict[str, float]:
    """Joint -> degrees, the same in all frames."""
    moved = to_robot(motion)
    np.testing.assert_allclose(moved.angles, moved.angles[:1].repeat(len(moved), axis=0), atol=1e-9)
    return dict(zip(g1.NAMES, np.degrees(moved.angles[0]), strict=True))


def about(axis: str, degrees: float) -> Rotation:
    return Rotation.from_euler(axis, degrees, degrees=True)


DOWN = about("z", -90.0)  # a left arm that hangs, its palm inwards
AHEAD = about("x", -90.0) * DOWN  # a left forearm that points ahead, its palm inwards
KNOWN = {
    "hanging": ((DOWN, DOWN, DOWN), {"elbow": 90.0}),
    "T-pose": ((about("z", 0.0),) * 3, {"shoulder_roll": 90.0, "elbow": 90.0, "wrist_roll": None,
                                        "shoulder_yaw": None}),
    "forearms ahead": ((DOWN, AHEAD, AHEAD), {}),
    "forearms ahead, palms up": ((DOWN, AHEAD, about("z", -90.0) * AHEAD), {"wrist_roll": -90.0}),
    "hands bent in": ((DOWN, AHEAD, about("y", -30.0) * AHEAD), {"wrist_yaw": -30.0}),
    "hands bent down": ((DOWN, AHEAD, about("x", 30.0) * AHEAD), {"wrist_pitch": 30.0}),
    "arms ahead": ((AHEAD, AHEAD, AHEAD), {"shoulder_pitch": -90.0, "elbow": 90.0,  # about an axis that rises by 16
                                               "shoulder_roll": 16.0, "shoulder_yaw": 16.0}),
    "forearms up": ((DOWN, about("x", -130.0) * DOWN, about("x", -130.0) * DOWN), {"elbow": -40.0}),
    "hands across": ((DOWN, about("y", -40.0) * AHEAD, about("y", -40.0) * AHEAD), {"shoulder_yaw": -40.0}),
}


@pytest.mark.parametrize("pose", KNOWN)
def test_poses_that_everybody_knows_have_the_angles_that_they_should(pose: str) -> None:
    left, wanted = KNOWN[pose]
    got = angles_of(posed(arms(left)))
    for side, mirror in (("left", 1.0), ("right", -1.0)):
        for index in g1.joints_of(side, "arm"):
            name = g1.NAMES[index]
            part = name.removeprefix(f"{side}_").removesuffix("_joint")
            angle = wanted.get(part, 0.0)
            if angle is not None:
                sign = 1.0 if g1.JOINTS[index].axis == "y" else mirror
                assert got[name] == pytest.approx(sign * angle, abs=0.5), name
    assert all(abs(got[f"waist_{part}_joint"]) < 1e-6 for part in ("yaw", "roll", "pitch"))


def test_the_waist_takes_the_chest_and_the_pelvis_faces_where_the_hips_do() -> None:
    chest = about("y", 20.0) * about("z", -8.0) * about("x", 15.0)
    got = angles_of(posed({"Hips": about("y", 60.0), "Spine3": about("y", 60.0) * chest}))
    for part, angle in (("yaw", 20.0), ("roll", -8.0), ("pitch", 15.0)):
        assert got[f"waist_{part}_joint"] == pytest.approx(angle, abs=0.01)
    moved = to_robot(posed({"Hips": about("y", 60.0)}))
    ahead = rotation.rotate(moved.turns, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(ahead, np.tile([np.cos(np.pi / 3), np.sin(np.pi / 3), 0.0], (3, 1)), atol=1e-9)


def test_what_cannot_be_done_is_told_and_cut() -> None:
    moved = to_robot(posed({"Spine3": about("x", 60.0)}))
    assert np.degrees(moved.angles[:, g1.INDEX["waist_pitch_joint"]]) == pytest.approx(29.79, abs=0.01)  # 0.52 rad
    assert moved.aside["trunk"] == 1.0
    note = moved.note()
    assert note is not None and "trunk in 100.0 %" in note and "\n" not in note
    assert to_robot(posed(arms((DOWN, AHEAD, AHEAD)))).note() is None


# ------------------------------------------------------------------------------------------------ limits and pointing

@settings(max_examples=15)
@given(st.integers(0, 10_000), st.floats(0.1, 4.0), st.floats(8.0, 240.0), st.sampled_from(sorted(CHARACTERS)))
def test_limits_hold_whatever_is_asked(seed: int, size: float, fps: float, joints: int) -> None:
    rng = np.random.default_rng(seed)
    turns = rotation.from_exponential_map(np.cumsum(rng.normal(size=(12, joints, 3)) * size, axis=0))
    hips = np.cumsum(rng.normal(size=(12, 3)) * 0.1, axis=0)
    moved = to_robot(Motion(CHARACTERS[joints], turns, hips, fps))
    assert (moved.angles > g1.LOW).all() and (moved.angles < g1.HIGH).all()
    steps = np.abs(np.diff(moved.angles, axis=0)) * moved.fps
    assert (steps <= SPEED_SHARE * g1.SPEED + 1e-6).all()
    np.testing.assert_allclose(np.linalg.norm(moved.turns, axis=-1), 1.0, atol=1e-9)


@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=30), st.floats(0.05, 4.0))
def test_a_slowed_track_is_slow_and_as_near_as_one_can_be(values: list[float], step: float) -> None:
    track = np.array(values)[:, None]
    got = slowed(track, np.array([step]))
    assert (np.abs(np.diff(got, axis=0)) <= step + 1e-9).all()
    assert got.min() >= track.min() - 1e-9 and got.max() <= track.max() + 1e-9
    # Two values that lie too far apart for the time between them share what is too much, and no track does better.
    apart = np.abs(track - track.T) - step * np.abs(np.subtract.outer(np.arange(len(track)), np.arange(len(track))))
    assert np.abs(got - track).max() == pytest.approx(max(0.0, apart.max()) / 2.0, abs=1e-9)


def missed(way: Array, pan: Array, tilt: Array) -> Array:
    """[T] degrees between directions and where two hinges point."""
    there = np.stack([np.cos(tilt) * np.cos(pan), np.cos(tilt) * np.sin(pan), np.sin(tilt)], axis=-1)
    return np.degrees(np.arccos(np.clip(np.sum(way * there, axis=-1), -1.0, 1.0)))


@pytest.mark.parametrize("high", [2.1, np.pi / 2.0], ids=["bends both ways", "bends one way"])
def test_what_passes_near_the_pole_goes_through_it_instead_of_around(high: float) -> None:
    # A forearm that swings past straight, 4 degrees beside it: frame by frame the pan would turn half around.
    across = np.linspace(-0.5, 0.5, 61)
    way = np.stack([across, np.full(61, np.sin(np.radians(4.0))), np.zeros(61)], axis=-1)
    way[:, 2] = np.sqrt(1.0 - np.sum(way ** 2, axis=-1))
    frames = np.arctan2(way[:, 1], way[:, 0])
    got = pan_over_time(way, np.zeros(61), 60.0, (-3.1, 3.1), (-1.0, high))
    off = missed(way, got, tilt_at(got, way, (-1.0, high)))
    if high > 2.0:
        assert np.abs(np.diff(got)).max() < 0.7 * np.abs(np.diff(frames)).max()
        assert np.ptp(got) < 1.0 and off.max() < 4.1
    else:  # no way through: half around it is, but smoothly
        assert off.max() < 2.0 and np.ptp(got) > 2.5
    assert off[:10].max() < 1.0 and off[-10:].max() < 1.0


# ---------------------------------------------------------------------------------------------------------- the file

def small(seed: int, skeleton: int = 16, fps: float = 60.0, size: float = 0.45) -> Performance:
    """Arms that gesture: from hanging, with bent elbows, by smooth turns of half a radian or so."""
    made = perform(2.5, fps, seed, skeleton=CHARACTERS[skeleton])
    motion = made.motion
    log = size * rotation.to_exponential_map(motion.rotations)
    log[:, [motion.skeleton.index(name) for name in ("Hips", "Spine", "Spine1", "Spine2", "Spine3")]] *= 0.15
    turns = rotation.from_exponential_map(log)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        for part, axis, angle in (("Arm", [0.0, 0.0, sign], -1.25), ("ForeArm", [0.0, sign, 0.0], -1.0)):
            joint = motion.skeleton.index(side + part)
            turns[:, joint] = rotation.multiply(rotation.from_exponential_map(angle * np.array(axis)), turns[:, joint])
    travel = 0.04 * np.sin(np.linspace(0.0, 6.0, len(motion)))[:, None] * [1.0, 0.2, 0.4]
    return replace(made, motion=replace(motion, rotations=turns, root_positions=travel))


def read_g1(path: Path) -> tuple[list[str], Array]:
    """The head and the numbers of a file."""
    with path.open(newline="") as file:
        head, *rows = list(csv.reader(file))
    return head, np.array(rows, dtype=np.float64)


def test_the_file_holds_time_base_and_joints_by_name(tmp_path: Path) -> None:
    made = small(1, fps=24.0)
    head, rows = read_g1(write(tmp_path / "talk.g1.csv", made))
    assert head == list(COLUMNS) and len(head) == 1 + 7 + 29
    np.testing.assert_allclose(rows[:, 0], np.arange(60) / 24.0, atol=1e-6)
    np.testing.assert_allclose(rows[:, 8:], to_robot(made.motion).angles, atol=1e-6)
    assert (rows[:, 8:] >= g1.LOW).all() and (rows[:, 8:] <= g1.HIGH).all()


def test_what_is_cut_is_one_warning(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write(tmp_path / "calm.g1.csv", replace(small(1), motion=posed(arms((DOWN, AHEAD, AHEAD)), 30)))
    bowed = replace(small(1), motion=posed({"Spine3": about("x", 60.0)}, 30))
    with pytest.warns(RobotWarning, match=r"bow\.g1\.csv: .* trunk in 100\.0 %") as caught:
        write(tmp_path / "bow.g1.csv", bowed)
    assert len(caught) == 1


@pytest.mark.parametrize(("path", "suffix"), [
    ("talk.csv", ".csv"), ("talk.g1.csv", ".g1.csv"), ("out/TALK.G1.CSV", ".g1.csv"), ("a.g1", ".g1"), ("talk", ""),
    ("g1.csv", ".csv"), ("a.b.csv", ".csv"), (".g1.csv", ".csv"),
])
def test_the_suffix_of_two_parts_is_known_and_csv_stays_as_it_is(path: str, suffix: str) -> None:
    assert suffix_of(path) == suffix


@pytest.mark.parametrize(("output", "told", "target"), [
    ("talk.g1.csv", None, "talk.g1.csv"), ("", "g1", "speech.g1.csv"), ("", ".g1.csv", "speech.g1.csv"),
    ("", "csv", "speech.csv"),
])
def test_the_command_names_the_file(tmp_path: Path, output: str, told: str | None, target: str) -> None:
    (tmp_path / "speech.wav").write_bytes(b"")
    parser = argparse.ArgumentParser()
    infer_arguments(parser)
    line = [str(tmp_path / "speech.wav"), "-o", f"{tmp_path}/{output}", *(("--format", told) if told else ())]
    assert jobs_of(parser.parse_args(line))[0].targets == (tmp_path / target,)


def test_a_motion_of_another_skeleton_is_refused() -> None:
    with pytest.raises(ValueError, match="our skeletons"):
        to_robot(Motion(replace(CHARACTER, names=tuple("abcdefghijklmnop")), np.tile([1.0, 0, 0, 0], (2, 16, 1)),
                        np.zeros((2, 3)), 30.0))


# ------------------------------------------------------------------------------------------------------------- MuJoCo

@pytest.fixture(scope="module")
def mujoco() -> ModuleType:
    return pytest.importorskip("mujoco", reason="mujoco is in the extra 'robot' of gesticulator-extra")


@pytest.fixture(scope="module")
def document() -> ET.Element:
    """The robot's model without what it looks like."""
    package = find_spec("mjlab")
    if package is None or not package.submodule_search_locations:
        pytest.skip("the model of the robot is in the package mjlab (pip install --no-deps mjlab)")
    root = ET.parse(Path(next(iter(package.submodule_search_locations))) / MODEL).getroot()
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag == "mesh" or (child.tag == "geom" and ("mesh" in child.attrib
                                                                or child.get("class") == "visual")):
                parent.remove(child)
    return root


@pytest.fixture(scope="module")
def model(mujoco: ModuleType, document: ET.Element) -> Any:
    return mujoco.MjModel.from_xml_string(ET.tostring(document, encoding="unicode"))


def test_the_table_is_that_of_the_model(mujoco: ModuleType, model: Any) -> None:
    assert [model.joint(index).name for index in range(1, model.njnt)] == list(g1.NAMES)
    np.testing.assert_allclose(model.jnt_range[1:], np.stack([g1.LOW, g1.HIGH], axis=-1), atol=1e-6)
    data = mujoco.MjData(model)
    for seed in range(5):
        angles = np.random.default_rng(seed).uniform(g1.LOW, g1.HIGH)
        data.qpos[:] = np.concatenate([[0, 0, 0, 1, 0, 0, 0], angles])
        mujoco.mj_forward(model, data)
        places, turns = g1.forward(angles[None], np.eye(3)[None], np.zeros((1, 3)))
        bodies = model.jnt_bodyid[1:]
        np.testing.assert_allclose(places[0], data.xpos[bodies], atol=5e-4)
        np.testing.assert_allclose(turns[0].reshape(-1, 9), data.xmat[bodies], atol=5e-4)


def played(mujoco: ModuleType, model: Any, rows: Array) -> dict[str, tuple[Array, Array]]:
    """Link -> [T, 3] where it is and [T, 3, 3] its axes, in MuJoCo; every joint is within the model's range."""
    data = mujoco.MjData(model)
    names = [model.body(index).name for index in range(1, model.nbody)]
    places, turns = np.zeros((len(rows), len(names), 3)), np.zeros((len(rows), len(names), 3, 3))
    for frame, row in enumerate(rows):
        data.qpos[:] = row[1:]
        mujoco.mj_forward(model, data)
        assert (data.qpos[7:] >= model.jnt_range[1:, 0]).all() and (data.qpos[7:] <= model.jnt_range[1:, 1]).all()
        places[frame], turns[frame] = data.xpos[1:], data.xmat[1:].reshape(-1, 3, 3)
    return {name: (places[:, index], turns[:, index]) for index, name in enumerate(names)}


def degrees(a: Array, b: Array) -> Array:
    """[T] between directions [T, 3]."""
    cosine = np.sum(a * b, -1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def at_limits(rows: Array) -> Array:
    """[T] whether an arm's or the waist's joint is at a limit of angle or speed, or was within the last frames."""
    angles = rows[:, 8 + 12:]
    edge = (angles < g1.LOW[12:] + 1e-3) | (angles > g1.HIGH[12:] - 1e-3)
    fast = np.abs(np.gradient(angles, rows[1, 0], axis=0)) > 0.9 * SPEED_SHARE * g1.SPEED[12:]
    return (edge | fast).any(axis=1)


@pytest.mark.parametrize("size", [16, 54])
def test_arms_point_in_mujoco_where_ours_do(mujoco: ModuleType, model: Any, tmp_path: Path, size: int) -> None:
    free = 0
    for seed in (2, 5, 8):
        made = small(seed, size)
        rows = read_g1(write(tmp_path / "talk.g1.csv", made))[1]
        links = played(mujoco, model, rows)
        ours = kinematics.positions_of(made.motion) @ TO_ROBOT.T
        at = dict(zip(made.joints, np.moveaxis(ours, 1, 0), strict=True))
        loose = ~at_limits(rows)
        free += int(loose.sum())
        for side in ("left", "right"):
            arm, elbow, hand = (at[side.title() + part] for part in ("Arm", "ForeArm", "Hand"))
            # The hinges that turn the upper arm and the forearm about themselves lie along them.
            upper = degrees(elbow - arm, -links[f"{side}_shoulder_yaw_link"][1][..., 2])
            lower = degrees(hand - elbow, links[f"{side}_wrist_roll_link"][1][..., 0])
            assert upper[loose].max() < 1.0 and lower[loose].max() < 2.5
            assert np.median(upper) < 0.1 and np.median(lower) < 0.3
            # From joint to joint, which the robot's links have set off by up to 7 degrees.
            joint = [links[f"{side}_{name}_link"][0] for name in ("shoulder_roll", "elbow", "wrist_yaw")]
            assert np.median(degrees(elbow - arm, joint[1] - joint[0])) < 8.0
            assert np.median(degrees(hand - elbow, joint[2] - joint[1])) < 12.0
            turned = links[f"{side}_wrist_yaw_link"][1][..., 0]
            fingers = TO_ROBOT @ Rotation.from_quat(kinematics.global_rotations(
                made.motion.skeleton, made.motion.rotations)[:, CHARACTER.index(side.title() + "Hand")],
                scalar_first=True).apply([1.0 if side == "left" else -1.0, 0.0, 0.0]).T
            assert np.median(degrees(turned, fingers.T)) < 1.0
    assert free > 250  # of 450


def test_feet_stand_still_and_flat_under_hips_that_move(mujoco: ModuleType, model: Any, tmp_path: Path) -> None:
    rows = read_g1(write(tmp_path / "talk.g1.csv", small(4, 54)))[1]
    assert np.ptp(rows[:, 1]) > 0.02 and np.ptp(rows[:, 2]) > 0.04  # the pelvis goes where the hips go
    links = played(mujoco, model, rows)
    for side in ("left", "right"):
        places, turns = links[f"{side}_ankle_roll_link"]
        assert np.ptp(places, axis=0).max() < 1e-3
        assert places[:, 2] == pytest.approx(g1.SOLE, abs=1e-3)
        assert np.degrees(np.arccos(np.clip(turns[:, 2, 2], -1.0, 1.0))).max() < 0.5


def test_motors_follow_in_the_simulation(mujoco: ModuleType, document: ET.Element, tmp_path: Path) -> None:
    """Held by its pelvis, with a position servo on every joint no stronger than its motor, it does the motion."""
    made = small(3)
    rows = read_g1(write(tmp_path / "talk.g1.csv", made))[1]
    root = ET.fromstring(ET.tostring(document))
    pelvis = next(body for body in root.iter("body") if body.get("name") == "pelvis")
    pelvis.remove(next(iter(pelvis.findall("freejoint"))))
    for joint in root.iter("joint"):
        joint.set("armature", "0.01")
    motors = ET.SubElement(root, "actuator")
    for joint in g1.JOINTS:
        force = "5" if joint.speed == 22.0 else "25"
        ET.SubElement(motors, "position", {"name": joint.name, "joint": joint.name, "kp": "60", "kv": "3",
                                           "forcerange": f"-{force} {force}"})
    for tag in ("sensor", "keyframe"):
        for child in root.findall(tag):
            root.remove(child)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    data.qpos[:] = rows[0, 8:]
    off = []
    for time, row in zip(rows[:, 0], rows, strict=True):
        while data.time < time:
            data.ctrl[:] = row[8:]
            mujoco.mj_step(model, data)
        off.append(np.abs(data.qpos - row[8:]))
    arms_and_waist = np.array(off)[:, 12:]
    assert np.isfinite(arms_and_waist).all()
    assert np.degrees(np.median(arms_and_waist)) < 5.0
    assert (data.qpos > model.jnt_range[:, 0] - 0.02).all() and (data.qpos < model.jnt_range[:, 1] + 0.02).all()


def test_soles_touch_the_floor(mujoco: ModuleType, model: Any) -> None:
    still = to_robot(posed({}))
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate([still.places[0], still.turns[0], still.angles[0]])
    mujoco.mj_forward(model, data)
    feet = [index for index in range(model.ngeom) if "_foot" in model.geom(index).name]
    assert len(feet) == 14  # capsules that lie on the floor
    lowest = data.geom_xpos[feet, 2] - model.geom_size[feet, 0]
    assert lowest == pytest.approx(0.0, abs=1e-3)
