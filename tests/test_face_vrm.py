"""A VRM animation moves the face of a VRM in three.js, by three-vrm's own player and by our package."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import package_page
from face_samples import VisemeSpan, spoken
from performances import write
from small_characters import write_character
from test_face_files import add_shapes

from gesticulator.face.motion import FaceMotion
from gesticulator.face.shapes import vrm

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
