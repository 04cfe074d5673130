"""MOCCA: monologues in Chinese of five speakers, with subtitles (the Chinese data of RG, as released).

    speaker01_clip01.bvh    the unit is guessed
    speaker01_clip01.wav
    speaker01_clip01.srt    optional: Whisper's subtitles

The files are in one folder, or in `Motion`, `Audio` and others below DIR. The release has 24 recordings for training
and 6 for test, without saying which; here the last recordings of each speaker are for test.

The subtitles time whole utterances, some of them wrongly by seconds; the words of each are spread over its loud parts,
so they count as guessed. The hand-labelled gesture beats of speaker01 are a separate download of unpublished layout;
they are not imported.
"""

import re
from pathlib import Path

from data_module.corpora.base import Options, needed
from data_module.corpora.takes import TakeReader, find_takes
from data_module.store import RecordingInfo

TEST = frozenset({"speaker01_clip04", "speaker02_clip07", "speaker03_clip07", "speaker03_clip08", "speaker04_clip05",
                  "speaker05_clip06"})
"""The test recordings."""

_NAME = re.compile(r"speaker\d{2}_clip\d{2}")


class Mocca(TakeReader):
    """A reader of the MOCCA gesture data."""

    licence = "that of the MOCCA Gesture Dataset (research, on its licence agreement); weights trained on it likewise"

    def __init__(self, source: Path | None, options: Options) -> None:
        advice = "name the folder that MOCCA was unpacked into"
        takes, notes = find_takes(needed(source, advice), _NAME, "speakerNN_clipNN", advice,
                                  texts=(".srt", ".textgrid", ".json", ".vtt"))
        notes.append("the test recordings are not published: here "
                     + ", ".join(sorted(TEST & set(takes)) or ["none that is there"]))
        infos = []
        for name in takes:
            speaker = name.partition("_")[0]
            infos.append(RecordingInfo(name, "test" if name in TEST else "train", speaker, speaker, "zh", group=name))
        super().__init__(options, takes, infos, notes)
