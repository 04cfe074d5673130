"""Trinity Speech-Gesture as released for the GENEA Challenge 2020: one actor, speech, motion and word times.

DIR is `GENEA_Challenge_2020_data_release`, or a folder that holds it:

    Training_data/Audio/Recording_001.wav           Test_data/Audio/TestSeq001.wav
    Training_data/Motion/Recording_001.bvh          Test_data/Motion/TestSeq001.bvh         centimetres, 60 fps
    Training_data/Transcripts/Recording_001.json    Test_data/Transcripts/TestSeq001.json   optional

The split is that of RG's released configuration: Recording_008 for validation, the other 22 recordings for training,
the ten test sequences for test.
"""

import re
from pathlib import Path

from data_module.corpora.base import Options, needed
from data_module.corpora.takes import TakeReader, find_takes
from data_module.motion.bvh import CENTIMETRES
from data_module.store import RecordingInfo, Split

SPLIT: dict[str, Split] = {
    **{f"Recording_{number:03d}": "val" if number == 8 else "train" for number in range(1, 24)},
    **{f"TestSeq{number:03d}": "test" for number in range(1, 11)},
}
"""Every published recording and its split."""

_NAME = re.compile(r"Recording_\d{3}|TestSeq\d{3}")


class Trinity(TakeReader):
    """A reader of the GENEA 2020 release of Trinity Speech-Gesture."""

    licence = "that of Trinity Speech-Gesture (research, on a signed agreement); weights trained on it likewise"
    unit = CENTIMETRES

    def __init__(self, source: Path | None, options: Options) -> None:
        advice = "name the folder GENEA_Challenge_2020_data_release"
        takes, notes = find_takes(needed(source, advice), _NAME, "Recording_NNN.bvh or TestSeqNNN", advice,
                                  texts=(".json",))
        notes += [f"left out {takes[name].motion}: it is not a recording of the published split"
                  for name in takes if name not in SPLIT]
        infos = [RecordingInfo(name, split, "trinity", "trinity", "en", group=name) for name, split in SPLIT.items()
                 if name in takes]
        super().__init__(options, takes, infos, notes)
