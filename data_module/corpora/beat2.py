"""BEAT2: the recordings of BEAT with motion as SMPL-X, and a published split.

DIR is `beat_english_v2.0.0` (or that of another language):

    train_test_split.csv                    id,type: train, val, test or additional
    smplxflame_30/2_scott_0_1_1.npz         SMPL-X poses, 30 fps
    wave16k/2_scott_0_1_1.wav
    textgrid/2_scott_0_1_1.TextGrid         optional: words and their times
"""

from dataclasses import replace
from pathlib import Path

from data_module.corpora.base import Options, needed
from data_module.corpora.beat import NAME, info_of
from data_module.corpora.takes import Take, TakeReader
from data_module.errors import InputError
from data_module.files import read_table
from data_module.store import Split

_LIST = "train_test_split.csv"
_SPLITS: dict[str, Split] = {"train": "train", "val": "val", "test": "test", "additional": "train"}


class Beat2(TakeReader):
    """A reader of BEAT2. Recordings listed as additional are used for training."""

    licence = "CC BY-NC 4.0 (BEAT2): not for commercial use, nor are weights trained on it"

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, "name BEAT2's folder beat_english_v2.0.0")
        notes: list[str] = []
        takes: dict[str, Take] = {}
        # The published list decides what there is; files that are missing are noted, not an error.
        listed = _listed(source / _LIST)
        for name in listed:
            take = Take(source / "smplxflame_30" / f"{name}.npz", source / "wave16k" / f"{name}.wav",
                        source / "textgrid" / f"{name}.TextGrid")
            missing = [str(file) for file in (take.motion, take.sound) if not file.is_file()]
            if missing:
                notes.append(f"left out {name}: {' and '.join(missing)} missing")
                continue
            if take.text is not None and not take.text.is_file():
                notes.append(f"{name}: {take.text} is missing, so its words are unknown")
                take = replace(take, text=None)
            takes[name] = take
        if not takes:
            raise InputError(source, f"holds none of the recordings that {_LIST} lists",
                             "it should have smplxflame_30/ and wave16k/")
        if more := sum(listed[name] == "additional" for name in takes):
            notes.append(f"{more} recordings listed as additional are used for training")
        notes += [f"left out {file}: {_LIST} does not list it"
                  for file in sorted((source / "smplxflame_30").glob("*.npz")) if file.stem not in listed]
        super().__init__(options, takes, [info_of(name, _SPLITS[listed[name]]) for name in takes], notes)


def _listed(path: Path) -> dict[str, str]:
    """The recordings of the published list and their types."""
    if not path.exists():
        raise InputError(path, "does not exist", "--source is BEAT2's folder beat_english_v2.0.0")
    rows = [(row.get("id") or "", row.get("type") or "") for _, row in read_table(path, "fetch it again")]
    wrong = [name or kind or "an empty line" for name, kind in rows if kind not in _SPLITS or not NAME.fullmatch(name)]
    # A recording that is listed twice could be in two splits.
    if not rows or wrong or len({name for name, _ in rows}) != len(rows):
        raise InputError(path, f"has invalid entries ({', '.join(wrong[:3])})" if wrong else
                         "is empty or lists a recording twice", "its columns are id and type")
    return dict(rows)
