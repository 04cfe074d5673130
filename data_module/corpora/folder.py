"""Any folder of speech and BVH files of the same name; also what `build` writes as a data set.

`NAME.bvh` (any rig whose joints have known names) goes with `NAME.flac`, `.wav`, `.mp3` or `.ogg`. What is said may
lie beside them as `NAME.TextGrid`, `.json` (words with their times), `.srt`, `.vtt` or `.txt` (plain); without any the
words are unknown. `NAME.json` may also tell split, performer, voice, language and the truth of a scripted performance;
without it the split goes by the order of the names.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from data_module.corpora import DroppedError, Imported, Item, Options, split_of
from data_module.corpora.takes import TEXTS, read_motion, with_text
from data_module.errors import InputError
from data_module.files import write_text
from data_module.motion.bvh import bvh_text
from data_module.performer.types import Phrase, PlayedStroke, Syllable
from data_module.speech.audio import load_speech
from data_module.store import Recording, RecordingInfo, Truth
from data_module.types import Speech, Word

SOUNDS = (".flac", ".wav", ".mp3", ".ogg")
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

    def settings(self) -> Mapping[str, Any]:
        sizes = {name: [file.stat().st_size for file in (*pair, *self._texts[name])]
                 for name, pair in self._pairs.items()}
        return {"files": sizes, "motion_fps": self._options.fps, "unit": self._options.unit}

    def items(self) -> Sequence[Item]:
        return [Item(self._info(name, index), index) for index, name in enumerate(self._pairs)]

    def read(self, item: Item) -> Imported:
        name = item.info.name
        bvh, sound = self._pairs[name]
        try:
            motion, unit = read_motion(bvh, self._options)
            told = self._told(name)
            speech, timing = self._with_words(name, replace(load_speech(sound), speaker=item.info.speaker), told)
            truth = truth_from_json(told) if "strokes" in told else None
        except InputError as error:
            raise DroppedError(str(error)) from None
        except (KeyError, TypeError, ValueError) as error:
            raise DroppedError(f"{self._source / name}.json: {error!r} does not belong there") from None
        return Imported(item.info, speech, motion, truth, unit=unit, words=timing)

    def notes(self) -> Sequence[str]:
        return [f"{name}: has no sound of the same name" for name in self._alone]

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
        try:
            told = json.loads(file.read_text(encoding="utf-8-sig"))
        except (ValueError, RecursionError):
            raise InputError(file, "is not JSON", "delete or repair it") from None
        if isinstance(told, list):
            return {}
        if not isinstance(told, dict):
            raise InputError(file, "is not an object", "delete or repair it")
        return told

    def _info(self, name: str, index: int) -> RecordingInfo:
        told = self._told(name)
        speaker = str(told.get("performer") or name.split("_")[0])
        return RecordingInfo(name, told.get("split") or split_of(index), speaker, str(told.get("voice") or speaker),
                             str(told.get("language") or "und"), group=str(told.get("group") or name))


def write_recording(folder: Path, recording: Recording) -> None:
    """Write NAME.bvh and NAME.json, the inverse of `Folder.read` (the sound is the store's own file)."""
    info, words = recording.info, recording.speech.words
    write_text(folder / f"{info.name}.bvh", bvh_text(recording.motion))
    truth = recording.truth or Truth()
    told: dict[str, Any] = {
        "words": [asdict(word) for word in words] if words is not None else None,
        "performer": info.speaker, "voice": info.voice, "language": info.language, "split": info.split,
        "group": info.group,
    }
    if recording.truth is not None:
        told |= {"phrases": [asdict(p) for p in truth.phrases], "syllables": [asdict(s) for s in truth.syllables],
                 "strokes": [asdict(s) for s in truth.strokes]}
    write_text(folder / f"{info.name}.json", json.dumps(told, ensure_ascii=False))


def truth_from_json(told: Mapping[str, Any]) -> Truth:
    """The truth as `write_recording` wrote it."""
    return Truth(tuple(PlayedStroke(**s) for s in told["strokes"]), tuple(Syllable(**s) for s in told["syllables"]),
                 tuple(Phrase(**p) for p in told["phrases"]))
