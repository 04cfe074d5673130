"""Trinity Speech-Gesture as released for the GENEA Challenge 2020: one actor, speech, motion and word times.

DIR is `GENEA_Challenge_2020_data_release`, or a folder that holds it:

    Training_data/Audio/Recording_001.wav           Test_data/Audio/TestSeq001.wav
    Training_data/Motion/Recording_001.bvh          Test_data/Motion/TestSeq001.bvh         centimetres, 60 fps
    Training_data/Transcripts/Recording_001.json    Test_data/Transcripts/TestSeq001.json   optional

The split is that of RG's released configuration: Recording_008 for validation, the other 22 recordings for training,
the ten test sequences for test.
"""

from __future__ import annotations

import re
from pathlib import Path

from data_module.corpora.base import DroppedError, Imported, Item, Options, needed
from data_module.corpora.takes import TakeReader, find_takes, read_take
from data_module.errors import InputError
from data_module.files import read_json
from data_module.motion.bvh import CENTIMETRES
from data_module.store import RecordingInfo, Split
from data_module.types import Word

SPLIT: dict[str, Split] = {
    **{f"Recording_{number:03d}": "val" if number == 8 else "train" for number in range(1, 24)},
    **{f"TestSeq{number:03d}": "test" for number in range(1, 11)},
}
"""Every published recording and its split."""

_NAME = re.compile(r"Recording_\d{3}|TestSeq\d{3}")
_FOLDERS = {".bvh": "Motion", ".wav": "Audio", ".json": "Transcripts"}
_TIME = re.compile(r"\d+(\.\d+)?s")


class Trinity(TakeReader):
    """A reader of the GENEA 2020 release of Trinity Speech-Gesture."""

    licence = "that of Trinity Speech-Gesture (research, on a signed agreement); weights trained on it likewise"
    unit, fps = CENTIMETRES, 60.0

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, "name the folder GENEA_Challenge_2020_data_release")
        takes, notes = find_takes(source, _NAME, texts=(".json",), folders=_FOLDERS)
        notes += [f"left out {takes[name].motion}: it is not a recording of the published split"
                  for name in takes if name not in SPLIT]
        infos = [RecordingInfo(name, split, "trinity", "trinity", "en", group=name) for name, split in SPLIT.items()
                 if name in takes]
        if not infos:
            raise InputError(source, "holds no Recording_NNN.bvh or TestSeqNNN.bvh with a .wav of the same name",
                             "name the folder GENEA_Challenge_2020_data_release")
        super().__init__(options, takes, infos, notes)

    def read(self, item: Item) -> Imported:
        """With the words of Google's recogniser, whose JSON no other reader takes."""
        take = self._takes[item.info.name]
        try:
            words = read_words(take.text) if take.text is not None else None
        except InputError as error:
            raise DroppedError(str(error)) from None
        return read_take(item.info, take, self._options, unit=self.unit, fps=self.fps, words=words)


def read_words(path: Path) -> tuple[Word, ...]:
    """The words of a transcript of Google's recogniser, with times such as "1.200s": either a list of segments, each
    with `alternatives` of which the first has `words`, or a plain list of words. `InputError` names the file and the
    place of an error."""
    content = read_json(path, "fetch it again")
    if not isinstance(content, list):
        raise InputError(path, "is not a list of words or segments", "fetch it again")
    words: list[Word] = []
    for place, entry in enumerate(content):
        try:
            # Only the first alternative: the others are less likely readings of the same sound.
            spoken = entry["alternatives"][0].get("words", []) if "alternatives" in entry else [entry]
            words += [Word(str(word["word"]), _seconds(word["start_time"]), _seconds(word["end_time"]))
                      for word in spoken]
        except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
            raise InputError(path, f"entry {place}: {error} (words have word, start_time and end_time)",
                             "fetch it again") from None
    # Segments of two channels may overlap, and words must be in order of time.
    words.sort(key=lambda word: word.start)
    return tuple(words)


def _seconds(time: object) -> float:
    if not isinstance(time, str) or not _TIME.fullmatch(time):
        raise ValueError(f"{str(time)[:30]!r} is not a time")
    return float(time[:-1])
