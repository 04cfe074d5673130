"""Readers of transcript files: plain text, TextGrid, TSV; and what the readers of subtitles and JSON share.

Each reader takes the text of a file and returns its words, or cues if there are no word times. Errors name the line.
Marks of gestures stay in the texts; `data_module.text.transcript` takes them out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from data_module.errors import InputError
from data_module.text.alignment import written_words
from data_module.text.marks import marked_text

SILENCES = frozenset({"", "sp", "sil", "<eps>", "<sil>", "<p>", "<p:>"})
"""Labels of aligners for silent intervals."""

# Possessive quantifiers (++) prevent backtracking, so that the time is linear in the length.
NUMBER = r"[-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?\d++)?+"
"""A number in TextGrids and label files."""
# The tokens of a TextGrid: quoted text, separate numbers, and a flag; everything else is for people. The last one is an
# error, an unclosed quote.
_TOKEN = re.compile(rf'"((?:[^"]++|"")*+)"|(?<![^\s=])({NUMBER})(?!\S)|(<exists>)|"')


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
    tokens = _TOKEN.finditer(text)

    def word() -> str:
        return next(tokens)[1].replace('""', '"')

    def number() -> float:
        return float(next(tokens)[2])

    tiers: dict[str, list[Entry]] = {}
    try:
        if not word().startswith("ooTextFile") or word() != "TextGrid":
            raise ValueError
        number(), number(), next(tokens)[3].strip()
        for _ in range(int(number())):
            kind, name = word(), word()
            number(), number()
            entries = []
            for place in range(int(number())):
                start = number()
                end = number() if kind == "IntervalTier" else start
                entries.append(Entry(" ".join(word().split()), start, end, f"interval {place + 1} of {name[:40]}"))
            # Points hold tones and comments; of intervals with one name the first count.
            if kind == "IntervalTier":
                tiers.setdefault(name, entries)
    except (StopIteration, ValueError, TypeError, AttributeError, OverflowError):
        # A token of another kind is None.
        raise InputError(source, "is not a whole TextGrid with tiers", "save it from Praat as a text file") from None
    return Content(words=spoken_tier(source, tiers, speaker))


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
    rows = [(number, line.split("\t")) for number, line in enumerate(text.split("\n"), 1) if line.strip()]
    if not rows or [name.strip().lower() for name in rows[0][1]] != ["start", "end", "text"]:
        raise InputError(source, "line 1: does not name the columns start, end and text",
                         "write them, with tabs between")
    for number, row in rows[1:]:
        if len(row) < 3 or not all(re.fullmatch(NUMBER, value.strip()) for value in row[:2]):
            raise InputError(source, f"line {number}: is not a start, an end and a text with tabs between",
                             "write it again")
    whole = all(value.strip().lstrip("+-").isdigit() for _, row in rows[1:] for value in row[:2])
    unit = 1e-3 if whole else 1.0
    return Content(cues=tuple(
        Entry(" ".join(" ".join(row[2:]).split()), float(row[0]) * unit, float(row[1]) * unit, f"line {number}")
        for number, row in rows[1:]))


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
