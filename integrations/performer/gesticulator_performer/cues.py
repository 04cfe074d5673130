"""Which gesture a speaker makes at which word: labels of gestures with their cues, and the clips that show them.

`meanings.csv` lists the labels ("point_there") with the words and phrases that call for them in English, German and
Spanish; `licensed_clips.csv` lists clips of strokes and of free motion with their label and their phases in seconds.
`words.toml` has the English words that ask for other strokes, and the beat strokes that any stressed syllable may take;
their names are those of `data/strokes`, and a performer without a stroke takes the next name.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path

from gesticulator.directing.meaning_cues import meaning_cues
from gesticulator_performer.syllables import is_function_word
from gesticulator_performer.tables import complete_rows, table

LANGUAGES = ("en", "de", "es")
MEANINGS, CLIPS = "meanings.csv", "licensed_clips.csv"
_PHASES = ("ready", "strokeStart", "emphasis", "stroke", "relax")
_COLUMNS = frozenset({"label", "category", "offensive", "talk"} | {f"cues_{language}" for language in LANGUAGES})
_CLIP_COLUMNS = frozenset({"file", "person", "label", *_PHASES})
# Weight of a cue that is one very common word.
_COMMON = 0.35
# Least score of a call of the detector: the texts are our own, and talk of meanings on purpose. What the score adds to
# the weight of its word: detected phrases are played in about four of five cases.
_LEAST_SCORE, _SURER = 0.55, 0.3
# Chance of a label of emotion against one of another category that has the same cue: a plain "yes" is a nod, seldom a
# cheer.
_EMOTIONAL = 0.25
LOW, MID, HIGH = "low", "mid", "high"
_TABLE = table("words.toml")
BEATS: dict[str, tuple[str, ...]] = {level: tuple(_TABLE["beats"][level].split()) for level in (LOW, MID, HIGH)}
"""Lexemes of beats by prominence of the syllable."""
_COMMON_OF = {language: frozenset(words.split()) for language, words in _TABLE["cues"].items()}
# Groups of strokes with one meaning, best first.
_STROKES: dict[str, tuple[str, ...]] = {
    name: tuple(group["strokes"].split()) for name, group in _TABLE["lexemes"].items()}
# Words so common that a stroke on them is rare.
_SELDOM = frozenset(_TABLE["common"]["words"].split())
_ASKING = {tuple(phrase.split()): _STROKES[name] for phrase, name in _TABLE["phrases"].items()}
_LOOKUP = {word: _STROKES[name] for name, group in _TABLE["lexemes"].items() for word in group["words"].split()}
_LONGEST_PHRASE = max(map(len, _ASKING))


@dataclass(frozen=True)
class MeantClip:
    """A clip that shows a gesture. file: relative to the folder above the tables; person: who moves; phases: seconds of
    ready, strokeStart, emphasis, stroke and relax, or () where no hand moves."""

    file: str
    person: str
    label: str
    phases: tuple[float, ...]

    @property
    def stem(self) -> str:
        return Path(self.file).stem


@dataclass(frozen=True)
class Asked:
    """What a word asks for: labels with their chances, which sum to 1, and the weight of the request (0 to 1)."""

    labels: Mapping[str, float]
    weight: float


@dataclass(frozen=True)
class Cues:
    """Cues of the labels that have clips or were asked for. phrases: by language, words in the spelling of `plain` ->
    labels with their chances; clips: by file stem; wanted: all labels.

    detected: whether the detector of the product (`gesticulator.directing.meaning_cues`) calls for the labels that it
    knows: it reads phrases with their guards, and does not fire on idioms, homonyms and negations.
    """

    phrases: Mapping[str, Mapping[tuple[str, ...], Mapping[str, float]]]
    clips: Mapping[str, MeantClip]
    wanted: frozenset[str] = frozenset()
    detected: bool = False

    def asked(self, words: Sequence[str], language: str = "en", pauses: Sequence[float] = ()) -> dict[int, Asked]:
        """What the words of a speech ask for, by index. At each place the longest phrase counts; its last content word
        carries the stroke. pauses: seconds of silence after each word, for the detector."""
        if not self.detected:
            return self._listed(words, language)
        detector = meaning_cues(language)
        out: dict[int, Asked] = {}
        for word, asked in self._listed(words, language).items():
            new = {label: chance for label, chance in asked.labels.items() if label not in detector.gestures}
            if new:
                out[word] = Asked(new, asked.weight)
        for call in detector.called(words, pauses):
            if call.score >= _LEAST_SCORE and call.label in self.wanted:
                out[call.word] = Asked({call.label: 1.0}, 1.0 + _SURER * call.score)
        return out

    def _listed(self, words: Sequence[str], language: str) -> dict[int, Asked]:
        out: dict[int, Asked] = {}
        for first, last, labels in self.found(words, language):
            carrier = next((k for k in range(last, first, -1) if not is_function_word(words[k], language)), first)
            common = last == first and plain(words[first]) in _COMMON_OF[language]
            out[carrier] = Asked(labels, _COMMON if common else 1.0)
        return out

    def found(self, words: Sequence[str], language: str = "en") -> Iterator[tuple[int, int, Mapping[str, float]]]:
        """(first word, last word, labels) of each cue in a text, in order, without overlap."""
        phrases = self.phrases.get(language, {})
        longest = max(map(len, phrases), default=0)
        spelled = [plain(word) for word in words]
        place = 0
        while place < len(words):
            for length in range(min(longest, len(words) - place), 0, -1):
                labels = phrases.get(tuple(spelled[place:place + length]))
                if labels:
                    yield place, place + length - 1, labels
                    place += length - 1
                    break
            place += 1


def plain(word: str) -> str:
    """A word in the spelling of the cues: lower case, one kind of apostrophe, no punctuation and no hyphen."""
    return re.sub(r"[^\w']|[\d_]", "", word.lower().replace("\u2019", "'")).strip("'")


def mirrored(label: str) -> str:
    """The label of the mirror image: left and right are swapped."""
    swap = {"left": "right", "right": "left"}
    return "_".join(swap.get(part, part) for part in label.split("_"))


def read_cues(folder: str | Path, labels: Set[str] = frozenset()) -> Cues:
    """Read both tables. Labels that are offensive, do not suit a standing speaker or have neither a clip nor a place in
    `labels` are left out."""
    folder = Path(folder)
    rows = {row["label"]: row for row in complete_rows(folder / MEANINGS, _COLUMNS)}
    allowed = {label for label, row in rows.items() if row["offensive"] == "no" and row["talk"] == "yes"}
    clips = [MeantClip(row["file"], row["person"], row["label"],
                       tuple(float(row[phase]) for phase in _PHASES if row[phase]))
             for row in complete_rows(folder / CLIPS, _CLIP_COLUMNS) if row["label"] in allowed]
    used = {clip.label for clip in clips} | (allowed & labels)
    return Cues({language: _phrases({label: row for label, row in rows.items() if label in used}, language)
                 for language in LANGUAGES}, {clip.stem: clip for clip in clips}, frozenset(used))


def _phrases(rows: Mapping[str, Mapping[str, str]], language: str) -> dict[tuple[str, ...], dict[str, float]]:
    weights: dict[tuple[str, ...], dict[str, float]] = {}
    for label, row in rows.items():
        for cue in row[f"cues_{language}"].split(";"):
            words = tuple(plain(word) for word in cue.split())
            if words and all(words):
                emotional = "emotion" in row["category"].split(";")
                weights.setdefault(words, {})[label] = _EMOTIONAL if emotional else 1.0
    return {words: {label: weight / sum(of.values()) for label, weight in of.items()} for words, of in weights.items()}


def lexemes_of(words: Sequence[str], index: int) -> tuple[tuple[str, ...], float]:
    """Candidate lexemes for the word at `index`, best first, and the weight of the request (0 to 1). Phrases take
    precedence over words; the last word of a phrase carries its stroke. ((), 0) for other words."""
    for length in range(min(_LONGEST_PHRASE, index + 1), 1, -1):
        phrase = tuple(plain(word) for word in words[index - length + 1:index + 1])
        if phrase in _ASKING:
            return _ASKING[phrase], 1.0
    word = plain(words[index])
    if word in _LOOKUP:
        return _LOOKUP[word], 0.35 if word in _SELDOM else 1.0
    return (), 0.0


def beat_level(prominence: float) -> str:
    """Level of the beats for a syllable of this prominence: low, mid or high."""
    if prominence < 0.35:
        return LOW
    return MID if prominence < 1.1 else HIGH


MOVEMENTS: dict[str, tuple[tuple[str, ...], ...]] = {
    movement: tuple(_STROKES[name] for name in names.split()) for movement, names in {
        "large": "big all", "small": "small", "self": "me", "forward": "you there give", "left": "left",
        "right": "right", "sideways": "negate no"}.items()}
"""Movement feature that a word can ask for, in the order of `talks.features_of` -> the lexemes that ask for it."""


def movements_of(words: Sequence[str]) -> list[int]:
    """For each word the index of its feature in `MOVEMENTS`, -1 for none and for words that are too common."""
    out = []
    for index in range(len(words)):
        lexemes, strength = lexemes_of(words, index)
        kinds = [kind for kind, known in enumerate(MOVEMENTS.values()) if lexemes in known]
        out.append(kinds[0] if kinds and strength == 1.0 else -1)
    return out
