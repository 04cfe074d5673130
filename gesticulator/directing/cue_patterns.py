"""Cue phrases as patterns of spoken words: `i|we do not *know` finds "we don't know" and marks its last word.

A pattern is a row of elements, one spoken word each: `a|b` one of them, `_` any word, `_ing` and `run~` any word with
this end or beginning, `a_b` two words, a trailing `?` an element that may be missing, a leading `*` the word that
carries the stroke. `^` and `$` stand for a boundary: the end of a sentence or a clause, or a pause. `,` and `?` stand
for themselves. A number in front of a pattern is its weight.
"""

from __future__ import annotations

import functools
import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

_BOUNDARY = "[,.?] "
_WORD = r"[\w'-]"
_WEIGHT = re.compile(r"0?\.\d+$")
_MARKS = {"^": _BOUNDARY, "$": _BOUNDARY, ",": ", ", "?": r"\? "}
_SHORT = {"i'm": "i am", "let's": "let us", "can't": "can not", "cannot": "can not", "won't": "will not",
          "shan't": "shall not", "ain't": "is not", "gonna": "going to", "gotta": "got to", "wanna": "want to",
          "y'all": "you all", "dunno": "do not know", "that's": "that is", "it's": "it is", "here's": "here is",
          "there's": "there is", "what's": "what is", "who's": "who is", "how's": "how is", "where's": "where is",
          "he's": "he is", "she's": "she is", "why's": "why is"}
_ENDINGS = (("n't", "not"), ("'re", "are"), ("'ve", "have"), ("'ll", "will"), ("'d", "would"))


@dataclass(frozen=True)
class SpokenText:
    """Words as patterns read them. text: lower case, short forms written out, `,` `.` `?` for boundaries, each followed
    by a space, and a boundary at both ends; owners: for each character of `text` that begins a word, the index of the
    written word."""

    text: str
    owners: dict[int, int] = field(repr=False)

    @functools.cached_property
    def places(self) -> list[int]:
        """Characters of `text` at which words begin, rising."""
        return list(self.owners)

    def words(self, start: int, end: int) -> tuple[int, int]:
        """The first and the last written word between two characters."""
        return (self.owners[self.places[bisect_left(self.places, start)]],
                self.owners[self.places[bisect_left(self.places, end) - 1]])

    @property
    def tokens(self) -> frozenset[str]:
        return frozenset(self.text.split())


def spoken_text(words: Sequence[str], pauses: Sequence[float] = ()) -> SpokenText:
    """The words of one or more sentences. pauses: seconds of silence after each word, if known; a third of a second
    counts as a comma, half a second as a full stop."""
    text, owners = ". ", {}
    for number, word in enumerate(words):
        lead, core, tail = _parted(word.lower().replace("\u2019", "'"))
        if lead and not text.endswith(_ends):
            text += ", "
        for part in _written_out(core):
            owners[len(text)] = number
            text += part + " "
        pause = pauses[number] if number < len(pauses) else 0.0
        mark = _boundary(tail, pause)
        if mark and not text.endswith(_ends):
            text += mark + " "
    return SpokenText(text if text.endswith(_ends) else text + ". ", owners)


_ends = (", ", ". ", "? ")


def _parted(word: str) -> tuple[str, str, str]:
    """Marks before the word, the word, and marks after it; a lone mark counts as one after."""
    places = [at for at, mark in enumerate(word) if mark.isalnum()]
    if not places:
        return "", "", word
    first, last = places[0], places[-1] + 1
    return word[:first].strip("'\"“”‘«([{*_"), word[first:last], word[last:]


def _boundary(tail: str, pause: float) -> str:
    if "?" in tail:
        return "?"
    if any(mark in tail for mark in ".!…。！") or pause >= 0.5:
        return "."
    return "," if any(mark in tail for mark in ",;:—–)") or tail in ("-", "--") or pause >= 0.33 else ""


def _written_out(core: str) -> list[str]:
    if core in _SHORT:
        return _SHORT[core].split()
    for ending, word in _ENDINGS:
        if core.endswith(ending) and len(core) > len(ending):
            return [core[:-len(ending)], word]
    return [core] if core else []


@dataclass(frozen=True)
class CuePattern:
    """A compiled pattern. weight: how sure it is, 0 to 1; keys: words one of which must be in the text, or () for
    none; length: elements that must be there."""

    source: str
    weight: float
    keys: tuple[str, ...]
    length: int
    _regex: re.Pattern[str] = field(repr=False)

    def matches(self, spoken: SpokenText, first: int = 0, last: int | None = None) -> Iterator[tuple[int, int, int]]:
        """(start, end, place of the stroke's word) of each match between two characters of the text."""
        for match in self._regex.finditer(spoken.text, first, len(spoken.text) if last is None else last):
            yield match.start(), match.end(), match.start("stroke") if "stroke" in match.groupdict() else match.start()


def cue_pattern(source: str, weight: float = 0.0) -> CuePattern:
    """Compile a pattern. weight: used where the pattern names none. ValueError for one without a word."""
    elements = source.split()
    if elements and _WEIGHT.match(elements[0]):
        weight, elements = float(elements[0]), elements[1:]
    if not any(re.search(r"[^\W_]", element) for element in elements):
        raise ValueError(f"the pattern {source!r} has no word")
    parts = ["(?<= )"]
    for at, element in enumerate(elements):
        parts.append(_element(element, at == 0, at == len(elements) - 1))
    keys = min((_alternatives(e) for e in elements if _is_key(e)), key=_commonness, default=())
    length = sum(not element.endswith("?") and element not in _MARKS for element in elements)
    return CuePattern(source, weight, keys, length, re.compile("".join(parts)))


def _element(element: str, first: bool, last: bool) -> str:
    mark, optional = element.rstrip("?") or "?", element.endswith("?") and element != "?"
    if mark in _MARKS:
        if mark in "^$" and not optional and (first or last):
            return f"(?<={_BOUNDARY})" if first else f"(?={_BOUNDARY})"
        return f"(?:{_MARKS[mark]})" + ("?" if optional else "")
    stroke, words = mark.startswith("*"), mark.lstrip("*")
    inner = "|".join(_word(one) for one in words.split("|"))
    whole = f"(?P<stroke>(?:{inner}) )" if stroke else f"(?:(?:{inner}) )"
    return whole + ("?" if optional else "")


def _word(one: str) -> str:
    if one == "_":
        return _WORD + "+"
    if one.startswith("_"):
        return _WORD + "+" + re.escape(one[1:])
    if one.endswith("~"):
        return re.escape(one[:-1]) + _WORD + "*"
    if one == "$":
        return "(?=[,.?])"
    return " ".join(re.escape(word) for word in one.split("_"))


def _alternatives(element: str) -> tuple[str, ...]:
    return tuple(one.split("_")[0] for one in element.lstrip("*").split("|"))


def _is_key(element: str) -> bool:
    """Whether one of the element's words must be in the text as it is written."""
    return not element.endswith("?") and element not in _MARKS and not any(
        one.startswith("_") or one.endswith("~") or one == "$" for one in element.lstrip("*").split("|"))


def _commonness(words: tuple[str, ...]) -> int:
    return sum(12 - min(len(word), 10) for word in words)
