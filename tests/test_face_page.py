"""The face in a page on a GLB that is no VRM: shapes in ARKit's names, Oculus visemes, eyes, or a jaw alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import OpenedPage
from performances import perform, write
from small_characters import write_character
from test_face_files import EYES, JAW, add_bones, add_shapes, with_face

from gesticulator.characters.reading import read_character
from gesticulator.face.motion import FaceMotion
from gesticulator.face.page import NUMBERS, curve_constants, page_face
from gesticulator.face.rig import find_face
from gesticulator.face.shapes import ARKIT, curves
from gesticulator.face.visemes import VISEMES

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
