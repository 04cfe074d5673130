"""Faults that characters of other people had: the properties of their files in figures of boxes.

Where the mesh or the rest pose is to blame, see `tests/test_retarget_rigs.py` and `tests/test_gltf_compression.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from performances import perform
from performances import write as write_performance
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from data_module.motion import kinematics
from data_module.motion.skeletons import FINGERED
from gesticulator.characters.joints import find_joints
from gesticulator.characters.reading import read_character
from gesticulator.characters.retarget import Retargeter
from gesticulator.characters.soundness import probe_motion
from tests.awkward import SIDES, Figure, figure, write
from tests.gltf_reader import GlbFile, save
from tests.rigs import STYLES

FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")
TURNED = Rotation.from_euler("Y", 45.0, degrees=True)
UPRIGHT = Rotation.identity()


def spelled(parts: dict[str, str], pattern: str, sides: tuple[str, str] = SIDES) -> Callable[[str], str]:
    """Names by a table of parts. pattern: of parts with a side."""
    def name(key: str) -> str:
        side = next((side for side in SIDES if key.startswith(side)), "")
        part = key.removeprefix(side)
        if not side:
            return parts.get(part, part)
        if part.startswith("Hand") and len(part) > 4:
            return pattern.format(part=parts.get(part[4:-1], part[4:-1]) + part[-1], side=sides[SIDES.index(side)])
        return pattern.format(part=parts.get(part, part), side=sides[SIDES.index(side)])

    return name


def moved(path: Path, body: Figure) -> Retargeter:
    """The character of a figure's file. Its joints must be those of the figure, and its limbs must point where
    those of the motion point."""
    retargeter = Retargeter(read_character(write(path, body)), contacts=False)
    joints, names = retargeter.mapping.joints, retargeter.character.names
    wanted = {key: body.names(key) for key in body.places if key in joints}
    assert {key: names[joints[key]] for key in wanted} == wanted
    assert {"Hips", "Head", "LeftHand", "RightHand", "LeftFoot", "RightFoot"} <= wanted.keys()
    motion = probe_motion()
    ours = kinematics.positions_of(motion)
    theirs = retargeter(motion).world_matrices()[:, :, :3, 3]
    for side in SIDES:
        for above, below in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot")):
            a, b = (ours[:, motion.skeleton.index(side + part)] for part in (above, below))
            c, d = (theirs[:, joints[side + part]] for part in (above, below))
            cosine = np.sum((b - a) * (d - c), axis=1) / np.linalg.norm(b - a, axis=1) / np.linalg.norm(d - c, axis=1)
            # Legs bend by a degree or two so that the feet stay in their place.
            most = 3.0 if above.endswith("Leg") else 1.0
            assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < most, (side, above)
    return retargeter


MIXAMO = "mixamorig:{side}{part}"
RIGIFY = {"Hips": "DEF-spine", "Spine": "DEF-spine.001", "Spine1": "DEF-spine.002", "Spine2": "DEF-spine.003",
          "Neck": "DEF-spine.004", "Head": "DEF-spine.006", "Arm": "upper_arm", "ForeArm": "forearm", "UpLeg": "thigh",
          "Leg": "shin", "ToeBase": "toe", "Shoulder": "shoulder", "Hand": "hand", "Foot": "foot"}
ROBOT = {"Arm": "UpperArm", "ForeArm": "LowerArm", "UpLeg": "UpperLeg", "Leg": "LowerLeg"}


def test_a_control_bone_named_hips_over_the_pelvis_is_not_the_hips(tmp_path: Path) -> None:
    """Taken for the hips, it leaned the body, lifted it and turned it by 45 degrees."""
    body = figure(spelled({**RIGIFY, "Hips": "pelvis", "Spine": "spine_01", "Spine1": "spine_02", "Spine2": "spine_03",
                           "Neck": "neck", "Head": "head"}, "{part}.{side}", ("L", "R")), "A")
    body.above = [("rig", UPRIGHT, 1.0), ("root", UPRIGHT, 1.0), ("hips", TURNED, 1.0),
                  ("torso_ctrl", TURNED.inv(), 1.0)]
    assert moved(tmp_path / "rig.glb", body).doubts == ()


def test_the_head_of_rigify_is_the_end_of_its_spine_and_not_the_bun_on_it(tmp_path: Path) -> None:
    """With the bun taken for the head, and the head for a neck, the character stares at the floor."""
    body = figure(spelled(RIGIFY, "DEF-{part}.{side}", ("L", "R")), "A")
    body.beside("DEF-top_bun.001.L", "Head", (0.02, 0.22, -0.05), 0.05)
    body.beside("DEF-top_bun.002.L", "DEF-top_bun.001.L", (0.0, 0.1, -0.05), 0.05)
    body.beside("DEF-hair_head.001", "Head", (0.0, 0.2, 0.0), 0.03)
    retargeter = moved(tmp_path / "rig.glb", body)
    assert [retargeter.character.names[node] for node in retargeter.mapping.neck] == ["DEF-spine.004"]
    assert retargeter.doubts == ()


def test_a_weapon_beyond_the_hand_is_no_hand_in_japanese(tmp_path: Path) -> None:
    body = figure(STYLES["japanese"], "A", FINGERS)
    body.beside("Hache", "RightHand", (-0.1, 0.0, 0.3), 0.06)
    body.beside("Hache_bout", "Hache", (0.0, 0.0, 0.5), 0.06)
    retargeter = moved(tmp_path / "rig.glb", body)
    assert len([name for name in retargeter.mapping.joints if "Hand" in name]) == 2 * 16
    assert retargeter.doubts == ()


@pytest.mark.parametrize("fingers", [(), ("Index",), ("Thumb", "Index", "Ring")])
def test_a_robot_with_round_feet_and_few_fingers_has_hands_legs_and_its_own_left(fingers: tuple[str, ...],
                                                                                 tmp_path: Path) -> None:
    """The mesh of a leg that ends in a stump a few millimetres behind the ankle says nothing of where it faces."""
    body = figure(spelled(ROBOT, "{part}.{side}", ("L", "R")), "down", fingers, toes=False)
    assert moved(tmp_path / "robot.glb", body).doubts == ()


def test_left_and_right_are_exchanged_back_where_shoes_show_it(tmp_path: Path) -> None:
    names = spelled({}, MIXAMO)
    swapped = {"Left": "Right", "Right": "Left"}
    body = figure(lambda key: names(swapped.get(key[:4], swapped.get(key[:5], ""))
                                    + key.removeprefix("Left").removeprefix("Right")), "A")
    assert "exchanged" in " ".join(moved(tmp_path / "rig.glb", body).doubts)


def unknown_words() -> Callable[[str], str]:
    """Names that say nothing of parts, but the side."""
    words = iter("abcdefghijklmnopqrstuvwxyz")
    plain: dict[str, str] = {}

    def name(key: str) -> str:
        side = next((side for side in SIDES if key.startswith(side)), "")
        part = key.removeprefix(side)
        if part not in plain:
            plain[part] = f"q{next(words)}z"
        return f"{side[:1]}_{plain[part]}" if side else plain[part]

    return name


@pytest.mark.parametrize("turned", [0.0, 180.0])
@pytest.mark.parametrize("legs", [True, False])
def test_sides_are_those_of_the_names_although_nothing_else_in_them_is_known(turned: float, legs: bool, tmp_path: Path
                                                                             ) -> None:
    """A robot whose joints are called l_shoulder_pan and l_wrist_flex was given the right arm for the left one: limbs
    that are found by position were taken to face +Z, and without feet nothing showed that they do not."""
    body = figure(unknown_words(), "T", toes=legs).turned(Rotation.from_euler("Y", turned, degrees=True))
    if not legs:
        body.without("Leg", "Foot")
    found = find_joints(read_character(write(tmp_path / "rig.glb", body)))
    names = read_character(tmp_path / "rig.glb").names
    wanted = {key: body.names(key) for key in body.places if key[-3:] in ("Arm", "and") or key.endswith("Leg")}
    assert {key: names[found.joints[key]] for key in wanted} == wanted
    assert [doubt for doubt in found.doubts if "left" in doubt] == []


@pytest.mark.parametrize("beside", ["Hips", "none"])
def test_a_bone_named_head_beside_the_spine_is_not_the_head(beside: str, tmp_path: Path) -> None:
    """A mesh or a handle of that name is nearer to the root of the file than the head itself."""
    body = figure(spelled({}, MIXAMO), "A")
    body.add("head", None if beside == "none" else beside, (0.0, 1.6, 0.0), 0.0)
    if beside == "none":
        body.places = {"head": body.places.pop("head"), **body.places}
    moved(tmp_path / "rig.glb", body)


def test_ears_wings_and_a_tail_are_no_limbs(tmp_path: Path) -> None:
    """Where no names are known but those, the outermost and highest ends were taken for hands and head."""
    body = figure(unknown_words(), "A")
    plain = body.names
    body.names = lambda key: key if key.startswith(("Ear", "Wing", "Tail")) else plain(key)
    for side, sign in zip(("L", "R"), (1.0, -1.0), strict=True):
        for word, parent, offset in (("Ear", "Head", (0.2, 0.2, 0.0)), ("Wing", "Spine2", (0.3, 0.2, -0.2))):
            above = parent
            for number in range(3):
                body.beside(f"{word}{number}_{side}", above, (sign * offset[0], offset[1], offset[2]), 0.02)
                above = f"{word}{number}_{side}"
    body.beside("Tail1", "Hips", (0.0, -0.1, -0.1), 0.03)
    body.beside("Tail2", "Tail1", (0.0, -0.3, -0.3), 0.03)
    moved(tmp_path / "rig.glb", body)


def test_the_legs_of_another_skeleton_in_the_file_are_not_those_of_the_character(tmp_path: Path) -> None:
    """A rider without shins was given the legs of the horse beside it, and refused for standing on four legs."""
    body = figure(spelled({}, "{part}_{side}"), "A", FINGERS).without("Leg", "Foot", "ToeBase")
    body.above = [("scene", UPRIGHT, 1.0)]
    body.add("Horse", None, (0.0, 1.0, -2.0))
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        above = "Horse"
        for y, key in zip((0.9, 0.5, 0.1, 0.0), ("UpLeg", "Leg", "Foot", "ToeBase"), strict=True):
            body.add(side + key, above, (0.15 * sign, y, -2.0 + (0.1 if key == "ToeBase" else 0.0)))
            above = side + key
        for number in range(3):
            body.beside(f"Rein{number}{side}", "Horse", (0.2 * sign, 0.1 * number, 0.3))
    character = read_character(write(tmp_path / "rig.glb", body))
    found = find_joints(character)
    assert {side + part: character.names[found.joints[side + part]] for side in SIDES for part in ("Arm", "Hand")} == {
        side + part: f"{part}_{side}" for side in SIDES for part in ("Arm", "Hand")}
    assert not [name for name in found.joints if name.endswith(("Leg", "Foot"))]
    assert character.names[found.joints["Hips"]] == "Hips"


@pytest.mark.parametrize("lies", [True, False])
def test_a_bird_is_refused_and_half_a_body_is_not(lies: bool, tmp_path: Path) -> None:
    """Its wings are arms by the names of their bones, and it has no legs: it was set upright and gestured."""
    body = figure(spelled({"Arm": "Humerus", "ForeArm": "Ulna", "Hips": "Body"}, "{part}_{side}", ("L", "R")), "T",
                  toes=False).without("Leg", "Foot")
    body = body.turned(Rotation.from_euler("X", 90.0 if lies else 0.0, degrees=True))
    character = read_character(write(tmp_path / "rig.glb", body))
    if lies:
        with pytest.raises(InputError, match="lies as a bird does"):
            Retargeter(character)
    else:
        assert Retargeter(character).mapping.joints.keys() >= {"LeftHand", "RightHand", "Head"}


@pytest.mark.parametrize(("missing", "named"), [(("Arm", "ForeArm", "Hand"), "RightArm, RightForeArm, RightHand"),
                                                (("ForeArm", "Hand"), "RightForeArm, RightHand"),
                                                (("Hand",), "RightHand")])
def test_a_missing_arm_is_named_and_no_leg_taken_for_it(missing: tuple[str, ...], named: str, tmp_path: Path) -> None:
    """One refusal said that a thigh was both the left arm and the right thigh."""
    body = figure(spelled({}, MIXAMO), "A", FINGERS)
    body.without(*(key for key in body.places if key.startswith(("RightHand", *("Right" + part for part in missing)))))
    with pytest.raises(InputError, match=f"no joint that could be {named}.*gestures need both"):
        Retargeter(read_character(write(tmp_path / "one_arm.glb", body)))


@pytest.mark.parametrize("given", ["no matrices", "the identity", "half the size"])
def test_a_mesh_in_the_axes_of_its_joints_is_as_good_as_one_that_was_bound(given: str, tmp_path: Path) -> None:
    """Inverse bind matrices may be left out, which is the identity for each joint: they say nothing of a bind pose."""
    path, scale = write(tmp_path / "bound.glb", figure(spelled({}, MIXAMO), "A", FINGERS)), 1.0
    bound = Retargeter(read_character(path))
    file = GlbFile.parse(path.read_bytes())
    skin, primitive = file.document["skins"][0], file.document["meshes"][0]["primitives"][0]["attributes"]
    inverse = file.numbers(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    places, slots = (file.numbers(primitive[name]) for name in ("POSITION", "JOINTS_0"))
    move = inverse[slots[:, 0]]
    if given == "no matrices":
        del skin["inverseBindMatrices"]
    else:
        scale = 0.5 if given == "half the size" else 1.0
        file = with_numbers(file, skin["inverseBindMatrices"],
                            np.tile(np.diag([scale] * 3 + [1.0]).ravel(), (len(inverse), 1)))
    local = np.einsum("vij,vj->vi", move[:, :3, :3], places) + move[:, :3, 3]
    file = with_numbers(file, primitive["POSITION"], local / scale)
    found = Retargeter(read_character(save(tmp_path / "local.glb", file.document, file.binary)))
    assert found.mapping.joints == bound.mapping.joints and found.doubts == ()
    for mine, other in ((found.character.flesh, bound.character.flesh),
                        (found.character.skin.points, bound.character.skin.points)):
        np.testing.assert_allclose(mine, other, atol=1e-5)
    np.testing.assert_allclose(found(probe_motion()).rotations, bound(probe_motion()).rotations, atol=1e-5)


def test_a_mesh_that_lost_its_matrices_is_refused(tmp_path: Path) -> None:
    """Its points are in the world, so that each joint takes them away: every viewer shows a heap."""
    file = GlbFile.parse(write(tmp_path / "bound.glb", figure(spelled({}, MIXAMO), "A")).read_bytes())
    del file.document["skins"][0]["inverseBindMatrices"]
    with pytest.raises(InputError, match="mesh"):
        Retargeter(read_character(save(tmp_path / "lost.glb", file.document, file.binary)))


def test_a_second_skin_in_a_space_of_its_own_is_where_its_matrices_say(tmp_path: Path) -> None:
    """A coat in centimetres over a body in metres, as exports of several meshes have it."""
    path = write(tmp_path / "body.glb", figure(spelled({}, MIXAMO), "A"))
    body, file = read_character(path), GlbFile.parse(path.read_bytes())
    document, binary = file.document, file.binary
    skin, primitive = document["skins"][0], document["meshes"][0]["primitives"][0]
    for accessor, numbers in ((skin["inverseBindMatrices"], file.numbers(skin["inverseBindMatrices"])
                               * np.tile([0.01, 0.01, 0.01, 1.0], (4, 1)).T.ravel()),
                              (primitive["attributes"]["POSITION"],
                               100.0 * file.numbers(primitive["attributes"]["POSITION"]))):
        document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": numbers.size * 4})
        document["accessors"].append({**document["accessors"][accessor],
                                      "bufferView": len(document["bufferViews"]) - 1})
        binary += numbers.astype("<f4").tobytes()
    document["buffers"][0]["byteLength"] = len(binary)
    document["skins"].append({**skin, "inverseBindMatrices": len(document["accessors"]) - 2})
    document["meshes"].append({"primitives": [{**primitive, "attributes": {
        **primitive["attributes"], "POSITION": len(document["accessors"]) - 1}}]})
    document["nodes"].append({"name": "Coat", "mesh": 1, "skin": 1})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    dressed = read_character(save(tmp_path / "dressed.glb", document, binary))
    np.testing.assert_allclose(dressed.flesh, np.tile(body.flesh, (2, 1)), atol=1e-4)
    np.testing.assert_allclose(dressed.skin.points, np.tile(body.skin.points, (2, 1)), atol=1e-4)


def with_numbers(file: GlbFile, accessor: int, numbers: np.ndarray) -> GlbFile:
    """The file with floats in place of those of an accessor, which has a view for itself."""
    entry = file.document["accessors"][accessor]
    start = file.document["bufferViews"][entry["bufferView"]]["byteOffset"]
    data = numbers.astype("<f4").tobytes()
    return GlbFile(file.document, file.binary[:start] + data + file.binary[start + len(data):])


def test_a_mesh_that_was_bound_in_a_frame_of_a_walk_faces_ahead(tmp_path: Path) -> None:
    """Hips and shoulders turn against each other in it, and in what follows they face as those of the motion do."""
    body = figure(pose="A")
    for pivot, ends, turn in (("Hips", ("UpLeg", "Leg", "Foot", "ToeBase"), Rotation.from_euler("YZ", [9, 3], True)),
                              ("Spine2", ("Shoulder", "Arm", "Hand"), Rotation.from_euler("YZ", [-11, -4], True))):
        for key in [key for key in body.places if key.endswith(ends)]:
            body.places[key] = body.places[pivot] + turn.apply(body.places[key] - body.places[pivot])
    found = Retargeter(read_character(write(tmp_path / "walk.glb", body)))
    moved = found(probe_motion())
    places = moved.world_matrices()[1, :, :3, 3]  # in the second pose the trunk is straight
    for part in ("UpLeg", "Shoulder"):
        across = places[moved.joints["Left" + part]] - places[moved.joints["Right" + part]]
        assert np.degrees(np.arccos(across[0] / np.linalg.norm(across))) < 0.5, part


@pytest.mark.parametrize("known", [True, False])
def test_fingers_that_hang_on_bones_of_the_palm_are_known_by_names_or_doubted(known: bool, tmp_path: Path) -> None:
    """By position, a hand has five chains: these have three and a bone that carries two."""
    names: dict[str, str] = {}
    body = figure(lambda key: names.get(key, key))
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        letter = side[0].lower()
        body.beside(f"{side}Palm", f"{side}Hand", (0.04 * sign, 0.0, -0.03), 0.01)
        names[f"{side}Palm"] = f"def_{letter}_fngCarpal"
        for number, finger in enumerate(("Thumb", "Index", "Mid", "Ring", "Pinky")):
            above = f"{side}Palm" if number > 2 else f"{side}Hand"
            for joint in "ABC":
                key = f"{side}Finger{number}{joint}"
                body.beside(key, above, (0.03 * sign, 0.0, 0.02 * (2 - number) if joint == "A" else 0.0), 0.01)
                names[key] = f"def_{letter}_fng{finger}{joint}" if known else f"{letter}{number}{joint}q"
                above = key
    found = find_joints(read_character(write(tmp_path / "host.glb", body)))
    assert sum("Hand" in name for name in found.joints) == (2 + 30 if known else 2)
    assert [doubt.split()[:3] for doubt in found.doubts] == ([] if known else [["its", "left", "hand"],
                                                                                ["its", "right", "hand"]])


def test_tails_wings_skirts_and_targets_are_no_limbs(tmp_path: Path) -> None:
    body = figure(spelled(ROBOT, "{part}_{side}", ("L", "R")), "T", ("Thumb", "Index", "Ring"))
    for number in range(5):
        body.beside(f"spine_tail_{number}", f"spine_tail_{number - 1}" if number else "Hips", (0.0, -0.03, -0.2), 0.03)
        for side, sign in (("L", 1.0), ("R", -1.0)):
            body.beside(f"Wing_{side}{number}", f"Wing_{side}{number - 1}" if number else "Spine2",
                        (0.25 * sign, 0.1, -0.08), 0.05)
            body.beside(f"Skirt_{side}_{number}", f"Skirt_{side}_{number - 1}" if number else "Hips",
                        (0.05 * sign, -0.15, 0.03), 0.02)
    for key, place in (("IK_Hand_L", (0.7, 0.5, 0.2)), ("Hand_L_pole", (0.4, 0.5, -0.6)),
                       ("Foot_IK_R", (-0.1, -0.9, 0.0)), ("HeadTarget", (0.0, 0.7, 1.0))):
        body.beside(key, "Hips", place, 0.0)
    assert moved(tmp_path / "rig.glb", body).doubts == ()


# ------------------------------------------------------------------------------------------- nodes, meshes and skins

def edited(path: Path, body: Figure, change: Callable[[GlbFile], None]) -> Path:
    """The file of a figure, changed."""
    file = GlbFile.parse(write(path, body).read_bytes())
    change(file)
    return save(path, file.document, file.binary)


def scaled(name: str, scale: list[float]) -> Callable[[GlbFile], None]:
    def change(file: GlbFile) -> None:
        file.document["nodes"][file.names().index(name)]["scale"] = scale

    return change


@pytest.mark.parametrize(("name", "scale"), [("LeftArm", [1, 1, -1]), ("RightForeArm", [-1, 1, 1]),
                                             ("LeftToeBase", [-1, 1, 1]), ("Spine1", [1, -1, 1])])
def test_a_node_that_mirrors_below_a_mesh_that_was_bound_otherwise_is_moved(name: str, scale: list[float],
                                                                            tmp_path: Path) -> None:
    """The rotations of its bind pose and of its rest pose differ by a reflection, which no rotation is."""
    body = figure(pose="A")
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        body.beside(f"{side}ForeArmTwist", f"{side}ForeArm", (0.09 * sign, -0.09, 0.0), 0.02)
    found = Retargeter(read_character(edited(tmp_path / "rig.glb", body, scaled(name, scale))))
    motion = probe_motion()
    assert np.isfinite(found(motion).rotations).all()
    plain = Retargeter(read_character(write(tmp_path / "plain.glb", body)))
    places = [each(motion).world_matrices()[:, each.mapping.joints["RightHand"], :3, 3] for each in (found, plain)]
    assert name == "Spine1" or name.startswith("Right") or np.abs(places[0] - places[1]).max() < 1e-4


@pytest.mark.parametrize("scale", [[1, 0, 1], [0, 0, 0]])
def test_a_flat_node_over_the_joints_is_named(scale: list[float], tmp_path: Path) -> None:
    body = figure()
    body.above = [("rig", UPRIGHT, 1.0)]
    character = read_character(edited(tmp_path / "rig.glb", body, scaled("rig", scale)))
    with pytest.raises(InputError, match=r"below rig, whose scale is .*0.*flat"):
        Retargeter(character)
    hidden = figure()
    hidden.beside("Prop", "LeftHand", (0.1, 0.0, 0.0), 0.02)
    assert Retargeter(read_character(edited(tmp_path / "rig.glb", hidden, scaled("Prop", scale)))).doubts == ()
    file = GlbFile.parse((tmp_path / "rig.glb").read_bytes())
    file.document["skins"][0].pop("inverseBindMatrices")
    with pytest.raises(InputError, match="come out wrong"):
        Retargeter(read_character(save(tmp_path / "bare.glb", file.document, file.binary)))


def test_a_robot_without_a_spine_whose_feet_hang_elsewhere_is_moved_with_contacts(tmp_path: Path) -> None:
    """Its trunk does not move, so that places on it have one frame, those of its hands all."""
    body = figure().without("Spine", "Spine1", "Spine2", "Neck", "ToeBase")
    body.above = [("rig", UPRIGHT, 1.0)]
    for key, parent in body.parents.items():
        body.parents[key] = None if key.endswith("Foot") else "Hips" if parent in ("Spine2", "Neck") else parent
    body.widths |= {f"{side}Foot": 0.0 for side in SIDES}
    found = Retargeter(read_character(write(tmp_path / "robot.glb", body)))
    assert np.isfinite(found(probe_motion()).rotations).all() and found.contacts


def test_legs_beside_the_hips_stay_where_they_are_and_so_do_the_hips(tmp_path: Path) -> None:
    body = figure()
    body.above = [("rig", UPRIGHT, 1.0)]
    body.parents |= {f"{side}UpLeg": None for side in SIDES}
    found = Retargeter(read_character(write(tmp_path / "apart.glb", body)))
    places = found(probe_motion()).world_matrices()[:, :, :3, 3]
    hips, thigh, foot, hand = (np.ptp(places[:, found.mapping.joints[name]], axis=0).max()
                               for name in ("Hips", "LeftUpLeg", "RightFoot", "LeftHand"))
    assert max(hips, thigh, foot) < 1e-6 and hand > 0.1


@pytest.mark.parametrize("rigid", [True, False])
def test_a_rigid_head_on_its_bone_is_a_head(rigid: bool, tmp_path: Path) -> None:
    """Robots and figures of game kits have parts without a skin that hang on bones."""
    body = figure()
    body.widths["Head"] = 0.0

    def change(file: GlbFile) -> None:
        document, mesh = file.document, file.document["meshes"][0]["primitives"][0]
        document["meshes"].append({"primitives": [{"attributes": {"POSITION": mesh["attributes"]["POSITION"]}}]})
        document["nodes"].append({"name": "Helmet", "mesh": 1})
        document["nodes"][file.names().index("Head")]["children"] = [len(document["nodes"]) - 1]

    character = read_character(edited(tmp_path / "robot.glb", body, change if rigid else lambda file: None))
    if rigid:
        assert Retargeter(character).doubts == () and character.flesh_nodes[-1] == character.names.index("Head")
    else:
        with pytest.raises(InputError, match="nothing that follows the head"):
            Retargeter(character)


def test_a_hat_on_a_head_with_a_skin_is_no_skin(tmp_path: Path) -> None:
    def change(file: GlbFile) -> None:
        file.document["nodes"].append({"name": "Hat", "mesh": 0})
        file.document["nodes"][file.names().index("Head")]["children"] = [len(file.document["nodes"]) - 1]

    plain = read_character(write(tmp_path / "plain.glb", figure()))
    worn = read_character(edited(tmp_path / "worn.glb", figure(), change))
    np.testing.assert_array_equal(worn.flesh, plain.flesh)


@pytest.mark.parametrize("known", [True, False])
def test_bones_without_any_skin_are_joints_by_their_names_alone(known: bool, tmp_path: Path) -> None:
    """An armature that was exported alone; a car has as many nodes, and no names of bones."""
    def change(file: GlbFile) -> None:
        for key in ("skins", "meshes"):
            del file.document[key]
        file.document["nodes"].pop()
        file.document["scenes"][0]["nodes"].pop()

    body = figure(spelled({}, MIXAMO) if known else unknown_words(), "A")
    character = read_character(edited(tmp_path / "rig.glb", body, change))
    if not known:
        with pytest.raises(InputError, match="it has no skin"):
            Retargeter(character)
        return
    made = perform(0.3, skeleton=FINGERED)
    made = replace(made, character=Retargeter(character)(made.motion))
    out = GlbFile.parse(write_performance(tmp_path / "out.glb", made).read_bytes())
    names = out.names()
    assert {names[node] for node in out.document["skins"][0]["joints"]} == set(map(body.names, body.places))


@pytest.mark.parametrize("weight", [0.0, np.nan])
def test_weights_that_players_cannot_use_are_doubted(weight: float, tmp_path: Path) -> None:
    file = GlbFile.parse(write(tmp_path / "rig.glb", figure()).read_bytes())
    accessor = file.document["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    weights = file.numbers(accessor).copy()
    weights[::7] = weight
    file = with_numbers(file, accessor, weights)
    doubts = Retargeter(read_character(save(tmp_path / "rig.glb", file.document, file.binary))).doubts
    assert len(doubts) == 1 and "skin weights" in doubts[0]


@pytest.mark.parametrize("mode", [5, 6])
@pytest.mark.parametrize("indexed", [True, False])
def test_triangles_of_strips_and_fans_are_those_of_the_format(mode: int, indexed: bool, tmp_path: Path) -> None:
    file = GlbFile.parse(write(tmp_path / "rig.glb", figure()).read_bytes())
    primitive = file.document["meshes"][0]["primitives"][0]
    points, corners = (file.numbers(number) for number in (primitive["attributes"]["POSITION"], primitive["indices"]))
    corners = corners[:, 0].astype(int) if indexed else np.arange(len(points))
    primitive["mode"] = mode
    if not indexed:
        del primitive["indices"]
    skin = read_character(save(tmp_path / "rig.glb", file.document, file.binary)).skin
    wanted = [(corners[k if mode == 5 else 0], corners[k + 1], corners[k + 2]) for k in range(len(corners) - 2)]
    np.testing.assert_allclose(skin.points[skin.triangles], points[np.array(wanted)], atol=1e-6)
