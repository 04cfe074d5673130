"""BEAT2: the recordings of BEAT with motion as SMPL-X, and a published split.

DIR is `beat_english_v2.0.0` (or that of another language):

    train_test_split.csv                    id,type: train, val, test or additional
    smplxflame_30/2_scott_0_1_1.npz         SMPL-X poses, 30 fps
    wave16k/2_scott_0_1_1.wav
    textgrid/2_scott_0_1_1.TextGrid         optional: words and their times
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_module.corpora.base import DroppedError, Imported, Item, Options, needed
from data_module.corpora.beat import NAME, info_of
from data_module.corpora.takes import with_text
from data_module.errors import InputError
from data_module.files import read_table
from data_module.motion.smplx import read_smplx
from data_module.speech.audio import load_speech
from data_module.store import Split

_LIST = "train_test_split.csv"
_SPLITS: dict[str, Split] = {"train": "train", "val": "val", "test": "test", "additional": "train"}


class Beat2:
    """A reader of BEAT2. Recordings listed as additional are used for training."""

    licence = "CC BY-NC 4.0 (BEAT2): not for commercial use, nor are weights trained on it"

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, "name BEAT2's folder beat_english_v2.0.0")
        self._source, self._options = source, options
        self._notes: list[str] = []
        kinds: Counter[str] = Counter()
        self._splits: dict[str, Split] = {}
        # The published list decides what there is; files that are missing are noted, not an error.
        for name, kind in _listed(source / _LIST):
            missing = [file for file in self._files(name)[:2] if not file.is_file()]
            if missing:
                self._notes.append(f"left out {name}: {' and '.join(map(str, missing))} missing")
                continue
            if not self._files(name)[2].is_file():
                self._notes.append(f"{name}: {self._files(name)[2]} is missing, so its words are unknown")
            kinds[kind] += 1
            self._splits[name] = _SPLITS[kind]
        if not self._splits:
            raise InputError(source, f"holds none of the recordings that {_LIST} lists",
                             "it should have smplxflame_30/ and wave16k/")
        if kinds["additional"]:
            self._notes.append(f"{kinds['additional']} recordings listed as additional are used for training")
        self._notes += [f"left out {file}: {_LIST} does not list it"
                        for file in sorted((source / "smplxflame_30").glob("*.npz")) if file.stem not in self._splits
                        and not any(note.startswith(f"left out {file.stem}:") for note in self._notes)]

    def _files(self, name: str) -> tuple[Path, Path, Path]:
        return (self._source / "smplxflame_30" / f"{name}.npz", self._source / "wave16k" / f"{name}.wav",
                self._source / "textgrid" / f"{name}.TextGrid")

    def _sizes(self, name: str) -> list[int]:
        return [file.stat().st_size for file in self._files(name) if file.is_file()]

    def settings(self) -> Mapping[str, Any]:
        # The split is part of the settings, because an edited list gives another store.
        sizes = {name: [split, *self._sizes(name)] for name, split in self._splits.items()}
        return {"files": sizes, "motion_fps": self._options.fps}

    def items(self) -> Sequence[Item]:
        return [Item(info_of(name, split), place, size=sum(self._sizes(name)))
                for place, (name, split) in enumerate(self._splits.items())]

    def read(self, item: Item) -> Imported:
        poses, sound, textgrid = self._files(item.info.name)
        try:
            motion = read_smplx(poses, fps=self._options.fps)
            speech, timing = replace(load_speech(sound), speaker=item.info.speaker), ""
            if textgrid.is_file():
                speech, timing = with_text(speech, textgrid)
        except InputError as error:
            raise DroppedError(str(error)) from None
        return Imported(item.info, speech, motion, unit="1 m, as published", words=timing)

    def notes(self) -> Sequence[str]:
        return self._notes


def _listed(path: Path) -> list[tuple[str, str]]:
    """The recordings of the published list and their types."""
    if not path.exists():
        raise InputError(path, "does not exist", "--source is BEAT2's folder beat_english_v2.0.0")
    rows = [(row.get("id") or "", row.get("type") or "") for _, row in read_table(path, "fetch it again")]
    wrong = [name or kind or "an empty line" for name, kind in rows if kind not in _SPLITS or not NAME.fullmatch(name)]
    # A recording that is listed twice could be in two splits.
    if not rows or wrong or len({name for name, _ in rows}) != len(rows):
        raise InputError(path, f"has invalid entries ({', '.join(wrong[:3])})" if wrong else
                         "is empty or lists a recording twice", "its columns are id and type")
    return rows
