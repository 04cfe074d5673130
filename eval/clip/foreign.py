"""Motion that others made, read so that it can be judged beside ours: BVH, SMPL-X, joint positions; with its speech.

A folder holds one motion file for each clip, and, unless another folder is told, the speech under the same name:

- `NAME.bvh`: any rig whose joints have known names (`skeletons.NAME_TABLES`);
- `NAME.npz`: SMPL-X poses (`data_module.motion.smplx`);
- `NAME.npy`: positions [T, J, 3] of joints in space, with `NAME.json` beside it, or `joints.json` for all:
  {"joints": [J names], "fps": 15, "up": "+Y"}. The names are those of a known rig, or TED's ten; up is the axis that
  points up (+Y when not told, -Y for pictures, +Z). The unit does not count.

All become motion of the 16-joint character, so that bodies are not compared, only what they do. What that costs: of
positions only the directions of bones are known, no turn of a limb about its length; the head is known where the names
tell a nose and a crown ("Nose", "HeadTop"), and is else masked. Positions do not say where the hips face: that is
taken from both hip joints in each frame where they are named, else from the shoulders over the whole clip.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from data_module.arrays import as_floats, read_npy
from data_module.errors import InputError, shown
from data_module.files import read_json
from data_module.motion import rotation
from data_module.motion.bvh import FRAME_RATE_ADVICE, BvhWarning, read_bvh
from data_module.motion.representation import TED_JOINTS, rotations_from_positions, ted_positions
from data_module.motion.skeletons import CHARACTER, FINGER_JOINTS, FINGERED, find_table, to_character
from data_module.motion.smplx import read_smplx
from data_module.speech.audio import SOUNDS, load_speech
from data_module.store import RecordingInfo, Split, Store
from data_module.types import Array, Motion, Speech

MOTIONS = (".bvh", ".npz", ".npy")
"""Endings of motion files; where a name has several, the first of these is read."""
SHARED, STORE = "joints.json", "store.json"
"""Files that tell the joints of all positions of a folder, and that a folder is a store."""

_UP = {"+Y": np.eye(3), "-Y": np.diag([-1.0, -1.0, 1.0]),
       "+Z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), "-Z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}
_HIP_JOINTS = (("leftupleg", "rightupleg"), ("left_hip", "right_hip"), ("lhip", "rhip"), ("thigh_l", "thigh_r"),
               ("leftupperleg", "rightupperleg"), ("left hip", "right hip"))
_NOSES = ("nose",)
_CROWNS = ("headtop", "head_top", "headend", "head_end", "headtop_end", "crown")
_EPS = 1e-9
_FARTHEST = 1e9
"""Units, whichever they are, of a position: a thousand kilometres in millimetres."""
_RATE_ADVICE = 'give the frame rate: {"fps": RATE} in NAME.json beside it'


@dataclass(frozen=True)
class Clip:
    """A motion of the 16-joint character and what was said to it, None where that is not known.

    group: clips of one group share their sound or their text.
    """

    name: str
    motion: Motion
    speech: Speech | None
    group: str = ""


# ---------------------------------------------------------------------------------------------------- folders

def find_motions(folder: Path) -> tuple[dict[str, Path], list[str]]:
    """The motion files of a folder by name, and what was left out. InputError when it is none or holds none."""
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", f"name one that holds NAME{' or NAME'.join(MOTIONS)}")
    files: dict[str, Path] = {}
    notes = []
    for file in sorted((file for file in folder.iterdir() if file.suffix.lower() in MOTIONS and file.is_file()),
                       key=lambda file: (MOTIONS.index(file.suffix.lower()), file.name)):
        if file.stem in files:
            # One name, one motion: the order of `MOTIONS` decides, and the other file is named to the reader.
            notes.append(f"{file}: {files[file.stem].name} is read instead")
        files.setdefault(file.stem, file)
    if not files:
        raise InputError(folder, "holds no motion", f"put NAME{' or NAME'.join(MOTIONS)} there")
    return dict(sorted(files.items())), notes


def find_sound(folder: Path, name: str) -> Path | None:
    """The sound file of this name, if there is one."""
    return next((file for kind in SOUNDS for file in (folder / f"{name}{kind}", folder / f"{name}{kind.upper()}")
                 if file.is_file()), None)


def names_in(folder: Path, split: str = "test") -> list[str]:
    """The names of the clips that `read_folder` would read; nothing but their files' names is looked at."""
    if (folder / STORE).is_file():
        return [info.name for info in _chosen(Store.open(folder), split)]
    return list(find_motions(folder)[0])


def read_folder(folder: Path, speech: Path | None = None, only: Sequence[str] | None = None, split: str = "test"
                ) -> tuple[dict[str, Clip], list[str]]:
    """The clips of a folder, or of a store's split ("all" for every one), by name; and what was left out.

    speech: where the sounds lie, beside the motion when not told. only: names to read (None: all). InputError for a
    file that cannot be read, and for a speech folder that is none.
    """
    if speech is not None and not speech.is_dir():
        raise InputError(speech, "is not a folder", f"name one that holds NAME{' or NAME'.join(SOUNDS)}")
    clips = {}
    if (folder / STORE).is_file():
        store = Store.open(folder)
        for info in _chosen(store, split):
            if only is None or info.name in only:
                recording = store.load(info.name)
                clips[info.name] = Clip(info.name, recording.motion, replace(recording.speech, speaker=info.speaker),
                                        info.group or info.name)
        return clips, []
    files, notes = find_motions(folder)
    for name, file in files.items():
        if only is None or name in only:
            sound = find_sound(speech or folder, name)
            clips[name] = Clip(name, read_motion(file), load_speech(sound) if sound else None, name)
    return clips, notes


def _chosen(store: Store, split: str) -> list[RecordingInfo]:
    return list(store.recordings if split == "all" else store.of_split(cast(Split, split)))


# ---------------------------------------------------------------------------------------------------- files

def read_motion(path: Path, fps: float | None = None, fingers: bool = False) -> Motion:
    """Any of `MOTIONS` on the 16-joint character; with its fingers, where it has some and they are asked for.

    fps: as told by the user, else by NAME.json, else by the file.
    """
    kind = path.suffix.lower()
    if kind not in MOTIONS:
        raise InputError(path, "is not a known motion format", f"give one of {', '.join(MOTIONS)}")
    if kind == ".npy":
        return read_positions(path, fps)
    rate = fps if fps is not None else _rate(sidecar(path), path)
    with warnings.catch_warnings():
        # A rate that is told answers the warning of a header that contradicts itself.
        warnings.simplefilter("ignore", BvhWarning)
        try:
            motion = read_bvh(path, fps=rate) if kind == ".bvh" else read_smplx(path, fps=rate)
            whole = to_character(motion, skeleton=FINGERED) if fingers else None
            if whole is not None and not set(FINGER_JOINTS) & set(whole.absent):
                return whole
            return to_character(motion)
        except InputError as error:
            advice = _RATE_ADVICE if error.advice == FRAME_RATE_ADVICE else error.advice
            # A skeleton is known by its joints alone, and a user by the file.
            subject = path if error.subject == "skeleton" else error.subject
            raise InputError(subject, error.wrong, advice) from None


def sidecar(path: Path) -> dict[str, Any]:
    """The content of NAME.json, else of joints.json, beside a motion file; empty without either."""
    for place in (path.with_suffix(".json"), path.with_name(SHARED)):
        if place.is_file():
            document = read_json(place, "repair it")
            if isinstance(document, dict):
                return document
    return {}


def _rate(document: dict[str, Any], path: Path) -> float | None:
    rate = document.get("fps")
    if rate is None:
        return None
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 < rate < 1000:
        raise InputError(path.with_suffix(".json"), f"tells a frame rate of {shown(rate)!r}",
                         "give frames a second")
    return float(rate)


def read_positions(path: Path, fps: float | None = None) -> Motion:
    """Positions [T, J, 3] as motion of the 16-joint character (see the chapter's head).

    InputError for a file or a sidecar that is missing or says something else.
    """
    document, beside = sidecar(path), path.with_suffix(".json")
    names, rate = document.get("joints"), fps if fps is not None else _rate(document, path)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or rate is None:
        raise InputError(beside, "does not name joints and fps", 'write {"joints": [...], "fps": ..., "up": "+Y"}')
    up = document.get("up", "+Y")
    if not isinstance(up, str) or up not in _UP:
        raise InputError(beside, f"has up {shown(up)!r}", f"choose among {', '.join(_UP)}")
    points = read_npy(path)
    if points.dtype.kind not in "fiu" or points.shape[1:] != (len(names), 3) or len(points) == 0:
        raise InputError(path, f"has {points.dtype} of shape {points.shape}, and its sidecar names {len(names)} joints",
                         f"it should be numbers, [T, {len(names)}, 3]")
    points = as_floats(points)
    # NaN fails the comparison, too. Joints in one place have no bones.
    if not (np.abs(points) < _FARTHEST).all() or not (len(names) < 2 or (np.ptp(points, axis=1) > _EPS).any(1).all()):
        raise InputError(path, "has positions that are not numbers, far too large or all in one place",
                         "fill or cut these frames")
    try:
        return from_positions(points @ _UP[up].T, names, rate)
    except InputError as error:
        raise InputError(beside, error.wrong, error.advice) from None


def from_positions(points: Array, names: Sequence[str], fps: float) -> Motion:
    """Motion of the 16-joint character from points [T, J, 3] of named joints, Y up, facing anywhere."""
    # Names may carry a prefix of the tool that wrote them, such as mixamorig:.
    plain = {name.rsplit(":", 1)[-1].lower(): k for k, name in enumerate(names)}
    if all(joint in plain for joint in TED_JOINTS):
        ten = points[:, [plain[joint] for joint in TED_JOINTS]]
        return rotations_from_positions(_faced(ten, ten[:, 4] - ten[:, 7], plain, points), fps)
    table = find_table(names)
    spine = next(table[joint] for joint in ("Spine2", "Spine1", "Spine") if joint in table)
    arms = [table[side + joint] for side in ("Left", "Right") for joint in ("Arm", "ForeArm", "Hand")]
    # Two points of the head tell its turn; one tells only where it leans.
    nose = next((plain[name] for name in _NOSES if name in plain), None)
    crown = next((plain[name] for name in _CROWNS if name in plain), None)
    across = points[:, table["LeftArm"]] - points[:, table["RightArm"]]
    if nose is None or crown is None:
        head = _resting_head(points[:, table["Neck"]], points[:, table["Head"]], across)
    else:
        head = points[:, [nose, crown]]
    ten = np.concatenate([points[:, [spine, table["Neck"]]], head, points[:, arms]], axis=1)
    motion = rotations_from_positions(_faced(ten, across, plain, points), fps)
    if nose is not None and crown is not None:
        return motion
    # Of a head without a face no turn is known: it holds the identity and is masked.
    motion.rotations[:, CHARACTER.index("Head")] = (1.0, 0.0, 0.0, 0.0)
    return replace(motion, absent=(*motion.absent, "Head"))


def _faced(ten: Array, across: Array, plain: dict[str, int], points: Array) -> Array:
    """The ten points turned about the vertical so that the hips, else the shoulders on the whole, lie along X."""
    pair = next((pair for pair in _HIP_JOINTS if pair[0] in plain and pair[1] in plain), None)
    line = across.mean(axis=0, keepdims=True) if pair is None else points[:, plain[pair[0]]] - points[:, plain[pair[1]]]
    # A line without a length has the angle 0, which keeps the frame as it is.
    half = np.unwrap(np.arctan2(line[:, 2], line[:, 0])) / 2
    turn = np.zeros((len(ten), 1, 4))
    turn[:, 0, 0], turn[:, 0, 2] = np.cos(half), np.sin(half)
    return rotation.rotate(turn, ten)


def _resting_head(neck: Array, head: Array, across: Array) -> Array:
    """[T, 2, 3] where nose and crown would be if the head kept its resting place on the neck, in metres."""
    rest = ted_positions(Motion(CHARACTER, np.tile([1.0, 0, 0, 0], (1, len(CHARACTER), 1)), np.zeros((1, 3)), 1.0))[0]
    # Where nose and crown are at rest, carried along with the neck.
    up = CHARACTER.offsets[CHARACTER.index("Neck1")] + CHARACTER.offsets[CHARACTER.index("Head")]
    resting = _frames(up[None], np.array([[1.0, 0.0, 0.0]]))[0]
    turned = _frames(head - neck, across) @ resting.T
    offsets = rest[[2, 3]] - rest[1]
    places: Array = neck[:, None] + np.einsum("tij,kj->tki", turned, offsets)
    return places


def _frames(along: Array, across: Array) -> Array:
    """[T, 3, 3] orthonormal columns: along, what of across is at right angles to it, and their product."""
    first = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), _EPS)
    # Gram and Schmidt: what is left of across at a right angle to along.
    second = across - np.sum(across * first, axis=-1, keepdims=True) * first
    second = second / np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), _EPS)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def named(entries: Sequence[str], what: str) -> dict[str, str]:
    """NAME=VALUE ... as a table; InputError for one that is not, or a name that comes twice."""
    table: dict[str, str] = {}
    for entry in entries:
        name, mark, value = entry.partition("=")
        if not (name and mark and value):
            raise InputError(f"{what} {entry}", "is not of the form NAME=VALUE", "name it: ours=DIR")
        if name in table:
            raise InputError(f"{what} {entry}", "has a name that was given before", "choose another")
        table[name] = value
    return table
