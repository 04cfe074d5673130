"""The files that hold what was said and when: TextGrid, subtitles, JSON.

Each reader takes the text of a file and gives its words, or whole cues where it times no words. What they cannot
read is refused with the line, or the place in the JSON.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from data_module.errors import InputError, shown
from data_module.json_files import parse_json
from data_module.text.alignment import written_words

SILENCES = frozenset({"", "sp", "sil", "<eps>", "<sil>", "<p>", "<p:>"})
"""What aligners write into an interval in which nobody speaks."""

# Possessive (++): what was matched is never given back, so that time grows with the length alone.
NUMBER = r"[-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?\d++)?+"
"""A number as TextGrids and label files write it; never tried twice, so linear."""
# What counts in a TextGrid: quoted text, numbers that stand alone, and a flag; everything else is for people. The last
# two are broken: a quote that nothing closes, and a value that is none of the three.
_TOKEN = re.compile(rf'"((?:[^"]++|"")*+)"|(?<![^\s=])({NUMBER})(?!\S)|(<exists>|<absent>)|"'
                    rf'|=[ \t]*(?!{NUMBER}(?!\S))[^\s"<]\S*')
_CLOCK = r"(?:(\d{1,4}):)?(\d{1,4}):(\d{1,4})(?:[.,](\d+))?"
_CUE = re.compile(rf"\s*{_CLOCK}\s*-->\s*{_CLOCK}(?:\s.*)?")
_NOT_SPOKEN = re.compile(r"<[^<>]*>|\{\\[^{}]*\}|\[[^\[\]]*\]")


@dataclass(frozen=True)
class Entry:
    """A word or a cue with its seconds, both None where the file does not tell. where: its place, for messages."""

    text: str
    start: float | None
    end: float | None
    where: str
    guessed: bool = False


@dataclass(frozen=True)
class Content:
    """What a file holds: words, or cues (several words under one time), or text without any time."""

    words: tuple[Entry, ...] = ()
    cues: tuple[Entry, ...] = ()
    text: str = ""


def plain(source: str, text: str, speaker: str | None = None) -> Content:
    """Text alone."""
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
        raise InputError(source, "is no TextGrid", "save it from Praat as a text file or a short text file")
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

    def refuse(self, found: str) -> NoReturn:
        raise InputError(self.source, f"line {self.line}: {found}", "save it again as a TextGrid")

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
            self.refuse(f"{value:g} is no number of entries")
        return int(value)


def _spoken_tier(source: str, tiers: Mapping[str, Sequence[Entry]], speaker: str | None) -> tuple[Entry, ...]:
    """The tier of words; of several speakers' tiers that of `speaker`."""
    names = [name for name in tiers if re.fullmatch(r"(.*- ?)?words?", name.strip().lower())]
    if not names:
        told = ", ".join(tiers) or "none"
        raise InputError(source, f"has no tier of words (its tiers: {told[:100]})", "name the tier 'words'")
    if len(names) > 1:
        own = [name for name in names if speaker and name.lower().startswith(speaker.lower())]
        if len(own) != 1:
            raise InputError(source, f"holds the words of several speakers ({', '.join(names)[:100]})",
                             "leave one tier of words in it")
        names = own
    return tuple(Entry("" if entry.text.lower() in SILENCES else entry.text, entry.start, entry.end, entry.where)
                 for entry in tiers[names[0]])


def srt(source: str, text: str, speaker: str | None = None) -> Content:
    """SubRip subtitles."""
    return Content(cues=tuple(_cues(source, text.split("\n"), 0, comments=False)))


def vtt(source: str, text: str, speaker: str | None = None) -> Content:
    """WebVTT subtitles."""
    lines = text.split("\n")
    if lines[0].split()[:1] != ["WEBVTT"]:
        raise InputError(source, "line 1: is no WebVTT, which begins with the word WEBVTT", "save it again, or as .srt")
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
            raise InputError(source, f"line {begin + clock + 1}: {block[clock].strip()[:60]!r} is no pair of times",
                             "write 00:00:01,000 --> 00:00:02,500")
        said = html.unescape(_NOT_SPOKEN.sub(" ", " ".join(block[clock + 1:])))
        times = match.groups()
        yield Entry(" ".join(said.split()), _clock(times[:4]), _clock(times[4:]), f"line {begin + clock + 1}")


def _clock(parts: Sequence[str | None]) -> float:
    hours, minutes, seconds, decimals = parts
    return int(hours or 0) * 3600 + int(minutes or 0) * 60 + float(f"{seconds}.{decimals or 0}")


def words_json(source: str, text: str, speaker: str | None = None) -> Content:
    """Words or segments with times as recognisers and aligners write them.

    {"words": [{"word" or "text", "start", "end"}]}, {"segments": [{"start", "end", "text", "words"}]} (whisper), a bare
    list of either, {"tiers": {"words": {"entries": [[start, end, word]]}}} (Montreal Forced Aligner), or {"text"}.
    """
    told = parse_json(text, source, "write it again")
    if isinstance(told, Mapping):
        if isinstance(told.get("words"), list):
            return Content(words=tuple(_entry(source, item, f"words[{n}]") for n, item in enumerate(told["words"])))
        if isinstance(told.get("segments"), list):
            return _segments(source, told["segments"], "segments")
        if isinstance(told.get("tiers"), Mapping):
            return Content(words=_json_tier(source, told["tiers"], speaker))
        if isinstance(told.get("text"), str):
            return Content(text=told["text"])
    if isinstance(told, list):
        if any(isinstance(item, Mapping) and "words" in item for item in told):
            return _segments(source, told, "")
        entries = tuple(_entry(source, item, f"[{n}]") for n, item in enumerate(told))
        # "well-known" is a word, "well known" is not, and neither is a sentence of a script without spaces.
        several = any(len(written_words(entry.text.replace("-", ""))) > 1 for entry in entries)
        return _segments(source, told, "") if several else Content(words=entries)
    raise InputError(source, "holds neither words nor segments",
                     'write {"words": [{"word": "hello", "start": 0.1, "end": 0.4}]}')


def _entry(source: str, item: object, where: str) -> Entry:
    """A JSON object as a word or a segment; times may both be missing (a word that was not found in the sound)."""
    if not isinstance(item, Mapping):
        raise InputError(source, f"{where}: is no object with a word and its times", "write it again")
    said = item.get("word", item.get("text"))
    if not isinstance(said, str):
        raise InputError(source, f"{where}: has no word", "give it a 'word' or a 'text'")
    start, end = item.get("start"), item.get("end")
    if start is None and end is None:
        return Entry(" ".join(said.split()), None, None, where)
    return Entry(" ".join(said.split()), _seconds(source, start, f"{where}.start"),
                 _seconds(source, end, f"{where}.end"), where)


def _seconds(source: str, value: object, where: str) -> float:
    try:
        if isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(float(value)):
            return float(value)
    except OverflowError:
        pass
    raise InputError(source, f"{where}: {shown(value, 30)!r} is no time", "give seconds")


def _segments(source: str, items: Sequence[Any], name: str) -> Content:
    """Segments as cues; where some have words, the words, and the other segments' words by their length."""
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
    """The words of a cue, which share out its time by their length."""
    assert cue.start is not None and cue.end is not None
    words = written_words(cue.text)
    share = np.cumsum([0.0] + [len(word) + 1.0 for word in words])
    edges = cue.start + (cue.end - cue.start) * share / max(1.0, share[-1])
    return [Entry(word, float(a), float(b), cue.where, guessed=True)
            for word, a, b in zip(words, edges, edges[1:], strict=False)]


def _json_tier(source: str, told: Mapping[str, Any], speaker: str | None) -> tuple[Entry, ...]:
    tiers = {}
    for name, tier in told.items():
        rows = tier.get("entries") if isinstance(tier, Mapping) else None
        if not isinstance(rows, list) or not all(isinstance(row, list) and len(row) == 3 for row in rows):
            continue
        tiers[name] = [_entry(source, {"start": a, "end": b, "word": word}, f"tiers.{name}[{n}]")
                       for n, (a, b, word) in enumerate(rows)]
    return _spoken_tier(source, tiers, speaker)
