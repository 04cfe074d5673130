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
from pathlib import Path

from data_module.corpora.base import Options, needed
from data_module.corpora.takes import Take, TakeReader, find_takes
from data_module.errors import InputError
from data_module.store import SPLITS, RecordingInfo, Split

TEST = frozenset({"speaker01_clip04", "speaker02_clip07", "speaker03_clip07", "speaker03_clip08", "speaker04_clip05",
                  "speaker05_clip06"})
"""The test recordings, unless folders name the split."""

_NAME = re.compile(r"speaker\d{2}_clip\d{2}")
_FOLDERS = {".bvh": "Motion", ".wav": "Audio", ".srt": "Text"}
_SPLIT_FOLDER = re.compile(r"(?P<split>train|val|test)(ing|id|idation)?([_ -]?(data|set))?", re.IGNORECASE)


class Mocca(TakeReader):
    """A reader of the MOCCA gesture data."""

    licence = "that of the MOCCA Gesture Dataset (research, on its licence agreement); weights trained on it likewise"

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, "name the folder that MOCCA was unpacked into")
        takes, notes = find_takes(source, _NAME, texts=(".srt", ".textgrid", ".json", ".vtt"), folders=_FOLDERS)
        if not takes:
            raise InputError(source, "holds no speakerNN_clipNN.bvh with a .wav of the same name",
                             "name the folder that MOCCA was unpacked into")
        # The published split is not in the files; folders that the user named after splits are the better source.
        named = {name: _folder_split(source, take) for name, take in takes.items()}
        if None in named.values():
            notes.append("the test recordings are not published: here "
                         + ", ".join(sorted(TEST & set(takes)) or ["none that is there"]))
        infos = []
        for name, split in named.items():
            speaker = name.partition("_")[0]
            infos.append(RecordingInfo(name, split or ("test" if name in TEST else "train"), speaker, speaker, "zh",
                                       group=name))
        super().__init__(options, takes, infos, notes)


def _folder_split(source: Path, take: Take) -> Split | None:
    """The split named by a folder between DIR and the motion file, the innermost first."""
    for part in reversed(take.motion.relative_to(source).parts[:-1]):
        match = _SPLIT_FOLDER.fullmatch(part)
        if match is not None:
            return next(split for split in SPLITS if split == match["split"].lower())
    return None
