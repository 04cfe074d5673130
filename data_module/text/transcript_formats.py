"""Readers of transcript files: TextGrid, subtitles, JSON.

Each reader takes the text of a file and returns its words, or cues if there are no word times. Errors name the line, or
the place in the JSON.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from data_module.errors import InputError, shown
from data_module.files import parse_json
from data_module.text.alignment import written_words

SILENCES = frozenset({"", "sp", "sil", "<eps>", "<sil>", "<p>", "<p:>"})
"""Labels of aligners for silent intervals."""

# Possessive quantifiers (++) prevent backtracking, so that the time is linear in the length.
NUMBER = r"[-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?\d++)?+"
"""A number in TextGrids and label files."""
# The tokens of a TextGrid: quoted text, separate numbers, and a flag; everything else is for people. The last two are
# errors: an unclosed quote, and a value that is none of the three.
_TOKEN = re.compile(rf'"((?:[^"]++|"")*+)"|(?<![^\s=])({NUMBER})(?!\S)|(<exists>|<absent>)|"'
                    rf'|=[ \t]*(?!{NUMBER}(?!\S))[^\s"<]\S*')
_CLOCK = r"(?:(\d{1,4}):)?(\d{1,4}):(\d{1,4})(?:[.,](\d+))?"
_CUE = re.compile(rf"\s*{_CLOCK}\s*-->\s*{_CLOCK}(?:\s.*)?")
_NOT_SPOKEN = re.compile(r"<[^<>]*>|\{\\[^{}]*\}|\[[^\[\]]*\]")


@dataclass(frozen=True)
class Entry:
    """A word or a cue with its times in seconds, both None if unknown. where: its place, for messages."""

    text: str
    start: float | None
    end: float | None
    where: str
    guessed: bool = False


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
    intervals = {name: entries for name, (kind, entries) in textgrid_tiers(source, text).items()
                 if kind == "IntervalTier"}
    return Content(words=_spoken_tier(source, intervals, speaker))


def textgrid_tiers(source: str, text: str) -> dict[str, tuple[str, list[Entry]]]:
    """By name each tier's kind and entries; a point has one time twice. Of tiers of one name the first counts."""
    tokens = _Tokens(source, text)
    if not tokens.text().startswith("ooTextFile") or tokens.text() != "TextGrid":
        raise InputError(source, "is not a TextGrid", "save it from Praat as a text file or a short text file")
    tokens.number(), tokens.number()
    tokens.flag()
    tiers: dict[str, tuple[str, list[Entry]]] = {}
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
        if tiers.get(name, ("",))[0] != "IntervalTier":
            tiers[name] = kind, entries
    return tiers


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


def _spoken_tier(source: str, tiers: Mapping[str, Sequence[Entry]], speaker: str | None) -> tuple[Entry, ...]:
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


def srt(source: str, text: str, speaker: str | None = None) -> Content:
    return Content(cues=tuple(_cues(source, text.split("\n"), 0, comments=False)))


def vtt(source: str, text: str, speaker: str | None = None) -> Content:
    lines = text.split("\n")
    if lines[0].split()[:1] != ["WEBVTT"]:
        raise InputError(source, "line 1: is not WebVTT, which begins with WEBVTT", "save it again, or as .srt")
    # The header's own lines end at the first empty line.
    first = next((n for n, line in enumerate(lines) if not line.strip() or "-->" in line), len(lines))
    return Content(cues=tuple(_cues(source, lines, first, comments=True)))


def _cues(source: str, lines: Sequence[str], first: int, *, comments: bool) -> Iterator[Entry]:
    """The cues from line `first` on: an optional name, a line with two times, lines of text, an empty line."""
    at = first
    while at < len(lines):
        begin = at
        while at < len(lines) and lines[at].strip():
            at += 1
        block = lines[begin:at]
        at += 1
        if not block or (comments and re.match(r"(NOTE|STYLE|REGION)\b", block[0])) \
                or (len(block) == 1 and block[0].strip().isdigit()):
            continue
        clock = next((n for n, line in enumerate(block[:2]) if "-->" in line), None)
        if clock is None:
            raise InputError(source, f"line {begin + 1}: no times (START --> END) above {block[0].strip()[:30]!r}",
                             "write 00:00:01,000 --> 00:00:02,500 above each cue")
        match = _CUE.fullmatch(block[clock])
        if match is None:
            raise InputError(source, f"line {begin + clock + 1}: {block[clock].strip()[:60]!r} is not a pair of times",
                             "write 00:00:01,000 --> 00:00:02,500")
        spoken = html.unescape(_NOT_SPOKEN.sub(" ", " ".join(block[clock + 1:])))
        times = match.groups()
        yield Entry(" ".join(spoken.split()), _clock(times[:4]), _clock(times[4:]), f"line {begin + clock + 1}")


def _clock(parts: Sequence[str | None]) -> float:
    hours, minutes, seconds, decimals = parts
    return int(hours or 0) * 3600 + int(minutes or 0) * 60 + float(f"{seconds}.{decimals or 0}")


def words_json(source: str, text: str, speaker: str | None = None) -> Content:
    """Words or segments with times in the formats of recognisers and aligners. {"words": [{"word" or "text", "start",
    "end"}]}, {"segments": [{"start", "end", "text", "words"}]} (whisper), a bare list of either, {"tiers": {"words":
    {"entries": [[start, end, word]]}}} (Montreal Forced Aligner), or {"text"}."""
    content = parse_json(text, source, "write it again")
    if isinstance(content, Mapping):
        if isinstance(content.get("words"), list):
            return Content(words=tuple(_entry(source, item, f"words[{n}]") for n, item in enumerate(content["words"])))
        if isinstance(content.get("segments"), list):
            return _segments(source, content["segments"], "segments")
        if isinstance(content.get("tiers"), Mapping):
            return Content(words=_json_tier(source, content["tiers"], speaker))
        if isinstance(content.get("text"), str):
            return Content(text=content["text"])
    if isinstance(content, list):
        if any(isinstance(item, Mapping) and "words" in item for item in content):
            return _segments(source, content, "")
        entries = tuple(_entry(source, item, f"[{n}]") for n, item in enumerate(content))
        # "well-known" is one word, "well known" is two, and a sentence of a script without spaces has several.
        several = any(len(written_words(entry.text.replace("-", ""))) > 1 for entry in entries)
        return _segments(source, content, "") if several else Content(words=entries)
    raise InputError(source, "holds neither words nor segments",
                     'write {"words": [{"word": "hello", "start": 0.1, "end": 0.4}]}')


def _entry(source: str, item: object, where: str) -> Entry:
    """A JSON object as a word or a segment; both times may be missing (for a word that was not aligned)."""
    if not isinstance(item, Mapping):
        raise InputError(source, f"{where}: is not an object with a word and its times", "write it again")
    word = item.get("word", item.get("text"))
    if not isinstance(word, str):
        raise InputError(source, f"{where}: has no word", "give it a 'word' or a 'text'")
    start, end = item.get("start"), item.get("end")
    if start is None and end is None:
        return Entry(" ".join(word.split()), None, None, where)
    return Entry(" ".join(word.split()), _seconds(source, start, f"{where}.start"),
                 _seconds(source, end, f"{where}.end"), where)


def _seconds(source: str, value: object, where: str) -> float:
    try:
        if isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(float(value)):
            return float(value)
    except OverflowError:
        pass
    raise InputError(source, f"{where}: {shown(value, 30)!r} is not a time", "give seconds")


def _segments(source: str, items: Sequence[Any], name: str) -> Content:
    """Segments as cues; if some have words, the words, and those of the other segments spread by their length."""
    cues: list[Entry] = []
    words: list[Entry] = []
    for n, item in enumerate(items):
        where = f"{name}[{n}]"
        inner = item.get("words") if isinstance(item, Mapping) else None
        if isinstance(inner, list) and inner:
            words += [_entry(source, word, f"{where}.words[{k}]") for k, word in enumerate(inner)]
            continue
        cue = _entry(source, item, where)
        if cue.start is None or cue.end is None:
            raise InputError(source, f"{where}: has no times", "give it 'start' and 'end' in seconds")
        cues.append(cue)
        words += shared_in_cue(cue)
    return Content(cues=tuple(cues)) if len(cues) == len(items) else Content(words=tuple(words))


def shared_in_cue(cue: Entry) -> list[Entry]:
    assert cue.start is not None and cue.end is not None
    words = written_words(cue.text)
    share = np.cumsum([0.0] + [len(word) + 1.0 for word in words])
    edges = cue.start + (cue.end - cue.start) * share / max(1.0, share[-1])
    return [Entry(word, float(a), float(b), cue.where, guessed=True)
            for word, a, b in zip(words, edges, edges[1:], strict=False)]


def _json_tier(source: str, content: Mapping[str, Any], speaker: str | None) -> tuple[Entry, ...]:
    tiers = {}
    for name, tier in content.items():
        rows = tier.get("entries") if isinstance(tier, Mapping) else None
        if not isinstance(rows, list) or not all(isinstance(row, list) and len(row) == 3 for row in rows):
            continue
        tiers[name] = [_entry(source, {"start": a, "end": b, "word": word}, f"tiers.{name}[{n}]")
                       for n, (a, b, word) in enumerate(rows)]
    return _spoken_tier(source, tiers, speaker)
