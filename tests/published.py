"""Folders as data sets are published, written small: what the readers of BEAT, BEAT2 and TED are tested on."""

from pathlib import Path

import numpy as np
import pytest
import soundfile
import ted_values

from data_module.motion.bvh import write_bvh
from data_module.motion.skeletons import CHARACTER
from data_module.motion.smplx import SKELETON
from data_module.types import Motion

TAKE = "2_scott_0_1_1"


def textgrid_of(words: list[tuple[str, float, float]]) -> str:
    rows = "".join(f'{start}\n{end}\n"{text}"\n' for text, start, end in words)
    last = words[-1][2]
    return (f'File type = "ooTextFile"\nObject class = "TextGrid"\n\n0\n{last}\n<exists>\n1\n"IntervalTier"\n"words"\n'
            f'0\n{last}\n{len(words)}\n{rows}')


def still_motion(seconds: float, fps: float) -> Motion:
    frames = round(seconds * fps)
    turns = np.zeros((frames, len(CHARACTER), 4))
    turns[..., 0] = 1.0
    return Motion(CHARACTER, turns, np.stack([np.arange(frames) / fps, *np.zeros((2, frames))], axis=-1), fps)


def write_beat(folder: Path, name: str, seconds: float = 4.0, sound: float = 4.0, text: bool = True) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    write_bvh(folder / f"{name}.bvh", still_motion(seconds, 120.0))
    ramp = np.linspace(0.1, 0.9, round(sound * 16000))
    soundfile.write(folder / f"{name}.wav", ramp, 16000)
    if text:
        words = [("one", 0.5, 1.0), ("two", 1.5, 2.5), ("three", 2.5, 3.0)]
        (folder / f"{name}.TextGrid").write_text(textgrid_of(words))


def poses_of(frames: int, **joints: tuple[float, float, float]) -> np.ndarray:
    poses = np.zeros((frames, 55, 3), np.float32)
    for name, turn in joints.items():
        poses[:, SKELETON.index(name)] = turn
    return poses.reshape(frames, -1)


def write_beat2(source: Path, name: str, poses: np.ndarray, **arrays: object) -> None:
    for part in ("smplxflame_30", "wave16k", "textgrid"):
        (source / part).mkdir(parents=True, exist_ok=True)
    content: dict[str, object] = {
        "betas": np.zeros(300, np.float32), "poses": poses, "trans": np.zeros((len(poses), 3)),
        "expressions": np.zeros((len(poses), 100)), "model": np.array("smplx2020"), "gender": np.array("neutral"),
        "mocap_frame_rate": np.array(30)} | arrays
    np.savez(source / "smplxflame_30" / f"{name}.npz", **content)  # type: ignore[arg-type]
    soundfile.write(source / "wave16k" / f"{name}.wav", np.full(len(poses) * 16000 // 30 + 5000, 0.1), 16000)
    (source / "textgrid" / f"{name}.TextGrid").write_text(textgrid_of([("", 0, 0.5), ("hello", 0.5, 1.0)]))


def listed_beat2(folder: Path) -> Path:
    """A folder of BEAT2 with one take, which its list names; the path of the list."""
    write_beat2(folder, TAKE, poses_of(45))
    (folder / "train_test_split.csv").write_text(f"id,type\n{TAKE},test\n")
    return folder / "train_test_split.csv"


def ted_value(name: str, version: str) -> bytes:
    return ted_values.unpacked(getattr(ted_values, f"{name}_{version}"))


def write_ted(folder: Path) -> None:
    """lmdb_train and lmdb_test; lmdb_val is missing. Skips without the libraries."""
    lmdb = pytest.importorskip("lmdb", reason="lmdb is in the extra 'ted'")
    pytest.importorskip("pyarrow", reason="pyarrow is in the extra 'ted'")
    content = {"train": [ted_value("EMPTY", "014"), ted_value("VIDEO", "014")], "test": [ted_value("VIDEO", "100")]}
    for split, videos in content.items():
        place = str(folder / f"lmdb_{split}")
        with lmdb.open(place, map_size=1 << 24) as base, base.begin(write=True) as change:
            for number, value in enumerate(videos):
                change.put(f"{number:010}".encode("ascii"), value)
