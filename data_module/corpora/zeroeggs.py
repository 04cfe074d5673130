"""ZeroEGGS: monologues of one actress in 19 styles, speech and motion without text.

DIR is the `data` folder of the release, or its `clean` folder, in which sound and motion begin and end together:

    info.csv                                optional: the published list, whose column `validation` is the split
    clean/001_Neutral_0_x_1_0.bvh           centimetres, 60 fps     NUMBER_STYLE_TAKE_x_1_0
    clean/001_Neutral_0_x_1_0.wav

The published split has training and validation only. Its validation part is divided here between validation and test,
every other recording, so that the training part is the published one. Mirrored and time-stretched copies, which the
authors also use for training, are left out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from data_module.corpora.base import Imported, Item, Options, needed
from data_module.corpora.takes import find_takes, read_take
from data_module.errors import InputError
from data_module.files import read_table
from data_module.motion.bvh import CENTIMETRES
from data_module.store import RecordingInfo, Split

FPS = 60.0
HELD_OUT = frozenset({5, 10, 15, 20, 25, 29, 33, 35, 38, 41, 44, 47, 50, 53, 56, 58, 61, 64, 65, 66, 67})
"""Numbers of the recordings that the published list holds out, used if the list is missing."""
RECORDINGS = 67

_NAME = re.compile(r"(?P<number>\d{3})_[A-Za-z]+_\d+_x_1_0")
_COPY = re.compile(r"\d{3}_[A-Za-z]+_\d+(_mirror_x_\d+_\d+|_x_(?!1_0$)\d+_\d+)")


class ZeroEggs:
    """A reader of the ZeroEGGS data."""

    licence = "CC BY-NC-ND 4.0 (ZeroEGGS): not for commercial use, nor are weights trained on it, and not to be shared"

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, "name ZeroEGGS's folder data, which holds clean/")
        self._options = options
        clean = source / "clean" if (source / "clean").is_dir() else source
        self._takes, self._notes = find_takes(clean, _NAME)
        if not self._takes:
            raise InputError(clean, "holds no NUMBER_STYLE_TAKE_x_1_0.bvh with a .wav of the same name",
                             "name ZeroEGGS's folder data, which holds clean/")
        # The release has no text, so its absence is not reported.
        self._notes = [note for note in self._notes if not note.endswith("its words are unknown")]
        if not any(take.text for take in self._takes.values()):
            self._notes.append("words are unknown: the release has none (put NAME.txt or .TextGrid beside NAME.wav)")
        copies = sum(_COPY.fullmatch(file.stem) is not None for file in clean.rglob("*.bvh"))
        if copies:
            self._notes.append(f"left out {copies} mirrored or time-stretched copies")
        listed = next((file for file in (source / "info.csv", clean.parent / "info.csv") if file.is_file()), None)
        held = HELD_OUT if listed is None else _held_out(listed)
        if listed is None:
            self._notes.append(f"{source / 'info.csv'} is missing: the split is the published one, by number")
        self._splits: dict[int, Split] = {number: "val" if place % 2 else "test"
                                          for place, number in enumerate(sorted(held))}
        self._notes.append("published as validation, divided here between val and test: "
                           f"{', '.join(f'{number:03d}' for number in sorted(held))}")
        absent = sorted(set(range(1, RECORDINGS + 1)) - {_number(name) for name in self._takes})
        if absent:
            self._notes.append(f"not there: {', '.join(f'{number:03d}' for number in absent)}")

    def settings(self) -> Mapping[str, Any]:
        return {"files": {name: [self._split(name), *take.sizes()] for name, take in self._takes.items()},
                "motion_fps": self._options.fps, "unit": self._options.unit}

    def items(self) -> Sequence[Item]:
        return [Item(RecordingInfo(name, self._split(name), "zeroeggs", "zeroeggs", "en", group=name), index,
                     size=sum(take.sizes())) for index, (name, take) in enumerate(self._takes.items())]

    def read(self, item: Item) -> Imported:
        return read_take(item.info, self._takes[item.info.name], self._options, unit=CENTIMETRES, fps=FPS)

    def notes(self) -> Sequence[str]:
        return self._notes

    def _split(self, name: str) -> Split:
        return self._splits.get(_number(name), "train")


def _number(name: str) -> int:
    return int(name[:3])


def _held_out(path: Path) -> frozenset[int]:
    """Numbers of the recordings that info.csv marks TRUE in its column `validation`."""
    rows = [(row.get("anim_bvh") or "", (row.get("validation") or "").strip().upper())
            for _, row in read_table(path, "fetch it again")]
    wrong = [name or marked or "an empty line" for name, marked in rows
             if not re.match(r"\d{3}_", name) or marked not in ("TRUE", "FALSE")]
    if wrong or not rows:
        raise InputError(path, f"has invalid entries ({', '.join(wrong[:3])})" if wrong else "is empty",
                         "its columns are anim_bvh and validation, among others")
    return frozenset(_number(name) for name, marked in rows if marked == "TRUE")
