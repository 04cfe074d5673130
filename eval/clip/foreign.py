"""Motion that others made, read so that it can be judged beside ours: BVH, SMPL-X, TED's joints; with its speech.

A folder holds one motion file for each clip, and, unless another folder is told, the speech under the same name:

- `NAME.bvh`: any rig whose joints have known names (`skeletons.NAME_TABLES`);
- `NAME.npz`: SMPL-X poses (`data_module.motion.smplx`);
- `NAME.points.npz`: positions [T, 3] by joint (`positions.POINTS`), Y up, facing +Z, at 60 fps;
- `NAME.npy`: positions [T, 10, 3] of TED's joints (`representation.TED_JOINTS`), Y up, in any unit, at 15 fps.

`{"fps": 25}` in NAME.json, or in motion.json for all files of the folder, goes before the rate of the files. All become
motion of the 16-joint character, so that bodies are not compared, only what they do. What that costs: of positions only
the directions of bones are known, no turn of a limb about its length. Nor do they say where the hips face: that is
taken from the shoulders over the whole clip.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from data_module.errors import InputError, shown
from data_module.files import read_json
from data_module.motion.bvh import FRAME_RATE_ADVICE, BvhWarning, read_bvh
from data_module.motion.skeletons import FINGER_JOINTS, FINGERED, to_character
from data_module.motion.smplx import read_smplx
from data_module.speech.audio import SOUNDS, load_speech
from data_module.store import Store
from data_module.types import Motion, Speech
from eval.clip.excerpts import evenly
from eval.clip.positions import read_points, read_positions

MOTIONS = (".bvh", ".npz", ".npy")
"""Endings of motion files; where a name has several, the first of these is read."""
SHARED, STORE = "motion.json", "store.json"
"""Files that tell the frame rate of a folder's motions, and that a folder is a store."""
TED_FPS, POINTS_FPS, POINTS = 15.0, 60.0, ".points"
"""Frames a second of positions, and how the name of a file ends, before its .npz, that holds them by joint."""
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
        name = file.stem.removesuffix(POINTS)
        if name in files:
            # One name, one motion: the order of `MOTIONS` decides, and the other file is named to the reader.
            notes.append(f"{file}: {files[name].name} is read instead")
        files.setdefault(name, file)
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
        return [info.name for info in evenly(Store.open(folder), split)]
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
        for info in evenly(store, split):
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


# ---------------------------------------------------------------------------------------------------- files

def read_motion(path: Path, fps: float | None = None, fingers: bool = False) -> Motion:
    """Any of `MOTIONS` on the 16-joint character; with its fingers, where it has some and they are asked for.

    fps: as told by the user, else by NAME.json, else by the file.
    """
    kind = path.suffix.lower()
    if kind not in MOTIONS:
        raise InputError(path, "is not a known motion format", f"give one of {', '.join(MOTIONS)}")
    rate = fps if fps is not None else told_rate(path)
    if kind == ".npy":
        return read_positions(path, TED_FPS if rate is None else rate)
    if path.stem.endswith(POINTS):
        return read_points(path, POINTS_FPS if rate is None else rate)
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


def told_rate(path: Path) -> float | None:
    """Frames a second by NAME.json, else motion.json, beside a motion file; None without either."""
    for place in (path.with_suffix(".json"), path.with_name(SHARED)):
        document = read_json(place, "repair it") if place.is_file() else None
        # A plan of that name may lie there, too.
        rate = document.get("fps") if isinstance(document, dict) else None
        if rate is not None and (type(rate) not in (int, float) or not 0 < rate < 1000):
            raise InputError(place, f"tells a frame rate of {shown(rate)!r}", "give frames a second")
        if rate is not None:
            return float(rate)
    return None


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
