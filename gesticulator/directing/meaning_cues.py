"""Which words of a speech call for a gesture with a meaning, and for which one: cue phrases with guards.

`meaning_cues.json` holds, for each meaning, cue phrases in English, German and Spanish (`cue_patterns`), and phrases in
which they do not count: idioms, homonyms and other parts of speech. After a negation in the same clause only meanings
that are themselves negative or questions count. Where two meanings are equally good, there is none. In English prose
that was written to be read, cue phrases are worth less than in talk: it has more "of" and "which", and less "you".
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from data_module.files import read_object
from data_module.text.language import LANGUAGES
from gesticulator.directing.cue_patterns import CuePattern, SpokenText, cue_pattern, spoken_text

_SCOPE = 4
"""Words after a negation that it may concern."""
_NEAR = 80
"""Characters around a phrase in which its guards are sought."""
_LONGER = 0.01
"""Added to the score for each further word of a cue phrase: the more specific phrase wins."""


def _set(words: str) -> frozenset[str]:
    return frozenset(words.split())


_TALK = _set("i me my you your we us our am let going got want know think get look well okay yeah yes thank do not "
             "what why that this just really so")
_PROSE = _set("of the which by upon such")
_AROUND, _FEWEST, _LEAST_TALK, _WRITTEN = 35, 25, -0.05, 0.15
"""Words on both sides that tell talk from prose, and how many are needed; the least share of words of talk minus those
of prose; what is taken off the scores in prose."""
_NEGATIONS = {"en": _set("not no never nobody none nothing without hardly neither nor cannot"),
              "de": _set("nicht kein keine keinen keiner nie niemals niemand ohne weder"),
              "es": _set("no nunca nadie nada sin jamás ni tampoco")}


@dataclass(frozen=True)
class CalledGesture:
    """A word that calls for a gesture. word: its index; first, last: the words of its phrase; label: the meaning;
    gesture: the name of its gesture; score: how sure it is, 0 to 1; source: the cue phrase."""

    word: int
    first: int
    last: int
    label: str
    gesture: str
    score: float
    source: str = ""


@dataclass(frozen=True)
class MeaningClass:
    """The cues of a meaning in one language. negated: they count after a negation, too."""

    label: str
    gesture: str
    negated: bool
    cues: tuple[CuePattern, ...]
    unless: tuple[CuePattern, ...]


class MeaningCues:
    """The cue phrases of one language."""

    def __init__(self, classes: Sequence[MeaningClass], language: str = "en") -> None:
        self.classes, self.language = tuple(classes), language
        self._by_key: dict[str, list[tuple[MeaningClass, CuePattern]]] = {}
        for meaning in self.classes:
            for cue in meaning.cues:
                for key in cue.keys or ("",):
                    self._by_key.setdefault(key, []).append((meaning, cue))

    @property
    def gestures(self) -> Mapping[str, str]:
        """Meaning -> the name of its gesture."""
        return {meaning.label: meaning.gesture for meaning in self.classes}

    def called(self, words: Sequence[str], pauses: Sequence[float] = ()) -> list[CalledGesture]:
        """The words that call for a gesture, in their order; of phrases that overlap the best one, or none on a tie.

        pauses: seconds of silence after each word, where they are known.
        """
        spoken = spoken_text(words, pauses)
        calls = sorted(self._candidates(spoken), key=lambda call: (call.first, call.word, call.label))
        if self.language == "en" and calls:
            written = _written(spoken, len(words))
            calls = [replace(call, score=round(call.score - _WRITTEN, 3)) if written[call.word] else call
                     for call in calls]
        return _best(calls)

    def _candidates(self, spoken: SpokenText) -> Iterator[CalledGesture]:
        """Every cue phrase that its guards let pass; they may overlap."""
        tried: set[int] = set()
        for key in (*spoken.tokens, ""):
            for meaning, cue in self._by_key.get(key, ()):
                if id(cue) not in tried:
                    tried.add(id(cue))
                    yield from self._matched(meaning, cue, spoken)

    def _matched(self, meaning: MeaningClass, cue: CuePattern, spoken: SpokenText) -> Iterator[CalledGesture]:
        for start, end, stroke in cue.matches(spoken):
            if _guarded(meaning, spoken, start, end) or (not meaning.negated and self._negated(spoken, start)):
                continue
            score = round(min(cue.weight + _LONGER * (cue.length - 1), 1.0), 3)
            yield CalledGesture(spoken.owners[stroke], *spoken.words(start, end), meaning.label, meaning.gesture, score,
                                cue.source)

    def _negated(self, spoken: SpokenText, start: int) -> bool:
        """True if a negation stands in the same clause within `_SCOPE` words before a place."""
        before: list[str] = []
        for token in reversed(spoken.text[max(start - _NEAR, 0):start].split()):
            if token in (",", ".", "?") or len(before) == _SCOPE:
                break
            before.append(token)
        negations = _NEGATIONS[self.language]
        # "not only", "not just" say more, not less.
        return any(token in negations and before[at - 1:at] not in (["only"], ["just"])
                   for at, token in enumerate(before))


def _written(spoken: SpokenText, count: int) -> list[bool]:
    """For each of `count` words, True if it stands in prose: by the common words around it."""
    worth, number = [0] * (count + 1), [0] * (count + 1)
    for place, word in spoken.owners.items():
        token = spoken.text[place:spoken.text.index(" ", place)]
        worth[word + 1] += (token in _TALK) - (token in _PROSE)
        number[word + 1] += 1
    worth, number = list(itertools.accumulate(worth)), list(itertools.accumulate(number))
    out = []
    for word in range(count):
        first, last = max(word - _AROUND, 0), min(word + _AROUND + 1, count)
        around = number[last] - number[first]
        out.append(around >= _FEWEST and worth[last] - worth[first] < _LEAST_TALK * around)
    return out


def _guarded(meaning: MeaningClass, spoken: SpokenText, start: int, end: int) -> bool:
    """True if a phrase in which the cues of a meaning do not count overlaps these characters."""
    first, last = max(start - _NEAR, 0), end + _NEAR
    return any(a < end and start < b for guard in meaning.unless for a, b, _ in guard.matches(spoken, first, last))


def _best(calls: list[CalledGesture]) -> list[CalledGesture]:
    """Of calls that share a word the best; none where two labels are equally good."""
    out: list[CalledGesture] = []
    for call in sorted(calls, key=lambda call: (-call.score, call.word, call.label)):
        if not any(other.first <= call.last and call.first <= other.last for other in out):
            tied = any(other.score == call.score and other.label != call.label and other.word == call.word
                       for other in calls)
            out.append(replace(call, score=0.0) if tied else call)  # a tie still keeps worse calls from its words
    return sorted((call for call in out if call.score > 0.0), key=lambda call: call.word)


@functools.cache
def meaning_cues(language: str = "en") -> MeaningCues:
    """The cue phrases of a language; those of English for a language without its own."""
    language = language if language in LANGUAGES else "en"
    return MeaningCues([_class(row, language) for row in _table() if row.get(language)], language)


@functools.cache
def _table() -> tuple[Mapping[str, Any], ...]:
    return tuple(read_object(Path(__file__).with_name("meaning_cues.json"), "install the program again")["classes"])


def _class(row: Mapping[str, Any], language: str) -> MeaningClass:
    unless = row.get("unless" if language == "en" else f"unless_{language}", ())
    weight = row["weight"]
    return MeaningClass(row["label"], row.get("gesture", row["label"].replace("_", " ")), row.get("negated", False),
                        tuple(cue_pattern(cue, weight) for cue in row[language]),
                        tuple(cue_pattern(guard) for guard in unless))
