"""Characters read from files, their joints named and found, and mappings kept in files."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from data_module.motion import bvh, kinematics, rotation
from data_module.motion.skeletons import CHARACTER, WHOLE_BODY
from data_module.types import Motion
from gesticulator import infer
from gesticulator.characters.blender import SCRIPT, run_in_blender
from gesticulator.characters.bvh_rig import write_character_bvh
from gesticulator.characters.joints import find_joints
from gesticulator.characters.mapping import check, load_mapping, save_mapping
from gesticulator.characters.names import label
from gesticulator.characters.reading import read_character
from gesticulator.characters.retarget import Retargeter, retarget
from tests.performances import EXAMPLE
from tests.rigs import Rig, as_glb, draw


def motion_of(skeleton=CHARACTER, frames: int = 6) -> Motion:  # type: ignore[no-untyped-def]
    """Arms that wave."""
    turns = np.zeros((frames, len(skeleton), 3))
    for name, size in (("LeftArm", 0.9), ("RightArm", -0.7), ("LeftForeArm", 0.5), ("Spine2", 0.1), ("Head", 0.2)):
        turns[:, skeleton.index(name)] = np.outer(np.sin(np.arange(frames)), [0.3, 0.2, size])
    return Motion(skeleton, rotation.from_exponential_map(turns), np.zeros((frames, 3)), 20.0)


@pytest.mark.parametrize(("name", "part", "side"), [
    ("mixamorig:LeftUpLeg", "UpLeg", "Left"), ("upperarm_r", "Arm", "Right"), ("Bip01 L UpperArm", "Arm", "Left"),
    ("J_Bip_R_LowerLeg", "Leg", "Right"), ("lShldrBend", "Arm", "Left"), ("DEF-forearm.R.001", "ForeArm", "Right"),
    ("LThumb", "Thumb", "Left"), ("index_02_l", "Index", "Left"), ("Bip01_R_Finger41", "Pinky", "Right"),
    ("spine_03", "Spine", ""), ("CC_Base_NeckTwist01", "Neck", ""), ("left_wrist", "Hand", "Left"),
])
def test_names_tell_part_and_side(name: str, part: str, side: str) -> None:
    assert label(name).parts[0] == part and label(name).side == side


@pytest.mark.parametrize("name", ["root", "Camera", "jaw", "LeftEye", "upperarm_bck_l", "spine_04_latissimus_l", "",
                                  "forehead.L", "armpit.L", "headband"])
def test_names_of_other_things_tell_no_part(name: str) -> None:
    assert not label(name).parts


def test_twist_bones_and_tips_are_known_as_such() -> None:
    assert label("upperarm_twist_01_l").aid and label("HeadTop_End").tip and not label("LeftHand").tip


@pytest.fixture(scope="module")
def rigs() -> list[Rig]:
    return [draw(3, "mixamo", "A"), draw(5, "vrm table", "T"), draw(6, "metahuman", "down")]


def test_a_glb_is_read_as_it_was_written(rigs: list[Rig], tmp_path: Path) -> None:
    for rig in rigs:
        file = tmp_path / "rig.glb"
        file.write_bytes(as_glb(rig))
        found = read_character(file)
        at = {number: place for place, number in enumerate(found.node_ids)}
        order = [at[node] for node in range(len(rig.character))]
        assert [found.names[place] for place in order] == list(rig.character.names)
        assert np.allclose(found.world_matrices()[order], rig.character.world_matrices(), atol=1e-5)
        assert found.bind is not None and np.allclose(found.bind[order], rig.character.world_matrices(), atol=1e-4)
        assert {bone: found.node_ids[node] for bone, node in found.humanoid.items()} == rig.character.humanoid
        assert np.allclose(found.flesh, rig.character.flesh, atol=1e-5)
        joints = find_joints(found)
        assert {name: found.node_ids[node] for name, node in joints.joints.items()} == rig.truth


def test_the_pose_that_a_file_stands_in_does_not_matter(tmp_path: Path) -> None:
    """Only the pose that the mesh was bound in does: the world rotations come out the same."""
    rig = draw(3, "mixamo", "T")
    arm = rig.truth["LeftArm"]
    twisted = rotation.multiply(rig.character.rotations[arm],
                                Rotation.from_euler("XYZ", [40, 20, -30], degrees=True).as_quat(scalar_first=True))
    straight, posed = tmp_path / "straight.glb", tmp_path / "posed.glb"
    straight.write_bytes(as_glb(rig))
    posed.write_bytes(as_glb(rig, {arm: twisted}))
    first, second = (retarget(motion_of(), file, contacts=False).world_matrices() for file in (straight, posed))
    assert not np.allclose(read_character(posed).world_matrices(), read_character(straight).world_matrices(), atol=0.01)
    assert np.allclose(first, second, atol=1e-4)


@pytest.mark.parametrize("damage", [
    lambda data: data[:200], lambda data: b"glTF" + data[8:], lambda data: b"no glTF at all",
    lambda data: data.replace(b'"children": [1]', b'"children": [0]'),  # a node that is its own child
])
def test_a_broken_glb_is_refused_in_a_line(damage, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "broken.glb"
    file.write_bytes(damage(as_glb(draw(3, "mixamo", "A"))))
    with pytest.raises(InputError, match="broken"):
        read_character(file)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.glb"):
        read_character(tmp_path / "rig.max")
    with pytest.raises(InputError, match="does not exist"):
        read_character(tmp_path / "rig.glb")


# ---------------------------------------------------------------------------------------------------- BVH

def test_a_bvh_character_keeps_her_own_skeleton_and_plays_the_motion(tmp_path: Path) -> None:
    rig = next(rig for rig in map(draw, range(200)) if rig.character.kind == "bvh" and rig.unit == 0.01)
    moved = Retargeter(rig.character)(motion_of(WHOLE_BODY))
    assert moved.translations is not None
    file = tmp_path / "talk.bvh"
    write_character_bvh(file, moved.character, moved.rotations, (moved.hips, moved.translations), moved.fps)
    again = read_character(file)
    assert set(again.names) == set(rig.character.names)
    assert "CHANNELS 3 Zrotation Yrotation Xrotation" in file.read_text()
    read = bvh.read_bvh(file, unit=1.0)
    order = [read.skeleton.names.index(name) for name in rig.character.names]
    expected = moved.world_matrices()[..., :3, 3]
    assert np.allclose(kinematics.positions_of(read)[:, order], expected, atol=1e-3 * np.ptp(expected))


# ---------------------------------------------------------------------------------------------------- FBX

@pytest.mark.usefixtures("blender")
def test_an_fbx_file_is_read_through_blender(tmp_path: Path) -> None:
    rig = draw(3, "mixamo", "A")
    glb = tmp_path / "rig.glb"
    glb.write_bytes(as_glb(rig))
    run_in_blender(glb, SCRIPT, str(glb), str(tmp_path / "rig.fbx"), "30")
    read = read_character(tmp_path / "rig.fbx")
    found = find_joints(read)
    check(found, read)
    assert {name: read.names[node] for name, node in found.joints.items()} == {
        name: rig.character.names[node] for name, node in rig.truth.items()}


def test_an_fbx_without_blender_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gesticulator.characters.blender.blender", lambda: None)
    (tmp_path / "rig.fbx").write_bytes(b"FBX")
    with pytest.raises(InputError, match="Blender"):
        read_character(tmp_path / "rig.fbx")


# ---------------------------------------------------------------------------------------------------- mappings

def test_a_mapping_is_saved_corrected_and_read(tmp_path: Path) -> None:
    rig = draw(3, "mixamo", "A")
    found, file = find_joints(rig.character), tmp_path / "rig.json"
    save_mapping(file, found, rig.character)
    again = load_mapping(file, rig.character)
    assert dict(again.joints) == dict(found.joints) and again.spine == found.spine and again.confidence == 1.0
    told = json.loads(file.read_text())
    told["joints"]["LeftArm"] = told["joints"]["LeftForeArm"]
    file.write_text(json.dumps(told))
    with pytest.raises(InputError, match="one node"):
        check(load_mapping(file, rig.character), rig.character)
    for joints, wrong in (({"LeftArm": "no such node"}, "no such node"), ({"Tail": None}, "Tail")):
        file.write_text(json.dumps({**told, "joints": joints}))
        with pytest.raises(InputError, match=wrong):
            load_mapping(file, rig.character)


def test_a_guess_that_is_not_sure_is_refused_unless_it_is_given(tmp_path: Path) -> None:
    rig = draw(3, "mixamo", "A")
    odd = replace(rig.character, names=tuple(f"thing {i}" for i in range(len(rig.character))),
                  translations=np.where(np.arange(len(rig.character))[:, None] == rig.truth["LeftForeArm"],
                                        3.0 * rig.character.translations, rig.character.translations))
    found = find_joints(odd)
    with pytest.raises(InputError, match="--save-mapping"):
        check(found, odd)
    check(replace(find_joints(rig.character), confidence=1.0), odd)


def test_something_without_a_body_is_refused() -> None:
    rig = draw(3, "mixamo", "A")
    n = 5
    box = replace(rig.character, names=("a", "b", "c", "d", "e"), parents=(-1, 0, 1, 2, 3),
                  translations=rig.character.translations[:n], rotations=rig.character.rotations[:n],
                  scales=rig.character.scales[:n], skinned=np.ones(n, dtype=bool), node_ids=tuple(range(n)),
                  flesh=np.zeros((0, 3)), flesh_nodes=np.zeros(0, np.int64))
    with pytest.raises(InputError, match="mapping"):
        check(find_joints(box), box)


def test_the_command_moves_a_bvh_character_from_sound_to_file(tmp_path: Path) -> None:
    """End to end: names, channels and floor of her file are kept, frames are those of the sound."""
    rig = next(rig for rig in map(draw, range(200)) if rig.character.kind == "bvh" and rig.unit == 0.01)
    still = np.tile(rig.character.rotations, (1, 1, 1))
    source, out = tmp_path / "rig.bvh", tmp_path / "talk.bvh"
    write_character_bvh(source, rig.character, still, None, 30.0)
    assert infer.main([str(EXAMPLE), "--character", str(source), "-o", str(out), "--fps", "20", "--quiet",
                       "--save-mapping", str(tmp_path / "m.json")]) == 0
    made, rest = bvh.read_bvh(out, unit=0.01), read_character(source)
    kept = [node for node in range(1, len(rest)) if node != rest.names.index("Hips")]
    assert made.skeleton.names == rest.names
    assert np.allclose(made.skeleton.offsets[kept], 0.01 * rest.translations[kept])
    assert abs(made.duration - 1.0 / made.fps - len(made) / 20.0) < 0.1 and len(made) > 40
    wrist = kinematics.positions_of(made)[:, rest.names.index(rig.character.names[rig.truth["LeftHand"]])]
    assert np.ptp(wrist, axis=0).max() > 0.1
