"""A face in files, read back from GLB, VRM and VRMA, and in a page on a GLB that is no VRM."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import OpenedPage
from face_samples import at_rest
from gltf_reader import GlbFile
from performances import perform, write
from small_characters import write_character

from gesticulator.characters.gltf_file import read_gltf
from gesticulator.characters.joints import find_joints
from gesticulator.characters.reading import read_character
from gesticulator.characters.rig import CharacterMotion
from gesticulator.export.face import FaceWarning
from gesticulator.export.gltf import GltfDocument, open_gltf
from gesticulator.face.motion import FaceMotion
from gesticulator.face.page import NUMBERS, curve_constants, page_face
from gesticulator.face.rig import find_face
from gesticulator.face.shapes import ARKIT, arkit, curves, jaw_angles, vrm
from gesticulator.face.visemes import VISEMES
from gesticulator.performance import Performance


def spoken(frames: int, fps: float) -> FaceMotion:
    """A mouth that goes from shut to a to p, with a blink and a look to the left."""
    face = at_rest(frames, fps)
    face.visemes[:] = 0.0
    third = frames // 3
    for place, name in enumerate(("sil", "aa", "PP")):
        face.visemes[place * third:frames if place == 2 else (place + 1) * third, VISEMES.index(name)] = 1.0
    return replace(face, blink=np.linspace(0, 1, frames), gaze=np.tile(np.radians([10.0, 5.0]), (frames, 1)),
                   smile=np.full(frames, 0.5))


def with_face(performance: Performance) -> Performance:
    return replace(performance, face=spoken(len(performance.motion), performance.fps))


def add_shapes(path: Path, names: list[str], expressions: dict[str, int] | None = None, jaw: bool = False) -> Path:
    """Give the mesh of a small character morph targets of these names; expressions: VRM's presets by target."""
    gltf: GltfDocument = open_gltf(path)
    document = gltf.document
    node = next(number for number, entry in enumerate(document["nodes"]) if "mesh" in entry)
    mesh = document["meshes"][document["nodes"][node]["mesh"]]
    part = mesh["primitives"][0]
    count = document["accessors"][part["attributes"]["POSITION"]]["count"]
    if names:
        part["targets"] = [{"POSITION": gltf.accessor(np.full((count, 3), 0.01 * index, "<f4"), bounds=True)}
                           for index in range(len(names))]
        mesh["extras"] = {"targetNames": names}
    extensions: dict[str, Any] = document.get("extensions", {})
    if expressions and "VRMC_vrm" in extensions:
        extensions["VRMC_vrm"]["expressions"] = {"preset": {
            name: {"morphTargetBinds": [{"node": node, "index": index, "weight": 1.0}]}
            for name, index in expressions.items()}}
    elif expressions:
        extensions["VRM"]["blendShapeMaster"] = {"blendShapeGroups": [
            {"presetName": name, "binds": [{"mesh": document["nodes"][node]["mesh"], "index": index, "weight": 100}]}
            for name, index in expressions.items()]}
    if jaw:
        head = next(entry for entry in document["nodes"] if entry["name"].endswith("Head"))
        document["nodes"].append({"name": "Jaw", "translation": [0, 0.02, 0.02]})
        head.setdefault("children", []).append(len(document["nodes"]) - 1)
    path.write_bytes(gltf.to_bytes())
    return path


JAW = {"Jaw": ("Head", (0.0, 0.02, 0.02)), "Chin": ("Jaw", (0.0, 0.0, 0.05))}
EYES = {"LeftEye": ("Head", (0.03, 0.06, 0.06)), "RightEye": ("Head", (-0.03, 0.06, 0.06))}
"""Bone -> the end of the name of the one above it, and where it is from there, metres in our axes."""


def add_bones(path: Path, bones: dict[str, tuple[str, tuple[float, float, float]]]) -> Path:
    """Give the skin of a small character bones such as `JAW`."""
    gltf, read = open_gltf(path), read_gltf(path)
    nodes, (skin,) = gltf.document["nodes"], gltf.document["skins"]
    inverse = list(read.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2))
    for name, (end, shift) in bones.items():
        above = next(number for number, entry in enumerate(nodes) if entry["name"].endswith(end))
        back = inverse[skin["joints"].index(above)]
        turn = back[:3, :3] / np.cbrt(np.linalg.det(back[:3, :3]))
        move = np.eye(4)
        move[:3, 3] = 100.0 * turn @ shift  # the file is in centimetres
        inverse.append(np.linalg.inv(move) @ back)
        nodes[above].setdefault("children", []).append(len(nodes))
        skin["joints"].append(len(nodes))
        nodes.append({"name": name, "translation": move[:3, 3].tolist()})
    matrices = np.array(inverse)
    matrices[:, 3] = [0, 0, 0, 1]
    skin["inverseBindMatrices"] = gltf.accessor(matrices.astype("<f4"))
    path.write_bytes(gltf.to_bytes())
    return path


def still(path: Path, performance: Performance) -> CharacterMotion:
    """A character that keeps its rest pose for the frames of a performance; its head has a track."""
    character = read_character(path)
    joints = find_joints(character).joints
    turns = np.tile(character.rotations, (len(performance.motion), 1, 1))
    return CharacterMotion(character, turns, None, performance.fps, joints, (joints["Head"],), 1.0)


def written(tmp_path: Path, character: Path) -> dict[tuple[str, str], np.ndarray]:
    """(name of the node, property) -> values of the animation that is written for a character with a face."""
    performance = with_face(perform(1.0))
    moved = replace(performance, character=still(character, performance))
    file = read_gltf(moved.save(tmp_path / "talk.glb"))
    animation = file.rows("animations")[-1]
    return {(file.rows("nodes")[channel["target"]["node"]].get("name", "mesh"), channel["target"]["path"]):
            file.array(animation["samplers"][channel["sampler"]]["output"]) for channel in animation["channels"]}


def test_arkit_shapes_of_a_character_are_animated(tmp_path: Path) -> None:
    names = ["Fat", *ARKIT]
    tracks = written(tmp_path, add_shapes(write_character(tmp_path / "a.glb"), names))
    weights = next(values for (_, path), values in tracks.items() if path == "weights").reshape(-1, len(names))
    face = spoken(len(weights), 25.0)
    for name, curve in arkit(face).items():
        np.testing.assert_allclose(weights[:, names.index(name)], curve, atol=1e-6)
    assert not weights[:, 0].any()


@pytest.mark.parametrize(("version", "presets"), [
    ("1.0", {"aa": 0, "blink": 1, "happy": 2}), ("0.x", {"a": 0, "blink": 1, "joy": 2})])
def test_expressions_of_a_vrm_are_animated(tmp_path: Path, version: str, presets: dict[str, int]) -> None:
    path = add_shapes(write_character(tmp_path / "a.vrm", vrm=version), ["x", "y", "z"], presets)
    weights = next(values for (_, kind), values in written(tmp_path, path).items() if kind == "weights").reshape(-1, 3)
    curves = vrm(spoken(len(weights), 25.0))
    for column, name in enumerate(("aa", "blink", "happy")):
        np.testing.assert_allclose(weights[:, column], curves[name], atol=1e-6)


def test_a_jaw_bone_opens_what_shapes_do_not(tmp_path: Path) -> None:
    """Lips in ARKit's names without jawOpen, beside a jaw bone; with jawOpen the bone stays."""
    lips = [name for name in ARKIT if name != "jawOpen"]
    for names, turns in ((lips, True), (list(ARKIT), False)):
        path = add_shapes(write_character(tmp_path / "a.glb"), names, jaw=True)
        assert (find_face(read_character(path)).jaw is not None) == turns


def test_a_jaw_bone_alone_opens_downwards(tmp_path: Path) -> None:
    path = add_shapes(write_character(tmp_path / "a.glb"), [], jaw=True)
    character = read_character(path)
    rig = find_face(character)
    jaw = character.names.index("Jaw")
    assert rig.jaw == jaw and rig.can_speak
    face = spoken(30, 25.0)
    turns = rig.turns(face, character, np.array([1.0, 0.0, 0.0]))[jaw]
    pose = np.tile(character.rotations, (2, 1, 1))
    pose[1, jaw] = turns[15]  # in a
    world = character.world_matrices(pose)[:, jaw, :3, :3]
    turned = world[1] @ np.linalg.inv(world[0])  # the file's scale cancels
    angle = float(jaw_angles(face)[15])
    np.testing.assert_allclose(turned @ [0, 0, 1], [0, -np.sin(angle), np.cos(angle)], atol=1e-6)


def test_a_character_without_a_face_is_written_with_one_line(tmp_path: Path) -> None:
    path = write_character(tmp_path / "a.glb")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tracks = written(tmp_path, path)
    assert sum(issubclass(one.category, FaceWarning) for one in caught) == 1
    assert not any(kind == "weights" for _, kind in tracks)


def test_a_vrm_animation_has_expressions_and_a_gaze(tmp_path: Path) -> None:
    path = with_face(perform(1.0)).save(tmp_path / "talk.vrma")
    file = read_gltf(path)
    extension = GlbFile.parse(path.read_bytes()).document["extensions"]["VRMC_vrm_animation"]
    face = spoken(len(perform(1.0).motion), 25.0)
    animation = file.rows("animations")[0]
    outputs = {channel["target"]["node"]: file.array(animation["samplers"][channel["sampler"]]["output"])
               for channel in animation["channels"]}
    for name, entry in extension["expressions"]["preset"].items():
        np.testing.assert_allclose(outputs[entry["node"]][:, 0], vrm(face)[name], atol=1e-6)
    assert {"aa", "oh", "blink", "happy"} <= set(extension["expressions"]["preset"])
    x, y, _, w = outputs[extension["lookAt"]["node"]][5]
    assert np.degrees(2 * np.arctan2(y, w)) == pytest.approx(10.0, abs=0.2)  # to the left
    assert np.degrees(2 * np.arctan2(x, w)) == pytest.approx(-5.0, abs=0.2)  # up
    plain = perform(1.0).save(tmp_path / "plain.vrma")
    assert "expressions" not in GlbFile.parse(plain.read_bytes()).document["extensions"]["VRMC_vrm_animation"]


def test_a_packet_of_the_server_holds_the_face() -> None:
    from pipecat_gesticulator.protocol import Poses

    from gesticulator.live.protocol import StreamRequest, pack
    from gesticulator.stream import StreamFrames

    made = with_face(perform(1.0))
    frames = StreamFrames(40, made.fps, made.motion.skeleton, made.rotations, made.motion.root_positions, (), made.face)
    poses = Poses.unpack(pack(frames, StreamRequest(16000, fps=made.fps), "speaking", 1.0))
    assert poses.face is not None and made.face is not None
    np.testing.assert_allclose(poses.face, made.face.values(), atol=1e-6)
    np.testing.assert_allclose(poses.root_positions, made.motion.root_positions, atol=1e-6)
    plain = Poses.unpack(pack(replace(frames, face=None), StreamRequest(16000, fps=made.fps), "speaking", 1.0))
    assert plain.face is None and np.array_equal(plain.rotations, poses.rotations)


def test_vmc_sends_blend_shapes_and_eyes() -> None:
    osc = pytest.importorskip("pythonosc.osc_bundle")
    from gesticulator.live.vmc import VmcFrames

    made = with_face(perform(1.0))
    frame = len(made.motion) // 2  # in a
    bundles = VmcFrames(made.motion, made.face).bundles(frame, 0.0)
    messages = [(message.address, list(message)) for bundle in bundles for message in osc.OscBundle(bundle)]
    values = {rest[0]: rest[1] for address, rest in messages if address == "/VMC/Ext/Blend/Val"}
    assert made.face is not None
    assert values["A"] == pytest.approx(1.0) and values["O"] == 0.0
    assert values["Blink"] == pytest.approx(made.face.blink[frame], abs=1e-6)
    assert messages[-1][0] == "/VMC/Ext/Blend/Apply"
    eye = next(rest for address, rest in messages if address == "/VMC/Ext/Bone/Pos" and rest[0] == "LeftEye")
    assert np.degrees(2 * np.arctan2(eye[5], eye[7])) == pytest.approx(-10.0, abs=0.3)  # mirrored: Unity's left is -X
    assert not any(message.address.startswith("/VMC/Ext/Blend") for bundle in VmcFrames(made.motion).bundles(frame, 0.0)
                   for message in osc.OscBundle(bundle))


# ------------------------------------------------------------------------------------------------------------ in pages

OCULUS = [f"viseme_{name}" for name in VISEMES]


def test_constants_are_the_curves() -> None:
    rng = np.random.default_rng(5)
    visemes = rng.dirichlet(np.full(15, 0.3), 50)
    rest = rng.uniform([0, -1, -1, -0.7, -0.5], [1, 1, 1, 0.7, 0.5], (50, 5))
    face = FaceMotion(visemes, rest[:, 0], rest[:, 1], rest[:, 2], rest[:, 3:], 30.0)
    values = face.values()
    parts = np.maximum(np.concatenate([values, -values], axis=1), 0.0)
    constants = curve_constants()
    for name, curve in curves(face).items():
        got = sum((constant * parts[:, place] for place, constant in constants[name].items()), np.zeros(50))
        np.testing.assert_allclose(np.clip(got, 0.0, 1.0), curve, atol=1e-5, err_msg=name)
    assert max(place for places in constants.values() for place in places) < 2 * NUMBERS


def test_lips_alone_leave_lids_and_eyes_to_the_file(tmp_path: Path) -> None:
    path = add_shapes(add_bones(write_character(tmp_path / "a.glb"), EYES), ["Fat", *ARKIT])
    whole, lips = (page_face(read_character(path), lips_only) for lips_only in (False, True))
    blink, jaw = 1 + ARKIT.index("eyeBlinkLeft"), 1 + ARKIT.index("jawOpen")
    moved = [{target for _, target, _ in face["morphs"]} for face in (whole, lips)]
    assert {blink, jaw} <= moved[0] and jaw in moved[1] and blink not in moved[1] and 0 not in moved[0]
    assert len(whole["eyes"]) == 2 and not lips["eyes"]
    assert page_face(read_character(write_character(tmp_path / "plain.glb"))) == {}


_FACE = """(time) => {
    const { clock, stage } = preview, [performer] = stage.performers, weights = {}, turns = {};
    clock.seek(time);
    performer.show(time, stage.camera);
    performer.character.gltf.scene.traverse((node) => {
        if (node.morphTargetInfluences) weights[node.name] = [...node.morphTargetInfluences];
        turns[node.name] = [node.quaternion.w, node.quaternion.x, node.quaternion.y, node.quaternion.z];
    });
    return { weights, turns };
}"""


@pytest.mark.parametrize("has", ["arkit and eyes", "oculus", "a jaw"])
def test_the_page_moves_what_a_glb_has_for_a_face_as_files_do(browser: Any, tmp_path: Path, has: str) -> None:
    path = write_character(tmp_path / "rig.glb")
    if has == "a jaw":
        add_bones(path, JAW)
    elif has == "oculus":
        add_shapes(path, ["Fat", *OCULUS])
    else:
        add_shapes(add_bones(path, EYES), ["Fat", *ARKIT])
    made = with_face(perform(1.0)).on(path)
    character, face = read_character(path), made.face
    assert face is not None
    rig = find_face(character)
    left = np.array([1.0, 0.0, 0.0])  # the character faces +Z
    page = OpenedPage(browser, write(tmp_path / "talk.html", made).as_uri())
    page.page.wait_for_function("() => preview.stage.performers[0].character !== null")
    for frame in (2, len(face) // 2, len(face) - 2):
        got = page.page.evaluate(_FACE, frame / face.fps)
        for wanted in rig.weights(face).values():
            (weights,) = got["weights"].values()
            np.testing.assert_allclose(weights, wanted[frame], atol=2e-4)
        for node, turns in rig.turns(face, character, left).items():
            agree = abs(float(turns[frame] @ got["turns"][character.names[node]]))
            assert agree == pytest.approx(1.0, abs=1e-6), character.names[node]
    page.check_quiet()
    page.page.close()
    still = OpenedPage(browser, write(tmp_path / "plain.html", replace(made, face=None)).as_uri())
    still.page.wait_for_function("() => preview.stage.performers[0].character !== null")
    assert not any(weight for weights in still.page.evaluate(_FACE, 0.5)["weights"].values() for weight in weights)
    still.page.close()
