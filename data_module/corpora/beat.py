"""BEAT: speech and BVH of 30 speakers in four languages, with word times.

DIR is `beat_english_v0.2.1` (or that of another language), a folder per speaker number:

    2/2_scott_0_1_1.bvh     centimetres, 120 fps    ID_NAME_RECORD_START_END
    2/2_scott_0_1_1.wav     16 kHz
    2/2_scott_0_1_1.TextGrid                        optional: words and their times

The split is the published one of the English part. Some recordings of the one-hour speakers are halved there, the first
half for test and the second for validation; here all of them are for test.
"""

import re
import warnings
from dataclasses import replace
from pathlib import Path

from data_module.corpora.base import DroppedError, Imported, Item, Options, needed, split_of
from data_module.corpora.takes import TakeReader, find_takes, read_take
from data_module.motion.bvh import CENTIMETRES, BvhWarning
from data_module.store import RecordingInfo, Split

NAME = re.compile(r"(?P<id>\d{1,9})_(?P<name>[A-Za-z]{1,40})_(?P<record>[0-7])_(?P<start>\d{1,9})_(?P<end>\d{1,9})")
LANGUAGES = ("en", "zh", "es", "ja")
"""Recording types come in pairs, speech and conversation, in this order of languages."""

FOUR_HOURS = frozenset({1, 2, 3, 4, 6, 7, 8, 9, 11, 21})
"""Speaker numbers with four hours each; the others have one. The split differs."""
_ADVICE = "name BEAT's folder beat_english_v0.2.1"
_EMOTIONS_BEGIN = (65, 73, 81, 87, 95, 103, 111)
_EMOTIONS_END = (72, 80, 86, 94, 102, 110, 118)


def published_split(name: str) -> Split | None:
    """The published split of a recording by the number of its sequence; None if unknown. It is known for English only
    (recording types 0 and 1)."""
    fields = NAME.fullmatch(name)
    if fields is None or fields["record"] not in "01":
        return None
    numbers = range(int(fields["start"]), int(fields["end"]) + 1)
    splits = {_split(number, fields["record"] == "1", int(fields["id"]) in FOUR_HOURS) for number in numbers}
    # A file of several sequences (version 0.1) is in a split when all of them are.
    return splits.pop() if len(splits) == 1 else None


def _split(number: int, talk: bool, many: bool) -> Split:
    # Sequences 1 to 64 are neutral, 65 to 118 seven emotions, each with a first and a last sequence.
    if talk:
        tests, checks = {1}, {12} if many else set()
    elif many:
        tests, checks = {*range(1, 9), *_EMOTIONS_BEGIN}, {*range(57, 65), *_EMOTIONS_END}
    else:
        tests, checks = {*range(1, 5), *_EMOTIONS_BEGIN}, {*range(5, 9)}
    return "test" if number in tests else "val" if number in checks else "train"


def info_of(name: str, split: Split) -> RecordingInfo:
    """The info in the name ID_NAME_RECORD_START_END; read speech of one text is one group over all speakers."""
    fields = NAME.fullmatch(name)
    if fields is None:
        raise ValueError(f"{name} is not named ID_NAME_RECORD_START_END")
    record = int(fields["record"])
    speaker = f"{fields['id']}_{fields['name']}"
    # Speech was read from texts that all speakers share; a conversation is a speaker's own.
    group = name if record % 2 else f"{record}_{fields['start']}_{fields['end']}"
    return RecordingInfo(name, split, speaker, speaker, LANGUAGES[record // 2], group=group)


class Beat(TakeReader):
    """A reader of BEAT."""

    licence = "CC BY-NC 4.0 (BEAT): not for commercial use, nor are weights trained on it"
    unit = CENTIMETRES

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, _ADVICE)
        takes, notes = find_takes(source, NAME, "ID_NAME_RECORD_START_END", _ADVICE, texts=(".textgrid",))
        notes += [f"left out {file}: is not named ID_NAME_RECORD_START_END"
                  for file in sorted(source.rglob("*.bvh")) if not NAME.fullmatch(file.stem)]
        unknown = sum(published_split(name) is None for name in takes)
        if unknown:
            notes.append(f"{unknown} recordings are in no published split: they are split by their order")
        super().__init__(options, takes, [info_of(name, published_split(name) or split_of(place))
                                          for place, name in enumerate(sorted(takes, key=_order))], notes)

    def read(self, item: Item) -> Imported:
        """See `Reader.read`. --fps applies only to files whose header contradicts itself, as some published ones do."""
        take, options = self._takes[item.info.name], self._options
        try:
            # The header is right in most files: a rate given for the broken ones must not slow down the others.
            return read_take(item.info, take, replace(options, fps=None), self.unit)
        except DroppedError as error:
            if options.fps is None or "its header says" not in str(error):
                raise
            warnings.warn(f"{error}; read at {options.fps:g} fps", BvhWarning, stacklevel=2)
        return read_take(item.info, take, options, self.unit)


def _order(name: str) -> tuple[int, ...]:
    fields = NAME.fullmatch(name)
    return tuple(int(fields[part]) for part in ("id", "record", "start", "end")) if fields else ()
