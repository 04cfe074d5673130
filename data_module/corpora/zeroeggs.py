"""ZeroEGGS: monologues of one actress in 19 styles, speech and motion without text.

DIR is the `data` folder of the release, or its `clean` folder, in which sound and motion begin and end together:

    clean/001_Neutral_0_x_1_0.bvh           centimetres, 60 fps     NUMBER_STYLE_TAKE_x_1_0
    clean/001_Neutral_0_x_1_0.wav

The published split has training and validation only. Its validation part is divided here between validation and test,
every other recording, so that the training part is the published one. Mirrored and time-stretched copies, which the
authors also use for training, are left out.
"""

import re
from pathlib import Path

from data_module.corpora.base import Options, needed
from data_module.corpora.takes import TakeReader, find_takes
from data_module.motion.bvh import CENTIMETRES
from data_module.store import RecordingInfo, Split

HELD_OUT = frozenset({5, 10, 15, 20, 25, 29, 33, 35, 38, 41, 44, 47, 50, 53, 56, 58, 61, 64, 65, 66, 67})
"""Numbers of the recordings that the published list (info.csv) holds out."""

_NAME = re.compile(r"(?P<number>\d{3})_[A-Za-z]+_\d+_x_1_0")


class ZeroEggs(TakeReader):
    """A reader of the ZeroEGGS data."""

    licence = "CC BY-NC-ND 4.0 (ZeroEGGS): not for commercial use, nor are weights trained on it, and not to be shared"
    unit = CENTIMETRES

    def __init__(self, source: Path | None, options: Options) -> None:
        advice = "name ZeroEGGS's folder data, which holds clean/"
        source = needed(source, advice)
        clean = source / "clean" if (source / "clean").is_dir() else source
        takes, notes = find_takes(clean, _NAME, "NUMBER_STYLE_TAKE_x_1_0", advice)
        # The release has no text, so its absence is not reported.
        notes = [note for note in notes if not note.endswith("its words are unknown")]
        if not any(take.text for take in takes.values()):
            notes.append("words are unknown: the release has none (put NAME.txt or .TextGrid beside NAME.wav)")
        notes.append("what was published as validation is divided between val and test")
        # Every other one, so that both parts have all styles.
        held = enumerate(sorted(HELD_OUT))
        splits: dict[int, Split] = {number: "val" if place % 2 else "test" for place, number in held}
        super().__init__(options, takes, [
            RecordingInfo(name, splits.get(int(name[:3]), "train"), "zeroeggs", "zeroeggs", "en", group=name)
            for name in takes], notes)
