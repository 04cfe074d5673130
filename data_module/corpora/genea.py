"""Talking With Hands as the GENEA challenges of 2022 and 2023 gave it: conversations of two, with fingers and words.

DIR is the folder of a release, or one that holds it:

    trn/bvh/trn_2022_v1_000.bvh                         2022; centimetres, 30 fps
    trn/wav/trn_2022_v1_000.wav
    trn/tsv/trn_2022_v1_000.tsv                         optional: start, end, word; seconds
    trn/trn_2022_v1_metadata.csv                        optional: name, fingers, speaker
    trn/main-agent/bvh/trn_2023_v0_000_main-agent.bvh   2023, wav and tsv likewise; the other person in interloctr/
    trn/metadata.csv                                    optional: name, then speaker and fingers of either person

The split is the published one: trn, val and tst. Fingers of recordings marked otherwise than `finger_incl` were not
measured; they are read as absent.
"""

import csv
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_module.corpora.base import Imported, Item, Options, needed
from data_module.corpora.takes import TakeReader, find_takes
from data_module.errors import InputError, shown
from data_module.files import read_text
from data_module.motion.bvh import CENTIMETRES
from data_module.motion.skeletons import FINGER_JOINTS, NAME_TABLES
from data_module.store import RecordingInfo, Split

_NAME = re.compile(r"(?P<take>(?P<split>trn|val|tst)_\d{4}_v\d+_\d+)(?:_(?:main-agent|interloctr))?")
_SPLITS: dict[str, Split] = {"trn": "train", "val": "val", "tst": "test"}
_FINGERS = frozenset(NAME_TABLES["genea"][joint] for joint in FINGER_JOINTS)


class Genea(TakeReader):
    """A reader of Talking With Hands in the layout of GENEA 2022 and 2023."""

    licence = "CC BY-NC 4.0 (Talking With Hands): not for commercial use, nor are weights trained on it"
    unit = CENTIMETRES

    def __init__(self, source: Path | None, options: Options) -> None:
        advice = "name the folder that holds GENEA's trn and val"
        source = needed(source, advice)
        takes, notes = find_takes(source, _NAME, "trn_2022_v1_NNN.bvh or trn_2023_v0_NNN_main-agent", advice,
                                  texts=(".tsv",))
        self._people = _people(source)
        unknown = [name for name in takes if name not in self._people]
        if unknown:
            notes.append(f"{len(unknown)} recordings are in no metadata.csv, so they count as of one speaker: "
                         f"{', '.join(unknown[:3])}")
        infos = []
        for name in takes:
            fields = _NAME.fullmatch(name)
            assert fields is not None
            speaker = f"speaker{self._people[name][0]}" if name in self._people else "unknown"
            # Both people of a conversation hear each other, so they belong in one part of a sample.
            infos.append(RecordingInfo(name, _SPLITS[fields["split"]], speaker, speaker, "en", group=fields["take"]))
        super().__init__(options, takes, infos, notes)

    def settings(self) -> Mapping[str, Any]:
        """See `Reader.settings`."""
        return {**super().settings(), "people": self._people}

    def read(self, item: Item) -> Imported:
        """See `Reader.read`."""
        recording = super().read(item)
        if self._people.get(item.info.name, ("", True))[1]:
            return recording
        absent = tuple(name for name in recording.motion.skeleton.names if name in _FINGERS)
        return replace(recording, motion=replace(recording.motion, absent=absent))


def _people(source: Path) -> dict[str, tuple[str, bool]]:
    """Recording -> its speaker and whether the fingers were measured, from all tables below `source`."""
    people: dict[str, tuple[str, bool]] = {}
    for file in sorted(source.rglob("*metadata.csv")):
        for number, row in enumerate(csv.reader(read_text(file, "unpack it again").splitlines()), 1):
            name, *rest = (field.strip() for field in row or ("",))
            # A line that begins otherwise is the head.
            if not _NAME.fullmatch(name):
                continue
            if len(rest) == 2:
                people[name] = (rest[1], rest[0] == "finger_incl")
            elif len(rest) == 4:
                people[f"{name}_main-agent"] = (rest[0], rest[1] == "finger_incl")
                people[f"{name}_interloctr"] = (rest[2], rest[3] == "finger_incl")
            else:
                raise InputError(file, f"line {number}: {shown(','.join(row))} is not a name with 2 or 4 fields",
                                 "unpack it again")
    return people
