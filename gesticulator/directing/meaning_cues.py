"""Which words of a speech call for a gesture with a meaning, and for which one: cue phrases with guards.

`meaning_cues.json` holds, for each meaning, cue phrases in English, German and Spanish, and phrases in which they do
not count: idioms, homonyms and other parts of speech. After a negation in the same clause only meanings that are
themselves negative or questions count. Where two meanings are equally good, there is none. In English prose that was
written to be read, cue phrases are worth less than in talk: it has more "of" and "which", and less "you".

Phrases are patterns of spoken words: `i|we do not *know` finds "we don't know" and marks its last word. A pattern is a
row of elements, one spoken word each: `a|b` one of them, `_` any word, `_ing` and `run~` any word with this end or
beginning, `a_b` two words, a trailing `?` an element that may be missing, a leading `*` the word that carries the
stroke. `^` and `$` stand for a boundary: the end of a sentence or a clause, or a pause. `,` and `?` stand for
themselves. A number in front of a pattern is its weight.
"""

import functools
import itertools
import re
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from data_module.files import read_object
from gesticulator.language import LANGUAGES

_BOUNDARY = "[,.?] "
_ENDS = (", ", ". ", "? ")
_LETTERS = r"[\w'-]"
_WEIGHT = re.compile(r"0?\.\d+$")
_MARKS = {"^": _BOUNDARY, "$": _BOUNDARY, ",": ", ", "?": r"\? "}
_SHORT = {"i'm": "i am", "let's": "let us", "can't": "can not", "cannot": "can not", "won't": "will not",
          "shan't": "shall not", "ain't": "is not", "gonna": "going to", "gotta": "got to", "wanna": "want to",
          "y'all": "you all", "dunno": "do not know", "that's": "that is", "it's": "it is", "here's": "here is",
          "there's": "there is", "what's": "what is", "who's": "who is", "how's": "how is", "where's": "where is",
          "he's": "he is", "she's": "she is", "why's": "why is"}
_ENDINGS = (("n't", "not"), ("'re", "are"), ("'ve", "have"), ("'ll", "will"), ("'d", "would"))
_FULL_STOP, _COMMA = 0.5, 0.33
"""Seconds of silence that count as a full stop and as a comma."""
_SCOPE = 4
"""Words after a negation that it may concern."""
_NEAR = 80
"""Characters around a phrase in which its guards are sought."""
_LONGER = 0.01
"""Added to the score for each further word of a cue phrase: the more specific phrase wins."""
_TALK = frozenset((
    "i", "me", "my", "you", "your", "we", "us", "our", "am", "let", "going", "got", "want", "know", "think", "get",
    "look", "well", "okay", "yeah", "yes", "thank", "do", "not", "what", "why", "that", "this", "just", "really", "so"))
_PROSE = frozenset(("of", "the", "which", "by", "upon", "such"))
_AROUND, _FEWEST, _LEAST_TALK, _WRITTEN = 35, 25, -0.05, 0.15
"""Words on both sides that tell talk from prose, and how many are needed; the least share of words of talk minus those
of prose; what is taken off the scores in prose."""
_NEGATIONS = {"en": "not no never nobody none nothing without hardly neither nor cannot",
              "de": "nicht kein keine keinen keiner nie niemals niemand ohne weder",
              "es": "no nunca nadie nada sin jamás ni tampoco"}


# ----------------------------------------------------------------------------------------------------- spoken text

@dataclass(frozen=True)
class SpokenText:
    """Words as patterns read them. text: lower case, short forms written out, `,` `.` `?` for boundaries, each followed
    by a space, and a boundary at both ends; owners: for each character of `text` that begins a word, the index of the
    written word, rising."""

    text: str
    owners: dict[int, int] = field(repr=False)

    @functools.cached_property
    def _places(self) -> list[int]:
        return list(self.owners)

    def words(self, start: int, end: int) -> tuple[int, int]:
        """The first and the last written word between two characters."""
        return (self.owners[self._places[bisect_left(self._places, start)]],
                self.owners[self._places[bisect_left(self._places, end) - 1]])


def spoken_text(words: Sequence[str], pauses: Sequence[float] = ()) -> SpokenText:
    """The words of one or more sentences. pauses: seconds of silence after each word, if known."""
    text, owners = ". ", {}
    for number, (word, pause) in enumerate(itertools.zip_longest(words, pauses[:len(words)], fillvalue=0.0)):
        word = str(word).lower().replace("\u2019", "'")
        # A lone mark counts as one after the word before.
        places = [at for at, mark in enumerate(word) if mark.isalnum()] or [0, -1]
        first, last = places[0], places[-1] + 1
        if word[:first].strip("'\"“”‘«([{*_") and not text.endswith(_ENDS):
            text += ", "
        for part in _written_out(word[first:last]):
            owners[len(text)] = number
            text += part + " "
        tail = word[last:]
        mark = "? " if "?" in tail else ". " if pause >= _FULL_STOP or any(mark in tail for mark in ".!…。！") else \
            ", " if pause >= _COMMA or tail in ("-", "--") or any(mark in tail for mark in ",;:—–)") else ""
        if not text.endswith(_ENDS):
            text += mark
    return SpokenText(text if text.endswith(_ENDS) else text + ". ", owners)


def _written_out(core: str) -> list[str]:
    for ending, word in _ENDINGS:
        if core not in _SHORT and core.endswith(ending) and len(core) > len(ending):
            return [core[:-len(ending)], word]
    return _SHORT.get(core, core).split()


# -------------------------------------------------------------------------------------------------------- patterns

@dataclass(frozen=True)
class CuePattern:
    """A compiled pattern. weight: how sure it is, 0 to 1; keys: words one of which must be in the text, or none;
    length: elements that must be there; regex: over `SpokenText.text`, with a group "stroke" or none."""

    source: str
    weight: float
    keys: frozenset[str]
    length: int
    regex: re.Pattern[str] = field(repr=False)


def cue_pattern(source: str, weight: float = 0.0) -> CuePattern:
    """Compile a pattern. weight: used where the pattern names none. ValueError for one without a word."""
    elements = source.split()
    if elements and _WEIGHT.match(elements[0]):
        weight, elements = float(elements[0]), elements[1:]
    if not any(re.search(r"[^\W_]", element) for element in elements):
        raise ValueError(f"the pattern {source!r} has no word")
    parts = [_element(element, at == 0, at == len(elements) - 1) for at, element in enumerate(elements)]
    # The rarest words of the phrase are the filter: long words are rarer than short ones.
    keys = max((_keys(element) for element in elements), key=lambda words: min(map(len, words), default=0))
    length = sum(not element.endswith("?") and element not in _MARKS for element in elements)
    return CuePattern(source, weight, frozenset(keys), length, re.compile("(?<= )" + "".join(parts)))


def _element(element: str, first: bool, last: bool) -> str:
    mark, optional = element.rstrip("?") or "?", "?" if element.endswith("?") and element != "?" else ""
    if mark in _MARKS:
        # A boundary at the edge of a phrase is not part of it, so that it may belong to the next phrase, too.
        if mark in "^$" and not optional and (first or last):
            return f"(?<={_BOUNDARY})" if first else f"(?={_BOUNDARY})"
        return f"(?:{_MARKS[mark]}){optional}"
    group, words = "?P<stroke>" if mark.startswith("*") else "?:", mark.lstrip("*").split("|")
    return f"({group}(?:{'|'.join(map(_word, words))}) ){optional}"


def _word(word: str) -> str:
    if word == "$":
        return "(?=[,.?])"
    if word.startswith("_"):
        return _LETTERS + "+" + re.escape(word[1:])
    if word.endswith("~"):
        return re.escape(word[:-1]) + _LETTERS + "*"
    return " ".join(map(re.escape, word.split("_")))


def _keys(element: str) -> list[str]:
    """Words one of which must be in the text as it is written; [] where others match, too."""
    words = element.lstrip("*").split("|")
    if element.endswith("?") or element in _MARKS or any(
            word.startswith("_") or word.endswith("~") or word == "$" for word in words):
        return []
    return [word.split("_")[0] for word in words]


# -------------------------------------------------------------------------------------------------------- meanings

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

    def guarded(self, spoken: SpokenText, start: int, end: int) -> bool:
        """Whether a phrase in which the cues do not count overlaps these characters."""
        return any(match.start() < end and start < match.end() for guard in self.unless
                   for match in guard.regex.finditer(spoken.text, max(start - _NEAR, 0), end + _NEAR))


class MeaningCues:
    """The cue phrases of one language."""

    def __init__(self, classes: Sequence[MeaningClass], language: str) -> None:
        self._classes, self._language = classes, language
        self._cues = [(meaning, cue) for meaning in classes for cue in meaning.cues]
        self._negations = frozenset(_NEGATIONS[language].split())

    @property
    def gestures(self) -> Mapping[str, str]:
        """Meaning -> the name of its gesture."""
        return {meaning.label: meaning.gesture for meaning in self._classes}

    def called(self, words: Sequence[str], pauses: Sequence[float] = ()) -> list[CalledGesture]:
        """The words that call for a gesture, in their order; of phrases that overlap the best one, or none on a tie.
        pauses: seconds of silence after each word, where they are known."""
        spoken = spoken_text(words, pauses)
        calls = sorted(self._candidates(spoken), key=lambda call: (call.first, call.word, call.label))
        if self._language == "en" and calls:
            written = _written(spoken, len(words))
            calls = [replace(call, score=round(call.score - _WRITTEN, 3)) if written[call.word] else call
                     for call in calls]
        return _best(calls)

    def _candidates(self, spoken: SpokenText) -> Iterator[CalledGesture]:
        """Every cue phrase that its guards let pass; they may overlap."""
        tokens = frozenset(spoken.text.split())
        for meaning, cue in self._cues:
            # Most of a thousand phrases have no word in the text: looking for one spares the regular expression.
            for match in cue.regex.finditer(spoken.text) if not cue.keys or cue.keys & tokens else ():
                start, end = match.span()
                if not meaning.guarded(spoken, start, end) and (meaning.negated or not self._negated(spoken, start)):
                    stroke = match.start("stroke") if "stroke" in cue.regex.groupindex else start
                    yield CalledGesture(spoken.owners[stroke], *spoken.words(start, end), meaning.label,
                                        meaning.gesture, round(min(cue.weight + _LONGER * (cue.length - 1), 1.0), 3),
                                        cue.source)

    def _negated(self, spoken: SpokenText, start: int) -> bool:
        """True if a negation stands in the same clause within `_SCOPE` words before a place."""
        before: list[str] = []
        for token in reversed(spoken.text[max(start - _NEAR, 0):start].split()):
            if token in (",", ".", "?") or len(before) == _SCOPE:
                break
            before.append(token)
        # "not only", "not just" say more, not less.
        return any(token in self._negations and before[at - 1:at] not in (["only"], ["just"])
                   for at, token in enumerate(before))


def _written(spoken: SpokenText, count: int) -> list[bool]:
    """For each of `count` words, True if it stands in prose: by the common words around it."""
    # Of each written word, what its spoken words are worth, and how many they are.
    worth = np.zeros((count, 2), dtype=int)
    for place, word in spoken.owners.items():
        token = spoken.text[place:spoken.text.index(" ", place)]
        worth[word] += (token in _TALK) - (token in _PROSE), 1
    around = [worth[max(word - _AROUND, 0):word + _AROUND + 1].sum(axis=0) for word in range(count)]
    return [bool(number >= _FEWEST and talk < _LEAST_TALK * number) for talk, number in around]


def _best(calls: list[CalledGesture]) -> list[CalledGesture]:
    """Of calls that share a word the best; none where two labels are equally good."""
    out: list[CalledGesture] = []
    for call in sorted(calls, key=lambda call: (-call.score, call.word, call.label)):
        if not any(other.first <= call.last and call.first <= other.last for other in out):
            tied = any(other.score == call.score and other.label != call.label and other.word == call.word
                       for other in calls)
            # A tie still keeps worse calls from its words.
            out.append(replace(call, score=0.0) if tied else call)
    return sorted((call for call in out if call.score > 0.0), key=lambda call: call.word)


@functools.cache
def meaning_cues(language: str = "en") -> MeaningCues:
    """The cue phrases of a language; those of English for a language without its own."""
    language = language if language in LANGUAGES else "en"
    guards = "unless" if language == "en" else f"unless_{language}"
    rows = read_object(Path(__file__).with_name("meaning_cues.json"), "install the program again")["classes"]
    return MeaningCues([MeaningClass(
        row["label"], row.get("gesture", row["label"].replace("_", " ")), row.get("negated", False),
        tuple(cue_pattern(cue, row["weight"]) for cue in row[language]),
        tuple(cue_pattern(guard) for guard in row.get(guards, ()))) for row in rows if row.get(language)], language)
