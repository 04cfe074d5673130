"""Real, generated and foreign motion in a table: perfect input is perfect, controls are seen, any file is read."""

from __future__ import annotations

import json
import shutil
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from data_module import rotation
from data_module.bvh import write_bvh
from data_module.errors import InputError
from data_module.kinematics import positions_of
from data_module.representation import TED_JOINTS, bone_directions, ted_positions
from data_module.skeletons import CHARACTER, facing
from data_module.smplx import SKELETON as SMPLX
from data_module.types import Motion, Speech
from eval import foreign, score
from eval.__main__ import main as door
from eval.controls import jittered
from eval.foreign import Clip, read_motion
from eval.gesture_features import RawFeatures
from eval.score import FLOOR, STILL, TRUTH, common_ground, flags, markdown, mean_pose, plain

SECONDS, FPS, RATE = 4.0, 20.0, 16000
NETWORKS = {"raw, 12 frames": RawFeatures(12), "raw, 20 frames": RawFeatures(20)}


def clip(seed: int) -> Clip:
    """Arms that brake at random moments, each of them a click in the sound."""
    rng = np.random.default_rng(seed)
    beats = np.cumsum(rng.uniform(0.35, 0.6, 20))
    beats = beats[beats < SECONDS - 0.2]
    time = np.arange(round(SECONDS * FPS)) / FPS
    corners = np.concatenate([[0.0], beats, [SECONDS]])
    angles = rng.uniform(0.2, 1.0, len(corners)) * np.resize([1, -1], len(corners))
    maps = np.zeros((len(time), len(CHARACTER), 3))
    for name, sign in (("RightArm", 1.0), ("LeftArm", -1.0)):
        maps[:, CHARACTER.index(name), 2] = sign * np.interp(time, corners, angles)
    maps[:, CHARACTER.index("Spine"), 0] = 0.05 * np.sin(time)
    samples = np.zeros(round(SECONDS * RATE), np.float32)
    for beat in beats:
        samples[int(beat * RATE):int(beat * RATE) + 800] = 0.4 * rng.normal(size=800).clip(-2, 2)
    motion = Motion(CHARACTER, rotation.from_exponential_map(maps), np.zeros((len(time), 3)), FPS)
    return Clip(f"clip{seed}", motion, Speech(samples, RATE), f"clip{seed}")


@pytest.fixture(scope="module")
def truth() -> dict[str, Clip]:
    return {f"clip{seed}": clip(seed) for seed in range(5)}


@pytest.fixture(scope="module")
def result(truth: dict[str, Clip]) -> dict[str, Any]:
    still = {name: Clip(name, mean_pose([own.motion])[0], None) for name, own in truth.items()}
    return score.score(common_ground({TRUTH: truth, "same": truth, "still": still}), NETWORKS)


def test_perfect_input_gets_the_perfect_score(result: dict[str, Any]) -> None:
    same = result["rows"]["same"]
    for metric in ("maje", "maje_length", "mad", "mad_per_frame", "speed_distance", *NETWORKS):
        assert same[metric]["mean"] == pytest.approx(0.0, abs=1e-9), metric
    for metric, cell in same.items():
        assert cell["mean"] == pytest.approx(result["rows"][TRUTH][metric]["mean"], nan_ok=True), metric
    assert result["mismatch"]["same"]["pmb_A"]["p_value"] == result["mismatch"][TRUTH]["pmb_A"]["p_value"]
    assert result["mismatch"][TRUTH]["pmb_B"]["right"] > result["mismatch"][TRUTH]["pmb_B"]["wrong"]


def test_controls_stand_beside_and_flag_what_they_beat(result: dict[str, Any]) -> None:
    assert set(result["rows"]) == {TRUTH, "same", "still", FLOOR, STILL, "shuffled", "reversed", "jitter"}
    said = {(flag["metric"], flag["control"]): flag["says"] for flag in result["flags"]}
    assert "not told from the truth" in said["jerk", "reversed"]
    assert "beats still" in said["jerk", "shuffled"], "the real speed of another clip is nearer than no speed"
    assert "no farther than half of the truth" in said["raw, 12 frames", "shuffled"]
    assert not any(metric == "maje" and "same" in says for (metric, _), says in said.items())
    assert not any(metric.startswith("chance") for metric, _ in said)
    assert result["rows"]["jitter"]["jerk"]["mean"] > 5 * result["rows"][TRUTH]["jerk"]["mean"]
    assert result["rows"][STILL]["maje"]["mean"] == pytest.approx(result["rows"]["still"]["maje"]["mean"])


def test_the_undefined_is_nan_with_a_reason_and_null_in_json(result: dict[str, Any]) -> None:
    assert result["rows"]["still"]["pmb_A"]["reason"] == "5 of 5 clips: the motion has no beat"
    assert "--bundle" in result["rows"]["same"]["diversity"]["reason"]
    for row in result["rows"].values():
        assert all(np.isfinite(cell["mean"]) or cell["reason"] for cell in row.values())
    kept = json.loads(json.dumps(plain(result), allow_nan=False))
    assert kept["rows"]["still"]["pmb_A"]["mean"] is None


def test_differences_are_paired(result: dict[str, Any]) -> None:
    own = result["differences"]["same - still"]
    assert own["jerk"]["mean"] == pytest.approx(result["rows"]["same"]["jerk"]["mean"])
    assert own["maje"]["mean"] == pytest.approx(-result["rows"]["still"]["maje"]["mean"]) and own["maje"]["high"] < 0
    assert own["speed_distance"]["mean"] == pytest.approx(-result["rows"]["still"]["speed_distance"]["mean"])


def test_the_tables_say_it_all(result: dict[str, Any]) -> None:
    text = markdown(result)
    assert "joint jerk, m/s^3 (!)" in text and "Metrics that a control beats:" in text and "Undefined:" in text
    assert "needed for features of 54 numbers" in text and "| PMB, % at delta, s | 0.025" in text
    assert "MAJE, mm, length, less" in text or "MAJE, mm, length (!), less" in text


def test_a_jitter_that_wins_is_told_of() -> None:
    metric = score.METRICS["consistency"]
    motions: list[Motion] = []
    rows = {name: score.Row(name, kind, motions, [], {"consistency": np.array(values)}) for name, kind, values in (
        (TRUTH, TRUTH, [0.5, 0.6]), ("ours", "system", [0.4, 0.5]), ("jitter", "control", [0.8, 0.9]))}
    figures = {name: {"consistency": {"mean": row.values["consistency"].mean()}} for name, row in rows.items()}
    (flag,) = flags(rows, figures, {"consistency": metric}, 0)
    assert flag["says"] == "beats the truth (0.85, 0.55); beats ours"
    rows["jitter"].values["consistency"][:] = 0.1
    figures["jitter"]["consistency"]["mean"] = 0.1
    assert flags(rows, figures, {"consistency": metric}, 0) == []


def test_clips_meet_by_name_at_one_rate_and_length(truth: dict[str, Clip]) -> None:
    short = {"clip1": Clip("clip1", truth["clip1"].motion.crop(0, 50), None), "other": truth["clip0"]}
    ground = common_ground({TRUTH: truth, "ours": short}, 10.0)
    assert ground.names == ["clip1"] and ground.fps == 10.0
    assert [len(motions[0]) for motions in ground.motions.values()] == [25, 25]
    assert ground.speeches[0] is not None and ground.speeches[0].duration == pytest.approx(2.5)
    assert "ours: other is not compared, because truth has none of that name" in ground.notes
    assert any("clip1: truth lasts 4.00 s, and 2.50 s are compared" in note for note in ground.notes)
    pieces = common_ground({TRUTH: {"clip0": truth["clip0"]}, "ours": {"clip0": truth["clip0"]}}, piece=1.9)
    assert pieces.names == ["clip0, piece 1", "clip0, piece 2"] and pieces.groups == ["clip0", "clip0"]
    with pytest.raises(InputError, match="no clip in common"):
        common_ground({TRUTH: truth, "ours": {"other": truth["clip0"]}})


# ----------------------------------------------------------------------------------------------- files of others

def degrees(first: Motion, second: Motion) -> Any:
    """[9] the mean angle between the bones of two motions."""
    a, b = (bone_directions(ted_positions(motion)) for motion in (first, second))
    return np.degrees(np.arccos(np.clip(np.sum(a * b, axis=-1), -1, 1))).mean(axis=0)


def test_positions_in_any_axes_and_unit_come_back(truth: dict[str, Clip], tmp_path: Path) -> None:
    motion = truth["clip0"].motion
    places = positions_of(facing(motion))
    for name, up, points in (("y", "+Y", places), ("z", "+Z", 100 * places[..., [0, 2, 1]] * [1, -1, 1]),
                             ("down", "-Y", places * [-1, -1, 1])):
        np.save(tmp_path / f"{name}.npy", points)
        told = {"joints": list(CHARACTER.names), "fps": FPS, "up": up}
        (tmp_path / f"{name}.json").write_text(json.dumps(told))
        got = read_motion(tmp_path / f"{name}.npy")
        assert got.fps == FPS and "Head" in got.absent
        assert degrees(motion, got)[[0, 3, 4, 5, 6, 7, 8]].max() < 2.0
    np.save(tmp_path / "ted.npy", ted_positions(motion))
    (tmp_path / "joints.json").write_text(json.dumps({"joints": TED_JOINTS, "fps": 15}))
    got = read_motion(tmp_path / "ted.npy")
    assert got.fps == 15.0 and degrees(motion, got).max() < 2.0 and "Head" not in got.absent


def test_smplx_and_bvh_are_read_with_their_rates(truth: dict[str, Clip], tmp_path: Path) -> None:
    motion = truth["clip0"].motion
    write_bvh(tmp_path / "a.bvh", motion)
    assert degrees(motion, read_motion(tmp_path / "a.bvh")).max() < 0.01
    assert read_motion(tmp_path / "a.bvh", 40.0).fps == 40.0
    (tmp_path / "a.json").write_text('{"fps": 25}')
    assert read_motion(tmp_path / "a.bvh").fps == 25.0
    poses = np.zeros((30, 165))
    poses[:, 3 * SMPLX.index("right_shoulder") + 2] = 0.8
    np.savez(tmp_path / "a.npz", poses=poses, trans=np.zeros((30, 3)), mocap_frame_rate=30)
    assert read_motion(tmp_path / "a.npz").fps == 25.0, "NAME.json goes before the file"
    files, notes = foreign.find_motions(tmp_path)
    assert files == {"a": tmp_path / "a.bvh"} and "a.bvh is read instead" in notes[0]


@pytest.mark.parametrize(("told", "points", "says"), [
    ({"joints": ["Hips"]}, np.zeros((3, 1, 3)), "does not name joints and fps"),
    ({"joints": ["Hips"], "fps": 15}, np.zeros((3, 1, 3)), "no joint known as"),
    ({"joints": ["Hips"], "fps": 15}, np.zeros((3, 2, 3)), r"has shape \(3, 2, 3\)"),
    ({"joints": ["Hips"], "fps": 15}, np.full((3, 1, 3), np.nan), "not numbers"),
    ({"joints": ["Hips"], "fps": 15, "up": "left"}, np.zeros((3, 1, 3)), "up 'left'"),
    ({"joints": ["Hips"], "fps": "fast"}, np.zeros((3, 1, 3)), "frame rate of 'fast'"),
])
def test_positions_that_cannot_be_used(told: dict[str, Any], points: Any, says: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", points)
    (tmp_path / "a.json").write_text(json.dumps(told))
    with pytest.raises(InputError, match=says):
        read_motion(tmp_path / "a.npy")


# --------------------------------------------------------------------------------------------------- the command

def write_clips(folder: Path, clips: dict[str, Clip], sound: bool = True) -> Path:
    folder.mkdir()
    for name, own in clips.items():
        write_bvh(folder / f"{name}.bvh", own.motion)
        if sound and own.speech is not None:
            soundfile.write(folder / f"{name}.wav", own.speech.samples, RATE)
    return folder


def test_the_command_writes_both_files(truth: dict[str, Clip], tmp_path: Path, capsys: pytest.CaptureFixture[str]
                                       ) -> None:
    few = {name: truth[name] for name in ("clip0", "clip1")}
    real, ours = write_clips(tmp_path / "real", truth), write_clips(tmp_path / "ours", few, sound=False)
    out = tmp_path / "results" / "score.json"
    assert door(["score", "--truth", str(real), "--system", f"ours={ours}", "--no-controls", "--out", str(out)]) == 0
    kept = json.loads(out.read_text())
    assert kept["clips"] == ["clip0", "clip1"] and kept["rows"]["ours"]["maje"]["mean"] < 0.01
    assert "truth: clip2 is not compared, because ours has none of that name" in kept["notes"]
    assert out.with_suffix(".md").read_text() == capsys.readouterr().out


@pytest.mark.parametrize(("arguments", "says"), [
    ([], "the command: is missing"), (["guess"], "the command: 'guess' is unknown"),
    (["score", "--truth", "no", "--system", "a=no"], "no: is not a folder"),
    (["score", "--truth", ".", "--system", "a"], "is not of the form NAME=VALUE"),
    (["score", "--truth", ".", "--system", "a=.", "--system", "a=."], "was given before"),
    (["score", "--truth", ".", "--system", "truth=."], "is the name of a row of its own"),
    (["score", "--truth", ".", "--system", "a=.", "--fps", "b=15"], "names no system"),
    (["score", "--truth", ".", "--system", "a=.", "--fps", "a=0"], "give a number over 0"),
    (["score", "--truth", ".", "--system", "a=.", "--piece", "nan"], "give a number over 0"),
    (["score", "--truth", ".", "--system", "a=.", "--fgd", "no"], "name the folder of the Human3.6M"),
    (["score", "--truth", ".", "--system", "a=."], "holds no motion"),
])
def test_bad_input_is_one_line(arguments: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                               capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        door(arguments)
    told = capsys.readouterr().err
    assert stop.value.code == 2 and says in told and len(told.splitlines()) == 1


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert door(["--help"]) == 0
    assert "  score " in capsys.readouterr().out


def test_a_real_take_as_a_foreign_system(outside_data: Path, tmp_path: Path) -> None:
    """Against itself it is perfect; jittered it is 14 mm off, far too rough, and better by beat consistency."""
    (file,) = (outside_data / "takes" / "beat_scott").glob("*.bvh")
    motion = read_motion(file, 15.0).crop(0, 360)
    real, shaken = tmp_path / "real", tmp_path / "shaken"
    for folder, own in ((real, motion), (shaken, jittered([motion], 1)[0])):
        folder.mkdir()
        write_bvh(folder / f"{file.stem}.bvh", own)
    shutil.copy(file.with_suffix(".wav"), real / f"{file.stem}.wav")
    result = score.run(Namespace(
        truth=real, system=[f"itself={real}", f"shaken={shaken}"], speech=None, fgd=None, work=None, bundle=None,
        piece="8", rate=None, fps=[], no_controls=False, seed=0))
    itself, off = result["rows"]["itself"], result["rows"]["shaken"]
    assert len(result["clips"]) == 3 and result["fps"] == 15.0
    assert itself["maje"]["mean"] == itself["mad"]["mean"] == itself["speed_distance"]["mean"] == 0.0
    assert 10 < off["maje"]["mean"] < 18 and off["jerk"]["mean"] > 10 * itself["jerk"]["mean"]
    assert off["speed_distance"]["mean"] > 0.2 and off["consistency"]["mean"] > itself["consistency"]["mean"]
    assert any(flag["metric"] == "consistency" and flag["control"] == "jitter" and "beats the truth" in flag["says"]
               for flag in result["flags"])
    assert "too few groups" in " ".join(result["notes"])
