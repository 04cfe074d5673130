"""BVH: round trips, any order of channels, upc-pymotion as a second opinion, and every way a file can be broken."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from pymotion.io.bvh import BVH
from pymotion.ops import skeleton as oracle
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from data_module.motion import bvh, kinematics, rotation
from data_module.motion.bvh import BvhWarning, read_bvh, write_bvh
from data_module.motion.skeletons import CHARACTER, scaled
from data_module.types import Array, Motion, Skeleton

ORDERS = ["".join(order) for order in itertools.permutations("XYZ")]

TEMPLATE = """HIERARCHY
ROOT Hips
{{
  OFFSET 0 0 0
  CHANNELS {channels}
  JOINT Tail
  {{
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {{
      OFFSET 0 5 0
    }}
  }}
}}
MOTION
Frames: {frames}
Frame Time: {time}
{rows}
"""
SIX = "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"


def small(channels: str = SIX, frames: object = 2, time: object = 0.05,
          rows: str = "1 2 3 10 20 30 0 0 0\n4 5 6 40 50 60 0 0 0") -> str:
    return TEMPLATE.format(channels=channels, frames=frames, time=time, rows=rows)


def stored(folder: Path, text: str | bytes) -> Path:
    path = folder / "in.bvh"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def lively(frames: int = 25, fps: float = 60.0, seed: int = 0) -> Motion:
    """The character in any pose at all, frame after frame, and anywhere."""
    rng = np.random.default_rng(seed)
    turns = Rotation.random(frames * len(CHARACTER), rng=rng).as_quat(scalar_first=True)
    return Motion(CHARACTER, turns.reshape(frames, -1, 4), rng.normal(size=(frames, 3)), fps)


def as_read_by_pymotion(path: Path) -> tuple[Array, list[str]]:
    """Positions [T, J, 3] in the file's own unit by upc-pymotion alone, and its joint names."""
    other = BVH()
    other.load(str(path))
    quaternions, positions, parents, offsets, _, _ = other.get_data()
    return oracle.fk(quaternions, positions[:, 0], offsets, parents)[0], [str(name) for name in other.data["names"]]


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    motion = lively()
    write_bvh(tmp_path / "out.bvh", motion)
    back = read_bvh(tmp_path / "out.bvh")
    # Joints are written depth first, which is the order of the character.
    assert back.skeleton.same_joints(CHARACTER)
    assert back.fps == 60.0
    assert rotation.angle_between(back.rotations, motion.rotations).max() < 1e-7
    assert np.allclose(back.root_positions, motion.root_positions, atol=1e-8)
    assert np.allclose(back.skeleton.offsets, CHARACTER.offsets, atol=1e-8)
    for joint, tip in CHARACTER.end_sites.items():
        assert np.allclose(back.skeleton.end_sites[joint], tip, atol=1e-8)


def test_joints_in_another_order_than_the_files_keep_their_own_angles(tmp_path: Path) -> None:
    # Both arms' roots, then both tips: a file can only hold arm by arm.
    skeleton = Skeleton(("root", "left", "right", "left_tip", "right_tip"), (-1, 0, 0, 1, 2), np.eye(5, 3))
    turns = rotation.from_exponential_map(np.arange(15.0).reshape(1, 5, 3) / 15)
    write_bvh(tmp_path / "out.bvh", Motion(skeleton, turns, np.zeros((1, 3)), 30.0))
    back = read_bvh(tmp_path / "out.bvh")
    assert back.skeleton.names == ("root", "left", "left_tip", "right", "right_tip")
    for joint, name in enumerate(skeleton.names):
        assert rotation.angle_between(back.rotations[0, back.skeleton.index(name)], turns[0, joint]) < 1e-7


@pytest.mark.parametrize(("time", "fps"), [("0.033333", 30.0), ("0.0333667", 29.97), ("0.008333", 120.0),
                                           ("0.0416667", 24.0), ("0.016667", 60.0), ("0.0417083", 23.976)])
def test_a_frame_time_of_few_digits_means_the_rate_next_to_it(tmp_path: Path, time: str, fps: float) -> None:
    assert read_bvh(stored(tmp_path, small(time=time))).fps == pytest.approx(fps, rel=1e-5)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("places", [(0, 1, 2), (2, 0, 1)])
def test_any_order_of_channels(tmp_path: Path, order: str, places: tuple[int, int, int]) -> None:
    angles = dict(zip(order, np.radians([10.0, 20.0, 30.0]), strict=True))
    channels = "6 " + " ".join([f"{'XYZ'[place]}position" for place in places] + [f"{a}rotation" for a in order])
    motion = read_bvh(stored(tmp_path, small(channels)), unit=1.0)
    # By hand: matrices multiplied in the order in which the channels are written.
    expected = np.eye(3)
    for axis in order:
        expected = expected @ Rotation.from_euler(axis, angles[axis]).as_matrix()
    ours = Rotation.from_quat(motion.rotations[0, 0], scalar_first=True).as_matrix()
    assert np.allclose(ours, expected, atol=1e-12)
    assert motion.root_positions[0, list(places)].tolist() == [1.0, 2.0, 3.0]


def test_the_way_of_hips_below_a_root_that_carries_them_is_kept(tmp_path: Path) -> None:
    """The root turns and moves, and so do the hips below it; a spine's own positions stay their mean."""
    joint = "JOINT {}\n{{\nOFFSET 0 1 0\nCHANNELS " + SIX + "\n{}}}\n"
    tip = "End Site\n{\nOFFSET 0 1 0\n}\n"
    tree = joint.format("hips", "".join(joint.format(name, tip) for name in ("spine", "left", "right")))
    text = (f"HIERARCHY\nROOT world\n{{\nOFFSET 0 0 0\nCHANNELS {SIX}\n{tree}}}\nMOTION\nFrames: 3\n"
            "Frame Time: 0.05\n")
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(3, 5, 6)) * [5, 5, 5, 40, 40, 40]
    (tmp_path / "carried.bvh").write_text(text + "\n".join(" ".join(map(str, row.ravel())) for row in rows) + "\n")
    motion = read_bvh(tmp_path / "carried.bvh", unit=1.0)
    root = Rotation.from_euler("ZXY", rows[:, 0, 3:], degrees=True)
    assert np.allclose(kinematics.positions_of(motion)[:, 1], rows[:, 0, :3] + root.apply(rows[:, 1, :3]), atol=1e-9)
    assert np.allclose(motion.skeleton.offsets[2], rows[:, 2, :3].mean(axis=0))


@pytest.mark.parametrize("frames", [1, 2, 3, 7, 8])
def test_a_file_in_slices_is_that_of_the_whole_motion(frames: int, tmp_path: Path,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    """Against numpy's own unwrapping of all frames at once, to the digit; poses that turn many times over."""
    ways = np.cumsum(np.random.default_rng(frames).normal(size=(frames, len(CHARACTER), 3)), axis=0)
    motion = Motion(CHARACTER, rotation.from_exponential_map(ways), np.zeros((frames, 3)), 60.0)
    monkeypatch.setattr(bvh, "_SLICE", 3)
    write_bvh(tmp_path / "out.bvh", motion)
    written = (tmp_path / "out.bvh").read_text()
    rows = np.loadtxt(written.partition("Frame Time")[2].splitlines()[1:], ndmin=2)
    orders = [re.findall("([XYZ])rotation", line) for line in written.splitlines() if "CHANNELS" in line]
    for joint, order in enumerate(orders):
        turns = Rotation.from_quat(motion.rotations[:, joint], scalar_first=True).as_euler("".join(order))
        whole = np.degrees(np.unwrap(turns, axis=0))
        assert [f"{value:.6f}" for value in rows[:, 3 + 3 * joint:6 + 3 * joint].ravel() + 0.0] == [
            f"{value:.6f}" for value in whole.ravel() + 0.0]


def test_our_files_mean_the_same_to_pymotion(tmp_path: Path) -> None:
    motion = lively(seed=2)
    write_bvh(tmp_path / "out.bvh", motion)
    positions, names = as_read_by_pymotion(tmp_path / "out.bvh")
    assert names == list(CHARACTER.names)
    assert np.allclose(positions / 100, kinematics.positions_of(motion), atol=1e-6)


def test_pymotions_files_mean_the_same_to_us(tmp_path: Path) -> None:
    write_bvh(tmp_path / "out.bvh", lively(seed=3))
    other = BVH()
    other.load(str(tmp_path / "out.bvh"))
    other.save(str(tmp_path / "theirs.bvh"))
    positions, _ = as_read_by_pymotion(tmp_path / "theirs.bvh")
    assert np.allclose(kinematics.positions_of(read_bvh(tmp_path / "theirs.bvh")), positions / 100, atol=1e-6)


def test_a_real_takes_wrong_header_is_refused_until_the_rate_is_told(outside_data: Path) -> None:
    path = outside_data / "takes" / "beat_scott" / "2_scott_0_1_1.bvh"
    with pytest.raises(InputError, match="7669 frames at 120 fps but 957 rows"):
        read_bvh(path)
    with pytest.warns(BvhWarning, match="7669 frames"):
        motion = read_bvh(path, fps=15.0)
    assert len(motion) == 957
    assert motion.duration == pytest.approx(63.8)
    # Centimetres are recognised: from hips to head an adult measures about 0.6 m.
    head = kinematics.positions_of(motion)[:, motion.skeleton.index("Head")] - motion.root_positions
    assert 0.4 < np.median(np.linalg.norm(head, axis=-1)) < 0.8


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001])
def test_metres_centimetres_and_millimetres_are_told_apart(tmp_path: Path, unit: float) -> None:
    # Written as if a metre were 1 / unit of the file's units; the writer itself divides by centimetres.
    motion = lively()
    write_bvh(tmp_path / "out.bvh", scaled(motion, 0.01 / unit))
    assert np.allclose(kinematics.positions_of(read_bvh(tmp_path / "out.bvh")), kinematics.positions_of(motion),
                       atol=1e-4)


@pytest.mark.parametrize("text", [
    small().replace("\n", "\r\n"),
    "\ufeff" + small(),
    small().replace("  ", "\t"),
    small() + "\n\n",
    small().rstrip("\n"),
    small().replace("JOINT Tail", "JOINT Left Tail"),
], ids=["CRLF", "BOM", "tabs", "blank lines", "no last line end", "names of two words"])
def test_the_ways_in_which_tools_write_are_all_read(tmp_path: Path, text: str) -> None:
    motion = read_bvh(stored(tmp_path, text), unit=1.0)
    assert motion.root_positions.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert motion.skeleton.names == ("Hips", "Left Tail" if "Left" in text else "Tail")


BROKEN = {
    "empty": b"",
    "not text": bytes(range(128, 256)),
    "another kind of text": b"Dear diary,\n",
    "no motion": small().split("MOTION")[0],
    "header only": small()[:70],
    "no rows": small(frames=0, rows=""),
    "fewer rows than said": small(frames=3),
    "more rows than said": small(frames=1),
    "short row": small(rows="1 2 3 10 20 30 0 0 0\n4 5 6"),
    "every row short": small(rows="1 2 3\n4 5 6"),
    "word in a row": small(rows="1 2 3 10 20 30 0 0 0\n4 5 6 x 50 60 0 0 0"),
    "comment in a row": small(rows="1 2 3 10 20 30 0 0 0 # one\n4 5 6 40 50 60 0 0 0"),
    "NaN in a row": small(rows="1 2 3 10 20 30 0 0 0\n4 5 6 nan 50 60 0 0 0"),
    "no channels": small("0", rows=""),
    "unknown channel": small(SIX.replace("Zrotation", "Wrotation")),
    "more channels said than named": small(SIX.replace("6", "7")),
    "no number in an offset": small().replace("OFFSET 0 10 0", "OFFSET 0 ten 0"),
    "infinite offset": small().replace("OFFSET 0 10 0", "OFFSET 0 inf 0"),
    "offset of two numbers": small().replace("OFFSET 0 10 0", "OFFSET 0 10"),
    "two joints of one name": small().replace("JOINT Tail", "JOINT Hips"),
    "a bracket too few": small().replace("}\nMOTION", "MOTION"),
    "a bracket too many": small().replace("}\nMOTION", "}\n}\nMOTION"),
    "frame time zero": small(time=0),
    "frame time negative": small(time=-0.1),
    "frame time no number": small(time="fast"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_one_line_that_names_it(tmp_path: Path, name: str) -> None:
    path = stored(tmp_path, BROKEN[name])
    with pytest.raises(InputError) as failure:
        read_bvh(path)
    said = str(failure.value)
    assert said.startswith(str(path))
    assert "\n" not in said
    assert failure.value.advice


@pytest.mark.parametrize("asked", [{"fps": 0.0}, {"fps": -30.0}, {"fps": float("nan")}, {"unit": 0.0}, {"unit": -1.0}])
def test_a_rate_or_a_unit_that_is_not_positive_is_the_users_error(tmp_path: Path, asked: dict[str, float]) -> None:
    with pytest.raises(InputError, match="positive"):
        read_bvh(stored(tmp_path, small()), **asked)


def test_angles_are_written_without_jumps(tmp_path: Path) -> None:
    # A full turn about Z in small steps: tools that interpolate channel by channel must not see 180 become -180.
    vectors = np.zeros((50, len(CHARACTER), 3))
    vectors[:, 9, 2] = np.linspace(0, 2 * np.pi, 50)
    motion = Motion(CHARACTER, rotation.from_exponential_map(vectors), np.zeros((50, 3)), 30.0)
    write_bvh(tmp_path / "turn.bvh", motion)
    rows = np.loadtxt((tmp_path / "turn.bvh").read_text().split("Frame Time:")[1].splitlines()[1:])
    assert np.abs(np.diff(rows, axis=0)).max() < 10.0


def test_a_palm_that_turns_past_90_degrees_comes_back_to_the_same_angles(tmp_path: Path) -> None:
    # A hand turns over by 120 degrees and back; on its way it nods a little, up in one take and down in the other.
    # About the middle axis of an order, the two would go round the pole on either side, and end 360 degrees apart.
    phase = np.linspace(0.0, 2.0 * np.pi, 120)
    ends = []
    for way in (1.0, -1.0):
        vectors = np.zeros((120, len(CHARACTER), 3))
        for joint in ("LeftHand", "RightForeArm", "Head"):
            vectors[:, CHARACTER.index(joint), 0] = np.radians(60.0) * (1.0 - np.cos(phase))
            vectors[:, CHARACTER.index(joint), 1] = way * np.radians(25.0) * np.sin(phase)
        motion = Motion(CHARACTER, rotation.from_exponential_map(vectors), np.zeros((120, 3)), 60.0)
        write_bvh(tmp_path / "turn.bvh", motion)
        assert rotation.angle_between(read_bvh(tmp_path / "turn.bvh").rotations, motion.rotations).max() < 1e-7
        text = (tmp_path / "turn.bvh").read_text()
        rows = np.loadtxt(text.split("Frame Time:")[1].splitlines()[1:])
        ends.append(dict(zip(_channels_of(text), (rows[-1] - rows[0]).round(3), strict=True)))
    for joint in ("LeftHand", "RightForeArm"):
        assert all(abs(end[joint, axis]) < 1e-3 for end in ends for axis in "XYZ")
    # The control: a head that did the same, in the order that suits heads.
    assert max(abs(end["Head", axis]) for end in ends for axis in "XYZ") == 360.0


def _channels_of(text: str) -> list[tuple[str, str]]:
    """The joint and axis of each column of a file, with small letters for translations."""
    columns, joint = [], ""
    for line in text.splitlines():
        words = line.split()
        if words[:1] in (["ROOT"], ["JOINT"]):
            joint = words[1]
        elif words[:1] == ["CHANNELS"]:
            columns += [(joint, word[0] if word.endswith("rotation") else word[0].lower()) for word in words[2:]]
    return columns
