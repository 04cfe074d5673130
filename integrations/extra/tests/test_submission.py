"""Motion in the form of a public leaderboard: lengths, skeletons, channels and rates are those of the data set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
from gesticulator_extra import submission
from gesticulator_extra.submission import COMMAND, fitted, recordings

from data_module.errors import InputError
from data_module.motion import bvh
from data_module.motion.smplx import read_smplx


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, outside_data: Path) -> Path:
    """Two test sounds of 1.02 and 1.5 s, BEAT2's reference of the first, and both submissions."""
    folder = tmp_path_factory.mktemp("submission")
    take = outside_data / "takes" / "beat_scott" / "2_scott_0_1_1"
    sound, rate = soundfile.read(take.with_suffix(".wav"), dtype="float32")
    (folder / "wav").mkdir()
    (folder / "like").mkdir()
    for name, seconds in (("1_wayne_0_1_1", 1.02), ("2_scott_0_2_2", 1.5)):
        soundfile.write(folder / "wav" / f"{name}.wav", sound[rate:rate + round(seconds * rate)], rate)
    with np.load(take.with_suffix(".npz")) as theirs:
        short = {name: theirs[name][:29] if name in ("poses", "expressions", "trans") else theirs[name]
                 for name in theirs.files}
    np.savez(folder / "like" / "1_wayne_0_1_1.npz", **short)
    lines = take.with_suffix(".bvh").read_text().splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("MOTION"))
    (folder / "set.bvh").write_text("\n".join([*lines[:start], "MOTION", "Frames: 1", "Frame Time: 0.0333333",
                                               lines[start + 3]]) + "\n")
    common = ["--speech", str(folder / "wav"), "--quiet", "--seed", "3"]
    assert COMMAND.main("gesticulator submission", ["beat2", *common, "--like", str(folder / "like"),
                                                    "--out", str(folder / "beat2")]) == 0
    assert COMMAND.main("gesticulator submission", ["genea", *common, "--like", str(folder / "set.bvh"),
                                                    "--out", str(folder / "genea")]) == 0
    return folder


def test_beat2_is_as_long_as_the_reference_or_else_as_the_sound_with_the_body_of_the_data_set(made: Path) -> None:
    first, second = (np.load(made / "beat2" / f"{name}.npz") for name in ("1_wayne_0_1_1", "2_scott_0_2_2"))
    assert len(first["poses"]) == 29 and len(second["poses"]) == 45
    with np.load(made / "like" / "1_wayne_0_1_1.npz") as theirs:
        np.testing.assert_array_equal(first["betas"], theirs["betas"])
    assert not second["betas"].any() and not first["expressions"].any()
    motion = read_smplx(made / "beat2" / "2_scott_0_2_2.npz")
    assert motion.fps == 30 and np.abs(np.diff(motion.rotations, axis=0)).max() > 1e-3


def test_genea_has_the_data_sets_hierarchy_channels_and_rate(made: Path) -> None:
    theirs, their_channels = bvh.read_hierarchy(made / "set.bvh")
    ours, channels = bvh.read_hierarchy(made / "genea" / "1_wayne_0_1_1.bvh")
    assert ours.skeleton.names == theirs.skeleton.names and channels == their_channels
    np.testing.assert_allclose(ours.skeleton.offsets, theirs.skeleton.offsets, atol=1e-4)
    whole = bvh.read_bvh(made / "genea" / "1_wayne_0_1_1.bvh")
    assert len(whole) == 31 and whole.fps == pytest.approx(30, rel=1e-3)


def test_what_is_there_is_not_made_again(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (made / "beat2" / "1_wayne_0_1_1.npz").stat().st_mtime_ns
    assert COMMAND.main("gesticulator submission", ["beat2", "--speech", str(made / "wav"), "--like",
                                                    str(made / "like"), "--out", str(made / "beat2")]) == 0
    assert (made / "beat2" / "1_wayne_0_1_1.npz").stat().st_mtime_ns == before
    assert capsys.readouterr().out.startswith("2 recordings")


def test_recordings_are_those_of_the_list(made: Path, tmp_path: Path) -> None:
    split = tmp_path / "train_test_split.csv"
    split.write_text("id,type\n1_wayne_0_1_1,train\n2_scott_0_2_2,test\n")
    assert list(recordings(made / "wav", split)) == ["2_scott_0_2_2"]
    names = tmp_path / "names.txt"
    names.write_text("1_wayne_0_1_1\nabsent\n")
    with pytest.raises(InputError, match="lacks 1 of the recordings"):
        recordings(made / "wav", names)
    with pytest.raises(InputError, match="holds no recordings"):
        recordings(tmp_path, None)
    with pytest.raises(InputError, match="is needed for genea"):
        submission.reference("genea", None)


def test_a_motion_is_cut_or_held_by_a_few_frames_and_no_more(made: Path) -> None:
    motion = read_smplx(made / "beat2" / "2_scott_0_2_2.npz")
    assert len(fitted(motion, 30.0, 40)) == 40 and len(fitted(motion, 30.0, 50)) == 50
    np.testing.assert_array_equal(fitted(motion, 30.0, 47).rotations[-1], motion.rotations[-1])
    with pytest.raises(InputError, match="has 45 frames where 60 are wanted"):
        fitted(motion, 30.0, 60)
