"""The build command, end to end on the toy corpus: bit for bit, in any order, and never over others."""

import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import published_bvh
import pytest
from scipy.spatial.transform import Rotation

from data_module.blocks import cut
from data_module.corpora.table import CORPORA
from data_module.files import lock
from data_module.motion import kinematics, rotation
from data_module.motion.bvh import read_bvh, write_bvh
from data_module.motion.skeletons import WHOLE_BODY
from data_module.store import Store
from data_module.types import Motion, Skeleton
from gesticulator.cli import main

FILLED = WHOLE_BODY.names[16:]
"""Joints that the toy corpus lacks: fingers and legs."""


def _of(corpus: Path) -> list[str]:
    """The arguments with which the fixture `tiny_store` is built, but for --out."""
    return ["folder", "--source", str(corpus)]


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def test_the_data_set_beside_the_store_gives_the_same_store(tiny_store: Path, tmp_path: Path) -> None:
    """BVH, FLAC and JSON hold everything: the folder reader brings back the same recordings."""
    assert main(["build", "folder", "--source", str(tiny_store / "dataset"), "--out", str(tmp_path / "s"),
                 "--no-dataset", "--workers", "1"]) == 0
    made, read = Store.open(tiny_store), Store.open(tmp_path / "s")
    assert read.names == made.names
    for before, after in zip(made.recordings, read.recordings, strict=True):
        assert (before.split, before.speaker, before.voice, before.language) == (
            after.split, after.speaker, after.voice, after.language)
    one, two = made.load(made.names[0], 54), read.load(made.names[0], 54)
    assert (one.motion.absent, one.motion.filled) == (two.motion.absent, two.motion.filled) == ((), FILLED)
    assert np.array_equal(one.speech.samples, two.speech.samples) and one.speech.words == two.speech.words
    apart = kinematics.positions_of(one.motion) - kinematics.positions_of(two.motion)
    assert np.abs(apart).max() < 1e-5


def test_two_workers_give_the_same_bytes_and_a_store_is_not_overwritten(
        toy_corpus: Path, tiny_store: Path, tmp_path: Path, refused: Callable[..., str],
        capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "store"
    (tmp_path / "store.partial").mkdir()  # of a build that was killed
    (tmp_path / "store.partial" / "old").touch()
    command = ["build", *_of(toy_corpus), "--out", str(out), "--workers", "2"]
    assert main(command) == 0
    told, said = json.loads((out / "report.json").read_text(encoding="utf-8")), capfd.readouterr().out
    assert f"{told['blocks']} blocks" in said
    assert any(f"warning: {minutes} minutes of training data are little" in said for minutes in (2, 3))
    # Its seed and settings are those of the fixture, so every byte must be, too.
    mine, theirs = _contents(out), _contents(tiny_store)
    assert list(mine) == list(theirs)
    assert [name for name in mine if mine[name] != theirs[name]] == []
    assert "is already there" in refused(*command)
    assert _contents(out) == mine and not (tmp_path / "store.partial").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    assert "is already there" in refused("build", *_of(toy_corpus), "--out", str(tmp_path / "mine"))
    assert (tmp_path / "mine" / "letter.txt").read_text() == "dear"


@pytest.mark.parametrize(("arguments", "wrong"), [
    (["nothing", "--out", "x"], "is not a data set"),
    (["folder", "--out", "x"], "--source"),
    (["folder", "--source", "missing", "--out", "x"], "does not exist"),
    (["folder", "--source", ".", "--workers", "0", "--out", "x"], "--workers"),
])
def test_bad_input_is_one_line_and_leaves_nothing(arguments: list[str], wrong: str, tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch,
                                                  refused: Callable[..., str]) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    assert wrong in refused("build", *arguments)
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
    assert main(["build", "folder", "--source", str(source), "--out", str(tmp_path / "s"), "--workers", "1"]) == 0
    said = capsys.readouterr().out
    assert "dropped talk_0001_puppet" in said and "dropped odd" in said and "LeftHand" in said
    told = json.loads((tmp_path / "s" / "report.json").read_text(encoding="utf-8"))
    assert set(told["dropped"]) == {"talk_0001_puppet", "odd"} and told["recordings"] == 1
    assert said.count("split is empty, so") == 2
    assert str(source / "talk_0001_puppet.flac") in told["dropped"]["talk_0001_puppet"]
    assert Store.open(tmp_path / "s").names == ("talk_0000_puppet",)


def _raised(degrees: float, around: str = "z") -> np.ndarray:
    return Rotation.from_euler(around, degrees, degrees=True).as_quat(scalar_first=True)


def _posed() -> Motion:
    """On the rig of Talking With Hands: the left arm raised by 40 degrees, its elbow bent forwards by 30 after a twist,
    the right arm lowered by 25, the left index finger bent by 35, while the person walks 0.5 m to the left."""
    still = published_bvh.moving(4.0, 30.0, skeleton=published_bvh.hands_rig())
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (120, len(still.skeleton), 1))
    for name, turn in (("b_l_arm", _raised(40.0)), ("b_l_arm_twist", _raised(20.0, "x")),
                       ("b_l_forearm", _raised(-30.0, "y")), ("b_r_arm", _raised(25.0)),
                       ("b_l_index1", _raised(-35.0))):
        turns[:, still.skeleton.index(name)] = turn
    way = np.linspace([0.0, 0.0, 0.0], [0.5, 0.0, 0.0], 120)
    return replace(still, rotations=turns, root_positions=way)


@pytest.mark.parametrize("facing", [0.0, -90.0])
def test_talking_with_hands_is_built_with_its_angles_times_and_units(facing: float, tmp_path: Path,
                                                                     capsys: pytest.CaptureFixture[str]) -> None:
    posed, turn = _posed(), _raised(facing, "y")
    # The same person in a file whose forward is another axis: everything turns, the angles stay.
    offsets = rotation.rotate(turn, posed.skeleton.offsets)
    turned = rotation.multiply(rotation.multiply(turn, posed.rotations), rotation.conjugate(turn))
    source = published_bvh.genea(tmp_path, motion=Motion(
        Skeleton(posed.skeleton.names, posed.skeleton.parents, offsets), turned,
        rotation.rotate(turn, posed.root_positions), 30.0))
    assert main(["build", "genea", "--source", str(source), "--out", str(tmp_path / "s"), "--workers", "1"]) == 0
    assert "0.01 m, as published" in capsys.readouterr().out
    store = Store.open(tmp_path / "s")
    assert [info.split for info in store.recordings] == ["train", "train", "val"] and "BY-NC" in store.licence
    recording = store.load("trn_2022_v1_000", len(WHOLE_BODY))
    motion, places = recording.motion, kinematics.positions_of(recording.motion)
    assert motion.fps == 30.0 and len(motion) == 120
    assert [(word.text, word.start, word.end) for word in recording.speech.words or ()] == [
        ("So", 0.3, 0.55), ("we", 0.55, 0.9), ("", 0.9, 1.5), ("went.", 2.0, 3.0)]

    def bone(above: str, below: str) -> np.ndarray:
        way = places[60, WHOLE_BODY.index(below)] - places[60, WHOLE_BODY.index(above)]
        return way / np.linalg.norm(way)

    def height(above: str, below: str) -> float:
        return float(np.degrees(np.arcsin(bone(above, below)[1])))

    assert height("LeftArm", "LeftForeArm") == pytest.approx(40.0, abs=0.01) and bone("LeftArm", "LeftForeArm")[0] > 0
    assert height("RightArm", "RightForeArm") == pytest.approx(-25.0, abs=0.01)
    assert bone("RightArm", "RightForeArm")[0] < 0
    elbow = bone("LeftArm", "LeftForeArm") @ bone("LeftForeArm", "LeftHand")
    assert np.degrees(np.arccos(elbow)) == pytest.approx(30.0, abs=0.01) and bone("LeftForeArm", "LeftHand")[2] > 0.3
    index = bone("LeftHandIndex1", "LeftHandIndex2") @ bone("LeftForeArm", "LeftHand")
    assert np.degrees(np.arccos(index)) == pytest.approx(35.0, abs=0.01)
    # Centimetres, and the character's own axes; feet may be planted anew, so only the way to the left counts.
    assert np.ptp(motion.root_positions[:, 0]) == pytest.approx(0.5, abs=1e-3)
    assert np.ptp(motion.root_positions[:, 2]) == pytest.approx(0.0, abs=1e-3)


def test_a_rig_of_any_names_is_built_by_its_joint_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The store is that of the same motion under known names, to the bit."""
    motion = published_bvh.moving(3.0, 30.0)
    table = {name: f"bone_{place}" for place, name in enumerate(motion.skeleton.names)}
    for folder, names in (("known", {}), ("strange", table)):
        text = published_bvh.bvh_in(motion)
        for known, other in names.items():
            text = re.sub(rf"(ROOT|JOINT) {known}\n", rf"\1 {other}\n", text)
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "talk.bvh").write_text(text)
        published_bvh.write_clicks(tmp_path / folder / "talk.wav", 3.0)
    spine, neck = ([table[name] for name in table if name.startswith(stem)] for stem in ("Spine", "Neck"))
    single = {name: table.get(name) for name in WHOLE_BODY.names if not name.startswith(("Spine", "Neck"))}
    joints = {"format": 1, "joints": single, "spine": spine, "neck": neck}
    (tmp_path / "joints.json").write_text(json.dumps(joints))

    def built(folder: str, *options: str) -> tuple[int, str]:
        out = str(tmp_path / f"{folder}.store")
        try:
            code = main(["build", "folder", "--source", str(tmp_path / folder), "--out", out, "--workers", "1",
                         *options])
        except SystemExit as left:
            code = int(str(left.code))
        return code, capsys.readouterr().err

    assert built("known")[0] == 0
    code, said = built("strange")
    assert code == 2 and said.count("\n") == 1 and "Hips" in said and "--joints" in said
    for wrong, message in (
            ({"joints": {**single, "LeftArm": None}}, "names no joint for LeftArm"),
            ({"joints": {**single, "LeftArm": single["Head"]}}, "for two joints"),
            ({"joints": {**single, "LeftArm": "elsewhere"}}, "has no joint elsewhere, which --joints names"),
            ({"joints": {**single, "Tail": "bone_1"}}, "unknown joints Tail"), ({"format": 9}, "is not a mapping")):
        (tmp_path / "wrong.json").write_text(json.dumps({**joints, **wrong}))
        code, said = built("strange", "--joints", str(tmp_path / "wrong.json"))
        assert code == 2 and said.count("\n") == 1 and message in said
        assert not (tmp_path / "strange.store").exists()
    assert built("strange", "--joints", str(tmp_path / "joints.json"))[0] == 0
    first, second = (Store.open(tmp_path / f"{folder}.store").load("talk", 54) for folder in ("known", "strange"))
    assert np.array_equal(first.motion.rotations, second.motion.rotations)
    assert np.array_equal(first.motion.root_positions, second.motion.root_positions)
    assert (first.motion.absent, first.motion.filled) == (second.motion.absent, second.motion.filled)


def test_nothing_usable_is_an_error_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "pairs"
    source.mkdir()
    (source / "a.bvh").write_text("no motion")
    (source / "a.wav").write_text("no sound")
    with pytest.raises(SystemExit):
        main(["build", "folder", "--source", str(source), "--out", str(tmp_path / "s"), "--workers", "1"])
    assert "no recording that can be used" in capsys.readouterr().err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["pairs"]


def test_two_builds_of_one_store_keep_out_of_each_others_way(tmp_path: Path, refused: Callable[..., str]) -> None:
    with lock(tmp_path / "s", "a build", beside=True):
        line = refused("build", "folder", "--source", tmp_path, "--out", tmp_path / "s")
    assert f"s: is in use by a build (process {os.getpid()} on " in line
    assert list(tmp_path.iterdir()) == []


def test_a_corpus_of_another_distribution_says_what_to_install(monkeypatch: pytest.MonkeyPatch,
                                                               refused: Callable[..., str]) -> None:
    monkeypatch.setitem(vars(CORPORA), "points", {})  # as in an environment without other distributions
    assert "pip install -e integrations/performer" in refused("build", "performer", "--out", "x")


def test_the_report_counts_what_is_in_the_store(tiny_store: Path) -> None:
    store = Store.open(tiny_store)
    told = json.loads((tiny_store / "report.json").read_text(encoding="utf-8"))
    blocks = {info.name: len(cut(store.load(info.name).speech)) for info in store.recordings}
    assert told["blocks"] == sum(blocks.values())
    for split, own in told["splits"].items():
        infos = [info for info in store.recordings if info.split == split]
        assert (own["recordings"], own["blocks"]) == (len(infos), sum(blocks[info.name] for info in infos))
        assert own["minutes"] == pytest.approx(sum(info.seconds for info in infos) / 60, abs=1e-3)
