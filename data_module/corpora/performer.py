"""The scripted performer as a data set: strokes played by rule on real and synthetic speech.

Nothing leaks from one split to another: the test split has its own topics and sentence templates, its own voices and
strokes that no other split plays, and the real readings kept for it are never trained on. Recording `i` depends on
(seed, i) alone, so it is the same in any order and on any number of workers.

The synthetic talks are in English, and every reading there is is used, unless `Options.languages` names the languages
of both.
"""

from __future__ import annotations

import csv
import functools
import hashlib
import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from data_module.corpora import Item, Options, split_of
from data_module.errors import InputError
from data_module.performer import text, voices
from data_module.performer.types import Spoken
from data_module.store import Recording, RecordingInfo, Split
from data_module.truth import Truth

SHORTEST, LONGEST = 115.0, 150.0
"""Seconds of a synthetic recording, before the voice decides."""
TEST_READINGS = ("en_sonnet_3", "en_austen_09")
TEST_TAIL = 30.0
"""Seconds at the end of each reading without word times (German, Spanish) that are kept for test."""
_TINY_SECONDS = 20.0
_TINY_SPLITS: tuple[Split, ...] = ("train", "train", "train", "train", "val", "train", "train", "test", "test")
_TINY_VOICES: dict[Split, tuple[str, ...]] = {"train": ("numpy_low",), "val": ("numpy_low",), "test": ("numpy_high",)}
_READINGS_FROM = 100_000
# What a random generator of a recording is for; one each, so that a longer text does not change the voice.
_TEXT, _VOICE, _PLAY = 0, 1, 2


@dataclass(frozen=True)
class Script:
    """A synthetic recording before it is spoken."""

    utterances: tuple[text.Utterance, ...]


@dataclass(frozen=True)
class Reading:
    """A real recording, or the part of it before (`head`) or after (`tail`) the cut."""

    stem: str
    part: str = "whole"


class Performer:
    """A reader that makes what it reads."""

    def __init__(self, source: Path | None, options: Options) -> None:
        self._options = options
        self._tiny = options.preset == "tiny"
        if self._tiny:
            if options.languages:
                raise InputError("--languages", "is not for the tiny preset, which speaks English letters only",
                                 "take --preset default")
            self._source = None
            self.licence = "free of rights: procedural strokes and a numpy voice"
            return
        if source is None:
            raise InputError("--source", "is missing", "name the folder that holds strokes/ and speech/, set "
                             "GESTICULATOR_DATA, or take --preset tiny")
        for needed in ("strokes/manifest.csv", "speech"):
            if not (source / needed).exists():
                raise InputError(source / needed, "does not exist",
                                 "--source is the folder that holds strokes/ and speech/")
        self._source = source
        unknown = sorted(set(options.languages) - set(voices.VOICES_OF))
        if unknown:
            raise InputError(f"--languages {','.join(options.languages)}", f"nobody here speaks {', '.join(unknown)}",
                             f"choose among {', '.join(voices.VOICES_OF)}")
        austen = any(stem.startswith("en_austen") for stem in self._stems)
        real = f"public domain (LibriVox){', BSD-like (Austen excerpts)' if austen else ''} and " if self._stems else ""
        self.licence = f"strokes: LGPL 2.1 (SmartBody); speech: {real}synthetic voices"
        if any(reading.startswith("en_") for reading in self._stems) and not importlib.util.find_spec("pocketsphinx"):
            raise InputError("alignment of the English readings", "needs pocketsphinx, which is not installed",
                             "pip install 'gesticulator[align]'")

    def settings(self) -> Mapping[str, Any]:
        own = Path(text.__file__).parent
        code = _hash_of([*sorted(own.glob("*.py")), Path(__file__)], own.parent)
        settings: dict[str, Any] = {"preset": self._options.preset, "code": code}
        if self._source is not None:
            files = [*sorted((self._source / "strokes").glob("*")), *sorted((self._source / "speech").glob("*"))]
            settings |= {"hours": self._options.hours, "source": _hash_of(files, self._source)}
        if self._options.languages:
            settings["languages"] = sorted(set(self._options.languages))
        return settings

    def items(self) -> Sequence[Item]:
        return self._talks() + ([] if self._tiny else self._readings())

    def read(self, item: Item) -> Recording:
        from data_module.performer.play import perform

        if isinstance(item.content, Script):
            spoken = voices.speak(item.info.name, item.content.utterances, item.info.voice,
                                  self._rng(item.index, _VOICE))
        else:
            spoken = self._heard(item)
        played = perform(spoken, item.info.speaker, self._strokes, self._rng(item.index, _PLAY), item.info.split)
        truth = Truth(played.strokes, spoken.syllables, spoken.phrases)
        speech = replace(spoken.speech, speaker=item.info.speaker)
        return Recording(replace(item.info, language=spoken.language), speech, played.motion, truth)

    def notes(self) -> Sequence[str]:
        strokes = self._strokes.strokes
        held = sum(stroke.held_out for stroke in strokes)
        lines = [f"strokes: {len(strokes)}, mirror images counted, {held} of them kept for test"]
        if self._source is not None:
            clips = {Path(row["file"]).stem for row in self._manifest}
            lines.append(f"clips without a usable stroke: {len(clips - {stroke.base for stroke in strokes})} of "
                         f"{len(clips)} (postures, fidgets, and clips with the wrong hand, posture or order)")
        return lines

    def _rng(self, index: int, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self._options.seed, index, purpose])

    @functools.cached_property
    def _strokes(self) -> Any:
        if self._source is None:
            from data_module.performer.strokes import procedural_strokes

            return procedural_strokes()
        from data_module.performer.strokes import load_strokes

        return load_strokes(self._source / "strokes")

    @functools.cached_property
    def _manifest(self) -> list[dict[str, str]]:
        if self._source is None:
            return []
        with (self._source / "strokes" / "manifest.csv").open(encoding="utf-8", newline="") as lines:
            return list(csv.DictReader(lines))

    @property
    def _performers(self) -> tuple[str, ...]:
        if self._source is None:
            return self._strokes.performers
        return tuple(sorted({row["speaker"] for row in self._manifest}))

    @functools.cached_property
    def _stems(self) -> tuple[str, ...]:
        if self._source is None:
            return ()
        stems = sorted(file.stem for file in (self._source / "speech").glob("*.flac"))
        wanted = self._options.languages
        return tuple(stem for stem in stems if not wanted or stem.split("_")[0] in wanted)

    def _talks(self) -> list[Item]:
        """The synthetic recordings with their texts; no sentence is said twice in the whole corpus."""
        mean = (SHORTEST + LONGEST) / 2
        count = len(_TINY_SPLITS) if self._tiny else max(1, round(self._options.hours * 3600 / mean))
        said: dict[str, set[str]] = {"train": set(), "test": set()}
        seen = dict.fromkeys(("train", "val", "test"), 0)
        items = []
        for index in range(count):
            split = _TINY_SPLITS[index] if self._tiny else split_of(index)
            turn = seen[split]
            seen[split] += 1
            performer = self._performers[turn % len(self._performers)]
            choice = self._voices(split)
            # Another round of the performers begins with another voice, so that every pair comes up.
            voice = choice[(turn + turn // len(self._performers)) % len(choice)]
            rng = self._rng(index, _TEXT)
            seconds = _TINY_SECONDS if self._tiny else float(rng.uniform(SHORTEST, LONGEST))
            source = "test" if split == "test" else "train"
            language = voices.VOICES[voice].language
            script = Script(tuple(text.compose(rng, seconds, source, said[source], language)))
            name = f"talk_{index:04d}_{performer}"
            items.append(Item(RecordingInfo(name, split, performer, voice, language, group=name), index, script))
        return items

    def _voices(self, split: Split) -> tuple[str, ...]:
        if self._tiny:
            return _TINY_VOICES[split]
        side = 1 if split == "test" else 0
        own = [voices.VOICES_OF[language][side] for language in sorted(set(self._options.languages)) or ("en",)]
        # Languages take turns, so that each gets its share however many voices it has.
        return tuple(of[rank % len(of)] for rank in range(max(map(len, own))) for of in own)

    def _readings(self) -> list[Item]:
        """Every reading for training by every performer; those for test by one performer each."""
        items: list[Item] = []
        turn = 0
        for number, stem in enumerate(self._stems):
            language = stem.split("_")[0]
            parts: list[tuple[str, Split]]
            if stem.startswith(TEST_READINGS):
                parts = [("whole", "test")]
            elif language == "en":
                parts = [("whole", "train")]
            else:
                parts = [("head", "train"), ("tail", "test")]
            for place, (part, split) in enumerate(parts):
                players = self._performers
                if split == "test":
                    players = (self._performers[turn % len(self._performers)],)
                    turn += 1
                group = stem if part == "whole" else f"{stem}_{part}"
                for player, performer in enumerate(players):
                    info = RecordingInfo(f"read_{group}_{performer}", split, performer, stem, language, group=group)
                    index = _READINGS_FROM + number * 100 + place * 10 + player
                    items.append(Item(info, index, Reading(stem, part)))
        return items

    def _heard(self, item: Item) -> Spoken:
        """A real reading as the performer hears it: English with its words, other languages by prominence alone."""
        from data_module.performer.syllables import find_syllables
        from data_module.speech.audio import load_speech
        from data_module.text import alignment as transcripts

        assert self._source is not None
        reading: Reading = item.content
        speech = load_speech(self._source / "speech" / f"{reading.stem}.flac")
        if reading.part != "whole":
            at = tail_begins(speech.samples, speech.sample_rate)
            samples = speech.samples[:at] if reading.part == "head" else speech.samples[at:]
            speech = replace(speech, samples=np.ascontiguousarray(samples))
        if item.info.language == "en":
            transcript = (self._source / "speech" / f"{reading.stem}.txt").read_text(encoding="utf-8")
            speech = replace(speech, words=transcripts.align(speech, transcript))
        return find_syllables(item.info.name, speech, item.info.voice, item.info.language)


def tail_begins(samples: np.ndarray, sample_rate: int) -> int:
    """The sample at which the part kept for test begins: the quietest 50 ms of the two seconds before `TEST_TAIL`."""
    hop = int(0.05 * sample_rate)
    last = max(hop, len(samples) - int(TEST_TAIL * sample_rate))
    starts = np.arange(max(0, last - 2 * sample_rate), last, hop)
    power = [float((samples[start:start + hop].astype(np.float64) ** 2).sum()) for start in starts]
    return int(starts[int(np.argmin(power))])


def _hash_of(files: Sequence[Path], root: Path) -> str:
    digest = hashlib.sha256()
    for file in files:
        if file.is_file():
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]
