"""The browser client with three.js: clips, poses of a stream and faces on characters."""

import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import package_page
from face_samples import VisemeSpan, spoken
from performances import perform, write, write_example
from small_characters import write_character
from test_face_files import add_shapes

from data_module.motion.kinematics import global_rotations, positions_of
from data_module.motion.skeletons import FINGERED, WHOLE_BODY, standing
from data_module.types import Array, Motion, Skeleton
from gesticulator.export.clip import ClipLayout
from gesticulator.export.vrma import BONES, humanoid
from gesticulator.face.motion import FaceMotion
from gesticulator.face.shapes import vrm
from gesticulator.live.protocol import StreamRequest, joints, pack
from gesticulator.performance import Performance
from gesticulator.stream import StreamFrames

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "integrations" / "gesticulator-client" / "src"
FPS, FRAMES = 25.0, (0, 10, 21)
TIMES = [frame / FPS for frame in FRAMES]
"""Seconds of these frames."""
VRMS = {"vrm0": "0.x", "vrm1": "1.0"}
"""Name of a character -> version of its VRM."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Performance, Performance]:
    """Files in a folder, our motion with legs, and a character's motion of the upper body."""
    folder = tmp_path_factory.mktemp("files")
    ours = perform(1.0, FPS, skeleton=WHOLE_BODY)
    write(folder / "talk.vrma", ours)
    for name, version in VRMS.items():
        write_character(folder / f"{name}.vrm", vrm=version)
    rest = perform(0.2, FPS, seed=9, skeleton=FINGERED).motion.crop(0, 1)
    spoken = replace(perform(1.0, FPS, skeleton=FINGERED), rest=lambda: rest)
    idle = replace(spoken, motion=replace(rest, rotations=np.tile(rest.rotations, (25, 1, 1)),
                                          root_positions=np.tile(rest.root_positions, (25, 1)), fps=FPS))
    rig = write_character(folder / "rig.glb", seed=5)
    write(folder / "idle.glb", idle.as_clip(ClipLayout("Idle", 0.0, upper=True)).on(rig))
    layer = spoken.as_clip(ClipLayout(keys=0.0, additive=True)).on(folder / "idle.glb")
    write(folder / "layer.glb", layer)
    return folder, ours, spoken.as_clip(ClipLayout(keys=0.0, upper=True)).on(rig)


@pytest.fixture(scope="module")
def page(browser: Any, made: tuple[Path, Performance, Performance], three_js: Path) -> Iterator[Any]:
    """A page without a network: what it loads comes from the disk."""
    with package_page(browser, "package_page.html", FOLDER, made[0], three_js) as window:
        yield window


def check_bones(got: dict[str, Any], version: str, ours: Performance, path: bool) -> None:
    """Each bone points where ours does, turned from where it pointed at rest."""
    faces = [-1.0, 1.0, -1.0] if version == "0.x" else [1.0, 1.0, 1.0]  # what faces -Z is turned to us
    places = {bone: np.array(track) * faces for bone, track in got.items()}
    wanted = humanoid(standing(ours.motion))
    turns = global_rotations(Skeleton(wanted.names, wanted.parents, wanted.translations), wanted.turns)
    world = dict(zip(wanted.names, np.moveaxis(turns, 1, 0), strict=True))
    pairs = [(above, bone) for bone, (above, _, _) in BONES.items() if above in world and bone in places]
    if not path:  # of the two joints of the spine, the client takes the upper one
        pairs = [(above, bone) for above, bone in pairs if above != "spine"]
    assert len(pairs) > 40
    from data_module.motion import rotation

    for above, bone in pairs:
        rest = places[bone][0] - places[above][0]  # the first is the character at rest, in a T-pose
        for moment, frame in enumerate(FRAMES):
            expected: Array = rotation.rotate(world[above][frame], rest)
            np.testing.assert_allclose(places[bone][1 + moment] - places[above][1 + moment], expected, atol=1e-3,
                                       err_msg=f"{above} to {bone} in frame {frame}")
    if path:
        # The hips' path is scaled by how high they are.
        ratio = places["hips"][0][1] / wanted.translations[0][1]
        for moment, frame in enumerate(FRAMES):
            np.testing.assert_allclose(places["hips"][1 + moment], wanted.shifts[0][frame] * ratio, atol=1e-3)


@pytest.mark.parametrize("model", sorted(VRMS))
def test_a_vrm_animation_moves_a_vrm(model: str, page: Any, made: tuple[Path, Performance, Performance]) -> None:
    got = page.evaluate("([model, file, times]) => playVrma(model, file, times)",
                        [f"/{model}.vrm", "/talk.vrma", TIMES])
    check_bones(got, VRMS[model], made[1], path=True)


@pytest.mark.parametrize("model", sorted(VRMS))
def test_poses_of_a_stream_move_a_vrm(model: str, page: Any, made: tuple[Path, Performance, Performance]) -> None:
    motion = made[1].motion
    frames = StreamFrames(0, FPS, motion.skeleton, motion.rotations, motion.root_positions, ())
    packet = pack(frames, StreamRequest(sample_rate=16000, fps=FPS), "speaking", 1.0)
    welcome = {"type": "hello", "fps": FPS, "joints": joints(motion.skeleton)}
    got = page.evaluate("([model, welcome, packet, times]) => playStream(model, welcome, packet, times)",
                        [f"/{model}.vrm", welcome, list(packet), TIMES])
    check_bones(got, VRMS[model], made[1], path=False)


def test_an_additive_layer_over_an_idle_clip_is_the_gesture(page: Any, made: tuple[Path, Performance, Performance]
                                                            ) -> None:
    got = page.evaluate("([file, times]) => playLayer(file, times)", ["/layer.glb", TIMES])
    moved = made[2].character
    assert moved is not None
    world = moved.world_matrices()
    checked = 0
    for node, name in enumerate(moved.character.names):
        track = got.get(name.replace(":", ""))
        if track is not None:
            np.testing.assert_allclose(track, world[list(FRAMES), node, :3, 3], atol=2e-4, err_msg=name)
            checked += 1
    assert checked > 40


def test_the_plain_receiver_shows_the_poses_of_a_real_server(browser: Any, three_js: Path, tmp_path: Path) -> None:
    """examples/three.html: each bone of three.js stands where our kinematics have it in the frame that is heard."""
    (tmp_path / "node_modules").mkdir()
    for name, folder in (("three", three_js / "node_modules" / "three"), ("gesticulator-client", FOLDER.parent)):
        (tmp_path / "node_modules" / name).symlink_to(folder)
    shutil.copy(FOLDER.parent / "examples" / "three.html", tmp_path / "index.html")
    site = ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(tmp_path)))
    threading.Thread(target=site.serve_forever, daemon=True).start()
    page = f"http://127.0.0.1:{site.server_port}"
    server = subprocess.Popen([sys.executable, "-m", "gesticulator", "serve", "--port", "0", "--origin", page],
                              stderr=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert server.stderr is not None
        address = re.search(r"ws://\S+/stream", server.stderr.readline())
        assert address is not None and any("ready" in line for line in server.stderr)
        window = browser.new_page()
        window.set_default_timeout(120_000)
        window.goto(f"{page}/?server={address.group()}")
        window.wait_for_function("window.ready === true")
        empty = window.screenshot()
        window.set_input_files("input", write_example(tmp_path / "voice.wav", 6.0))
        window.wait_for_function("() => window.clock?.() > 2 && stream.frames.size && bones[1].quaternion.w !== 1")
        names, turns, places, frame = window.evaluate("""() => [bones.map((bone) => bone.name),
            bones.map((bone) => bone.quaternion.toArray()),
            bones.map((bone) => bone.matrixWorld.elements.slice(12, 15)),
            (({ turns, root }) => [...turns, ...root])(stream.frames.values().next().value)]""")
        shown = window.screenshot()
        window.close()
    finally:
        server.terminate()
        server.wait(60)
        site.shutdown()
        site.server_close()
    assert tuple(names) == WHOLE_BODY.names and shown != empty
    sent = np.array(frame[:-3]).reshape(-1, 4)
    np.testing.assert_allclose(np.array(turns)[:, [3, 0, 1, 2]], sent, atol=1e-6)
    posed = Motion(WHOLE_BODY, sent[None], np.array([frame[-3:]]), 60.0)
    np.testing.assert_allclose(places, positions_of(posed)[0], atol=1e-5)
    assert np.abs(sent[:, 1:]).max() > 0.1, "it gestures"


# ------------------------------------------------------------------------------------------------------------ the face

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
def face_page(browser: Any, talk: tuple[Path, FaceMotion, list[VisemeSpan]], three_js: Path) -> Iterator[Any]:
    """A page without a network: what it loads comes from the disk."""
    with package_page(browser, "face_page.html", FOLDER, talk[0], three_js) as window:
        yield window


def play(page: Any, by: str, model: str, times: list[float]) -> list[dict[str, Any]]:
    got: list[dict[str, Any]] = page.evaluate("([by, model, motion, times]) => playFace(by, model, motion, times)",
                                              [by, model, "/talk.vrma", times])
    return got


def expected(face: FaceMotion, times: list[float]) -> list[dict[str, float]]:
    curves = vrm(face)
    return [{name: float(np.interp(time, face.times, curves[name])) for name in PRESETS} for time in times]


@pytest.mark.parametrize("by", PLAYERS)
def test_expressions_are_those_of_the_file(by: str, face_page: Any, talk: tuple[Path, FaceMotion, list[VisemeSpan]]
                                           ) -> None:
    _, face, track = talk
    times = [float(face.times[round((one.start + one.end) / 2 * face.fps)]) for one in track]
    got = play(face_page, by, "/small.vrm", times)
    for shown, wanted in zip(got, expected(face, times), strict=True):
        for name, number in PRESETS.items():
            assert shown["weights"][name] == pytest.approx(wanted[name], abs=2e-3), name
            assert shown["morphs"][number] == pytest.approx(wanted[name], abs=2e-3), name
