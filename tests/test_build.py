"""The build command, end to end on the tiny preset: bit for bit, in any order, after a kill, and never over others."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from data_module import kinematics
from data_module.build import main
from data_module.bvh import read_bvh, write_bvh
from data_module.corpora import CORPORA
from data_module.motion_beats import motion_beats
from data_module.store import Store

TINY = ["performer", "--preset", "tiny", "--seed", "5"]
"""As the fixture `tiny_store` builds it."""
ROOT = Path(__file__).parent.parent


def _command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "data_module.build", *arguments]


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def test_tiny_store(tiny_store: Path) -> None:
    store = Store.open(tiny_store)
    seconds = sum(info.seconds for info in store.recordings)
    assert 120 < seconds < 240 and {info.split for info in store.recordings} == {"train", "val", "test"}
    for info in store.recordings:
        recording = store.load(info.name)
        assert recording.motion.fps == 60 and recording.speech.words and recording.truth is not None
        assert abs(recording.motion.duration - recording.speech.duration) <= 1 / 60
        assert recording.truth.strokes and recording.truth.syllables and recording.truth.phrases


def test_strokes_kept_for_test_are_played_there_alone(tiny_store: Path) -> None:
    store = Store.open(tiny_store)
    held: set[str] = set()
    played: set[str] = set()
    for info in store.recordings:
        truth = store.load(info.name).truth
        assert truth is not None
        own = {stroke.clip for stroke in truth.strokes if stroke.held_out}
        assert not own or info.split == "test"
        held |= own
        if info.split != "test":
            played |= {stroke.clip for stroke in truth.strokes}
    assert held and not held & played


def test_planned_beats_are_in_the_stored_motion(tiny_store: Path) -> None:
    """The truth is true of what was stored: strokes' planned beats are found again by the detector of motion beats."""
    store = Store.open(tiny_store)
    near: dict[float, list[float]] = {0.0: [], 0.37: []}
    for info in store.of_split("train"):
        recording = store.load(info.name)
        found = motion_beats(recording.motion, mode="A")
        assert recording.truth is not None
        for shift, apart in near.items():
            apart += [float(np.abs(found - stroke.beat - shift).min()) for stroke in recording.truth.strokes]
    # The detector sums both hands, so a beat of one may be moved by the other; a shifted plan shows what chance gives.
    assert np.median(near[0.0]) < 0.015 and np.mean(np.array(near[0.0]) < 0.04) > 0.7
    assert np.median(near[0.37]) > 0.05


def test_the_data_set_beside_the_store_gives_the_same_store(tiny_store: Path, tmp_path: Path) -> None:
    """BVH, FLAC and JSON hold everything: the folder reader brings back the same recordings."""
    assert main(["folder", "--source", str(tiny_store / "dataset"), "--out", str(tmp_path / "s"), "--no-dataset",
                 "--workers", "1"]) == 0
    made, read = Store.open(tiny_store), Store.open(tmp_path / "s")
    assert read.names == made.names
    for before, after in zip(made.recordings, read.recordings, strict=True):
        assert (before.split, before.speaker, before.voice, before.language) == (
            after.split, after.speaker, after.voice, after.language)
    one, two = made.load(made.names[0]), read.load(made.names[0])
    assert np.array_equal(one.speech.samples, two.speech.samples) and one.speech.words == two.speech.words
    assert one.truth == two.truth
    apart = kinematics.positions_of(one.motion) - kinematics.positions_of(two.motion)
    assert np.abs(apart).max() < 1e-5


def test_killed_half_way_then_finished_by_two_workers_gives_the_same_bytes(tiny_store: Path, tmp_path: Path) -> None:
    out = tmp_path / "store"
    command = _command(*TINY, "--out", str(out), "--workers", "2")
    first = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
    finished = tmp_path / "store.partial" / "recordings"
    deadline = time.monotonic() + 120
    while len(list(finished.glob("*.json"))) < 2 and first.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    first.send_signal(signal.SIGTERM if os.name == "nt" else signal.SIGKILL)
    first.wait()
    assert not out.exists(), "the build was over before it could be killed"
    kept = {file.name: file.stat().st_mtime_ns for file in finished.glob("*.json")}
    assert kept
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    said = int(done.stdout.split("recordings were there already")[0].rsplit("(", 1)[1])
    # The workers of a killed build may finish a recording more before they notice.
    assert len(kept) <= said < 9
    # Its seed and settings are those of the fixture, so every byte must be, too.
    mine, theirs = _contents(out), _contents(tiny_store)
    assert list(mine) == list(theirs)
    assert [name for name in mine if mine[name] != theirs[name]] == []


def test_a_built_store_is_left_alone_and_other_settings_are_refused(tiny_store: Path, tmp_path: Path,
                                                                    capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "store"
    shutil.copytree(tiny_store, out)
    before = {file: file.stat().st_mtime_ns for file in out.rglob("*")}
    assert main([*TINY, "--out", str(out), "--workers", "1"]) == 0
    assert {file: file.stat().st_mtime_ns for file in out.rglob("*")} == before
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        main([*TINY[:-1], "6", "--out", str(out), "--workers", "1"])
    said = capsys.readouterr().err
    assert caught.value.code == 2 and said.count("\n") == 1 and "seed 5 (now 6)" in said


@pytest.mark.parametrize(("arguments", "wrong"), [
    (["nothing", "--out", "x"], "is no data set"),
    (["folder", "--out", "x"], "--source"),
    (["folder", "--source", "missing", "--out", "x"], "does not exist"),
    (["performer", "--source", ".", "--out", "x"], "manifest.csv"),
    (["performer", "--preset", "tiny", "--hours", "-1", "--out", "x"], "--hours"),
    (["performer", "--preset", "tiny", "--workers", "0", "--out", "x"], "--workers"),
    (["performer", "--preset", "tiny", "--seed", "-1", "--out", "x"], "--seed"),
])
def test_bad_input_is_one_line_and_leaves_nothing(arguments: list[str], wrong: str, tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch,
                                                  capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    said = capsys.readouterr().err
    assert caught.value.code == 2 and wrong in said and said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_used_is_dropped_and_reported(tiny_store: Path, tmp_path: Path,
                                                     capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "pairs"
    source.mkdir()
    for name in ("talk_0000_puppet", "talk_0001_puppet"):
        for suffix in ("bvh", "flac", "json"):
            shutil.copy(tiny_store / "dataset" / f"{name}.{suffix}", source)
    (source / "talk_0001_puppet.flac").write_bytes(b"no sound")
    motion = read_bvh(source / "talk_0000_puppet.bvh")
    renamed = (*motion.skeleton.names[:-1], "Claw")
    odd = type(motion.skeleton)(renamed, motion.skeleton.parents, motion.skeleton.offsets)
    write_bvh(source / "odd.bvh", type(motion)(odd, motion.rotations, motion.root_positions, motion.fps))
    shutil.copy(source / "talk_0000_puppet.flac", source / "odd.flac")
    assert main(["folder", "--source", str(source), "--out", str(tmp_path / "s"), "--workers", "1"]) == 0
    said = capsys.readouterr().out
    assert "dropped talk_0001_puppet" in said and "dropped odd" in said and "LeftHand" in said
    assert Store.open(tmp_path / "s").names == ("talk_0000_puppet",)


def test_nothing_usable_is_an_error_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "pairs"
    source.mkdir()
    (source / "a.bvh").write_text("no motion")
    (source / "a.wav").write_text("no sound")
    with pytest.raises(SystemExit):
        main(["folder", "--source", str(source), "--out", str(tmp_path / "s"), "--workers", "1"])
    assert "no recording that can be used" in capsys.readouterr().err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["pairs"]


def test_help_names_every_corpus_and_is_fast() -> None:
    times = []
    for _ in range(2):
        begun = time.perf_counter()
        said = subprocess.run(_command("--help"), cwd=ROOT, capture_output=True, text=True, check=True).stdout
        times.append(time.perf_counter() - begun)
    assert all(name in said for name in CORPORA) and min(times) < 0.5


def test_the_words_in_the_data_set_are_those_of_the_store(tiny_store: Path) -> None:
    store = Store.open(tiny_store)
    told = json.loads((tiny_store / "dataset" / f"{store.names[0]}.json").read_text(encoding="utf-8"))
    recording = store.load(store.names[0])
    assert recording.speech.words is not None and recording.truth is not None
    assert [w["text"] for w in told["words"]] == [w.text for w in recording.speech.words]
    assert set(told) >= {"words", "performer", "voice", "language", "split", "phrases", "syllables", "strokes"}
    assert set(told["strokes"][0]) == {"lexeme", "clip", "hand", "start", "beat", "hold_end", "end", "syllable", "gain",
                                       "held_out"}
