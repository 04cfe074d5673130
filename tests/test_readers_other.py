"""The readers of BEAT, BEAT2 and TED: real files, files of just the published layout, and broken ones."""

import itertools
import shutil
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from published import TAKE, poses_of, ted_value, write_beat, write_beat2, write_ted
from test_readers_bvh import _named

from data_module.corpora.base import DroppedError, Options, load
from data_module.corpora.beat import published_split
from data_module.corpora.table import open_corpus
from data_module.errors import InputError
from data_module.motion import kinematics, skeletons
from data_module.motion.bvh import BvhWarning, read_bvh
from data_module.motion.skeletons import CHARACTER
from data_module.motion.smplx import read_smplx
from data_module.store import Store
from gesticulator.cli import main

# ---------------------------------------------------------------------------------------------------- BEAT


def test_the_real_take_of_beat_needs_its_frame_rate_told(outside_data: Path, tmp_path: Path) -> None:
    (tmp_path / "2").mkdir()
    for kind in (".bvh", ".wav"):
        shutil.copyfile(outside_data / "takes" / "beat_scott" / (TAKE + kind), tmp_path / "2" / (TAKE + kind))
    reader = open_corpus("beat", tmp_path, Options())
    [item] = reader.items()
    assert (item.info.split, item.info.speaker, item.info.language) == ("test", "2_scott", "en")
    with pytest.raises(DroppedError, match=rf"{TAKE}\.bvh: its header says 7669 frames .* 957 rows .* --fps"):
        reader.read(item)
    assert any(f"{TAKE}.textgrid is missing" in note for note in reader.notes())
    with pytest.warns(BvhWarning, match="7669 frames at 120 fps but 957 rows"):
        recording = load(open_corpus("beat", tmp_path, Options(fps=15.0)), item)
    assert (recording.motion.fps, len(recording.motion)) == (15.0, 957)
    assert recording.speech.duration == pytest.approx(63.8, abs=1e-3)
    forearm = recording.motion.skeleton.offsets[recording.motion.skeleton.index("RightHand")]
    assert np.linalg.norm(forearm) == pytest.approx(0.2546, abs=1e-4)


def test_a_folder_as_beat_is_published_is_read(tmp_path: Path) -> None:
    write_beat(tmp_path / "2", "2_scott_0_1_1", sound=3.5)
    write_beat(tmp_path / "5", "5_stewart_0_65_65")
    write_beat(tmp_path / "12", "12_zhao_3_2_2", text=False)
    write_beat(tmp_path / "1", "1_wayne_0_9_9")
    (tmp_path / "1" / "1_wayne_0_9_9.wav").unlink()
    (tmp_path / "1" / "notes.bvh").write_text("not one of BEAT's")
    reader = open_corpus("beat", tmp_path, Options(fps=15.0))  # the rate of files that contradict themselves: not these
    items = _named(reader)
    assert {name: (item.info.split, item.info.language) for name, item in items.items()} == {
        "2_scott_0_1_1": ("test", "en"), "5_stewart_0_65_65": ("test", "en"), "12_zhao_3_2_2": ("train", "zh")}
    whole = load(reader, items["2_scott_0_1_1"])
    assert whole.motion.fps == 120.0 and len(whole.motion) == 420 and whole.speech.duration == 3.5
    assert whole.speech.words is not None and [(w.text, w.start) for w in whole.speech.words] == [
        ("one", 0.5), ("two", 1.5), ("three", 2.5)]
    assert whole.motion.root_positions[120, 0] == pytest.approx(1.0)  # centimetres in the file
    assert load(reader, items["12_zhao_3_2_2"]).speech.words is None
    notes = "\n".join(reader.notes())
    assert "1_wayne_0_9_9.wav is missing" in notes and "notes.bvh: is not named" in notes
    assert "12_zhao_3_2_2.textgrid is missing" in notes and "1 recordings are in no published split" in notes


def test_the_published_split_of_beat() -> None:
    sequences = [f"0_{n}_{n}" for n in range(1, 119)] + [f"1_{n}_{n}" for n in range(1, 13)]
    long = Counter(published_split(f"4_lawrence_{rest}") for rest in sequences)
    assert long == {"train": 48 + 40 + 10, "val": 8 + 7 + 1, "test": 8 + 7 + 1}
    short = Counter(published_split(f"30_katya_{rest}") for rest in sequences)
    assert short == {"train": 118 - 8 - 7 + 11, "val": 4, "test": 4 + 7 + 1}
    assert published_split("1_wayne_0_1_8") == "test" and published_split("1_wayne_0_8_9") is None
    assert published_split("13_lu_2_1_1") is None


# ---------------------------------------------------------------------------------------------------- BEAT2


def test_a_folder_as_beat2_is_published_is_read(tmp_path: Path) -> None:
    kinds = {"2_scott_0_1_1": "test", "2_scott_0_2_2": "val", "2_scott_0_9_9": "train", "2_scott_1_1_1": "additional",
             "2_scott_0_3_3": "test"}
    for name in kinds:
        write_beat2(tmp_path, name, poses_of(45))
    (tmp_path / "wave16k" / "2_scott_0_3_3.wav").unlink()
    (tmp_path / "textgrid" / "2_scott_0_2_2.TextGrid").unlink()
    poses = tmp_path / "smplxflame_30"
    shutil.copyfile(poses / "2_scott_0_9_9.npz", poses / "2_scott_0_99_99.npz")
    (tmp_path / "train_test_split.csv").write_text("id,type\n" + "".join(f"{n},{kind}\n" for n, kind in kinds.items()))
    reader = open_corpus("beat2", tmp_path, Options())
    assert {name: item.info.split for name, item in _named(reader).items()} == {
        "2_scott_0_1_1": "test", "2_scott_0_2_2": "val", "2_scott_0_9_9": "train", "2_scott_1_1_1": "train"}
    recording = load(reader, _named(reader)["2_scott_0_1_1"])
    assert (recording.motion.fps, len(recording.motion), recording.speech.duration) == (30.0, 45, 1.5)
    assert [w.text for w in recording.speech.words or ()] == ["", "hello"]
    notes = "\n".join(reader.notes())
    assert f"left out 2_scott_0_3_3: {tmp_path / 'wave16k' / '2_scott_0_3_3.wav'} missing" in notes
    assert "2_scott_0_99_99.npz: train_test_split.csv does not list it" in notes
    assert "2_scott_0_2_2.TextGrid is missing" in notes and "1 recordings listed as additional" in notes
    out = tmp_path / "store"
    assert main(["build", "beat2", "--source", str(tmp_path), "--out", str(out), "--workers", "1"]) == 0
    store = Store.open(tmp_path / "store")
    assert store.names == ("2_scott_0_1_1", "2_scott_0_2_2", "2_scott_0_9_9", "2_scott_1_1_1")
    assert set(store.recordings[0].absent) == {"Spine3", "Neck1"}


@pytest.mark.parametrize(("joint", "turn", "bone", "direction"), [
    ("left_elbow", (0, -np.pi / 2, 0), ("LeftForeArm", "LeftHand"), (0, 0, 1)),  # forearm from +X to the front
    ("right_shoulder", (0, 0, np.pi / 2), ("RightArm", "RightForeArm"), (0, -1, 0)),  # arm from -X to the floor
    ("spine1", (np.pi / 2, 0, 0), ("Spine2", "Neck"), (0, 0, 1)),  # a deep bow
    ("pelvis", (0, np.pi / 2, 0), ("LeftArm", "LeftForeArm"), (0, 0, -1)),  # facing +X
])
def test_axis_angles_turn_the_bones_that_they_should(tmp_path: Path, joint: str, turn: tuple[float, float, float],
                                                     bone: tuple[str, str], direction: tuple[float, ...]) -> None:
    write_beat2(tmp_path, TAKE, poses_of(2, **{joint: turn}), trans=np.tile([0.1, 1.3, 0.2], (2, 1)))
    motion = skeletons.to_character(read_smplx(tmp_path / "smplxflame_30" / f"{TAKE}.npz"))
    points = kinematics.positions_of(motion)[0]
    way = points[CHARACTER.index(bone[1])] - points[CHARACTER.index(bone[0])]
    np.testing.assert_allclose(way / np.linalg.norm(way), direction, atol=0.12)  # a spine is not quite straight
    np.testing.assert_allclose(motion.root_positions, [[0.1, 0.95, 0.2]] * 2, atol=1e-6)


def test_one_take_in_two_formats_is_one_motion(outside_data: Path) -> None:
    """BEAT's BVH and BEAT2's SMPL-X of the same minute; the two come from different solvers on different bodies."""
    place = outside_data / "takes" / "beat_scott"
    body = kinematics.resample(skeletons.to_character(read_smplx(place / f"{TAKE}.npz")), 15.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BvhWarning)
        rig = skeletons.to_character(read_bvh(place / f"{TAKE}.bvh", fps=15.0))
    hands = [CHARACTER.index(side + "Hand") for side in ("Left", "Right")]
    # The rows of the BVH begin a frame earlier.
    ours, theirs = (kinematics.positions_of(skeletons.facing(m))[:, hands] for m in (body, rig))
    ours, theirs = ours[10:940], theirs[11:941]
    assert np.linalg.norm(ours - theirs, axis=-1).mean() < 0.10
    assert np.linalg.norm(ours[:, ::-1] - theirs, axis=-1).mean() > 0.25  # another hand is far away
    for hand, axis in itertools.product((0, 1), range(3)):
        assert np.corrcoef(ours[:, hand, axis], theirs[:, hand, axis])[0, 1] > 0.95


@pytest.mark.parametrize(("text", "message"), [
    (None, "does not exist"), ("id,type\n", "is empty"), (f"id,type\n{TAKE},exam\n", f"invalid entries \\({TAKE}\\)"),
    (f"id,type\n{TAKE},test\n{TAKE},val\n", "twice"), ("name\na\n", "invalid entries"),
    ("id,type\n2_scott_0_5_5,test\n", "holds none of the recordings"),
])
def test_a_broken_list_of_beat2_is_named(tmp_path: Path, text: str | None, message: str) -> None:
    write_beat2(tmp_path, TAKE, poses_of(5))
    if text is not None:
        (tmp_path / "train_test_split.csv").write_text(text)
    with pytest.raises(InputError, match=rf"{tmp_path}.*{message}"):
        open_corpus("beat2", tmp_path, Options())


# ---------------------------------------------------------------------------------------------------- TED


def test_nothing_is_unpickled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is in the extra 'ted'")
    from data_module.corpora.serialised import deserialise

    monkeypatch.chdir(tmp_path)
    [thing] = deserialise(ted_value("PICKLED", "100"))["clips"]
    assert isinstance(thing, dict) and b"made_by_a_pickle" in thing["data"]
    assert not list(tmp_path.iterdir())


@pytest.fixture
def ted(tmp_path: Path) -> Path:
    """The three published databases, lmdb_val without its file."""
    write_ted(tmp_path)
    return tmp_path


def test_the_databases_of_ted_are_read(ted: Path) -> None:
    reader = open_corpus("ted", ted, Options())
    assert [(item.info.name, item.info.split, item.info.speaker) for item in reader.items()] == [
        ("ted_-aB_1_000", "train", "-aB_1"), ("ted_-aB_1_001", "train", "-aB_1"),
        ("ted_-aB_1_000_2", "test", "-aB_1"), ("ted_-aB_1_001_2", "test", "-aB_1")]
    assert reader.notes() == [f"{ted / 'lmdb_val' / 'data.mdb'} is missing, so nothing is in val"]
    recording = load(reader, reader.items()[1])
    motion, speech = recording.motion, recording.speech
    assert (len(motion), motion.fps, speech.duration, speech.sample_rate) == (50, 25.0, 2.0, 16000)
    assert [(w.text, round(w.start, 6), round(w.end, 6)) for w in speech.words or ()] == [
        ("and", 0.0, 0.2), ("so", 0.5, 0.75)]
    points = kinematics.positions_of(motion)
    at = {name: points[:, CHARACTER.index(name)] for name in CHARACTER.names}
    for side, sign in (("Left", 1), ("Right", -1)):
        # As in the published mean pose: elbows out and down, hands in front.
        assert (sign * at[side + "ForeArm"][:, 0] > sign * at[side + "Arm"][:, 0]).all()
        assert (at[side + "ForeArm"][:, 1] < at[side + "Arm"][:, 1]).all()
        assert (at[side + "Hand"][:25, 2] - at[side + "ForeArm"][:25, 2] > 0.15).all()
    assert (at["Head"][:, 1] > at["Neck"][:, 1]).all()
    assert at["LeftHand"][-1, 1] - at["LeftHand"][0, 1] > 0.15  # the raised joint 6 is the left wrist
    assert np.abs(at["RightHand"] - at["RightHand"][0]).max() < 1e-6
    with pytest.raises(DroppedError, match=r"lmdb_train, key 0000000001, clip 0: skeletons_3d has shape \(50, 9, 3\)"):
        load(reader, reader.items()[0])


def test_a_broken_database_of_ted_is_named(ted: Path) -> None:
    (ted / "lmdb_test" / "data.mdb").write_bytes(b"not a database" * 100)
    with pytest.raises(InputError, match="lmdb_test: is not a database"):
        open_corpus("ted", ted, Options()).items()
    shutil.rmtree(ted / "lmdb_train")
    shutil.rmtree(ted / "lmdb_test")
    with pytest.raises(InputError, match="holds none of lmdb_train"):
        open_corpus("ted", ted, Options())
