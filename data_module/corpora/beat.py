"""BEAT: speech and BVH of 30 speakers in four languages, with word times.

DIR is `beat_english_v0.2.1` (or that of another language), a folder per speaker number:

    2/2_scott_0_1_1.bvh     centimetres, 120 fps    ID_NAME_RECORD_START_END
    2/2_scott_0_1_1.wav     16 kHz
    2/2_scott_0_1_1.TextGrid                        optional: words and their times

The split is the published one of the English part, in which some recordings of the one-hour speakers are halved: the
first half tests, the second validates.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_module.corpora.base import DroppedError, Imported, Item, Options, needed, split_of, trimmed
from data_module.corpora.takes import Take, find_takes, read_motion, with_text
from data_module.errors import InputError
from data_module.motion.bvh import CENTIMETRES, BvhWarning
from data_module.speech.audio import load_speech
from data_module.store import RecordingInfo, Split
from data_module.types import Motion, Word

NAME = re.compile(r"(?P<id>\d{1,9})_(?P<name>[A-Za-z]{1,40})_(?P<record>[0-7])_(?P<start>\d{1,9})_(?P<end>\d{1,9})")
LANGUAGES = ("en", "zh", "es", "ja")
"""Recording types come in pairs, speech and conversation, in this order of languages."""

FOUR_HOURS = frozenset({1, 2, 3, 4, 6, 7, 8, 9, 11, 21})
"""Speaker numbers with four hours each; the others have one. The split differs."""
_EMOTIONS_BEGIN = (65, 73, 81, 87, 95, 103, 111)
_EMOTIONS_END = (72, 80, 86, 94, 102, 110, 118)


def published_split(name: str) -> dict[str, Split] | None:
    """The halves of a recording ('' the whole) -> their published split, by the number of the sequence; None if
    unknown. It is known for English only (recording types 0 and 1)."""
    fields = NAME.fullmatch(name)
    if fields is None or fields["record"] not in "01":
        return None
    numbers = range(int(fields["start"]), int(fields["end"]) + 1)
    rules = [_rule(number, fields["record"] == "1", int(fields["id"]) in FOUR_HOURS) for number in numbers]
    # A file of several sequences (version 0.1) is in a split when all of them are.
    same = bool(rules) and all(rule == rules[0] for rule in rules)
    # A half belongs to one sequence; of a file with several it would be unclear whose half it is.
    return rules[0] if same and ("" in rules[0] or len(rules) == 1) else None


def _rule(number: int, talk: bool, many: bool) -> dict[str, Split]:
    # Sequences 1 to 64 are neutral, 65 to 118 seven emotions, each with a first and a last sequence.
    if many:
        tests = {1} if talk else {*range(1, 9), *_EMOTIONS_BEGIN}
        checks = {12} if talk else {*range(57, 65), *_EMOTIONS_END}
        return {"": "test" if number in tests else "val" if number in checks else "train"}
    if number in ({1} if talk else set(_EMOTIONS_BEGIN)):
        return {"a": "test", "b": "val"}
    if talk or number > 8:
        return {"": "train"}
    return {"": "test" if number <= 4 else "val"}


def info_of(name: str, split: Split, half: str = "") -> RecordingInfo:
    """The info in the name ID_NAME_RECORD_START_END; read speech of one text is one group over all speakers."""
    fields = NAME.fullmatch(name)
    if fields is None:
        raise ValueError(f"{name} is not named ID_NAME_RECORD_START_END")
    record = int(fields["record"])
    speaker = f"{fields['id']}_{fields['name']}"
    # Speech was read from texts that all speakers share; a conversation is a speaker's own.
    group = name if record % 2 else f"{record}_{fields['start']}_{fields['end']}"
    return RecordingInfo(name + ("_" + half if half else ""), split, speaker, speaker, LANGUAGES[record // 2],
                         group=group)


class Beat:
    """A reader of BEAT."""

    licence = "CC BY-NC 4.0 (BEAT): not for commercial use, nor are weights trained on it"

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, "name the folder that holds BEAT's folders of speakers")
        self._options = options
        takes, self._notes = find_takes(source, NAME, texts=(".textgrid",))
        self._takes: dict[str, Take] = {name: takes[name] for name in sorted(takes, key=_order)}
        if not self._takes:
            raise InputError(source, "holds no ID_NAME_RECORD_START_END.bvh with a .wav of the same name",
                             "name BEAT's folder beat_english_v0.2.1")
        self._notes += [f"left out {file}: is not named ID_NAME_RECORD_START_END"
                        for file in sorted(source.rglob("*.bvh")) if not NAME.fullmatch(file.stem)]
        unknown = sum(published_split(name) is None for name in self._takes)
        if unknown:
            self._notes.append(f"{unknown} recordings are in no published split: they are split by their order")

    def settings(self) -> Mapping[str, Any]:
        return {"files": {name: take.sizes() for name, take in self._takes.items()}, "motion_fps": self._options.fps,
                "unit": self._options.unit}

    def items(self) -> Sequence[Item]:
        items: list[Item] = []
        for place, (name, take) in enumerate(self._takes.items()):
            halves = published_split(name) or {"": split_of(place)}
            for half, split in halves.items():
                # Both halves read the whole take, so each counts as half of its work.
                items.append(Item(info_of(name, split, half), len(items), (name, half),
                                  sum(take.sizes()) / len(halves)))
        return items

    def read(self, item: Item) -> Imported:
        name, half = item.content
        take = self._takes[name]
        try:
            motion, unit = self._motion(take.motion)
            speech, timing = replace(load_speech(take.sound), speaker=item.info.speaker), ""
            if take.text is not None:
                speech, timing = with_text(speech, take.text)
        except InputError as error:
            raise DroppedError(str(error)) from None
        return halved(Imported(item.info, speech, motion, unit=unit, words=timing), half)

    def notes(self) -> Sequence[str]:
        return self._notes

    def _motion(self, path: Path) -> tuple[Motion, str]:
        """--fps applies only to files whose header contradicts itself, as some published ones do."""
        try:
            # The header is right in most files: a rate given for the broken ones must not slow down the others.
            return read_motion(path, replace(self._options, fps=None), CENTIMETRES)
        except InputError as error:
            if "its header says" not in error.wrong:
                raise
            if self._options.fps is None:
                raise InputError(error.subject, error.wrong, "give its true rate with --fps") from None
            warnings.warn(f"{path}: {error.wrong}; read at {self._options.fps:g} fps", BvhWarning, stacklevel=2)
        return read_motion(path, self._options, CENTIMETRES)


def halved(recording: Imported, half: str) -> Imported:
    if not half:
        return recording
    speech, motion = trimmed(recording.speech, recording.motion)
    # Cut at a frame, so that sound and motion of each half still begin together.
    middle = len(motion) // 2
    if half == "a":
        speech, motion = trimmed(speech, motion.crop(0, middle))
        return replace(recording, speech=speech, motion=motion)
    start = middle / motion.fps
    words = speech.words
    if words is not None:
        # A word that begins before the middle belongs to the first half, even where it ends after it.
        words = tuple(Word(w.text, w.start - start, w.end - start) for w in words if w.start >= start)
    speech = replace(speech, samples=speech.samples[round(start * speech.sample_rate):], words=words)
    return replace(recording, speech=speech, motion=motion.crop(middle, len(motion)))


def _order(name: str) -> tuple[int, ...]:
    fields = NAME.fullmatch(name)
    return tuple(int(fields[part]) for part in ("id", "record", "start", "end")) if fields else ()
