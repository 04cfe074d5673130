"""MOCCA: monologues in Chinese of five speakers, with subtitles (the Chinese data of RG, as released).

    speaker01_clip01.bvh    the unit is guessed
    speaker01_clip01.wav
    speaker01_clip01.srt    optional: Whisper's subtitles

The files are in one folder, or in `Motion`, `Audio` and others below DIR. The release has 24 recordings for training
and 6 for test, without saying which. If a folder of the path is named accordingly (`Training_Data`, `Test_Data`), that
is the split; else the last recordings of each speaker are for test.

The subtitles time whole utterances, some of them wrongly by seconds; the words of each are spread over its loud parts,
so they count as guessed. The hand-labelled gesture beats of speaker01 are a separate download of unpublished layout;
they are not imported.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from data_module.corpora.base import Imported, Item, Options, needed
from data_module.corpora.takes import Take, find_takes, read_take
from data_module.errors import InputError
from data_module.store import RecordingInfo, Split

CLIPS = {"speaker01": 4, "speaker02": 7, "speaker03": 8, "speaker04": 5, "speaker05": 6}
"""Number of recordings of each speaker."""
TEST = frozenset({"speaker01_clip04", "speaker02_clip07", "speaker03_clip07", "speaker03_clip08", "speaker04_clip05",
                  "speaker05_clip06"})
"""The test recordings, unless folders name the split."""

_NAME = re.compile(r"speaker\d{2}_clip\d{2}")
_FOLDERS = {".bvh": "Motion", ".wav": "Audio", ".srt": "Text"}
_SPLIT_FOLDER = re.compile(r"(?P<split>train|val|test)(ing|id|idation)?([_ -]?(data|set))?", re.IGNORECASE)


class Mocca:
    """A reader of the MOCCA gesture data."""

    licence = "that of the MOCCA Gesture Dataset (research, on its licence agreement); weights trained on it likewise"

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, "name the folder that MOCCA was unpacked into")
        self._source, self._options = source, options
        self._takes, self._notes = find_takes(source, _NAME, texts=(".srt", ".textgrid", ".json", ".vtt"),
                                              folders=_FOLDERS)
        if not self._takes:
            raise InputError(source, "holds no speakerNN_clipNN.bvh with a .wav of the same name",
                             "name the folder that MOCCA was unpacked into")
        noted = " ".join(self._notes)
        absent = [name for speaker, clips in CLIPS.items() for clip in range(1, clips + 1)
                  if (name := f"{speaker}_clip{clip:02d}") not in self._takes and name not in noted]
        if absent:
            self._notes.append(f"not there: {', '.join(absent)}")
        texts = {take.text for take in self._takes.values()}
        self._notes += [f"left out {file}: no motion, sound or subtitles"
                        for file in sorted(source.rglob("speaker??_clip??*"))
                        if file.is_file() and file.suffix.lower() not in (".bvh", ".wav") and file not in texts]
        if any(self._folder_split(take) is None for take in self._takes.values()):
            self._notes.append("the test recordings are not published: here "
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
        """The split named by a folder between DIR and the motion file, the innermost first."""
        for part in reversed(take.motion.relative_to(self._source).parts[:-1]):
            match = _SPLIT_FOLDER.fullmatch(part)
            if match is not None:
                split: Split = "train" if match["split"].lower() == "train" else (
                    "val" if match["split"].lower() == "val" else "test")
                return split
        return None
