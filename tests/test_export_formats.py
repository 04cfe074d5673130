"""Every format read back: by an independent reader, by the library of its makers, or by the inverse in data_module."""

import csv
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gltf_reader import GlbFile
from hypothesis import given, settings
from hypothesis import strategies as st
from performances import perform, write
from scipy.spatial.transform import Rotation

from data_module.errors import InputError, install_line
from data_module.motion import rotation, smplx
from data_module.motion.kinematics import global_rotations
from data_module.motion.skeletons import CHARACTERS, FINGER_JOINTS, FINGERED, HIP_HEIGHT, to_character
from data_module.types import Array
from gesticulator.export.vrma import BONES
from gesticulator.export.writers import WRITERS, check_output
from gesticulator.performance import Performance

SIZES = tuple(CHARACTERS)


def walking(size: int = 46, seconds: float = 1.2, fps: float = 25.0) -> Performance:
    """A performance whose root moves."""
    made = perform(seconds, fps, skeleton=CHARACTERS[size])
    walk = np.cumsum(np.random.default_rng(1).normal(size=(len(made.motion), 3)) * 0.01, axis=0)
    return replace(made, motion=replace(made.motion, root_positions=walk))


def read_table(path: Path) -> dict[str, Array]:
    """Joint -> [T, 8] time, place and rotation; the joint above it is the last part of the key."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time", "joint", "parent", "x", "y", "z", "qw", "qx", "qy", "qz"]
    found: dict[str, list[list[float]]] = {}
    for row in rows:
        found.setdefault(f"{row['joint']}<{row['parent']}", []).append(
            [float(row[name]) for name in ("time", "x", "y", "z", "qw", "qx", "qy", "qz")])
    return {joint: np.array(values) for joint, values in found.items()}


@pytest.mark.parametrize("size", SIZES)
def test_glb_nodes_are_where_the_joints_are(tmp_path: Path, size: int) -> None:
    made = walking(size)
    glb = GlbFile.parse(write(tmp_path / "a.glb", made).read_bytes())
    names = glb.names()
    world = glb.worlds(animation=0)
    got = np.stack([world[:, names.index(joint), :3, 3] for joint in made.joints], axis=1)
    np.testing.assert_allclose(got, made.positions(), atol=1e-5)
    times = glb.numbers(glb.document["animations"][0]["samplers"][0]["input"])[:, 0]
    np.testing.assert_allclose(times, np.arange(len(made.motion)) / made.fps, atol=1e-6)
    rest = glb.worlds()[0]
    assert rest[names.index("Hips"), 1, 3] == pytest.approx(HIP_HEIGHT)
    arm, hand = (rest[names.index(name), :3, 3] for name in ("LeftArm", "LeftHand"))
    np.testing.assert_allclose((hand - arm)[1:], 0, atol=1e-6)
    assert hand[0] > arm[0], "at rest she stands in a T-pose, her left to +X"


def test_glb_figure_hangs_on_its_joints(tmp_path: Path) -> None:
    made = walking(16)
    glb = GlbFile.parse(write(tmp_path / "a.glb", made).read_bytes())
    skin, mesh = glb.document["skins"][0], glb.document["meshes"][0]["primitives"][0]["attributes"]
    bind = glb.numbers(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    rest = glb.worlds()[0][skin["joints"]]
    np.testing.assert_allclose(rest @ bind, np.broadcast_to(np.eye(4), rest.shape), atol=1e-6)
    corners, joints = glb.numbers(mesh["POSITION"]), glb.numbers(mesh["JOINTS_0"])[:, 0]
    assert np.linalg.norm(glb.numbers(mesh["NORMAL"]), axis=1) == pytest.approx(1, abs=1e-5)
    # A spindle begins in the joint that turns it.
    starts = np.array([corners[joints == joint] for joint in np.unique(joints)], dtype=object)
    for joint, own in zip(np.unique(joints), starts, strict=True):
        away = np.linalg.norm(np.array(own, float) - rest[joint, :3, 3], axis=1)
        assert away.min() < 1e-5 and away.max() < 0.5
    # Faces look outwards: the volume that they enclose is positive.
    triangles = corners.reshape(-1, 3, 3).astype(float)
    assert np.sum(triangles[:, 0] * np.cross(triangles[:, 1], triangles[:, 2])) > 0


@pytest.mark.parametrize("size", SIZES)
def test_vrma_bones_point_where_ours_do(tmp_path: Path, size: int) -> None:
    made = walking(size)
    glb = GlbFile.parse(write(tmp_path / "a.vrma", made).read_bytes())
    told = glb.document["extensions"]["VRMC_vrm_animation"]
    assert told["specVersion"] == "1.0" and glb.document["extensionsUsed"] == ["VRMC_vrm_animation"]
    bones = {bone: entry["node"] for bone, entry in told["humanoid"]["humanBones"].items()}
    assert {"hips", "spine", "chest", "neck", "head", "leftUpperArm", "rightHand"} <= set(bones)
    assert ("leftThumbMetacarpal" in bones) == (size > 16) and ("leftFoot" in bones) == (size == 54)
    world = glb.worlds(animation=0)
    ours = global_rotations(made.motion.skeleton, made.rotations)
    for bone, node in bones.items():
        if bone != "spine":  # halfway between two joints
            expected = Rotation.from_quat(ours[:, made.motion.skeleton.index(BONES[bone][1][0])], scalar_first=True)
            turned = Rotation.from_matrix(world[:, node, :3, :3])
            assert (turned * expected.inv()).magnitude().max() < 1e-5, bone
    np.testing.assert_allclose(world[:, bones["hips"], :3, 3], made.positions()[:, 0], atol=1e-5)
    assert glb.worlds()[0][bones["hips"], 1, 3] == pytest.approx(HIP_HEIGHT), "players scale by the resting hips"
    np.testing.assert_allclose(glb.worlds()[0][:, :3, :3], np.broadcast_to(np.eye(3), (len(bones), 3, 3)), atol=1e-9)


def test_vrma_says_nothing_of_joints_that_were_not_moved(tmp_path: Path) -> None:
    made = walking(54)
    gone = tuple(name for name in made.joints if "Leg" in name or "Foot" in name or "Toe" in name)
    made = replace(made, motion=replace(made.motion, absent=gone))
    glb = GlbFile.parse(write(tmp_path / "a.vrma", made).read_bytes())
    assert not [name for name in glb.names() if "Leg" in name or "Foot" in name or "Toes" in name]


@pytest.mark.parametrize("size", SIZES)
def test_csv_holds_places_and_rotations_that_agree(tmp_path: Path, size: int) -> None:
    made = walking(size)
    table = read_table(write(tmp_path / "a.csv", made))
    skeleton = made.motion.skeleton
    for index, (joint, rows) in enumerate(table.items()):
        parent = skeleton.parents[index]
        assert joint == f"{made.joints[index]}<{made.joints[parent] if parent >= 0 else ''}"
        np.testing.assert_allclose(rows[:, 0], np.arange(len(made.motion)) / made.fps, atol=1e-6)
        np.testing.assert_allclose(rows[:, 1:4], made.positions()[:, index], atol=2e-6)
        assert rotation.angle_between(rows[:, 4:], made.rotations[:, index]).max() < 1e-5


def test_smplx_is_as_the_leaderboard_takes_it(tmp_path: Path) -> None:
    made = walking(46, seconds=2.0, fps=60.0)
    with np.load(write(tmp_path / "a.npz", made), allow_pickle=False) as file:
        arrays = dict(file)
    assert {name: (array.shape, array.dtype.kind) for name, array in arrays.items()} == {
        "betas": ((300,), "f"), "poses": ((60, 165), "f"), "expressions": ((60, 100), "f"), "trans": ((60, 3), "f"),
        "model": ((), "U"), "gender": ((), "U"), "mocap_frame_rate": ((), "i")}
    assert str(arrays["model"]) == "smplx2020" and str(arrays["gender"]) == "neutral"
    assert int(arrays["mocap_frame_rate"]) == 30
    poses = arrays["poses"].reshape(60, 55, 3)
    assert not poses[:, 22:25].any(), "jaw and eyes"
    assert not poses[:, [1, 2, 4, 5, 7, 8, 10, 11]].any(), "legs, which the motion has not"
    assert np.abs(np.diff(poses, axis=0)).max() < 1.0, "no jumps by a turn"
    # SMPL-X's own order of its hands: index, middle, pinky, ring, thumb, the left hand first.
    own = rotation.to_exponential_map(made.rotations[::2])
    np.testing.assert_allclose(poses[:, 25 + 6], own[:, FINGERED.index("LeftHandPinky1")], atol=1e-5)
    np.testing.assert_allclose(poses[:, 40 + 14], own[:, FINGERED.index("RightHandThumb3")], atol=1e-5)
    np.testing.assert_allclose(poses[:, 18], own[:, FINGERED.index("LeftForeArm")], atol=1e-5)


@pytest.mark.parametrize("size", SIZES)
def test_smplx_read_back_is_the_motion(tmp_path: Path, size: int) -> None:
    made = walking(size, fps=30.0)
    skeleton = CHARACTERS[size]
    back = to_character(smplx.read_smplx(write(tmp_path / "a.npz", made)), skeleton=skeleton)
    assert back.fps == 30 and len(back) == len(made.motion)
    ours, theirs = (global_rotations(skeleton, motion.rotations) for motion in (made.motion, back))
    between = {"Spine1", "Spine2", "Spine3", "Neck1"}  # SMPL-X has three joints for these four, and one for two
    for index, name in enumerate(skeleton.names):
        if name not in between:
            assert rotation.angle_between(ours[:, index], theirs[:, index]).max() < 1e-5, name
    np.testing.assert_allclose(back.root_positions, made.positions()[:, 0], atol=1e-6)


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_usd_as_pixars_own_library_poses_it(tmp_path: Path, suffix: str) -> None:
    pxr = pytest.importorskip("pxr.UsdSkel")
    from pxr import Usd, UsdGeom

    made = walking(54, fps=29.97)
    stage = Usd.Stage.Open(str(write(tmp_path / f"a{suffix}", made)))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert stage.GetTimeCodesPerSecond() == pytest.approx(made.fps)
    skeleton = next(pxr.Skeleton(prim) for prim in stage.Traverse() if prim.IsA(pxr.Skeleton))
    cache = pxr.Cache()
    query = cache.GetSkelQuery(skeleton)
    names = [str(path).rsplit("/", 1)[-1] for path in query.GetJointOrder()]
    assert names == list(made.joints)
    for frame in range(0, len(made.motion), 7):
        places = [matrix.ExtractTranslation() for matrix in query.ComputeJointSkelTransforms(frame)]
        np.testing.assert_allclose(places, made.positions()[frame], atol=1e-5)
    bind = [matrix.ExtractTranslation() for matrix in skeleton.GetBindTransformsAttr().Get()]
    rest = [matrix.ExtractTranslation() for matrix in query.ComputeJointSkelTransforms(0, True)]
    np.testing.assert_allclose(bind, rest, atol=1e-6)
    # Bent by the joints, the figure's corners keep their distance from the joint that they hang on.
    root = pxr.Root(stage.GetDefaultPrim())
    cache.Populate(root, Usd.PrimDefaultPredicate)
    skin = next(found for binding in cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
                for found in binding.GetSkinningTargets())
    points = UsdGeom.Mesh(skin.GetPrim()).GetPointsAttr().Get()
    moved = type(points)(points)
    assert skin.ComputeSkinnedPoints(query.ComputeSkinningTransforms(5), moved, 5)
    joints = np.array(skin.GetJointIndicesPrimvar().Get())
    before = np.linalg.norm(np.array(points) - np.array(bind)[joints], axis=1)
    after = np.linalg.norm(np.array(moved) - made.positions()[5][joints], axis=1)
    np.testing.assert_allclose(after, before, atol=1e-5)
    assert np.abs(np.array(moved) - np.array(points)).max() > 0.1


@given(st.sampled_from(SIZES), st.integers(0, 50))
@settings(max_examples=10, deadline=None)
def test_nodes_stand_where_forward_kinematics_puts_them(size: int, seed: int) -> None:
    made = perform(1.0, seed=seed, root_height=0.3, skeleton=CHARACTERS[size])
    np.testing.assert_allclose(made.scene().nodes.positions(), made.positions(), atol=1e-9)


def test_what_cannot_be_written_is_said() -> None:
    with pytest.raises(InputError, match=r"\.usdc"):
        check_output("a.obj")


@pytest.mark.parametrize("suffix", sorted(name for name, entry in WRITERS.items() if entry.needs))
def test_a_missing_library_is_named_with_its_extra(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                                                   ) -> None:
    needs = WRITERS[suffix].needs
    assert needs is not None
    module, package, extra = needs.module, needs.package, needs.extra
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError) as caught:
        perform().save(tmp_path / "new" / f"a{suffix}")
    assert f"needs {package}" in str(caught.value) and install_line(extra) in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_films_show_fingers_that_move() -> None:
    pytest.importorskip("PIL.Image")
    from gesticulator.export import film
    from gesticulator.export.figure import figure_points

    made = perform(0.5, skeleton=FINGERED).motion
    flat, fist = made.rotations.copy(), made.rotations.copy()
    for turns, degrees in ((flat, 0.0), (fist, 80.0)):
        for name in FINGER_JOINTS:
            sign = 1.0 if name.startswith("Left") else -1.0
            half = np.radians(0.0 if "Thumb" in name else -sign * degrees) / 2.0
            turns[:, FINGERED.index(name)] = [np.cos(half), 0.0, 0.0, np.sin(half)]
    points = [figure_points(replace(made, rotations=turns), np.zeros(1), fingers=True) for turns in (flat, fist)]
    reach = [np.linalg.norm(one["LeftHandMiddle3Tip"] - one["LeftHand"]) for one in points]
    assert reach[0] > 0.16 > 0.1 > reach[1], "metres from the wrist to the tip of the middle finger"
    assert not np.array_equal(*(np.array(next(film.pictures(one))) for one in points)), "fingers are drawn"
    assert not [name for name in figure_points(made, np.zeros(1)) if "Index" in name], "not asked for, not drawn"
