"""Blend shapes of a face in USD and FBX, as the libraries of these formats read them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from performances import perform, write
from small_characters import write_character
from test_face_files import JAW, add_bones, add_shapes, still, with_face

from data_module.types import Array
from gesticulator.characters.blender import SCRIPT, run_in_blender
from gesticulator.characters.retarget import retarget
from gesticulator.export.face import FaceWarning
from gesticulator.face.shapes import ARKIT, arkit, jaw_angles
from gesticulator.performance import Performance

HERE = Path(__file__).resolve().parent


def test_a_glb_without_a_mesh_for_a_face_is_written_with_one_line(tmp_path: Path) -> None:
    with pytest.warns(FaceWarning, match="give a --character"):
        path = write(tmp_path / "a.glb", with_face(perform(1.0)))
    assert path.read_bytes() == write(tmp_path / "plain.glb", perform(1.0)).read_bytes()


def in_blender(path: Path, made: Performance) -> dict[str, dict[str, Array]]:
    """Mesh -> shape key -> its values in Blender at the frames of the face."""
    target = path.with_suffix(".json")
    run_in_blender(path, HERE / "blender_shapes.py", str(path), f"{made.fps:g}", str(target))
    told = json.loads(target.read_text())
    assert made.face is not None
    # Blender counts the frames of an FBX file from 1.
    return {mesh: {name: np.array(entry["values"][1:len(made.face) + 1]) for name, entry in keys.items()
                   if entry["moves"] > 0} for mesh, keys in told.items()}


@pytest.mark.usefixtures("blender")
def test_shape_keys_of_fbx_as_blender_reads_them(tmp_path: Path) -> None:
    made = with_face(perform(1.0))
    assert made.face is not None
    path = add_shapes(write_character(tmp_path / "a.glb"), ["Fat", *ARKIT])
    made = replace(made, character=still(path, made))
    (keys,) = in_blender(write(tmp_path / "talk.fbx", made), made).values()
    wanted = arkit(made.face)
    assert {"jawOpen", "mouthPressLeft", "eyeBlinkLeft"} <= set(keys)
    for name, curve in wanted.items():
        if name in keys:
            np.testing.assert_allclose(keys[name], curve, atol=2e-3, err_msg=name)


@pytest.mark.usefixtures("blender")
def test_a_character_from_fbx_shows_the_face_with_its_shape_keys(tmp_path: Path) -> None:
    add_shapes(write_character(tmp_path / "a.glb"), ["Empty", "Fat", *ARKIT])
    run_in_blender(tmp_path, SCRIPT, str(tmp_path / "a.glb"), str(tmp_path / "a.fbx"), "30")
    made = with_face(perform(1.0))
    made = replace(made, character=retarget(made.motion, tmp_path / "a.fbx"))
    assert made.face is not None
    (keys,) = in_blender(write(tmp_path / "talk.fbx", made), made).values()
    assert {"jawOpen", "mouthPressLeft", "eyeBlinkLeft"} <= set(keys)
    for name, curve in arkit(made.face).items():
        if name in keys:
            np.testing.assert_allclose(keys[name], curve, atol=2e-3, err_msg=name)
    assert not keys["Fat"].any()
    still_keys = in_blender(write(tmp_path / "plain.fbx", replace(made, face=None)), made)
    assert not any(values.any() for keys in still_keys.values() for values in keys.values())


@pytest.mark.usefixtures("blender")
def test_the_jaw_bone_of_a_character_from_fbx_opens_downwards(tmp_path: Path) -> None:
    add_bones(write_character(tmp_path / "a.glb"), JAW)
    run_in_blender(tmp_path, SCRIPT, str(tmp_path / "a.glb"), str(tmp_path / "a.fbx"), "30")
    made = with_face(perform(1.0))
    made = replace(made, character=still(tmp_path / "a.fbx", made))
    assert made.face is not None
    path, target = write(tmp_path / "talk.fbx", made), tmp_path / "told.json"
    run_in_blender(path, HERE / "blender_joints.py", str(path), f"{made.fps:g}", str(target))
    frames = json.loads(target.read_text())["frames"]
    chin = np.array([np.subtract(frame["Chin"], frame["Jaw"]) for frame in frames])[:len(made.face)]
    chin /= np.linalg.norm(chin, axis=1, keepdims=True)
    down = np.arcsin(chin[0, 2]) - np.arcsin(chin[:, 2])  # Z is up, and the first mouth is shut
    np.testing.assert_allclose(down, jaw_angles(made.face), atol=np.radians(0.2))
    assert down.max() > np.radians(10.0)
