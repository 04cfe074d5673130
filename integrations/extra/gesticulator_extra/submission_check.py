"""Whether a folder of motion is in the form of a public leaderboard: names, lengths, skeleton, arrays, and numbers.

What fools it: it looks at the form. Motion that stands still for a second or more is named, but nothing else about how
it looks is.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.arrays import read_npz
from data_module.errors import InputError
from data_module.motion import bvh
from data_module.speech.audio import header_seconds
from data_module.types import Array

FPS = 30.0
"""Frames per second of BEAT2."""
ARRAYS: dict[str, tuple[int | None, ...]] = {
    "poses": (None, 165), "trans": (None, 3), "betas": (300,), "expressions": (None, 100)}
"""Shapes of BEAT2's arrays of numbers; None: frames."""
WORDS = ("gender", "model", "mocap_frame_rate")
"""Its other arrays, of one value."""
SLACK = 1
"""Frames that a length may differ by: sounds do not last whole frames."""
STILL = 1e-5
"""Radians between frames, the most that a body moves that stands still."""
_OFFSETS = 1e-3
"""How far the offset of a joint may lie from the reference's, in its unit, as files print three digits or more."""


def frames_for(seconds: float, fps: float) -> int:
    """Frames of a sound."""
    return max(1, round(seconds * fps))


def arrays_of(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a BEAT2 file; InputError for another file."""
    return read_npz(path, (*ARRAYS, *WORDS), "fetch it again")


def check(form: str, folder: Path, sounds: Mapping[str, Path], like: Path | None) -> list[str]:
    """What is wrong in a folder, a line each. sounds: by name, the recordings that it must hold motion for; like: the
    .bvh (genea) or the folder of .npz (beat2, or None) that the files must be like."""
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "name the folder of the motion")
    suffix = {"beat2": ".npz", "genea": ".bvh"}[form]
    faults = [f"{file.name}: no recording has this name" for file in sorted(folder.iterdir())
              if file.suffix != suffix or file.stem not in sounds]
    for name, sound in sounds.items():
        path = folder / f"{name}{suffix}"
        if not path.is_file():
            faults.append(f"{path.name}: is missing")
            continue
        try:
            found = _beat2(path, sound, like) if form == "beat2" else _genea(path, sound, like)
        except InputError as error:
            found = [str(error).removeprefix(f"{path}: ").removeprefix(str(path)).strip()]
        faults += [f"{path.name}: {fault}" for fault in found]
    return faults


def _beat2(path: Path, sound: Path, like: Path | None) -> list[str]:
    arrays = arrays_of(path)
    missing = [name for name in (*ARRAYS, *WORDS) if name not in arrays]
    if missing:
        return [f"has no {', '.join(missing)}"]
    frames = len(arrays["poses"]) if arrays["poses"].ndim else 0
    faults = []
    for name, shape in ARRAYS.items():
        wanted = tuple(frames if length is None else length for length in shape)
        if arrays[name].shape != wanted:
            faults.append(f"{name} is {list(arrays[name].shape)} and should be {list(wanted)}")
        elif arrays[name].dtype.kind != "f":
            faults.append(f"{name} is of type {arrays[name].dtype} and should be floating point")
        elif not np.isfinite(arrays[name]).all():
            faults.append(f"{name} holds numbers that are not finite")
    rate = arrays["mocap_frame_rate"]
    if rate.size != 1 or rate.dtype.kind not in "fiu" or float(np.ravel(rate)[0]) != FPS:
        faults.append(f"mocap_frame_rate is not {FPS:g}")
    reference = None if like is None else like / path.name
    if faults:
        return faults
    if reference is not None and reference.is_file():
        theirs = arrays_of(reference)
        if "poses" not in theirs or theirs["poses"].ndim != 2:
            raise InputError(reference, "has no poses", "name BEAT2's smplxflame_30")
        faults += _length(frames, len(theirs["poses"]), "the data set's")
        if "betas" in theirs and not np.array_equal(theirs["betas"].astype(np.float32), arrays["betas"]):
            faults.append("betas are not the data set's: another body")
    else:
        faults += _length(frames, frames_for(header_seconds(sound), FPS), "the sound's")
    return faults + _moves(arrays["poses"][:, :66])


def _genea(path: Path, sound: Path, like: Path | None) -> list[str]:
    if like is None:
        raise ValueError("genea needs a reference")
    (motion, channels), (theirs, their_channels) = bvh.read_hierarchy(path), bvh.read_hierarchy(like)
    ours, faults = motion.skeleton, []
    if ours.names != theirs.skeleton.names or ours.parents != theirs.skeleton.parents:
        return ["has other joints than the data set, or in another order"]
    if channels != their_channels:
        faults.append("has other channels than the data set")
    if not np.allclose(ours.offsets, theirs.skeleton.offsets, atol=_OFFSETS):
        faults.append("has other bone lengths than the data set")
    if abs(motion.fps - theirs.fps) > 1e-2 * theirs.fps:
        faults.append(f"has {motion.fps:.4g} frames per second and should have {theirs.fps:.4g}")
    whole = bvh.read_bvh(path)
    faults += _length(len(whole), frames_for(header_seconds(sound), theirs.fps), "the sound's")
    return faults + _moves(whole.rotations.reshape(len(whole), -1))


def _length(frames: int, wanted: int, whose: str) -> list[str]:
    return [] if abs(frames - wanted) <= SLACK else [f"has {frames} frames, and {whose} are {wanted}"]


def _moves(values: Array) -> list[str]:
    """A fault where the body never moves. values: [T, N] angles or quaternions."""
    steps = np.abs(np.diff(values, axis=0)).max(axis=1) if len(values) > 1 else np.zeros(1)
    return ["does not move"] if (steps < STILL).all() else []
