"""A VRM animation moves the face of a VRM in three.js, by three-vrm's own player and by our package.

The small VRM is ours; the human one is MakeHuman's, which only a full run fetches (GESTICULATOR_ZOO names a folder for
the packages).
"""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import package_page
from face_samples import spoken
from performances import write
from small_characters import write_character
from test_face_files import add_shapes

from data_module.types import Array
from gesticulator.face.motion import FaceMotion
from gesticulator.face.shapes import vrm
from gesticulator.face.visemes import VISEMES, VisemeSpan
from tests.zoo import CACHE, Unavailable

ROOT = Path(__file__).resolve().parents[1]
PACKAGE, JS = ROOT / "integrations" / "gesticulator-client" / "src", Path(__file__).resolve().parent / "js"
PRESETS = {"aa": 0, "ih": 1, "ou": 2, "ee": 3, "oh": 4, "blink": 5, "happy": 6, "sad": 7}
PLAYERS = ("three-vrm", "gesticulator-client")


@pytest.fixture(scope="module")
def talk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FaceMotion, list[VisemeSpan]]:
    """A folder with the animation and a small VRM, the face in it, and what is spoken."""
    folder = tmp_path_factory.mktemp("files")
    performance, track = spoken()
    face = performance.face
    assert face is not None
    count = len(face)
    face = replace(face, lips_only=False, blink=np.linspace(0.0, 0.4, count), smile=np.linspace(-0.3, 0.5, count),
                   gaze=np.tile([0.2, 0.1], (count, 1)))
    write(folder / "talk.vrma", replace(performance, face=face))
    add_shapes(write_character(folder / "small.vrm", vrm="1.0"), list(PRESETS), PRESETS)
    return folder, face, track


@pytest.fixture(scope="module")
def page(talk: tuple[Path, FaceMotion, list[VisemeSpan]]) -> Iterator[Any]:
    """A page without a network: what it loads comes from the disk."""
    if not (JS / "node_modules" / "@pixiv" / "three-vrm-animation").is_dir():
        pytest.skip("three-vrm is not installed: npm ci --prefix tests/js")

    with package_page("face_page.html", PACKAGE, talk[0], JS) as window:
        yield window


def play(page: Any, by: str, model: str, times: list[float]) -> list[dict[str, Any]]:
    got: list[dict[str, Any]] = page.evaluate("([by, model, motion, times]) => playFace(by, model, motion, times)",
                                              [by, model, "/talk.vrma", times])
    return got


def expected(face: FaceMotion, times: list[float]) -> list[dict[str, float]]:
    curves = vrm(face)
    return [{name: float(np.interp(time, face.times, curves[name])) for name in PRESETS} for time in times]


@pytest.mark.parametrize("by", PLAYERS)
def test_expressions_are_those_of_the_file(by: str, page: Any, talk: tuple[Path, FaceMotion, list[VisemeSpan]]) -> None:
    _, face, track = talk
    times = [float(face.times[round((one.start + one.end) / 2 * face.fps)]) for one in track]
    got = play(page, by, "/small.vrm", times)
    for shown, wanted in zip(got, expected(face, times), strict=True):
        for name, number in PRESETS.items():
            assert shown["weights"][name] == pytest.approx(wanted[name], abs=2e-3), name
            assert shown["morphs"][number] == pytest.approx(wanted[name], abs=2e-3), name


def picture(shown: dict[str, Any]) -> Array:
    """[H, W, 3] of a picture from the page."""
    image = pytest.importorskip("PIL.Image")
    data = base64.b64decode(shown["picture"].split(",")[1])
    return np.asarray(image.open(io.BytesIO(data)).convert("RGB")).astype(int)


@pytest.mark.skipif(CACHE not in os.environ, reason=f"{CACHE} does not name a folder for the packages")
def test_a_human_mouth_is_open_on_vowels_and_shut_on_m(page: Any, talk: tuple[Path, FaceMotion, list[VisemeSpan]]
                                                       ) -> None:
    from tests.face_vrm import PRESETS as UNITS_OF
    from tests.face_vrm import UNITS, human_vrm

    folder, face, track = talk
    try:
        (folder / "human.vrm").write_bytes(human_vrm().read_bytes())
    except Unavailable as reason:
        pytest.skip(str(reason))
    moments = {name: (one.start + one.end) / 2 for one in reversed(track) for name in [VISEMES[one.viseme]]}
    order = ["PP", "aa", "oh", "ou", "FF", "ih"]
    times = [0.3, *(moments[name] for name in order)]
    got = play(page, "three-vrm", "/human.vrm", times)
    for shown, wanted in zip(got, expected(face, times), strict=True):
        for number, unit in enumerate(UNITS):
            share = sum(units.get(unit, 0.0) * wanted[preset] for preset, units in UNITS_OF.items())
            assert shown["morphs"][number] == pytest.approx(share, abs=0.02), unit
    assert got[0]["eye"] == pytest.approx([np.degrees(0.2), -np.degrees(0.1)], abs=0.5)
    silent, *spoken_ = (picture(one) for one in got)
    # Around the mouth a picture differs from that of silence the more, the wider it opens.
    lips = slice(220, 330), slice(150, 280)
    away = {name: float(np.abs(one[lips] - silent[lips]).mean()) for name, one in zip(order, spoken_, strict=True)}
    assert away["aa"] > 4 * away["PP"] and away["oh"] > 2 * away["PP"]
    if os.environ.get("SCREENSHOT"):
        from PIL import Image

        Image.fromarray(np.concatenate([silent, *spoken_], axis=1).astype(np.uint8)).save(os.environ["SCREENSHOT"])
