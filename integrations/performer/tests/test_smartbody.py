"""Strokes of the clips that SmartBody publishes: real files, files of just the published layout, and broken ones."""

from __future__ import annotations

import csv
import itertools
import shutil
from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer.commands import SMARTBODY
from gesticulator_performer.sources import skm
from gesticulator_performer.sources.smartbody import SmartBody
from gesticulator_performer.strokes import load_strokes
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from data_module.motion import kinematics, rotation
from data_module.motion.bvh import read_bvh


@pytest.fixture(scope="module")
def rebuilt(outside_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """strokes/ made from the eight published clips, by the command."""
    out = tmp_path_factory.mktemp("smartbody") / "strokes"
    assert SMARTBODY.main("gesticulator smartbody", [str(outside_data / "smartbody_original"), "--out", str(out)]) == 0
    return out


def _rows(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "manifest.csv").open(encoding="utf-8", newline="") as lines:
        return {row["file"]: row for row in csv.DictReader(lines)}


def test_the_published_clips_give_the_motion_of_the_strokes(rebuilt: Path, outside_data: Path) -> None:
    files = sorted(_rows(rebuilt))
    assert len(files) == 8
    for file in files:
        ours, theirs = (read_bvh(folder / file, unit=1.0) for folder in (rebuilt, outside_data / "strokes"))
        assert ours.skeleton.same_joints(theirs.skeleton), file
        assert (len(ours), ours.fps) == (len(theirs), 30.0), file
        worlds = [kinematics.global_rotations(m.skeleton, m.rotations) for m in (ours, theirs)]
        assert rotation.angle_between(*worlds).max() < 1e-4, file
        np.testing.assert_allclose(ours.skeleton.offsets, theirs.skeleton.offsets, atol=2e-6)
        np.testing.assert_allclose(ours.root_positions, theirs.root_positions, atol=6e-5)  # theirs have four digits


def test_the_performer_plays_what_was_rebuilt(rebuilt: Path, outside_data: Path, tmp_path: Path) -> None:
    shutil.copytree(outside_data / "strokes", tmp_path / "strokes")
    (tmp_path / "strokes" / "manifest.csv").write_bytes((rebuilt / "manifest.csv").read_bytes())
    ours, theirs = load_strokes(rebuilt), load_strokes(tmp_path / "strokes")
    assert [s.base for s in ours.strokes] == [s.base for s in theirs.strokes] and len(ours.strokes) == 16
    for mine, other in zip(ours.strokes, theirs.strokes, strict=True):
        assert mine.beat == pytest.approx(other.beat, abs=1e-3)


def _body(rng: np.random.Generator) -> tuple[list[str], dict[str, str], dict[str, np.ndarray], dict[str, Rotation]]:
    """SmartBody's joints with a twist joint between shoulder and elbow: names, parents, offsets, prerots."""
    ours = {**_ours_parents()}
    theirs = {name: skm.JOINT_TABLE[name] for name in ours}
    parents = {theirs[name]: theirs.get(parent, "") for name, parent in ours.items()}
    parents["JtTwistLf"], parents["JtElbowLf"] = "JtShoulderLf", "JtTwistLf"
    names = ["JtRoot"]
    while len(names) < len(parents):
        names += [name for name in parents if name not in names and parents[name] in names]
    return (names, parents, {name: rng.normal(size=3) for name in names},
            {name: Rotation.from_rotvec(rng.normal(size=3)) for name in names})


def _ours_parents() -> dict[str, str]:
    parents = {"Hips": "", "Spine": "Hips", "Spine1": "Spine", "Spine2": "Spine1", "Neck": "Spine2", "Neck1": "Neck",
               "Head": "Neck1"}
    for side in ("Left", "Right"):
        chain = ["Spine2", *(side + part for part in ("Shoulder", "Arm", "ForeArm", "Hand"))]
        leg = ["Hips", *(side + part for part in ("UpLeg", "Leg", "Foot", "ToeBase"))]
        fingers = [[side + "Hand", *(f"{side}Hand{finger}{n}" for n in (1, 2, 3))]
                   for finger in ("Thumb", "Index", "Middle", "Ring", "Pinky")]
        for row in (chain, leg, *fingers):
            parents |= {below: above for above, below in itertools.pairwise(row)}
    return parents


def _sk_text(names: list[str], parents: dict[str, str], offsets: dict[str, np.ndarray],
             prerots: dict[str, Rotation], name: str = "JtRoot") -> str:
    turn = prerots[name].as_rotvec()
    angle = float(np.linalg.norm(turn))
    inside = "".join(_sk_text(names, parents, offsets, prerots, child) for child in names if parents[child] == name)
    return (f"{'root' if name == 'JtRoot' else 'joint'} {name}\n{{ offset {' '.join(map(str, offsets[name]))}\n"
            f"prerot axis {' '.join(map(str, turn / angle))} ang {np.degrees(angle)}\nchannel Quat\n{inside}}}\n")


def test_rotations_are_those_of_the_chain_of_matrices(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    names, parents, offsets, prerots = _body(rng)
    turns = {name: rng.normal(size=(7, 3)) for name in names}
    place = rng.normal(size=(7, 3))
    tree = _sk_text(names, parents, offsets, prerots)
    (tmp_path / "a.sk").write_text(f"# SK\nset_name Any\nskeleton\n{tree}end\n")
    columns = np.concatenate([place, *turns.values()], axis=1)
    frames = "".join(f"kt {t / 60:.9f} fr {' '.join(map(repr, row.tolist()))} \n" for t, row in enumerate(columns))
    channels = "".join(f"JtRoot {axis}Pos\n" for axis in "XYZ") + "".join(f"{name} Quat\n" for name in names)
    (tmp_path / "a.skm").write_text(f"SkMotion\n\nname \"a\"\n\nchannels {len(names) + 3}\n{channels}\nframes 7\n"
                                    f"{frames}\nready time: 0.5\n")
    clip = skm.read_skm(tmp_path / "a.skm")
    motion = skm.motion_of(skm.read_sk(tmp_path / "a.sk"), clip)
    assert clip.sync == {"ready": 0.5} and len(motion) == 4
    world, bind, spot = {}, {}, {}
    for name in names:
        above = parents[name]
        own = prerots[name] * Rotation.from_rotvec(turns[name])
        world[name] = world[above] * own if above else own
        bind[name] = bind[above] * prerots[name] if above else prerots[name]
        spot[name] = spot[above] + bind[above].apply(offsets[name]) if above else np.zeros(3)
    found = kinematics.global_rotations(motion.skeleton, motion.rotations)
    for joint, name in enumerate(motion.skeleton.names):
        theirs = skm.JOINT_TABLE[name]
        expected = (world[theirs] * bind[theirs].inv()).as_quat(scalar_first=True)[::2]  # every second frame of 60
        assert rotation.angle_between(found[:, joint], expected).max() < 1e-5, name
        if parent := _ours_parents()[name]:
            bone = spot[theirs] - spot[skm.JOINT_TABLE[parent]]
            np.testing.assert_allclose(motion.skeleton.offsets[joint], bone, atol=1e-9)
    np.testing.assert_allclose(motion.root_positions, (place + offsets["JtRoot"])[::2], atol=1e-4)


@pytest.fixture
def published(tmp_path: Path, outside_data: Path) -> Path:
    """A copy of one published folder with two of its clips, to be spoilt."""
    source = tmp_path / "behaviorsets"
    clips = [f"motions/ChrBrad@Idle01_{gesture}.skm" for gesture in ("Shrug01", "BeatLowRt01")]
    for part in ("skeletons/ChrBrad.sk", *clips):
        (source / "Gestures" / part).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(outside_data / "smartbody_original" / "Gestures" / part, source / "Gestures" / part)
    return source


@pytest.mark.parametrize(("part", "content", "message"), [
    ("motions/ChrBrad@Idle01_Shrug01.skm", b"hello\n", r"Shrug01\.skm: is not a SmartBody motion"),
    ("motions/ChrBrad@Idle01_Shrug01.skm", b"\xfa\xfe\x00\x81", r"Shrug01\.skm: line 1: is not text"),
    ("skeletons/ChrBrad.sk", b"root A { offset 0 0 x }", r"ChrBrad\.sk: has '0 0 x' where 3 numbers belong"),
    ("skeletons/ChrBrad.sk", b"root A { offset 0 0 0 }", r"no joint JtRoot"),
    ("skeletons/ChrBrad.sk", b"root A { offset 0 0 0", r"ChrBrad\.sk: is not a SmartBody skeleton"),
])
def test_a_broken_file_of_smartbody_is_named(published: Path, tmp_path: Path, part: str, content: bytes,
                                             message: str) -> None:
    (published / "Gestures" / part).write_bytes(content)
    with pytest.raises(InputError, match=message):
        SmartBody(published).write(tmp_path / "out")
