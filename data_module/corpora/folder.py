"""Any folder of speech and BVH files of the same name, such as the data set that `build` writes.

`NAME.bvh` (any rig whose joints have known names) goes with `NAME.flac`, `.wav`, `.mp3` or `.ogg`. A transcript may be
`NAME.TextGrid`, `.json` (words with times), `.srt`, `.vtt` or `.txt` (plain); without one the words are unknown.
`NAME.json` may also give split, performer, voice, language, whether the performer stands in one place (`stands`) and
joints with synthetic motion (`filled`). Without it the split follows the order of the names, 80/10/10 or --split, and
the performer is the part of the names before the first "_" if several recordings share it, else the folder, or given by
--speaker.
"""

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from data_module.corpora.base import DroppedError, Imported, Item, Options, needed, spread
from data_module.corpora.takes import TEXTS, read_motion, with_text
from data_module.errors import InputError, shown
from data_module.files import read_json, read_text, write_text
from data_module.motion.bvh import write_bvh
from data_module.speech.audio import SOUNDS, load_speech
from data_module.store import SPLITS, Recording, RecordingInfo, Split
from data_module.types import Speech

DEFAULT_SPLIT = "80/10/10"
"""Percent for train, val and test."""
_SAID = ("words", "segments", "tiers", "text")
"""Keys of a JSON object with a transcript."""


@dataclass(frozen=True)
class FolderOptions(Options):
    """split: see `spread_by`; speaker: see `speakers_by`; both empty for the default."""

    split: str = ""
    speaker: str = ""


class Folder:
    """A reader of same-named speech and BVH files."""

    licence = "that of the source folder; ask its owner"

    @staticmethod
    def arguments(parser: argparse.ArgumentParser) -> None:
        """The options of a folder."""
        parser.add_argument("--split", default="", metavar="80/10/10|FILE",
                            help="percentages for training, validation and test (default 80/10/10, with at least one "
                            "recording in each if there are three), or a file with a line NAME,train|val|test per "
                            "recording")
        parser.add_argument("--speaker", default="", metavar="NAME|REGEX",
                            help="the speaker of every recording, or a pattern whose group matches it in the file "
                            "name, such as '^([a-z]+)' (default: the part before the first '_' if several recordings "
                            "share it, else the folder's name)")

    @staticmethod
    def options(arguments: argparse.Namespace) -> FolderOptions:
        """The options in parsed arguments."""
        return FolderOptions(arguments.fps, arguments.unit, split=arguments.split, speaker=arguments.speaker)

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, "name the folder that holds the BVH and sound files")
        self._source = source
        self._options = options if isinstance(options, FolderOptions) else FolderOptions(options.fps, options.unit)
        self._pairs: dict[str, tuple[Path, Path]] = {}
        self._alone: list[str] = []
        # Names with their suffix: a dot may be part of a recording's name.
        files = {file.name: file for file in sorted(source.iterdir()) if file.is_file()}
        texts = {(file.stem, file.suffix.lower()): file for file in files.values() if file.suffix.lower() in TEXTS}
        for name, file in files.items():
            if file.suffix.lower() != ".bvh":
                continue
            # The first of these kinds that is there: the lossless ones come first.
            sound = next((files[file.stem + suffix] for suffix in SOUNDS if file.stem + suffix in files), None)
            if sound is None:
                self._alone.append(name)
            else:
                self._pairs[file.stem] = (file, sound)
        self._texts = {name: tuple(texts[name, kind] for kind in TEXTS if (name, kind) in texts)
                       for name in self._pairs}
        if not self._pairs:
            raise InputError(source, "holds no BVH file with a sound file of the same name",
                             f"put NAME.bvh beside NAME{' or '.join(SOUNDS)}")
        self._infos = self._listed()

    def settings(self) -> Mapping[str, Any]:
        sizes = {name: [file.stat().st_size for file in (*pair, *self._texts[name])]
                 for name, pair in self._pairs.items()}
        return {"files": sizes, "motion_fps": self._options.fps, "unit": self._options.unit,
                "split": self._options.split or DEFAULT_SPLIT, "speaker": self._options.speaker}

    def items(self) -> Sequence[Item]:
        return [Item(info, index) for index, info in enumerate(self._infos)]

    def _listed(self) -> list[RecordingInfo]:
        beside = {name: self._fields(name) for name in self._pairs}
        # Only recordings without a split of their own are spread, so that a written split is never changed.
        open_ = [name for name in self._pairs if not beside[name].get("split")]
        splits = dict(zip(open_, spread_by(self._options.split, open_), strict=True))
        # Guessed from all names together: one name alone says nothing about which part is the speaker.
        speakers = speakers_by(self._options.speaker, list(self._pairs), self._source)
        infos = []
        for name, fields in beside.items():
            for key in ("split", "performer", "voice", "language", "group"):
                if not isinstance(fields.get(key) or "", str):
                    raise InputError(self._source / f"{name}.json", f"has {key} {shown(fields[key])!r}",
                                     "write a text there")
            speaker = fields.get("performer") or speakers[name]
            infos.append(RecordingInfo(name, fields.get("split") or splits[name], speaker,
                                       fields.get("voice") or speaker, fields.get("language") or "und",
                                       group=fields.get("group") or name))
        return infos

    def read(self, item: Item) -> Imported:
        name = item.info.name
        bvh, sound = self._pairs[name]
        try:
            motion, unit = read_motion(bvh, self._options)
            fields = self._fields(name)
            speech, timing = self._with_words(name, replace(load_speech(sound), speaker=item.info.speaker), fields)
        except InputError as error:
            raise DroppedError(str(error)) from None
        filled = fields.get("filled")
        if isinstance(filled, list):
            motion = replace(motion, filled=tuple(joint for joint in motion.skeleton.names if joint in filled))
        return Imported(item.info, speech, motion, fields.get("stands") is True, unit=unit, words=timing)

    def notes(self) -> Sequence[str]:
        return [f"{name}: has no sound of the same name" for name in self._alone]

    def _with_words(self, name: str, speech: Speech, fields: Mapping[str, Any]) -> tuple[Speech, str]:
        """The speech with its words and the source of their times."""
        for text in self._texts[name]:
            # An object without words may be there only for the split.
            if text.suffix.lower() != ".json" or not fields or any(fields.get(key) for key in _SAID):
                return with_text(speech, text)
        return speech, ""

    def _fields(self, name: str) -> dict[str, Any]:
        """The object in NAME.json; empty if there is none, or a list of words."""
        file = next((text for text in self._texts[name] if text.suffix.lower() == ".json"), None)
        if file is None:
            return {}
        content = read_json(file, "delete or repair it")
        if isinstance(content, list):
            return {}
        if not isinstance(content, dict):
            raise InputError(file, "is not an object", "delete or repair it")
        return content


def spread_by(option: str, names: Sequence[str]) -> Sequence[Split]:
    """The split of each name. option: shares such as "80/10/10" (the default), or a file of lines NAME,SPLIT.
    InputError for anything else, and for a name that is not in the file."""
    shares = (option or DEFAULT_SPLIT).split("/")
    # Digits only: float() would accept nan, inf and 1e999.
    if len(shares) == 3 and all(re.fullmatch(r"\d{1,3}(\.\d{1,3})?", share) for share in shares):
        train, val, test = map(float, shares)
        if train + val + test > 0:
            return spread(len(names), (train, val, test))
    file = Path(option)
    if not file.is_file():
        raise InputError(f"--split {option}", "is neither three shares nor a file", f"give for example {DEFAULT_SPLIT}")
    splits: dict[str, Split] = {}
    for number, line in enumerate(read_text(file, "write NAME,train in each line").split("\n"), 1):
        # From the right: a name may hold commas.
        name, _, word = (part.strip() for part in line.rpartition(","))
        split = next((split for split in SPLITS if split == word), None)
        if split is not None and name:
            splits[name] = split
        elif line.strip() and number > 1:  # the first line may be a head
            raise InputError(file, f"line {number}: {shown(line)!r} is not a name with train, val or test",
                             "write NAME,train in each line")
    lacking = [name for name in names if name not in splits]
    if lacking:
        raise InputError(file, f"does not name {', '.join(lacking[:5])}", "write NAME,train in each line")
    return [splits[name] for name in names]


def speakers_by(option: str, names: Sequence[str], folder: Path) -> dict[str, str]:
    """The performer of each recording. option: a name for all, or a regular expression with a group; empty for a guess.
    The guess is the part of the name before the first "_" if at least two recordings share it; else all have one
    performer, named after the folder. InputError for an invalid expression or one that does not match a name."""
    if not option:
        guess = {name: name.split("_")[0] for name in names}
        if len(set(guess.values())) < len(names) or len(names) == 1:
            return guess
        return dict.fromkeys(names, folder.resolve().name or "speaker")
    # Without a group it cannot be a pattern that names speakers, so it is one speaker's name.
    if "(" not in option:
        return dict.fromkeys(names, option)
    out = {}
    try:
        pattern = re.compile(option)
    except re.error as error:
        raise InputError(f"--speaker {option}", f"is not a regular expression ({error})", "try '^([^_]+)'") from None
    for name in names:
        match = pattern.search(name)
        if match is None or not pattern.groups or not match[1]:
            raise InputError(f"--speaker {option}", f"matches no speaker in {name}", "try '^([^_]+)'")
        out[name] = match[1]
    return out


def write_recording(folder: Path, recording: Recording) -> None:
    """Write NAME.bvh and NAME.json, the inverse of `Folder.read` (the sound is the store's own file)."""
    info, words = recording.info, recording.speech.words
    write_bvh(folder / f"{info.name}.bvh", recording.motion)
    fields: dict[str, Any] = {
        "words": None if words is None else [{"text": w.text, "start": w.start, "end": w.end} for w in words],
        "performer": info.speaker, "voice": info.voice, "language": info.language, "split": info.split,
        "group": info.group, "stands": recording.stands, "filled": list(recording.motion.filled),
    }
    write_text(folder / f"{info.name}.json", json.dumps(fields, ensure_ascii=False))
