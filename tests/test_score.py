"""Real, generated and foreign motion in a table: perfect input is perfect, controls are seen, any file is read."""

import json
import math
import re
import shutil
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scipy.stats import kendalltau

from data_module.blocks import cut
from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.bvh import write_bvh
from data_module.motion.kinematics import positions_of, resample
from data_module.motion.representation import bone_directions, ted_positions
from data_module.motion.skeletons import CHARACTER, facing
from data_module.motion.smplx import SKELETON as SMPLX
from data_module.store import Store
from data_module.types import Motion, Speech
from eval.baselines.controls import jittered, mean_pose
from eval.clip import foreign
from eval.clip.clip_set import TRUTH, common_clips
from eval.clip.foreign import Clip, read_motion
from eval.clip.positions import POINTS
from eval.commands import SCORE
from eval.context import EvalContext
from eval.metrics import METRICS, fgd
from eval.metrics.encode import encode_motion
from eval.metrics.gesture_features import RawFeatures
from eval.score import command as score
from eval.score.command import flags, mean_of
from eval.score.played_rows import PlayedBundle
from eval.score.ratings import agreement, ratings_table, tau
from eval.score.tables import FLOOR, STILL, Flag, ScoreRow, Scores, tables
from eval.stats import Interval
from eval.table import Marked, Provenance, load, save
from gesticulator.bundle import bundle as bundles
from gesticulator.gesticulator import Gesticulator
from gesticulator.training.stages.corpus import prepare
from gesticulator.training.stages.lexicon import token_labels

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
    for name, sign in (("RightArm", 1.0), ("LeftArm", -0.8)):
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
def result(truth: dict[str, Clip]) -> Scores:
    still = {name: Clip(name, mean_pose([own.motion])[0], None) for name, own in truth.items()}
    return score.score(EvalContext(networks=NETWORKS), common_clips({TRUTH: truth, "same": truth, "held": still}))


def door(arguments: list[str]) -> int:
    return SCORE.main("gesticulator score", arguments)


def test_perfect_input_gets_the_perfect_score(result: Scores) -> None:
    for metric in ("maje", "mad", "mad_per_frame", "speed_distance", *NETWORKS):
        assert mean_of(result.figures, "same", metric) == pytest.approx(0.0, abs=1e-9), metric
    for metric in result.metrics:
        assert mean_of(result.figures, "same", metric) == pytest.approx(
            mean_of(result.figures, TRUTH, metric), nan_ok=True), metric
    assert mean_of(result.figures, TRUTH, "pmb_B") > mean_of(result.figures, "shuffled", "pmb_B")


def test_controls_stand_beside_and_flag_what_they_beat(result: Scores) -> None:
    assert set(result.figures) == {TRUTH, "same", "held", FLOOR, STILL, "shuffled", "reversed", "jitter", "mirrored",
                                   "bobbing"}
    said = {(flag.metric, flag.control): flag.says for flag in result.flags}
    assert said["jerk_hands", "shuffled"] == "does no worse than same, held", "its jerk is that of the truth, in all"
    assert FLOOR in said["raw, 12 frames", "shuffled"] and TRUTH in said["pmb_A", "bobbing"]
    assert not any(metric == "maje" and "same" in says for (metric, _), says in said.items())
    assert not any(metric.startswith("chance") for metric, _ in said)
    assert mean_of(result.figures, "jitter", "jerk_hands") > 5 * mean_of(result.figures, TRUTH, "jerk_hands")
    assert mean_of(result.figures, STILL, "maje") == pytest.approx(mean_of(result.figures, "held", "maje"))


def test_the_undefined_is_nan_with_a_reason(result: Scores) -> None:
    assert result.figures["held"]["pmb_A"].reason == "5 of 5 clips: the motion has no beat"
    assert "--bundle" in result.figures["same"]["diversity"].reason
    for row in result.figures.values():
        assert all(isinstance(cell.value, Interval) and (math.isfinite(cell.value.mean) or cell.reason)
                   for cell in row.values())


def test_differences_are_paired(result: Scores) -> None:
    own = result.differences["same - held"]
    assert mean_of(result.differences, "same - held", "jerk_hands") == pytest.approx(
        mean_of(result.figures, "same", "jerk_hands"))
    maje = own["maje"].value
    assert isinstance(maje, Interval) and maje.below()
    assert maje.mean == pytest.approx(-mean_of(result.figures, "held", "maje"))
    assert mean_of(result.differences, "same - held", "speed_distance") == pytest.approx(
        -mean_of(result.figures, "held", "speed_distance"))


def test_the_tables_hold_every_figure_and_come_back(result: Scores, tmp_path: Path) -> None:
    made = tables(result)
    save(made, tmp_path / "s.json", Provenance.now("gesticulator score"))
    back = load(tmp_path / "s.json")
    found = {(row, key): cell for table in back for row, cells in table.rows.items() for key, cell in cells.items()}
    for row, figures in result.figures.items():
        for metric, cell in figures.items():
            got = found[row, metric]
            assert isinstance(got, Marked) and isinstance(got.value, Interval) and isinstance(cell.value, Interval)
            assert got.reason == cell.reason
            np.testing.assert_equal(got.value.to_dict(), cell.value.to_dict())
    titles = {table.title: table for table in back}
    assert titles["Speed and smoothness"].columns["jerk_hands"].title.endswith("(!)")
    assert not titles["Motion beats and onsets"].columns["chance_A"].title.endswith("(!)")
    assert found["held", "raw, 12 frames"].mark == "(?)" and found[TRUTH, "raw, 12 frames"].mark == ""
    assert "270 are needed" in found["held", "raw, 12 frames"].reason
    assert "too narrow" in back[0].title


def test_a_jitter_that_wins_is_told_of() -> None:
    def judged(jitter: float) -> list[Flag]:
        figures = {name: {"pmb_A": Marked(Interval.exact(value, 2))}
                   for name, value in ((TRUTH, 0.55), ("ours", 0.45), ("jitter", jitter))}
        return flags({TRUTH: TRUTH, "ours": "system", "jitter": "control", FLOOR: "floor"}, figures,
                     {"pmb_A": METRICS["pmb_A"]})

    (flag,) = judged(0.85)
    assert flag.says == "does no worse than truth, ours"
    assert judged(0.15) == []
    (equal,) = judged(0.45)
    assert equal.says == "does no worse than ours"


def test_clips_meet_by_name_at_one_rate_and_length(truth: dict[str, Clip]) -> None:
    short = {"clip1": Clip("clip1", truth["clip1"].motion.crop(0, 50), None), "other": truth["clip0"]}
    slow = {"clip1": replace(short["clip1"], motion=resample(short["clip1"].motion, 10.0)), "other": truth["clip0"]}
    clips = common_clips({TRUTH: truth, "ours": slow})
    assert clips.names == ["clip1"] and clips.fps == 10.0
    assert [len(motions[0]) for motions in clips.motions.values()] == [25, 25]
    assert clips.speeches[0] is not None and clips.speeches[0].duration == pytest.approx(2.5)
    assert "ours: other not compared, because not every row has that name" in clips.notes
    assert any("clip1: truth lasts 4.00 s, and 2.50 s are compared" in note for note in clips.notes)
    with pytest.raises(InputError, match="no clip in common"):
        common_clips({TRUTH: truth, "ours": {"other": truth["clip0"]}})


# ----------------------------------------------------------------------------------------------- files of others

def degrees(first: Motion, second: Motion) -> Any:
    """[9] the mean angle between the bones of two motions."""
    a, b = (bone_directions(ted_positions(motion)) for motion in (first, second))
    return np.degrees(np.arccos(np.clip(np.sum(a * b, axis=-1), -1, 1))).mean(axis=0)


def test_positions_of_teds_joints_come_back_whatever_they_face_and_their_unit(truth: dict[str, Clip], tmp_path: Path
                                                                              ) -> None:
    motion = truth["clip0"].motion
    turned = rotation.rotate(rotation.from_exponential_map(np.array([0.0, 1.0, 0.0])), 100 * ted_positions(motion))
    np.save(tmp_path / "ted.npy", turned)
    got = read_motion(tmp_path / "ted.npy")
    assert got.fps == 15.0 and degrees(facing(motion), facing(got)).max() < 2.0 and "Head" not in got.absent
    (tmp_path / "motion.json").write_text('{"fps": 20}')
    assert read_motion(tmp_path / "ted.npy").fps == FPS


def write_points(file: Path, motion: Motion) -> None:
    """The points of a motion, the waist where the character has its third joint of the spine."""
    places = positions_of(facing(motion))
    points: dict[str, Any] = {name: places[:, CHARACTER.index({"Waist": "Spine2"}.get(name, name))].astype(np.float16)
                              for name in POINTS}
    np.savez(file, **points, Hips=np.zeros((1, 3)))


def test_points_by_joint_come_back(truth: dict[str, Clip], tmp_path: Path) -> None:
    motion = truth["clip0"].motion
    write_points(tmp_path / "a.points.npz", motion)
    (files, _), got = foreign.find_motions(tmp_path), read_motion(tmp_path / "a.points.npz")
    assert list(files) == ["a"] and got.fps == 60.0 and "Head" in got.absent
    waist, names = CHARACTER.index("Spine2"), [name for name in POINTS if name not in ("Waist", "Head")]
    first, second = (places - places[:, waist, None] for places in map(positions_of, (facing(motion), got)))
    for name in names:
        off = np.linalg.norm(first - second, axis=-1)[:, CHARACTER.index(name)]
        assert off.max() < 0.005, f"{name}: {off.max()} m, seen from the waist"


@pytest.mark.parametrize(("change", "says"), [
    ({"Neck": None}, "has other joints"), ({"Neck": np.zeros((7, 3))}, "not the same frames"),
    ({"Neck": np.full((8, 3), np.nan)}, "not numbers")])
def test_points_that_cannot_be_used(change: dict[str, Any], says: str, tmp_path: Path) -> None:
    points = {name: np.random.default_rng(0).normal(size=(8, 3)) for name in POINTS} | change
    np.savez(tmp_path / "a.points.npz", **{name: value for name, value in points.items() if value is not None})
    with pytest.raises(InputError, match=says):
        read_motion(tmp_path / "a.points.npz")


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


@pytest.mark.parametrize(("fps", "points", "says"), [
    (15, np.zeros((3, 2, 3)), r"of shape \(3, 2, 3\)"), (15, np.full((3, 10, 3), np.nan), "not numbers"),
    (15, np.zeros((3, 10, 3)), "all in one place"), (15, np.full((3, 10, 3), 1e300), "far too large"),
    (15, np.full((3, 10, 3), "1"), "numbers"), ("fast", np.zeros((3, 10, 3)), "frame rate of 'fast'")])
def test_positions_that_cannot_be_used(fps: Any, points: Any, says: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", points)
    (tmp_path / "a.json").write_text(json.dumps({"fps": fps}))
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


@pytest.mark.parametrize("clips", [1, 2])
def test_the_screen_is_short_and_one_clip_has_no_interval(clips: int, truth: dict[str, Clip], tmp_path: Path,
                                                          capsys: pytest.CaptureFixture[str]) -> None:
    some = {f"clip{number}": truth[f"clip{number}"] for number in range(clips)}
    places = [str(write_clips(tmp_path / name, some)) for name in ("real", "ours", "theirs")]
    assert door(["--truth", places[0], "--system", f"ours={places[1]}", "--system", f"theirs={places[2]}"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 40 and max(map(len, lines)) <= 100 and "--out" in lines[-1]
    assert {len(re.findall(r"\d+\.\d+", line)) for line in lines if "hand speed" in line} == {3 if clips == 1 else 9}


def test_the_command_writes_both_files(truth: dict[str, Clip], tmp_path: Path) -> None:
    few = {name: truth[name] for name in ("clip0", "clip1")}
    real, ours = write_clips(tmp_path / "real", truth), write_clips(tmp_path / "ours", few, sound=False)
    out = tmp_path / "results" / "score.json"
    assert door(["--truth", str(real), "--system", f"ours={ours}", "--out", str(out)]) == 0
    about, joints, *_ = load(out)
    assert about.facts["clips"] == ["clip0", "clip1"]
    assert joints.rows["ours"]["maje"].value.mean < 0.01  # type: ignore[union-attr]
    assert "truth: clip2, clip3, clip4 not compared, because not every row has that name" in about.facts["notes"]
    assert out.with_suffix(".md").is_file()


@pytest.mark.parametrize(("arguments", "says"), [
    (["--truth", "no", "--system", "a=no"], "no: is not a folder"),
    (["--truth", ".", "--system", "a"], "is not of the form NAME=VALUE"),
    (["--truth", ".", "--system", "a=.", "--system", "a=."], "was given before"),
    (["--truth", ".", "--system", "truth=."], "is the name of a row of its own"),
    (["--truth", ".", "--system", "still=."], "is the name of a row of its own"),
    (["--truth", ".", "--system", "a=."], "holds no motion"),
])
def test_bad_input_is_one_line(arguments: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                               refused: Any) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refused("score", *arguments)


def test_a_real_take_as_a_foreign_system(outside_data: Path, tmp_path: Path) -> None:
    """Against itself it is perfect; jittered it is 14 mm off, and far too rough."""
    (file,) = (outside_data / "takes" / "beat_scott").glob("*.bvh")
    motion = read_motion(file, 15.0).crop(0, 360)
    real, shaken = tmp_path / "real", tmp_path / "shaken"
    for folder, own in ((real, motion), (shaken, jittered([motion], 1)[0])):
        folder.mkdir()
        write_bvh(folder / f"{file.stem}.bvh", own)
    shutil.copy(file.with_suffix(".wav"), real / f"{file.stem}.wav")
    result = score.scored(asked(real, [f"itself={real}", f"shaken={shaken}"]))
    itself, off = ({name: mean_of(result.figures, row, name) for name in METRICS} for row in ("itself", "shaken"))
    assert result.fps == 15.0
    assert itself["maje"] == itself["mad"] == itself["speed_distance"] == 0.0
    assert 10 < off["maje"] < 18 and off["jerk_hands"] > 5 * itself["jerk_hands"]
    assert off["speed_distance"] > 0.2
    assert "no row shuffled" in " ".join(result.notes)


# ----------------------------------------------------------------------------------------- what a user runs into

def asked(truth: Path, systems: list[str], **others: Any) -> Namespace:
    told: dict[str, Any] = {"speech": None, "fgd": None, "bundle": None, "seed": 0, "split": "test",
                            "ratings": None}
    return Namespace(truth=truth, system=systems, **{**told, **others})


def test_of_a_store_only_what_both_have_is_compared(tiny_store: Path, tmp_path: Path) -> None:
    store = Store.open(tiny_store)
    (info, *_) = store.of_split("test")
    (learned, *_) = store.of_split("train")
    ours = tmp_path / "ours"
    ours.mkdir()
    for name in (info.name, learned.name):
        write_bvh(ours / f"{name}.bvh", store.load(name).motion.crop(0, 200))
    folders, notes = score.read_all(asked(tiny_store, [f"ours={ours}"]))
    assert list(folders[TRUTH]) == list(folders["ours"]) == [info.name]
    assert f"ours: {learned.name} not compared, because not every row has that name" in notes
    folders, _ = score.read_all(asked(tiny_store, [f"ours={ours}"], split="all"))
    assert set(folders["ours"]) == {info.name, learned.name}
    with pytest.raises(InputError, match="no clip in common"):
        score.read_all(asked(tiny_store, [f"ours={ours}"], split="val"))


def test_a_bundle_as_a_system_is_what_it_writes_for_the_truths_sounds(tiny_store: Path, tiny_bundle: Path,
                                                                      tmp_path: Path) -> None:
    store = Store.open(tiny_store)
    (info, *_) = store.of_split("test")
    recording, system = store.load(info.name), Gesticulator.from_pretrained(tiny_bundle)
    for chooser in ("lstm", "statistical"):
        (tmp_path / chooser).mkdir()
        made = system(recording.speech, speaker=info.speaker, interpreter=chooser, seed=3)
        write_bvh(tmp_path / chooser / f"{info.name}.bvh", made.motion)
    folders, _ = score.read_all(asked(tiny_store, [f"first={tiny_bundle}", f"other={tiny_bundle}:statistical",
                                                   *(f"{name}={tmp_path / name}" for name in ("lstm", "statistical"))],
                                      seed=3))
    played = {name: clips[info.name].motion for name, clips in folders.items() if name != TRUTH}
    for name, written in (("first", "lstm"), ("other", "statistical")):
        assert played[name].skeleton.names == played[written].skeleton.names
        assert degrees(played[name], played[written]).max() < 0.01, "as it is written to a file and read"
    assert degrees(played["first"], played["other"]).max() > 1, "another interpreter, other gestures"
    clips, _ = foreign.read_folder(tiny_store)
    with pytest.raises(InputError, match="has no sound to gesture to"):
        PlayedBundle(tiny_bundle).row({name: replace(clip, speech=None) for name, clip in clips.items()}, 0)


def test_a_speech_folder_without_the_sound_is_an_error(truth: dict[str, Clip], tmp_path: Path) -> None:
    real = write_clips(tmp_path / "real", {"clip0": truth["clip0"]}, sound=False)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty: has no sound for clip0"):
        score.scored(asked(real, [f"ours={real}"], speech=tmp_path / "empty"))
    with pytest.raises(InputError, match=r"is not the Human3\.6M gesture encoder"):
        score.scored(asked(real, [f"ours={real}"], fgd=tmp_path / "none"))
    row = score.scored(asked(real, [f"ours={real}"])).figures["ours"]
    assert row["pmb_A"].reason == "1 of 1 clips: its speech is not known"


@pytest.mark.parametrize("frames", [1, 2, 3, 10])
def test_the_shortest_clips_are_scored_or_say_why_not(truth: dict[str, Clip], frames: int) -> None:
    short = {"a": replace(truth["clip0"], motion=truth["clip0"].motion.crop(0, frames))}
    result = score.score(EvalContext(networks=NETWORKS), common_clips({TRUTH: short, "ours": short}))
    assert mean_of(result.figures, "ours", "maje") == 0.0
    assert np.isnan(mean_of(result.figures, "ours", "raw, 20 frames"))
    assert result.figures["ours"]["raw, 20 frames"].reason == "0 windows, and 270 are needed"


@pytest.mark.parametrize(("name", "spoil", "says"), [
    ("a.npz", b"not a zip", "is not an .npz of plain arrays"), ("a.bvh", b"HIERARCHY\nROOT", "a.bvh"),
    ("a.npy", b"\x93NUMPY", "is not an .npy of plain numbers"), ("a.wav", b"RIFF", "a.wav")])
def test_spoilt_files_are_one_line_and_leave_nothing(truth: dict[str, Clip], name: str, spoil: bytes, says: str,
                                                     tmp_path: Path, refused: Any) -> None:
    real = write_clips(tmp_path / "real", {"a": replace(truth["clip0"], name="a")})
    ours = tmp_path / "ours"
    ours.mkdir()
    if name == "a.wav":
        write_bvh(ours / "a.bvh", truth["clip0"].motion)
    (ours / "a.json").write_text('{"joints": ["Hips"], "fps": 20}')
    (ours / name).write_bytes(spoil)
    assert says in refused("score", "--truth", real, "--system", f"ours={ours}", "--out", tmp_path / "out" / "s.json")
    assert not (tmp_path / "out").exists()


def test_the_table_says_whether_the_sample_suffices() -> None:
    def doubt(*windows: int) -> str:
        return fgd.Figure(Interval(9.0, 0.0, 10.0, 3), (windows[0], windows[1]), 160).doubt

    assert doubt(200, 300) == ""
    assert doubt(100, 300) == "100 windows, and 160 are needed"


# ------------------------------------------------------------------------------------------------- beside people

def test_tau_is_kendalls_b_ties_and_all() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        first, second = rng.integers(4, size=(2, 7)).astype(float)
        np.testing.assert_allclose(tau(first, second), kendalltau(first, second).statistic)
    order = np.array([1.0, 2.0, 3.0, 4.0])
    assert tau(order, order) == 1.0 and tau(-order, order) == -1.0 and np.isnan(tau(np.ones(4), order))
    assert tau(np.array([1.0, np.nan, 3.0, 2.0]), order) == pytest.approx(1 / 3), "as if of the three others"


def test_the_interval_holds_the_true_tau_of_few_systems_and_clips() -> None:
    rng, within = np.random.default_rng(1), 0
    for _ in range(200):
        truly, noise = rng.normal(size=(2, 7))
        # Of two normal variables with this correlation, sin(pi tau / 2), tau is 0.6.
        ratings = np.sin(0.3 * np.pi) * truly + np.cos(0.3 * np.pi) * noise
        clips = truly + 0.3 * rng.normal(size=(12, 7))
        drawn = clips[rng.integers(12, size=(300, 12))].mean(axis=1)
        found = agreement(-clips.mean(axis=0), -drawn, ratings)
        within += found.low <= 0.6 <= found.high or not np.isfinite(found.low)
    assert within > 186


def test_a_perfect_order_has_no_interval_and_one_that_is_hardly_any_a_wide_one() -> None:
    ratings = np.array([3.0, 2.0, 1.0, 0.0])
    perfect = agreement(-ratings, np.tile(-ratings, (50, 1)), ratings)
    assert perfect.mean == 1.0 and np.isnan(perfect.low), "of redrawn systems each is in order, which proves nothing"
    once = np.array([0.0, 0.0, 0.0, 1.0])
    found = agreement(once, np.tile(once, (500, 1)), ratings)
    assert found.low <= 0.0 < found.mean, "many draws have no other than equal figures"


def fabricated(name: str, **values: list[float]) -> ScoreRow:
    still = Motion(CHARACTER, rotation.from_exponential_map(np.zeros((2, 16, 3))), np.zeros((2, 3)), FPS)
    return ScoreRow(name, "system", [still] * 2, [], {key: np.array(row) for key, row in values.items()},
                    {"speed_distance": lambda chosen: float(np.mean(np.array(values["maje"])[chosen]))})


def test_metrics_stand_beside_people_and_controls() -> None:
    """Doses of damage 1, 2, 3: "maje" orders them, "pmb_A" praises damage, "eye_elbow" is as far off either side."""
    doses = [fabricated(f"dose{dose}", maje=[dose, dose + 0.1], pmb_A=[10 * dose] * 2, eye_elbow=[elbow] * 2)
             for dose, elbow in ((1, 31.0), (2, 28.0), (3, 33.0))]
    truth = fabricated(TRUTH, maje=[0.0, 0.0], pmb_A=[0.0, 0.0], eye_elbow=[30.0, 30.0])
    rated = {"dose1": 50.0, "dose2": 40.0, "dose3": 30.0, TRUTH: 70.0}
    metrics = {name: METRICS[name] for name in ("maje", "pmb_A", "eye_elbow", "speed_distance", "chance_A")}
    found = [Flag("maje", "still", ["dose1", "dose3"]), Flag("maje", "shuffled", ["dose1"]),
             Flag("pmb_A", "jitter", ["dose3"])]
    table = ratings_table([*doses, fabricated("unrated", maje=[9.0, 9.0])], truth, rated, metrics, found, 0)
    got = {name: table.rows[METRICS[name].heading] for name in metrics if name != "chance_A"}
    assert len(table.rows) == len(got), "what is no judgement has no tau"
    means = {name: row["systems"].mean for name, row in got.items()}  # type: ignore[union-attr]
    assert means == {"maje": 1.0, "pmb_A": -1.0, "eye_elbow": 1.0, "speed_distance": 1.0}
    assert got["pmb_A"]["person"].mean == -1.0  # type: ignore[union-attr]
    assert all(got[name]["person"] is None for name in ("maje", "eye_elbow", "speed_distance")), "by construction"
    assert (got["maje"]["motion"], got["maje"]["moment"], got["pmb_A"]["motion"]) == ("still", "shuffled", "")


def test_the_command_shows_what_people_say(truth: dict[str, Clip], tmp_path: Path) -> None:
    few = {name: truth[name] for name in ("clip0", "clip1")}
    places = {"person": write_clips(tmp_path / "person", few)}
    for name, metres in (("a", 0.01), ("b", 0.03), ("c", 0.09)):
        (tmp_path / name).mkdir()
        for clip_name, own in few.items():
            write_bvh(tmp_path / name / f"{clip_name}.bvh", jittered([own.motion], 1, metres)[0])
        places[name] = tmp_path / name
    (tmp_path / "people.json").write_text('{"person": 70, "a": 60.5, "b": 50, "c": 40, "M": 3}')
    out = tmp_path / "s.json"
    assert door(["--truth", str(places["person"]), *(f"--system={name}={places[name]}" for name in "abc"),
                 "--ratings", str(tmp_path / "people.json"), "--out", str(out)]) == 0
    about, *_, worth = load(out)
    assert worth.facts["ratings"] == {TRUTH: 70.0, "a": 60.5, "b": 50.0, "c": 40.0}
    assert any("people.json: M is no row" in note for note in about.facts["notes"])
    taus = {name: worth.rows[METRICS[name].heading]["systems"].mean for name in ("maje", "jerk_hands")}  # type: ignore[union-attr]
    assert taus == {"maje": 1.0, "jerk_hands": 1.0}
    assert "mirrored" not in worth.rows[METRICS["jerk_hands"].heading]["moment"]  # type: ignore[operator]


@pytest.mark.parametrize(("text", "says"), [
    ("[70, 60]", "is not a JSON object"), ('{"a": "good"}', "rates a with good"), ('{"a": true}', "rates a with True"),
    ('{"a": 1, "b": 2, "c": 3}', "rates 1 of the systems"), ('{"a": NaN}', "is not valid JSON")])
def test_ratings_that_cannot_be_used_are_one_line(text: str, says: str, tmp_path: Path,
                                                  refused: Any) -> None:
    (tmp_path / "people.json").write_text(text)
    assert says in refused("score", "--truth", tmp_path, "--system", f"a={tmp_path}", "--ratings",
                           tmp_path / "people.json")


# -------------------------------------------------------------------------------------------- as a bundle reads it

def test_lexeme_accuracy_stands_in_the_table(tiny_store: Path, tiny_bundle: Path, tmp_path: Path) -> None:
    bundle, store = bundles.load(tiny_bundle), Store.open(tiny_store)
    clips, _ = foreign.read_folder(tiny_store, split="all")
    some = dict(list(clips.items())[:3])
    common = common_clips({TRUTH: some, "same": some})
    figures = score.score(EvalContext(models=bundle), common).figures
    assert mean_of(figures, TRUTH, "lexeme_accuracy") == 100.0 > mean_of(figures, "shuffled", "lexeme_accuracy")
    # By another way: the corpus as the stages train on it.
    corpus = prepare(store, bundle.config, tmp_path, bundle.encoder, progress=False)
    blocks = corpus.blocks_of(corpus.names.index(next(iter(some))))
    assert common.speeches[0] is not None
    encoded = encode_motion(bundle, common.motions[TRUTH][0], cut(common.speeches[0], bundle.config.rhythm),
                            common.speeches[0].speaker or "")
    assert (encoded.labels == token_labels(bundle.lexicon, corpus)[blocks]).mean() > 0.98
