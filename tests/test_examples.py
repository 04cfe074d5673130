"""Every example does what its first line says, on a short recording and with the shipped weights."""

import importlib.util
import json
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from gltf_reader import GlbFile
from performances import write_example
from small_characters import write_character
from untrained import untrained

from data_module.motion import rotation
from data_module.motion.bvh import read_bvh, write_bvh
from data_module.motion.kinematics import positions_of
from eval.table import load
from gesticulator import Gesticulator
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.config import Schedules
from gesticulator.characters.blender import run_in_blender
from gesticulator.plan.plan import edited_blocks
from gesticulator.plan.plan_file import read_plan

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
SECONDS = 4.0
RUN = {"calmer_take", "direct", "edit_plan", "file_to_bvh", "folder", "gestures_at_words", "own_engine", "racer",
       "rhythmic_gesticulator", "samples", "score", "to_blender", "to_character", "to_vrm", "train"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first seconds of the example recording."""
    return write_example(tmp_path_factory.mktemp("recordings") / "a.flac", SECONDS)


def example(name: str) -> Callable[..., None]:
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


def test_every_example_is_run_here() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == RUN


def test_rhythmic_gesticulator_in_the_papers_steps_is_the_systems_motion(recording: Path, tmp_path: Path) -> None:
    example("rhythmic_gesticulator")(str(recording), str(tmp_path / "steps.bvh"))
    Gesticulator.from_pretrained("paper")(recording).save(tmp_path / "whole.bvh")
    steps, whole = (read_bvh(tmp_path / name) for name in ("steps.bvh", "whole.bvh"))
    np.testing.assert_array_equal(steps.rotations, whole.rotations)


def test_racer_in_the_papers_steps_with_a_lexicon_and_with_a_codec(recording: Path, tmp_path: Path) -> None:
    codec = untrained("system=racer", "rhythm.beats.rule=even", "rhythm.beats.d_max=0.4", "front_end.name=mel",
                      "text.encoder=", "generator.use_control=false", "interpreter.use_control=false", "racer.size=12",
                      "racer.width=16", "lexicon.size=12", "lexicon.code_width=16", "default_speaker=ann")
    bundles.save(codec, tmp_path / "codec", "a card")
    for name, given in (("lexicon", ()), ("codec", (str(tmp_path / "codec"),))):
        example("racer")(str(recording), str(tmp_path / f"{name}.bvh"), *given)
        motion = read_bvh(tmp_path / f"{name}.bvh")
        assert motion.duration == pytest.approx(SECONDS, abs=0.02)
        assert np.abs(np.diff(motion.rotations, axis=0)).max() > 1e-4


def test_a_file_and_samples_to_bvh(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("file_to_bvh")(str(recording), str(tmp_path / "file.bvh"), str(tmp_path / "file.html"))
    assert (tmp_path / "file.html").stat().st_size > 100_000
    example("samples")(str(tmp_path / "samples.bvh"))
    assert "240 frames at 60" in capsys.readouterr().out
    for name in ("file", "samples"):
        assert read_bvh(tmp_path / f"{name}.bvh").duration == pytest.approx(SECONDS, abs=0.02)


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
    hands = [joints.index(f"{side}Hand") for side in ("Right", "Left")]
    # Of the higher hand: the other one may hang.
    heights = [pose[:, hands, 1].max(axis=1) - pose[:, 0, 1] for pose in (calm, rising)]
    half = len(heights[0]) // 2
    assert heights[1][half:].mean() > heights[0][half:].mean() + 0.05, "asked high, against asked low"
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
    for vrm, source in (("", tmp_path / "her.glb"), ("1.0", tmp_path / "her.vrm")):
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


def test_a_plan_is_edited(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("edit_plan")(str(recording), str(tmp_path / "edited.bvh"), str(tmp_path / "plan.json"))
    edited, plan = read_bvh(tmp_path / "edited.bvh"), read_plan(tmp_path / "plan.json")
    first = Gesticulator.from_pretrained()(recording).save(tmp_path / "first.bvh")
    differs = np.abs(edited.rotations - read_bvh(first).rotations).max(axis=(1, 2)) > 1e-6
    assert sum(edited_blocks(plan)) >= 1 and 0.0 < differs.mean() < 0.9, "a part of it"
    assert "generated again" in capsys.readouterr().out


def test_gestures_at_words(recording: Path, tmp_path: Path) -> None:
    example("gestures_at_words")(str(recording), "Heavy bread rises slowly", "bread=wave,slowly=open palms",
                                 str(tmp_path / "cued.bvh"))
    motion = read_bvh(tmp_path / "cued.bvh")
    hand, shoulder = (positions_of(motion)[:, motion.skeleton.index(name), 1] for name in ("RightHand", "RightArm"))
    assert (hand > shoulder + 0.05).mean() > 0.1, "she waves beside her head"


def test_a_calmer_take(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example("calmer_take")(str(recording), str(tmp_path / "first.bvh"), str(tmp_path / "calm.bvh"))
    speeds = []
    for name in ("first", "calm"):
        motion = read_bvh(tmp_path / f"{name}.bvh")
        hands = positions_of(motion)[:, [motion.skeleton.index(side + "Hand") for side in ("Left", "Right")]]
        speeds.append(np.linalg.norm(np.diff(hands, axis=0), axis=-1).mean() * motion.fps)
    assert speeds[1] < 0.85 * speeds[0]
    assert capsys.readouterr().out.count("m/s") == 2


@pytest.mark.usefixtures("blender")
def test_a_scene_for_blender(recording: Path, tmp_path: Path) -> None:
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


@pytest.fixture
def spoken(tiny_store: Path, tmp_path: Path) -> Path:
    """A folder as a user has one: BVH files and the WAV files that go with them, and nothing else."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    for number, motion in enumerate(sorted((tiny_store / "dataset").glob("*.bvh"))[:4]):
        samples, rate = soundfile.read(motion.with_suffix(".flac"))
        soundfile.write(folder / f"take{number}.wav", samples, rate)
        shutil.copy(motion, folder / f"take{number}.bvh")
    return folder


def test_a_folder_of_recordings_becomes_weights_that_gesture(spoken: Path, recording: Path, tmp_path: Path) -> None:
    few = [part for stage in fields(Schedules) for part in ("--set", f"schedules.{stage.name}.steps=6")
           if stage.name not in ("interpreter_text", "others")]
    options = ("--preset", "tiny", "--threads", "1", "--quiet", "--set", "text.encoder=", "--set", "cql.copy_every=3")
    example("train")(str(spoken), str(tmp_path / "bundle"), str(recording), str(tmp_path / "talk.bvh"), *options, *few)
    told = json.loads((tmp_path / "bundle" / "bundle.json").read_text())
    assert told["config"]["name"] == "tiny"
    motion = read_bvh(tmp_path / "talk.bvh")
    assert motion.duration == pytest.approx(SECONDS, abs=0.02)
    assert np.ptp(positions_of(motion)[:, motion.skeleton.index("RightHand")], axis=0).max() > 0.01, "she moves"
    shipped = Gesticulator.from_pretrained()(recording)
    assert len(motion.skeleton) == 16 != len(shipped.joints), "by its own weights: the preset has no fingers"


def test_another_system_is_scored(spoken: Path, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    for number in range(4):
        motion, sound = spoken / f"take{number}.bvh", spoken / f"take{number}.wav"
        if number > 1:  # two recordings, of a few seconds, are enough
            motion.unlink()
            sound.unlink()
            continue
        samples, rate = soundfile.read(sound, frames=round(SECONDS * 16000))
        soundfile.write(sound, samples, rate)
        made = read_bvh(motion)
        kept = round(SECONDS * made.fps)
        made = replace(made, rotations=made.rotations[:kept], root_positions=made.root_positions[:kept])
        write_bvh(motion, made)
        shutil.copy(motion, theirs / motion.name)  # a system that is as good as the speaker
    example("score")(str(spoken), str(theirs), str(tmp_path / "score.json"))
    about, joints, *_ = load(tmp_path / "score.json")
    assert about.facts["clips"] == ["take0", "take1"] and about.facts["systems"] == ["theirs", "ours"]
    apart = {name: joints.rows[name]["maje"].value.mean for name in ("theirs", "ours")}  # type: ignore[union-attr]
    assert apart["theirs"] < 0.01 < 10.0 < apart["ours"], "millimetres from the speaker's own joints"
    assert joints.rows["theirs - ours"]["maje"].value.mean == pytest.approx(apart["theirs"] - apart["ours"], abs=1e-6)
