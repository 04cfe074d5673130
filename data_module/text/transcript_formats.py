"""Readers of transcript files: plain text, TextGrid, tables, subtitles; and what they share with that of JSON.

Each reader takes the text of a file and returns its words, or cues if there are no word times. Errors name the line.
Marks of gestures stay in the texts; `data_module.text.transcript` takes them out.

Recognisers write the times of words into subtitles in two ways: a cue for each word, with the whole line in it and the
word in <u>, <b>, <font> or <c> (whisper and whisperX with highlighted words, stable-ts); or a time in angle brackets
before each word (WebVTT; rolling captions repeat the line above).
"""

import html
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.errors import InputError
from data_module.text.alignment import written_words
from data_module.text.marks import is_mark, marked_text

SILENCES = frozenset({"", "sp", "sil", "<eps>", "<sil>", "<p>", "<p:>"})
"""Labels of aligners for silent intervals."""

# Possessive quantifiers (++) prevent backtracking, so that the time is linear in the length.
NUMBER = r"[-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?\d++)?+"
"""A number in TextGrids and label files."""
# The tokens of a TextGrid: quoted text, separate numbers, and a flag; everything else is for people. The last one is an
# error, an unclosed quote.
_TOKEN = re.compile(rf'"((?:[^"]++|"")*+)"|(?<![^\s=])({NUMBER})(?!\S)|(<exists>)|"')
_CLOCK = r"(?:(\d{1,4}):)?(\d{1,4}):(\d{1,4})(?:[.,](\d+))?"
_CUE = re.compile(rf"\s*{_CLOCK}\s*-->\s*{_CLOCK}(?:\s.*)?")
# Tags, positions of the SubStation kind, descriptions of sounds, and names of unknown speakers.
_NOT_SPOKEN = re.compile(r"<[^<>]*>|\{\\[^{}]*\}|\[[^\[\]]*\]|\bSPEAKER_\d+:")
_BETWEEN_WORDS = re.compile(r"\[|<(\w+:)?br\b")
# Duration of a word without times and without timed neighbours, seconds: the mean of spoken English.
_UNTIMED = 0.3
_INNER = re.compile(rf"<{_CLOCK}>")
_HIGHLIGHT = re.compile(r"<(u|b|font|c)(?:[ .][^<>]*)?>([^<>]*)</\1>", re.IGNORECASE)


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
    """Tab-separated start, end and text. Below a line with these names, as whisper writes it, the texts are cues; whole
    numbers are milliseconds, others seconds. Without that line, as the GENEA challenges give it, the texts are words
    and all times seconds; a row without text is a silence, and "#" (laughter) is no word."""
    rows = [(number, line.split("\t")) for number, line in enumerate(text.split("\n"), 1) if line.strip()]
    headed = bool(rows) and [name.strip().lower() for name in rows[0][1]] == ["start", "end", "text"]
    if rows and not headed and not _timed(rows[0][1]):
        raise InputError(source, "line 1: does not name the columns start, end and text",
                         "write them, with tabs between")
    for number, row in rows[headed:]:
        if not _timed(row) or (headed and len(row) < 3):
            raise InputError(source, f"line {number}: is not a start, an end and a text with tabs between",
                             "write it again")
    whole = headed and all(value.strip().lstrip("+-").isdigit() for _, row in rows[1:] for value in row[:2])
    unit = 1e-3 if whole else 1.0
    entries = tuple(Entry(" ".join(" ".join(row[2:]).split()), float(row[0]) * unit, float(row[1]) * unit,
                          f"line {number}") for number, row in rows[headed:])
    if headed:
        return Content(cues=entries)
    return Content(words=tuple(replace(entry, text=entry.text.replace("#", "").strip()) for entry in entries))


_CTM = re.compile(rf"^(\S+) +\S+ +({NUMBER}) +({NUMBER}) +(\S+).*$|^;;.*$", re.M)


def ctm(source: str, text: str, speaker: str | None = None) -> Content:
    """CTM, as NeMo and Kaldi write it: rows of recording, channel, start, length and word."""
    if len(recordings := {row[1] for row in _CTM.finditer(text) if row[1]}) > 1:
        raise InputError(source, f"holds the words of {len(recordings)} recordings", "leave those of one in it")
    return tsv(source, _CTM.sub(
        lambda row: f"{row[2]}\t{float(row[2]) + float(row[3])}\t{row[4]}" if row[1] else "", text))


def comma_separated(source: str, text: str, speaker: str | None = None) -> Content:
    """The same as `tsv` with commas, as whisper.cpp writes it."""
    return tsv(source, re.sub(r'^([^,\n]*),([^,\n]*),"?(.*?)"?$', r"\1\t\2\t\3", text, flags=re.M))


def _timed(row: Sequence[str]) -> bool:
    """Whether a row begins with a start and an end."""
    return len(row) >= 2 and all(re.fullmatch(NUMBER, value.strip()) for value in row[:2])


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


def filled(entries: Sequence[Entry], begin: float | None = None, end: float | None = None) -> list[Entry]:
    """Entries with times for those that have none: a run shares the gap between its neighbours; at an end it reaches to
    `begin` or `end`, or has a usual length."""
    out: list[Entry] = []
    for timed, group in itertools.groupby(entries, lambda entry: entry.start is not None):
        run = list(group)
        if timed:
            out += run
            continue
        after = entries[len(out) + len(run)].start if len(out) + len(run) < len(entries) else end
        start = out[-1].end if out else begin
        if start is None:
            start = max(0.0, (after or 0.0) - _UNTIMED * len(run))
        last = max(start, after) if after is not None else start + _UNTIMED * len(run)
        edges = np.linspace(start, last, len(run) + 1).tolist()
        out += [replace(e, start=a, end=b, guessed=True) for e, a, b in zip(run, edges, edges[1:], strict=False)]
    return out


# ---------------------------------------------------------------------------------------------------- subtitles

def timed_lines(source: str, text: str, speaker: str | None = None) -> Content:
    """SubRip, WebVTT, SubStation, SBV and LRC, by the file's suffix; a line of LRC lasts until the next one."""
    for row in re.finditer(r"^\s*\d+:[^>\n]*-->.*$", text, re.M):
        if _CUE.fullmatch(row[0]) is None:
            raise InputError(source, f"line {text.count(chr(10), 0, row.end()) + 1}: {row[0].strip()[:60]!r} is not a "
                             "pair of times", "write 00:00:01,000 --> 00:00:02,500")
    cues: list[Entry] = []
    number, at = 1, 0
    for match in TIMED_LINES[source[source.rindex("."):].lower()].finditer(text):
        *clock, line = match.groups()
        start = _clock(clock[:4])
        if cues and len(clock) == 4:
            cues[-1] = replace(cues[-1], end=max(start, cues[-1].start or 0.0))
        # The last line of LRC has no end: its words are counted from the last time in it.
        inner = [*_INNER.finditer(line)]
        known, rest = (_clock(inner[-1].groups()), line[inner[-1].end():]) if inner else (start, line)
        end = known + usual_length(plain_text(rest))
        if len(clock) > 4:
            end = _clock(clock[4:])
        number, at = number + text.count("\n", at, match.start(3)), match.start(3)
        cue = Entry(line.replace("\\N", " "), start, end, f"line {number}")
        # NeMo's aligner shows a line anew for each word, in other colours.
        if cues and "\\c&" in line and plain_text(cues[-1].text) == plain_text(cue.text):
            cues[-1] = replace(cues[-1], end=end)
        else:
            cues.append(cue)
    return content_of(cues)


TIMED_LINES = {
    # In WebVTT a line of spaces is a line; rolling captions have one above the first.
    **dict.fromkeys((".srt", ".vtt"), re.compile(
        rf"^[ \t]*{_CLOCK}[ \t]*-->[ \t]*{_CLOCK}(?:[ \t].*)?$((?:\n.+(?:\n.*\S.*)*)?)", re.M)),
    **dict.fromkeys((".ass", ".ssa"), re.compile(rf"^Dialogue:[^,\n]*,{_CLOCK},{_CLOCK},(?:[^,\n]*,){{6}}(.*)$",
                                                 re.M)),
    ".lrc": re.compile(rf"^\[{_CLOCK}\](.*)$", re.M), ".sbv": re.compile(rf"^{_CLOCK},{_CLOCK}\n((?:.+\n?)+)", re.M)}
"""By suffix: the time of a line, that of its end where it has one, and the text."""


def content_of(cues: Sequence[Entry]) -> Content:
    # One time inside a line is enough: the first word of each line has the time of its cue.
    if any(_INNER.search(cue.text) for cue in cues):
        return Content(words=tuple(_timed_inside(cues)))
    lines = _highlighted_lines(cues)
    if lines is None:
        return Content(cues=tuple(replace(cue, text=plain_text(cue.text)) for cue in cues))
    return Content(words=tuple(word for line in lines for word in _words_of_line(line)))


def usual_length(text: str) -> float:
    """Seconds that a text without times takes."""
    return _UNTIMED * len(written_words(marked_text(text)[0]))


def plain_text(text: str) -> str:
    """A line as it is spoken: without tags and notes in brackets; marks of gestures stay."""
    # A tag may stand inside of a word, unless it is a break.
    spoken = _NOT_SPOKEN.sub(
        lambda note: note[0] if is_mark(note[0]) else " " if _BETWEEN_WORDS.match(note[0]) else "", text)
    return " ".join(html.unescape(spoken).split())


def _clock(parts: Sequence[str | None]) -> float:
    hours, minutes, seconds, decimals = parts
    return int(hours or 0) * 3600 + int(minutes or 0) * 60 + float(f"{seconds}.{decimals or 0}")


# ------------------------------------------------------------------------------------------ highlighted words

def _highlight(cue: Entry) -> tuple[int, int] | None:
    """Where the one highlighted word of a cue begins and ends among the words of its text; None without one."""
    spans = list(_HIGHLIGHT.finditer(cue.text))
    if len(spans) != 1:
        return None
    before, inside = (len(plain_text(part).split()) for part in (cue.text[:spans[0].start()], spans[0][2]))
    return (before, before + inside) if inside else None


def _highlighted_lines(cues: Sequence[Entry]) -> list[list[Entry]] | None:
    """The cues of each line, if one line is shown several times with one word after the other highlighted; else None.
    """
    lines: list[list[Entry]] = []
    place = 0
    repeated = False
    for cue in cues:
        span = _highlight(cue)
        # The highlight only moves forward in a line; a step back means that the line is spoken again.
        again = bool(lines) and plain_text(lines[-1][-1].text) == plain_text(cue.text) and (
            span is None or span[0] >= place)
        if again:
            lines[-1].append(cue)
            repeated = repeated or (span is not None and place > 0)
        else:
            lines.append([cue])
            place = 0
        place = span[1] if span is not None else place
    return lines if repeated else None


def _words_of_line(cues: Sequence[Entry]) -> list[Entry]:
    """The words of a line with the times at which each is highlighted; a line without highlights is spread over its
    time, and other words have no times."""
    tokens = plain_text(cues[0].text).split()
    words: list[Entry] = []
    at = 0
    for cue in cues:
        span = _highlight(cue)
        if span is None or span[0] < at:
            continue
        # Words that were never highlighted are filled in between later.
        words += [Entry(token, None, None, cue.where) for token in tokens[at:span[0]]]
        words.append(Entry(" ".join(tokens[span[0]:span[1]]), cue.start, cue.end, cue.where))
        at = span[1]
    if not words:
        return shared_in_cue(Entry(plain_text(cues[0].text), cues[0].start, cues[-1].end, cues[0].where))
    return words + [Entry(token, None, None, cues[-1].where) for token in tokens[at:]]


# ---------------------------------------------------------------------------------------- times inside of cues

def _timed_inside(cues: Sequence[Entry]) -> Iterator[Entry]:
    """The words of cues with times inside; a line that repeats one of the cue before is left out."""
    before: list[str] = []
    for cue in cues:
        lines = [plain_text(line) for line in cue.text.split("\n")]
        for line, plain in zip(cue.text.split("\n"), lines, strict=True):
            # A rolling caption shows the line before once more, without times.
            if plain and (plain not in before or _INNER.search(line)):
                yield from _pieces(line, cue)
        before = lines


def _pieces(line: str, cue: Entry) -> Iterator[Entry]:
    """The words of a line with times inside: each piece lasts from its time to the next one."""
    assert cue.start is not None and cue.end is not None
    starts = [cue.start, *(_clock(match.groups()) for match in _INNER.finditer(line)), cue.end]
    ends = [0, *(edge for match in _INNER.finditer(line) for edge in match.span()), len(line)]
    for (start, end), first, last in zip(itertools.pairwise(starts), ends[::2], ends[1::2], strict=True):
        text = plain_text(line[first:last])
        piece = Entry(text, start, max(start, end), cue.where)
        if len(written_words(marked_text(text)[0])) > 1:
            yield from shared_in_cue(piece)
        elif text:
            yield piece
