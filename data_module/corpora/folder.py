"""Any folder of speech and BVH files of the same name; also what `build` writes as a data set.

`NAME.bvh` (any rig whose joints have known names) goes with `NAME.flac`, `.wav`, `.mp3` or `.ogg`. What is said may
lie beside them as `NAME.TextGrid`, `.json` (words with their times), `.srt`, `.vtt` or `.txt` (plain); without any the
words are unknown. `NAME.json` may also tell split, performer, voice, language, whether whoever moves stands in one
place (`stands`), joints whose motion was made up (`filled`) and the truth of a scripted performance; without it the
split goes by the order of the names, in shares of 80/10/10 or as `Options.split` says, and the performer is what stands
before the first "_" of the names where several recordings share it, else the folder, or what `Options.speaker` says.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from data_module.corpora.base import DroppedError, Imported, Item, Options, spread
from data_module.corpora.takes import TEXTS, read_motion, with_text
from data_module.errors import InputError, shown
from data_module.files import read_text, write_text
from data_module.json_files import read_json
from data_module.motion.bvh import bvh_text
from data_module.speech.audio import SOUNDS, load_speech
from data_module.store import SPLITS, Recording, RecordingInfo, Split
from data_module.truth import Truth
from data_module.types import Speech, Word

DEFAULT_SPLIT = "80/10/10"
"""Percent for train, val and test."""
_SAID = ("words", "segments", "tiers", "text")
"""Keys of a JSON object that hold what is said."""


class Folder:
    """A reader of same-named speech and BVH files."""

    licence = "that of the source folder; ask its owner"

    def __init__(self, source: Path | None, options: Options) -> None:
        if source is None:
            raise InputError("--source", "is missing", "name the folder that holds the BVH and sound files")
        self._source, self._options = source, options
        self._pairs: dict[str, tuple[Path, Path]] = {}
        self._alone: list[str] = []
        files = {file.name: file for file in sorted(source.iterdir()) if file.is_file()}
        texts = {(file.stem, file.suffix.lower()): file for file in files.values() if file.suffix.lower() in TEXTS}
        for name, file in files.items():
            if file.suffix.lower() != ".bvh":
                continue
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
        return [Item(info, index, size=sum(file.stat().st_size for file in self._pairs[info.name]))
                for index, info in enumerate(self._infos)]

    def _listed(self) -> list[RecordingInfo]:
        """Every pair with its split and speaker: as NAME.json says, else as the options do."""
        beside = {name: self._told(name) for name in self._pairs}
        self._guessed = not self._options.speaker and any(not told.get("performer") for told in beside.values())
        open_ = [name for name in self._pairs if not beside[name].get("split")]
        splits = dict(zip(open_, spread_by(self._options.split, open_), strict=True))
        speakers = speakers_by(self._options.speaker, list(self._pairs), self._source)
        infos = []
        for name, told in beside.items():
            for key in ("split", "performer", "voice", "language", "group"):
                if not isinstance(told.get(key) or "", str):
                    raise InputError(self._source / f"{name}.json", f"has {key} {shown(told[key])!r}",
                                     "write a text there")
            speaker = told.get("performer") or speakers[name]
            infos.append(RecordingInfo(name, told.get("split") or splits[name], speaker, told.get("voice") or speaker,
                                       told.get("language") or "und", group=told.get("group") or name))
        return infos

    def read(self, item: Item) -> Imported:
        name = item.info.name
        bvh, sound = self._pairs[name]
        try:
            motion, unit = read_motion(bvh, self._options)
            told = self._told(name)
            speech, timing = self._with_words(name, replace(load_speech(sound), speaker=item.info.speaker), told)
            truth = Truth.from_json(told) if "strokes" in told else None
        except InputError as error:
            raise DroppedError(str(error)) from None
        except (KeyError, TypeError, ValueError) as error:
            raise DroppedError(f"{self._source / name}.json: {error!r} does not belong there") from None
        filled = told.get("filled")
        if isinstance(filled, list):
            motion = replace(motion, filled=tuple(joint for joint in motion.skeleton.names if joint in filled))
        return Imported(item.info, speech, motion, truth, told.get("stands") is True, unit=unit, words=timing)

    def notes(self) -> Sequence[str]:
        lines = [f"{name}: has no sound of the same name" for name in self._alone]
        there = {info.split for info in self._infos}
        lines += [f"no recording is in {split}: {what}; --split {DEFAULT_SPLIT} shares them out, or name them in a file"
                  for split, what in (("train", "nothing can be trained"), ("test", "score has nothing to judge"))
                  if split not in there]
        speakers = {info.speaker for info in self._infos}
        if self._guessed and len(self._infos) > 1 and len(speakers) in (1, len(self._infos)):
            lines.append(f"every recording has {'the same speaker' if len(speakers) == 1 else 'a speaker of its own'}; "
                         "if that is wrong, --speaker '^([^_]+)' takes the name from what stands before '_'")
        return lines

    def _with_words(self, name: str, speech: Speech, told: Mapping[str, Any]) -> tuple[Speech, str]:
        """The speech with its words, and how they got their times: from `write_recording`, or from any text."""
        words = told.get("words")
        if words and all(isinstance(word, Mapping) and "text" in word for word in words):
            return replace(speech, words=tuple(Word(w["text"], w["start"], w["end"]) for w in words)), "given"
        for text in self._texts[name]:
            # An object without words may be there for the split alone.
            if text.suffix.lower() != ".json" or not told or any(told.get(key) for key in _SAID):
                return with_text(speech, text)
        return speech, ""

    def _told(self, name: str) -> dict[str, Any]:
        """The object in NAME.json; nothing where there is none, or another kind of JSON (a list of words)."""
        file = next((text for text in self._texts[name] if text.suffix.lower() == ".json"), None)
        if file is None:
            return {}
        told = read_json(file, "delete or repair it")
        if isinstance(told, list):
            return {}
        if not isinstance(told, dict):
            raise InputError(file, "is not an object", "delete or repair it")
        return told


def spread_by(asked: str, names: Sequence[str]) -> Sequence[Split]:
    """The split of each name. asked: shares such as "80/10/10" (empty: those), or a file of lines NAME,SPLIT.

    InputError for anything else, and for a name that the file lacks.
    """
    shares = (asked or DEFAULT_SPLIT).split("/")
    if len(shares) == 3 and all(re.fullmatch(r"\d{1,3}(\.\d{1,3})?", share) for share in shares):
        train, val, test = map(float, shares)
        if train + val + test > 0:
            return spread(len(names), (train, val, test))
    file = Path(asked)
    if not file.is_file():
        raise InputError(f"--split {asked}", "is neither three shares nor a file", f"give {DEFAULT_SPLIT}, for example")
    told: dict[str, Split] = {}
    for number, line in enumerate(read_text(file, "write NAME,train in each line").split("\n"), 1):
        name, _, word = (part.strip() for part in line.rpartition(","))
        split = next((split for split in SPLITS if split == word), None)
        if split is not None and name:
            told[name] = split
        elif line.strip() and number > 1:  # the first line may be a head
            raise InputError(file, f"line {number}: {shown(line)!r} is no name with train, val or test",
                             "write NAME,train in each line")
    lacking = [name for name in names if name not in told]
    if lacking:
        raise InputError(file, f"does not name {', '.join(lacking[:5])}", "write NAME,train in each line")
    return [told[name] for name in names]


def speakers_by(asked: str, names: Sequence[str], folder: Path) -> dict[str, str]:
    """Who gestures in each recording. asked: a name for all, or a regular expression with a group; empty for a guess.

    The guess is what stands before the first "_", where at least two recordings share it; else all are one speaker,
    named after the folder. InputError for an expression that is none or does not fit a name.
    """
    if not asked:
        guess = {name: name.split("_")[0] for name in names}
        if len(set(guess.values())) < len(names) or len(names) == 1:
            return guess
        return dict.fromkeys(names, folder.resolve().name or "speaker")
    if "(" not in asked:
        return dict.fromkeys(names, asked)
    out = {}
    try:
        pattern = re.compile(asked)
    except re.error as error:
        raise InputError(f"--speaker {asked}", f"is no regular expression ({error})", "try '^([^_]+)'") from None
    for name in names:
        match = pattern.search(name)
        if match is None or not pattern.groups or not match[1]:
            raise InputError(f"--speaker {asked}", f"finds no speaker in {name}", "try '^([^_]+)'")
        out[name] = match[1]
    return out


def write_recording(folder: Path, recording: Recording) -> None:
    """Write NAME.bvh and NAME.json, the inverse of `Folder.read` (the sound is the store's own file)."""
    info, words = recording.info, recording.speech.words
    write_text(folder / f"{info.name}.bvh", bvh_text(recording.motion))
    told: dict[str, Any] = {
        "words": [asdict(word) for word in words] if words is not None else None,
        "performer": info.speaker, "voice": info.voice, "language": info.language, "split": info.split,
        "group": info.group, "stands": recording.stands, "filled": list(recording.motion.filled),
    }
    if recording.truth is not None:
        told |= recording.truth.to_json()
    write_text(folder / f"{info.name}.json", json.dumps(told, ensure_ascii=False))
