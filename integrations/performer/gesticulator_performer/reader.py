"""The scripted performer as a data set: real motion combined with speech by rule.

Part A ("motion"): continuous real motion with speech synthesised for it. Part B ("talk"): synthetic speech performed
with real strokes by independent hands, over a real person's trunk. Part C ("style"): the same in audible voices. Real
readings ("reading") are performed as B; most are single utterances of the many voices in the folder `voices`, which
may be missing.

Nothing leaks between splits: the test split has separate topics, sentence templates, voices, takes, strokes and
readings; the validation split has separate takes and sentences. Recording `i` depends on (seed, i) alone, so it is the
same in any order and with any number of workers.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import importlib.util
import itertools
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from data_module.corpora.base import Item, Options, split_of
from data_module.errors import InputError
from data_module.files import read_text
from data_module.registry import RegistryEntry
from data_module.speech.audio import load_speech
from data_module.store import Recording, RecordingInfo, Split
from data_module.text.alignment import alignment
from gesticulator.directing import meaning_cues
from gesticulator_performer import play, tables, text, voices
from gesticulator_performer.inverse import Pool, make_pool, phrase_texts
from gesticulator_performer.meant_strokes import load_borrowed, with_borrowed, with_meanings, with_repertoire
from gesticulator_performer.plan import STEADY, draw_manner
from gesticulator_performer.repertoire import Repertoire, read_repertoire, write_takes
from gesticulator_performer.strokes import StrokeSet, load_strokes
from gesticulator_performer.syllables import Spoken, find_syllables
from gesticulator_performer.takes import Library, RealTake, list_takes, load_takes, split_of_takes
from gesticulator_performer.talks import talk_for_motion
from gesticulator_performer.trunk import Segment, trunk_segments

SHARES = {"motion": 0.36, "talk": 0.46, "style": 0.18}
"""Shares of the hours of synthetic speech. Part A has 10 minutes of real motion, so more of it would be repetition."""
SHORTEST, LONGEST = 115.0, 150.0
"""Requested length of a recording of part B or C, seconds; the voice determines the actual one."""
SHORTEST_MOTION, LONGEST_MOTION = 60.0, 80.0
"""Length of a recording of part A, seconds: it draws on 14 stretches of about 9 s."""
POOL: dict[Split, int] = {"train": 700, "val": 350, "test": 400}
"""Phrases in a voice's pool of speech for motion: with 150, a third of the phrases of motion get no speech, with 700
one in a hundred."""
MOTION_VOICES: dict[Split, tuple[str, ...]] = {
    "train": ("slt", "us_f3", "rms", "gb_m3", "scot_f2"), "val": ("us_f3", "gb_m3"), "test": ("awb", "rp_m7")}
"""Voices of part A; each needs a pool, spoken phrase by phrase."""
MOTION_GROUPS = ("conversation", "traffic", "story", "presenter", "conversation", "traffic", "story", "lesson")
"""Main group of motion in the recordings of part A, in turns (keys of `performer.takes.GROUPS`)."""
TEST_READINGS = ("en_sonnet_3", "es_prose_1", "en_austen_0930")
"""Readings that are held out for test as a whole."""
PERFORMERS_PER_READING = 3
"""Performances of each reading for training; with more, the 5 minutes of these voices would be memorised."""
SHORTEST_UTTERANCE = 5.0
"""Shortest utterance of `voices`, seconds; of shorter ones prominence, which compares syllables, says little."""
UTTERANCES_PER_READER = 2
"""Most utterances of each reader in `voices`; there is one of each for training."""
ADDED: dict[Split, dict[str, int]] = {"val": {"motion": 6, "talk": 8, "style": 3},
                                      "test": {"motion": 18, "talk": 27, "style": 8}}
"""Short recordings of each part for validation and test, added to those of the ordinary turns: with the readings, over
60 test recordings of unseen texts, voices and takes. Corpora of less than `ADDED_HOURS` hours have fewer."""
ADDED_HOURS = 4.0
ADDED_LENGTH = (38.0, 48.0)
"""Their length, seconds."""
# The index of the first recording of each part.
_FIRST = {"talk": 0, "reading": 100_000, "utterance": 150_000, "motion": 200_000, "style": 300_000}
# Files of `gesticulator.directing` on which the words that call for named gestures depend.
_DETECTOR = ("meaning_cues.py", "meaning_cues.json")
# Five and six times this is added to that index for the recordings of `ADDED`.
_ADDED = 10_000
# Folders of the source that may be missing: real voices, and people who stand and wait.
_OPTIONAL = ("voices", "idle")
# Purposes of the random generators of a recording; one each, so that a longer text does not change the voice.
_TEXT, _VOICE, _PLAY, _STYLE = 0, 1, 2, 3


@dataclass(frozen=True)
class PerformerOptions(Options):
    """The options of a synthetic corpus. data: the folder of the source where --source is not given. hours: of
    synthetic speech. repertoire: folder of takes of named gestures, or None."""

    data: Path | None = None
    hours: float = 4.2
    repertoire: Path | None = None


class Performer:
    """A reader whose recordings are synthesised. Content of an item: the utterances of a talk; of a real voice
    its folder in the source; of motion None."""

    @staticmethod
    def arguments(parser: argparse.ArgumentParser) -> None:
        """The options of the corpus; --source may be left out where GESTICULATOR_DATA is set."""
        parser.add_argument("--seed", type=int, default=1, help="random seed of the corpus (default 1)")
        parser.add_argument("--hours", type=float, default=4.2, help="hours of synthetic speech (default 4.2)")
        parser.add_argument("--repertoire", type=Path, metavar="DIR",
                            help="takes of named gestures, which are played at words that call for them; they are "
                            "drawn if DIR does not exist")

    @staticmethod
    def options(arguments: argparse.Namespace) -> PerformerOptions:
        """The options in parsed arguments; `InputError` for one out of range."""
        if not 0 < arguments.hours < float("inf"):
            raise InputError("--hours", f"is {arguments.hours:g}", "give a number above 0")
        if arguments.seed < 0:
            raise InputError("--seed", f"is {arguments.seed}", "give 0 or more")
        data = os.environ.get("GESTICULATOR_DATA")
        return PerformerOptions(
            arguments.fps, arguments.unit, arguments.seed, data=Path(data) if data else None, hours=arguments.hours,
            repertoire=arguments.repertoire)

    def __init__(self, source: Path | None, options: Options) -> None:
        options = options if isinstance(options, PerformerOptions) else PerformerOptions(seed=options.seed)
        source = source or options.data
        self._options = options
        self._trunks: dict[str, tuple[Segment, ...]] = {}
        self._pools: dict[tuple[str, Split], Pool] = {}
        self._repertoire: Repertoire | None = None
        if source is None:
            raise InputError("--source", "is missing", "name the folder that holds strokes/ and speech/, or "
                             "set GESTICULATOR_DATA")
        for needed in ("strokes/manifest.csv", "free_motion/manifest.csv", "meaning", "speech"):
            if not (source / needed).exists():
                raise InputError(source / needed, "does not exist",
                                 "--source is the folder that holds strokes/, free_motion/, meaning/ and speech/")
        self._source = source
        self._performers = sorted({row["speaker"] for row in tables.read_clips(source / "strokes", {"speaker"})})
        self._stems = sorted(file.stem for file in (source / "speech").glob("*.flac"))
        if options.repertoire is not None:
            if not options.repertoire.exists():
                count = write_takes(options.repertoire, options.seed)
                print(f"{options.repertoire}: {count} takes of named gestures were drawn", flush=True)
            self._repertoire = read_repertoire(options.repertoire)
        licences = [f"named gestures: {licence}" for licence in self._repertoire.licences] if self._repertoire else []
        credits = [credit for part, credit in tables.table("clips.toml")["credits"].items()
                   if part not in _OPTIONAL or (source / part).is_dir()]
        self.licence = "; ".join([*credits, *licences])
        if any(reading.startswith("en_") for reading in self._stems) and not importlib.util.find_spec("pocketsphinx"):
            raise InputError("alignment of the English readings", "needs pocketsphinx, which is not installed",
                             "pip install 'gesticulator[align]'")

    def settings(self) -> Mapping[str, Any]:
        room = Path(__file__).parent
        code = _hash_of([*sorted(room.glob("*.py")), *tables.files()], room)
        sources = [file for folder in ("strokes", "speech", "free_motion", "meaning", *_OPTIONAL)
                   for file in sorted((self._source / folder).rglob("*"))]
        settings: dict[str, Any] = {"code": code, "hours": self._options.hours,
                                    "source": _hash_of(sources, self._source)}
        if self._options.repertoire is not None:
            detector = [Path(meaning_cues.__file__).with_name(name) for name in _DETECTOR]
            settings["repertoire"] = _hash_of(sorted(self._options.repertoire.iterdir()), self._options.repertoire)
            settings["detector"] = _hash_of(detector, detector[0].parent)
        return settings

    def items(self) -> Sequence[Item]:
        # Sentences that are used already, by grammar; those of part A come first.
        used = {source: set(self._phrases[1][source]) for source in text.SPLITS}
        return [*self._motion_talks(), *self._talks("talk", used), *self._talks("style", used), *self._readings(),
                *self._utterances()]

    def read(self, item: Item) -> Recording:
        if item.info.part == "motion":
            return self._speech_for_motion(item)
        rng, sound = self._rng(item.index, _STYLE), self._rng(item.index, _VOICE)
        style = voices.NEUTRAL
        if item.info.part == "reading":
            spoken = self._reading(item)
        elif item.info.part == "talk":
            spoken = voices.speak(item.content, item.info.voice, sound)
        else:
            style = voices.draw_style(2.0 * LONGEST, rng)
            spoken = voices.styled_speech(item.content, item.info.voice, style, sound)
        manner = STEADY if item.info.part == "style" else draw_manner(rng)
        staging = play.Staging(manner, self._segments(item.info.split), style)
        played = play.perform(spoken, item.info.speaker, self._strokes, staging, self._rng(item.index, _PLAY),
                              item.info.split)
        info = replace(item.info, language=spoken.language,
                       sources=tuple(sorted({planned.stroke.base for planned in played.strokes})))
        return Recording(info, replace(spoken.speech, speaker=info.speaker), played.motion, stands=True)

    def _speech_for_motion(self, item: Item) -> Recording:
        takes = [take for take in self._library.talks() if self._take_splits[take.name] == item.info.split]
        pool = self._pool(item.info.voice, item.info.split)
        motion, spoken, used = talk_for_motion(item.info.speaker, item.info.seconds, self._library, takes, pool,
                                               self._rng(item.index, _PLAY))
        info = replace(item.info, language=spoken.language, sources=used)
        return Recording(info, replace(spoken.speech, speaker=info.speaker), motion, stands=True)

    def notes(self) -> Sequence[str]:
        return ()

    def _rng(self, index: int, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self._options.seed, index, purpose])

    @functools.cached_property
    def _strokes(self) -> StrokeSet:
        strokes = load_strokes(self._source / "strokes")
        strokes = with_borrowed(strokes, *load_borrowed(self._source / "free_motion"))
        strokes = with_meanings(strokes, self._source)
        return strokes if self._repertoire is None else with_repertoire(strokes, self._repertoire, self._source)

    @functools.cached_property
    def _library(self) -> Library:
        return load_takes(self._source)

    @functools.cached_property
    def _takes(self) -> list[RealTake]:
        return [take for take, _ in list_takes(self._source)]

    @functools.cached_property
    def _take_splits(self) -> dict[str, Split]:
        return split_of_takes(self._takes)

    def _segments(self, split: Split) -> tuple[Segment, ...]:
        if split not in self._trunks:
            self._trunks[split] = trunk_segments(self._library, self._take_splits, split)
        return self._trunks[split]

    def _pool(self, voice: str, split: Split) -> Pool:
        """The phrase pool of a voice in a split, spoken once per process."""
        if (voice, split) not in self._pools:
            self._pools[voice, split] = make_pool(voice, self._phrases[0][voice, split])
        return self._pools[voice, split]

    @functools.cached_property
    def _phrases(self) -> tuple[dict[tuple[str, Split], tuple[str, ...]], dict[str, set[str]]]:
        """The phrases of part A by voice and split, and their sentences by grammar; no sentence is used by two voices
        or in two splits."""
        out: dict[tuple[str, Split], tuple[str, ...]] = {}
        used: dict[str, set[str]] = {"train": set(), "test": set()}
        for number, (split, speakers) in enumerate(MOTION_VOICES.items()):
            source = "test" if split == "test" else "train"
            for place, voice in enumerate(speakers):
                rng = self._rng(_FIRST["motion"] + 100 * number + place, _TEXT)
                out[voice, split] = phrase_texts(rng, POOL[split], source, used[source])
        return out, used

    def _motion_talks(self) -> list[Item]:
        """Part A: in each split the groups with takes there, in turns."""
        items = []
        for place, split, turn, _, seconds in self._places("motion", (SHORTEST_MOTION, LONGEST_MOTION)):
            able = {take.group for take in self._takes if self._take_splits[take.name] == split}
            groups = [group for group in MOTION_GROUPS if group in able]
            group, voice = groups[turn % len(groups)], MOTION_VOICES[split][turn % len(MOTION_VOICES[split])]
            name = f"motion_{place:04d}_{group}"
            info = RecordingInfo(name, split, group, voice, "en", seconds, group=name, part="motion")
            items.append(Item(info, _FIRST["motion"] + place))
        return items

    def _places(self, part: str, lengths: tuple[float, float]
                ) -> Iterator[tuple[int, Split, int, np.random.Generator, float]]:
        """(place, split, turn in the split, generator of the text, seconds) of the recordings of a part and of those of
        `ADDED`."""
        count = max(1, round(self._options.hours * SHARES[part] * 3600 / (sum(lengths) / 2)))
        places: list[tuple[int, Split, tuple[float, float]]] = [(k, split_of(k), lengths) for k in range(count)]
        for number, (split, counts) in enumerate(ADDED.items()):
            added = round(counts[part] * min(1.0, self._options.hours / ADDED_HOURS))
            places += [((5 + number) * _ADDED + k, split, ADDED_LENGTH) for k in range(added)]
        turns = Counter[str]()
        for place, split, between in places:
            rng = self._rng(_FIRST[part] + place, _TEXT)
            yield place, split, turns[split], rng, float(rng.uniform(*between))
            turns[split] += 1

    def _talks(self, part: str, used: dict[str, set[str]]) -> list[Item]:
        """Parts B and C with their texts; no sentence of `used` (by grammar, updated) is repeated."""
        items = []
        for place, split, turn, rng, seconds in self._places(part, (SHORTEST, LONGEST)):
            performer = self._performers[turn % len(self._performers)]
            choice = voices.TEST_VOICES if split == "test" else voices.TRAIN_VOICES
            # Each round of the performers begins with another voice, so that every pair occurs.
            voice = choice[(turn + turn // len(self._performers)) % len(choice)]
            source = "test" if split == "test" else "train"
            written = text.compose(rng, seconds, source, used[source], repertoire=self._repertoire is not None)
            name = f"{part}_{place:04d}_{performer}"
            info = RecordingInfo(name, split, performer, voice, "en", seconds, group=name, part=part)
            items.append(Item(info, _FIRST[part] + place, tuple(written)))
        return items

    def _readings(self) -> list[Item]:
        """Every reading for training by three performers, in turns; readings for test by one performer each."""
        items: list[Item] = []
        for number, stem in enumerate(self._stems):
            split: Split = "test" if stem in TEST_READINGS else "train"
            for player in range(min(1 if split == "test" else PERFORMERS_PER_READING, len(self._performers))):
                performer = self._performers[(number + player) % len(self._performers)]
                info = RecordingInfo(f"read_{stem}_{performer}", split, performer, stem, stem.split("_")[0], LONGEST,
                                     group=stem, part="reading")
                items.append(Item(info, _FIRST["reading"] + number * 100 + player, "speech"))
        return items

    def _utterances(self) -> list[Item]:
        """The longest utterances of every reader in `voices`, each by one performer, in turns: `train_clean` for
        training; of `test_other` every other reader for validation, the others for test."""
        items: list[Item] = []
        turns = Counter[Split]()
        for folder in ("train_clean", "test_other"):
            files = sorted((self._source / "voices" / folder).glob("*.flac"))
            for number, (reader, own) in enumerate(itertools.groupby(files, lambda file: file.name.split("-")[0])):
                split: Split = "train" if folder == "train_clean" else "test" if number % 2 else "val"
                heard = sorted(((load_speech(file).duration, file.stem) for file in own), reverse=True)
                for seconds, stem in heard[:UTTERANCES_PER_READER]:
                    if seconds >= SHORTEST_UTTERANCE:
                        performer = self._performers[turns[split] % len(self._performers)]
                        info = RecordingInfo(f"read_{stem}_{performer}", split, performer, stem, "en", seconds,
                                             group=reader, part="reading")
                        items.append(Item(info, _FIRST["utterance"] + len(items), f"voices/{folder}"))
                        turns[split] += 1
        return items

    def _reading(self, item: Item) -> Spoken:
        """A real voice with its syllables; word times are known for the English readings only."""
        sound = self._source / item.content / f"{item.info.voice}.flac"
        speech = load_speech(sound)
        if item.info.language == "en" and item.content == "speech":
            transcript = read_text(sound.with_suffix(".txt"), "save it as text in UTF-8")
            speech = replace(speech, words=alignment(speech, transcript)[0])
        return find_syllables(speech, item.info.language)


def _hash_of(files: Sequence[Path], root: Path) -> str:
    digest = hashlib.sha256()
    for file in files:
        if file.is_file():
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


ENTRY = RegistryEntry("scripted motion made of real strokes (SOURCE/strokes) on real (SOURCE/speech) and synthetic "
                      "speech", "gesticulator_performer.reader:Performer")
