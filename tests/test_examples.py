"""Every example does what its first line says, on a short recording and with the shipped weights."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile
from gltf_reader import GlbFile
from small_characters import write_character

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.bvh import read_bvh
from data_module.motion.kinematics import positions_of
from gesticulator import Gesticulator
from gesticulator.export.blender import check_blender, run_in_blender

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
SECONDS = 4.0
RUN = {"direct", "file_to_bvh", "folder", "own_engine", "samples", "to_blender", "to_character", "to_vrm", "two_takes"}
NEEDS_MORE = {"make_speech"}
"""Examples that need a program that is not installed with the tests."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first seconds of the example recording."""
    samples, rate = soundfile.read(EXAMPLES / "speech.flac", frames=round(SECONDS * 16000))
    path = tmp_path_factory.mktemp("recordings") / "a.flac"
    soundfile.write(path, samples, rate)
    return path


def example(name: str) -> Callable[..., None]:
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


def test_every_example_is_run_here() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == RUN | NEEDS_MORE


def test_a_file_to_bvh(recording: Path, tmp_path: Path) -> None:
    example("file_to_bvh")(str(recording), str(tmp_path / "g.bvh"), str(tmp_path / "g.html"))
    assert read_bvh(tmp_path / "g.bvh").duration == pytest.approx(SECONDS, abs=0.02)
    assert (tmp_path / "g.html").stat().st_size > 100_000


def test_samples(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("samples")(str(tmp_path / "g.bvh"))
    assert read_bvh(tmp_path / "g.bvh").duration == pytest.approx(4.0, abs=0.02)
    assert "240 frames at 60" in capsys.readouterr().out


def test_a_folder(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (recording.parent / "broken.wav").write_bytes(b"no sound")
    example("folder")(str(recording.parent), str(tmp_path / "out"))
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a.bvh"]
    assert "broken.wav: is not sound" in capsys.readouterr().err


def test_direction(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("direct")(str(recording), "Heavy bread rises slowly", str(tmp_path / "calm.bvh"),
                      str(tmp_path / "rising.bvh"))
    calm, rising = (positions_of(read_bvh(tmp_path / f"{name}.bvh")) for name in ("calm", "rising"))
    joints = read_bvh(tmp_path / "calm.bvh").skeleton
    heights = [pose[:, joints.index("RightHand"), 1] - pose[:, 0, 1] for pose in (calm, rising)]
    half = len(heights[0]) // 2
    assert heights[1][half:].mean() > heights[0][half:].mean() + 0.1, "asked high, against asked low"
    assert capsys.readouterr().out.count("right hand over the hips") == 2


def test_rotations_for_an_engine(recording: Path, tmp_path: Path) -> None:
    example("own_engine")(str(recording), str(tmp_path / "frames.jsonl"))
    frames = [json.loads(line) for line in (tmp_path / "frames.jsonl").read_text().splitlines()]
    gesture = Gesticulator.from_pretrained()(recording, fps=30)
    assert len(frames) == round(SECONDS * 30) and frames[30]["time"] == 1.0
    assert all(tuple(frame["bones"]) == gesture.joints for frame in frames)
    poses = np.array([list(frame["bones"].values()) for frame in frames])
    assert rotation.angle_between(poses[..., [3, 0, 1, 2]], gesture.rotations).max() < 1e-4, "w is the last one"


def test_a_character_and_a_vrm_animation(recording: Path, tmp_path: Path) -> None:
    for vrm, source in ((False, tmp_path / "her.glb"), (True, tmp_path / "her.vrm")):
        before = GlbFile.parse(write_character(source, vrm=vrm).read_bytes())
        example("to_character")(str(recording), str(source), str(tmp_path / "out.glb"))
        after = GlbFile.parse((tmp_path / "out.glb").read_bytes())
        assert after.names() == before.names() and after.document["meshes"] == before.document["meshes"]
        animation = after.document["animations"][0]
        times = after.numbers(animation["samplers"][0]["input"])[:, 0]
        assert times[-1] == pytest.approx(SECONDS, abs=0.05)
        places = after.worlds(0)[..., :3, 3]
        foot, hand = (places[:, after.names().index(f"mixamorig:Left{name}")] for name in ("ToeBase", "Hand"))
        assert np.ptp(hand, axis=0).max() > 0.05 > np.ptp(foot, axis=0).max(), "hands move, feet stand"
    example("to_vrm")(str(recording), str(tmp_path / "talk.vrma"))
    assert "VRMC_vrm_animation" in GlbFile.parse((tmp_path / "talk.vrma").read_bytes()).document["extensions"]


def test_two_takes_on_one_page(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("two_takes")(str(recording), "lstm", "statistical", str(tmp_path / "two.html"))
    page = (tmp_path / "two.html").read_text(encoding="utf-8")
    told = json.loads(page.partition('id="performance">')[2].partition("</script>")[0])
    takes = {take["name"]: [block["lexeme"] for block in take["plan"]["blocks"]] for take in told["takes"]}
    assert list(takes) == ["lstm", "statistical"] and told["together"]
    same = np.mean(np.equal(takes["lstm"], takes["statistical"]))
    assert same < 0.9 and f"{same:.0%} of the blocks" in capsys.readouterr().out


def test_a_scene_for_blender(recording: Path, tmp_path: Path) -> None:
    try:
        check_blender(tmp_path)
    except InputError as lacking:
        pytest.skip(str(lacking))
    Gesticulator.from_pretrained()(recording, fps=30).save(tmp_path / "talk.glb")
    run_in_blender(tmp_path, EXAMPLES / "to_blender.py", str(tmp_path / "talk.glb"), str(recording),
                   str(tmp_path / "talk.blend"))
    look = tmp_path / "look.py"
    look.write_text("import bpy, json, sys\nbpy.ops.wm.open_mainfile(filepath=sys.argv[-1])\n"
                    "scene = bpy.context.scene\n"
                    "strips = getattr(scene.sequence_editor, 'strips', None) or scene.sequence_editor.sequences\n"
                    "print('told', json.dumps([scene.frame_end, scene.render.fps, len(strips), strips[0].type]))\n")
    told = run_in_blender(tmp_path, look, str(tmp_path / "talk.blend"))
    assert json.loads(told.split("told ")[1].splitlines()[0]) == [round(SECONDS * 30) - 1, 30, 1, "SOUND"]
