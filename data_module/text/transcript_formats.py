"""Readers of transcript files: plain text, TextGrid, TSV; and what the readers of subtitles and JSON share.

Each reader takes the text of a file and returns its words, or cues if there are no word times. Errors name the line.
Marks of gestures stay in the texts; `data_module.text.transcript` takes them out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from data_module.errors import InputError
from data_module.text.alignment import written_words
from data_module.text.marks import marked_text

SILENCES = frozenset({"", "sp", "sil", "<eps>", "<sil>", "<p>", "<p:>"})
"""Labels of aligners for silent intervals."""

# Possessive quantifiers (++) prevent backtracking, so that the time is linear in the length.
NUMBER = r"[-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?\d++)?+"
"""A number in TextGrids and label files."""
# The tokens of a TextGrid: quoted text, separate numbers, and a flag; everything else is for people. The last two are
# errors: an unclosed quote, and a value that is none of the three.
_TOKEN = re.compile(rf'"((?:[^"]++|"")*+)"|(?<![^\s=])({NUMBER})(?!\S)|(<exists>|<absent>)|"'
                    rf'|=[ \t]*(?!{NUMBER}(?!\S))[^\s"<]\S*')


@dataclass(frozen=True)
class Entry:
    """A word or a cue with its times in seconds, both None if unknown. where: its place, for messages; marks: names of
    the gesture marks before a word, which are no longer in its text."""

    text: str
    start: float | None
    end: float | None
    where: str
    guessed: bool = False
    marks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Content:
    """The content of a file: words, or cues (several words with one time), or text without times."""

    words: tuple[Entry, ...] = ()
    cues: tuple[Entry, ...] = ()
    text: str = ""


def plain(source: str, text: str, speaker: str | None = None) -> Content:
    return Content(text=text)


def textgrid(source: str, text: str, speaker: str | None = None) -> Content:
    """A Praat TextGrid in its long or its short form, as the Montreal Forced Aligner and others write it."""
    tokens = _Tokens(source, text)
    if not tokens.text().startswith("ooTextFile") or tokens.text() != "TextGrid":
        raise InputError(source, "is not a TextGrid", "save it from Praat as a text file or a short text file")
    tokens.number(), tokens.number()
    tokens.flag()
    tiers: dict[str, list[Entry]] = {}
    for _ in range(tokens.count()):
        kind, name = tokens.text(), tokens.text()
        if kind not in ("IntervalTier", "TextTier"):
            tokens.refuse(f"a tier of an unknown kind, {kind[:30]!r}")
        tokens.number(), tokens.number()
        entries = []
        for _ in range(tokens.count()):
            start = tokens.number()
            end = tokens.number() if kind == "IntervalTier" else start
            where = f"line {tokens.line}"
            entries.append(Entry(" ".join(tokens.text().split()), start, end, where))
        # Points hold tones and comments; of intervals with one name the first count.
        if kind == "IntervalTier":
            tiers.setdefault(name, entries)
    return Content(words=spoken_tier(source, tiers, speaker))


class _Tokens:
    """The tokens of a TextGrid one after the other; `line` is that of the last one."""

    def __init__(self, source: str, text: str) -> None:
        self.source, self.line, self._text, self._at = source, 1, text, 0
        self._found = _TOKEN.finditer(text)

    def _next(self) -> re.Match[str]:
        match = next(self._found, None)
        if match is None:
            raise InputError(self.source, f"ends in line {self._text.count(chr(10)) + 1}, before all that it announces",
                             "it is cut off: copy it again")
        self.line += self._text.count("\n", self._at, match.start())
        self._at = match.start()
        return match

    def refuse(self, problem: str) -> NoReturn:
        raise InputError(self.source, f"line {self.line}: {problem}", "save it again as a TextGrid")

    def text(self) -> str:
        match = self._next()
        if match[1] is None:
            self.refuse(f"a text in quotes was expected, not {match[0].lstrip('= ')[:40]}")
        return match[1].replace('""', '"')

    def number(self) -> float:
        match = self._next()
        if match[2] is None or not np.isfinite(float(match[2])):
            self.refuse(f"a number was expected, not {match[0].lstrip('= ')[:40]}")
        return float(match[2])

    def flag(self) -> None:
        if self._next()[3] != "<exists>":
            self.refuse("it has no tiers")

    def count(self) -> int:
        value = self.number()
        if not 0 <= value <= len(self._text) or value != int(value):
            self.refuse(f"{value:g} is not a number of entries")
        return int(value)


def spoken_tier(source: str, tiers: Mapping[str, Sequence[Entry]], speaker: str | None) -> tuple[Entry, ...]:
    """The tier of words; of several speakers' tiers that of `speaker`."""
    names = [name for name in tiers if re.fullmatch(r"(.*- ?)?words?", name.strip().lower())]
    if not names:
        listed = ", ".join(tiers) or "none"
        raise InputError(source, f"has no tier of words (its tiers: {listed[:100]})", "name the tier 'words'")
    if len(names) > 1:
        matching = [name for name in names if speaker and name.lower().startswith(speaker.lower())]
        if len(matching) != 1:
            raise InputError(source, f"holds the words of several speakers ({', '.join(names)[:100]})",
                             "leave one tier of words in it")
        names = matching
    return tuple(Entry("" if entry.text.lower() in SILENCES else entry.text, entry.start, entry.end, entry.where)
                 for entry in tiers[names[0]])


def tsv(source: str, text: str, speaker: str | None = None) -> Content:
    """Tab-separated start, end and text below a line with these names, as whisper writes it: whole numbers are
    milliseconds, others seconds."""
    lines = [(number, line.split("\t")) for number, line in enumerate(text.split("\n"), start=1) if line.strip()]
    if not lines or [name.strip().lower() for name in lines[0][1]] != ["start", "end", "text"]:
        raise InputError(source, "line 1: does not name the columns start, end and text",
                         "write them, with tabs between")
    for number, row in lines[1:]:
        if len(row) < 3 or not all(re.fullmatch(NUMBER, value.strip()) for value in row[:2]):
            raise InputError(source, f"line {number}: is not a start, an end and a text with tabs between",
                             "write it again")
    whole = all(value.strip().lstrip("+-").isdigit() for _, row in lines[1:] for value in row[:2])
    unit = 1e-3 if whole else 1.0
    entries = [Entry(" ".join(" ".join(row[2:]).split()), float(row[0]) * unit, float(row[1]) * unit,
                     f"line {number}") for number, row in lines[1:]]
    return Content(cues=tuple(entries))


def shared_in_cue(cue: Entry) -> list[Entry]:
    """The words of a cue, with its time shared by their length; and its gesture marks, each before its word."""
    assert cue.start is not None and cue.end is not None
    text, marks = marked_text(cue.text)
    words = written_words(text)
    share = np.cumsum([0.0] + [len(word) + 1.0 for word in words])
    edges = (cue.start + (cue.end - cue.start) * share / max(1.0, share[-1])).tolist()
    out: list[Entry] = []
    count = at = 0
    for offset, name in (*marks, (len(text), "")):
        first, at = at, offset
        begin, count = count, count + len(written_words(text[first:offset]))
        out += [Entry(word, a, b, cue.where, guessed=True)
                for word, a, b in zip(words[begin:count], edges[begin:], edges[begin + 1:], strict=False)]
        out += [Entry(f"[{name}]", edges[count], edges[count], cue.where)] if name else []
    return out
