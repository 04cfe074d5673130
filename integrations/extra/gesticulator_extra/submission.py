"""`gesticulator submission`: motion for a folder of speech in the form of a public leaderboard.

Two forms. `beat2` is that of the GENEA leaderboard: SMPL-X as in BEAT2, one .npz a recording, 30 frames per second, no
face. `genea` is that of the GENEA challenges: BVH with the hierarchy, channels and frame rate of a file of the data
set, one file a recording. In both a file has the name of its recording and is as long as it.
"""

from __future__ import annotations

import argparse
import io
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError
from gesticulator.cli import Command

if TYPE_CHECKING:
    from data_module.types import Motion
    from gesticulator.performance import Performance

FORMS = {"beat2": ".npz", "genea": ".bvh"}
"""By form the suffix of its files."""
SOUNDS = (".wav", ".flac", ".mp3", ".ogg")
FPS = 30.0
"""Frames per second of BEAT2."""
LONGEST_HOLD = 0.25
"""Seconds that the last frame may be held for, where the motion ends before the sound by rounding."""


def arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("form", choices=tuple(FORMS), help="beat2: SMPL-X .npz as in BEAT2; genea: BVH like the data set's")
    p.add_argument("--speech", required=True, metavar="DIR", help="the recordings of the test set (BEAT2: wave16k)")
    p.add_argument("--out", required=True, metavar="DIR", help="folder of the motion, one file for each recording")
    p.add_argument("--like", metavar="PATH", help="genea: a .bvh file of the data set, required; beat2: its folder "
                   "smplxflame_30, whose lengths, body shapes and genders are then used")
    p.add_argument("--only", metavar="FILE", help="names of the recordings, one a line, or BEAT2's "
                   "train_test_split.csv, of which those listed as test are taken (default: every sound in --speech)")
    p.add_argument("--bundle", metavar="NAME|DIR", help="trained weights: default, paper, or a folder")
    p.add_argument("--text", metavar="DIR", help="transcripts with the names of the recordings")
    p.add_argument("--speaker", metavar="NAME", help="performer whose gesture style to use")
    p.add_argument("--interpreter", metavar="NAME", help="the model that chooses the lexemes")
    p.add_argument("--seed", type=int, default=0, metavar="N", help="random seed (default 0)")
    p.add_argument("--quiet", action="store_true", help="print no progress bar")


def recordings(folder: Path, only: Path | None) -> dict[str, Path]:
    """Sounds by name, in order; InputError where there is none, where two have one name, or where one is missing."""
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "name the folder of the recordings")
    sounds: dict[str, Path] = {}
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() in SOUNDS:
            if file.stem in sounds:
                raise InputError(file, f"has the name of {sounds[file.stem].name}", "keep one of them")
            sounds[file.stem] = file
    if only is not None:
        wanted = _names(only)
        missing = [name for name in wanted if name not in sounds]
        if missing:
            raise InputError(folder, f"lacks {len(missing)} of the recordings in {only.name}, such as {missing[0]}",
                             "complete it")
        sounds = {name: sounds[name] for name in wanted}
    if not sounds:
        raise InputError(folder, "holds no recordings", f"it should hold {', '.join(SOUNDS)} files")
    return sounds


def _names(path: Path) -> list[str]:
    """Names of a list, one a line; of a .csv with the columns id and type those listed as test."""
    from data_module.files import read_table, read_text

    if path.suffix.lower() == ".csv":
        names = [row.get("id") or "" for _, row in read_table(path, "give BEAT2's train_test_split.csv")
                 if row.get("type") == "test"]
    else:
        names = [line.strip() for line in read_text(path, "give a list of names").splitlines() if line.strip()]
    if not names or len(set(names)) != len(names):
        raise InputError(path, "names no recording, or one twice", "give one name a line")
    return names


def reference(form: str, like: str | None) -> Path | None:
    """What the files must be like; InputError where it is missing."""
    path = None if like is None else Path(like)
    if form == "genea" and (path is None or not path.is_file()):
        raise InputError("--like", "is needed for genea", "name a .bvh file of the data set")
    if form == "beat2" and path is not None and not path.is_dir():
        raise InputError(path, "is not a folder", "name BEAT2's smplxflame_30")
    return path


def fitted(motion: Motion, fps: float, frames: int) -> Motion:
    """The motion at `fps`, of exactly so many frames: cut, or its last frame held. InputError where much is missing."""
    import numpy as np

    from data_module.motion.kinematics import resample

    moved = resample(motion, fps)
    if frames - len(moved) > max(1.0, LONGEST_HOLD * fps):
        raise InputError("the motion", f"has {len(moved)} frames where {frames} are wanted",
                         "the reference is longer than the sound: give the sound that belongs to it")
    index = np.minimum(np.arange(frames), len(moved) - 1)
    return replace(moved, rotations=moved.rotations[index], root_positions=moved.root_positions[index])


def frames_for(seconds: float, fps: float) -> int:
    """Frames of a sound."""
    return max(1, round(seconds * fps))


def write_beat2(performance: Performance, path: Path, like: Path | None) -> None:
    """A recording as BEAT2's .npz, as long as the one of that name in `like`, with its body shape and gender."""
    import numpy as np

    from data_module.arrays import read_npz
    from data_module.files import write_bytes
    from data_module.motion.skeletons import standing
    from data_module.motion.smplx import smplx_arrays

    theirs = None if like is None else like / path.name
    known = {}
    if theirs is not None and theirs.is_file():
        known = read_npz(theirs, ("poses", "betas", "gender"), "fetch it again")
    frames = len(known["poses"]) if "poses" in known else frames_for(performance.duration, FPS)
    arrays = smplx_arrays(standing(fitted(performance.motion, FPS, frames)))
    arrays |= {name: known[name] for name in ("betas", "gender") if name in known}
    out = io.BytesIO()
    np.savez(out, **arrays)  # type: ignore[arg-type, unused-ignore]
    write_bytes(path, out.getvalue())


def write_genea(performance: Performance, path: Path, like: Path) -> None:
    """A recording as BVH with the hierarchy, channels and frame rate of `like`."""
    from data_module.motion.bvh import read_hierarchy

    fps = read_hierarchy(like)[0].fps
    moved = fitted(performance.motion, fps, frames_for(performance.duration, fps))
    replace(performance, motion=moved).on(like).save(path)


def make(args: argparse.Namespace, sounds: dict[str, Path], like: Path | None) -> None:
    """Gesture for each recording that has no file yet."""
    from tqdm import tqdm

    from gesticulator.gesticulator import Gesticulator

    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    system = Gesticulator.from_pretrained(args.bundle)
    chosen = {name: getattr(args, name) for name in ("speaker", "interpreter") if getattr(args, name) is not None}
    for name, sound in tqdm(sounds.items(), disable=args.quiet):
        path = out / f"{name}{FORMS[args.form]}"
        if path.exists():
            continue
        texts = sorted(Path(args.text).glob(f"{name}.*")) if args.text else []
        performance = system(sound, text=texts[0] if texts else None, seed=args.seed, **chosen)
        if args.form == "beat2":
            write_beat2(performance, path, like)
        elif like is not None:
            write_genea(performance, path, like)


def run(args: argparse.Namespace) -> int:
    """Make what is missing."""
    like = reference(args.form, args.like)
    sounds = recordings(Path(args.speech), None if args.only is None else Path(args.only))
    make(args, sounds, like)
    print(f"{len(sounds)} recordings in {args.out}")
    return 0


COMMAND = Command(
    "motion in the form of a public leaderboard", arguments, run,
    examples=(
        "submission beat2 --speech wave16k --like smplxflame_30 --only train_test_split.csv --out submission",
        "submission genea --speech test_wav --like data_set.bvh --out submission",
    ))
