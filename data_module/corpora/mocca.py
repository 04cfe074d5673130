"""MOCCA: monologues in Chinese of five speakers, with subtitles (the Chinese data of RG, as released).

    speaker01_clip01.bvh    its unit is guessed
    speaker01_clip01.wav
    speaker01_clip01.srt    optional: Whisper's subtitles

They lie in one folder, or in `Motion`, `Audio` and any other below DIR. The release says that 24 of its 30 recordings
are trained on and 6 test, and not which. Where a folder of the path says so (`Training_Data`, `Test_Data`), that is
the split; else the last recordings of each speaker test.

The subtitles time whole utterances, and some of them wrongly by seconds; the words of each share out its loud parts,
so they count as guessed. The hand-labelled gesture beats of speaker01 come in a download of their own, whose layout is
not published; they are not imported.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from data_module.corpora.base import Imported, Item, Options
from data_module.corpora.takes import Take, find_takes, read_take
from data_module.errors import InputError
from data_module.store import RecordingInfo, Split

CLIPS = {"speaker01": 4, "speaker02": 7, "speaker03": 8, "speaker04": 5, "speaker05": 6}
"""How many recordings each speaker has."""
TEST = frozenset({"speaker01_clip04", "speaker02_clip07", "speaker03_clip07", "speaker03_clip08", "speaker04_clip05",
                  "speaker05_clip06"})
"""The recordings that test where no folder says which do."""

_NAME = re.compile(r"speaker\d{2}_clip\d{2}")
_FOLDERS = {".bvh": "Motion", ".wav": "Audio", ".srt": "Text"}
_SPLIT_FOLDER = re.compile(r"(?P<split>train|val|test)(ing|id|idation)?([_ -]?(data|set))?", re.IGNORECASE)


class Mocca:
    """A reader of the MOCCA gesture data."""

    licence = "that of the MOCCA Gesture Dataset (research, on its licence agreement); weights trained on it likewise"

    def __init__(self, source: Path | None, options: Options) -> None:
        if source is None:
            raise InputError("--source", "is missing", "name the folder that MOCCA was unpacked into")
        self._source, self._options = source, options
        self._takes, self._notes = find_takes(source, _NAME, texts=(".srt", ".textgrid", ".json", ".vtt"),
                                              folders=_FOLDERS)
        if not self._takes:
            raise InputError(source, "holds no speakerNN_clipNN.bvh with a .wav of the same name",
                             "name the folder that MOCCA was unpacked into")
        told = " ".join(self._notes)
        absent = [name for speaker, clips in CLIPS.items() for clip in range(1, clips + 1)
                  if (name := f"{speaker}_clip{clip:02d}") not in self._takes and name not in told]
        if absent:
            self._notes.append(f"not there: {', '.join(absent)}")
        texts = {take.text for take in self._takes.values()}
        self._notes += [f"left out {file}: no motion, sound or subtitles"
                        for file in sorted(source.rglob("speaker??_clip??*"))
                        if file.is_file() and file.suffix.lower() not in (".bvh", ".wav") and file not in texts]
        if any(self._folder_split(take) is None for take in self._takes.values()):
            self._notes.append("which recordings test is not published: here "
                               + ", ".join(sorted(TEST & set(self._takes)) or ["none that is there"]))

    def settings(self) -> Mapping[str, Any]:
        return {"files": {name: [self._split(name), *take.sizes()] for name, take in self._takes.items()},
                "motion_fps": self._options.fps, "unit": self._options.unit}

    def items(self) -> Sequence[Item]:
        items = []
        for index, (name, take) in enumerate(self._takes.items()):
            speaker = name.partition("_")[0]
            items.append(Item(RecordingInfo(name, self._split(name), speaker, speaker, "zh", group=name), index,
                              size=sum(take.sizes())))
        return items

    def read(self, item: Item) -> Imported:
        return read_take(item.info, self._takes[item.info.name], self._options)

    def notes(self) -> Sequence[str]:
        return self._notes

    def _split(self, name: str) -> Split:
        return self._folder_split(self._takes[name]) or ("test" if name in TEST else "train")

    def _folder_split(self, take: Take) -> Split | None:
        """The split that a folder between DIR and the motion file is named after, the innermost first."""
        for part in reversed(take.motion.relative_to(self._source).parts[:-1]):
            told = _SPLIT_FOLDER.fullmatch(part)
            if told is not None:
                split: Split = "train" if told["split"].lower() == "train" else (
                    "val" if told["split"].lower() == "val" else "test")
                return split
        return None
