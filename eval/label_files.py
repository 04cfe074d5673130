"""Files in which people mark moments by hand: which moments, in seconds, whatever program wrote them.

The layout is chosen by what the file holds, not by its name:

- a TextGrid of Praat or ELAN (long or short form), point tier or interval tier: the entries that have a text;
- a label track of Audacity: START tab END tab LABEL, or two numbers with a tab between;
- JSON: a list of numbers, of [time, label] or of objects with "time" (or "start"), bare or below "beats", "labels",
  "onsets", "strokes" or "times";
- plain text: one number a line, with an optional label behind it; `#` begins a remark;
- a table with a head (comma, semicolon or tab): the column that the caller names, else one of `COLUMNS`. With a column
  of `FILES` it is a table of many recordings, one mark a row.

Anything else is refused with the line. A mark that lasts has three moments; `at` chooses.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError, shown
from data_module.files import read_text
from data_module.text.transcript_formats import NUMBER, SILENCES, textgrid_tiers
from data_module.types import Array

COLUMNS = ("time", "seconds", "second", "sec", "t", "timestamp", "beat", "beats", "onset", "emphasis", "start")
"""Heads of a column of moments, the first that is there."""
FILES = ("file", "recording", "clip", "name")
"""Heads of a column that tells which recording a row belongs to."""
AT = ("start", "middle", "end")
OTHERS = frozenset({".bvh", ".npz", ".npy", ".fbx", ".wav", ".flac", ".ogg", ".mp3", ".mp4", ".avi", ".mov", ".srt",
                    ".vtt", ".pdf", ".md"})
"""Endings of what lies beside labels and is none."""

_LISTS = ("beats", "labels", "onsets", "strokes", "times")
_WANTED = re.compile(r"beat|emphas|stroke|gesture|onset|apex", re.IGNORECASE)
_ADVICE = ("give seconds, one a line; a table with a head (time,label); an Audacity label track; a Praat TextGrid "
           "(ELAN exports one); or a JSON list")
_LARGEST = 1e300
"""Of a number in JSON: a larger whole number has no float."""
_LATEST = 1e6
"""Seconds (eleven days) into a recording: a later time is no moment of it."""
# Possessive (++): what was matched is never given back, so that time grows with the length alone.
_NUMBER = re.compile(rf"\s*+({NUMBER})\s*+")
_LINE = re.compile(rf"\s*+(?P<time>{NUMBER})(?:(?P<between>\s*[;,]\s*+|\s++)(?P<rest>.*)|)")

Mark = tuple[float, float]


@dataclass(frozen=True)
class Labels:
    """Moments that somebody marked in one recording. times: [n] seconds, rising; layout: what the file was read as."""

    times: Array
    layout: str


@dataclass(frozen=True)
class LabelChoice:
    """What to take of a file that holds more than moments.

    at: of a mark that lasts its "start", "middle" or "end". tier: of a TextGrid. column: of a table. rate: marks a
    second, where the file counts frames (20) or milliseconds (1000) and not seconds.
    """

    at: str = "start"
    tier: str | None = None
    column: str | None = None
    rate: float = 1.0

    def __post_init__(self) -> None:
        if self.at not in AT:
            raise InputError("--at", f"is {self.at!r}", f"choose among {', '.join(AT)}")
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise InputError("--label-fps", f"is {self.rate:g}", "give a positive number of frames a second")


def read_recordings(path: Path, choice: LabelChoice | None = None) -> dict[str, Labels]:
    """The moments of a file by what it calls each recording: a column of `FILES`; "" where it names none.

    InputError for a file of another kind, one without marks, or marks before 0.
    """
    choice = choice or LabelChoice()
    text = read_text(path, _ADVICE)
    marks: dict[str, list[Mark]] = {}
    if text.lstrip()[:1] in ("[", "{"):
        layout, marks[""] = "JSON", _of_json(path, text)
    elif "ooTextFile" in text[:200]:
        layout, marks[""] = "TextGrid", _of_textgrid(path, text, choice.tier)
    elif "-->" in text:
        raise InputError(path, "holds subtitles, which time what is said and no gestures", _ADVICE)
    elif not (rows := _rows(text)) or _LINE.fullmatch(rows[0][1]):
        layout, marks[""] = _of_numbers(path, rows)
    else:
        for name, mark in _of_table(path, text, choice.column):
            marks.setdefault(name, []).append(mark)
        layout = "table" if "" in marks else "table of recordings"
    if not any(marks.values()):
        raise InputError(path, "holds no labels", _ADVICE)
    return {name: Labels(_moments(path, own, choice), layout) for name, own in marks.items()}


def read_labels(path: Path, choice: LabelChoice | None = None) -> Labels:
    """The moments of a file of one recording; InputError as in `read_recordings`, and where it holds several."""
    first, *others = read_recordings(path, choice).values()
    if others:
        raise InputError(path, "holds the labels of several recordings", "name all of them (--motion DIR, --store)")
    return first


def find_labels(folder: Path, name: str) -> Path | None:
    """The label file of a recording below a folder: NAME.*, or NAME and something after it (NAME_beats.txt).

    None where there is none; InputError where there are several. Motion, sound, films and subtitles are no labels.
    """
    found = [file for file in sorted(folder.rglob("*")) if file.is_file() and file.suffix.lower() not in OTHERS
             and re.fullmatch(rf"{re.escape(name)}(?![0-9A-Za-z]).*", file.name)]
    if len(found) > 1:
        raise InputError(folder, f"holds several files for {name} ({', '.join(file.name for file in found)[:200]})",
                         "name the one that holds the labels")
    return found[0] if found else None


def _moments(path: Path, marks: Sequence[Mark], choice: LabelChoice) -> Array:
    """[n] seconds, rising, of marks (start, end)."""
    start, end = np.array(marks, dtype=np.float64).T
    with np.errstate(over="ignore"):
        latest = float(np.abs(np.stack([start, end]) / choice.rate).max())
    if not latest <= _LATEST:
        raise InputError(path, f"has a label at {latest:g} s", "labels are seconds from 0; --label-fps for frames")
    if (end < start).any():
        first = marks[int(np.flatnonzero(end < start)[0])]
        raise InputError(path, f"has a label that ends before it starts ({first[0]:g} to {first[1]:g})", "repair it")
    times = {"start": start, "middle": (start + end) / 2, "end": end}[choice.at] / choice.rate
    if times.min() < 0:
        raise InputError(path, f"has a label before the recording, at {times.min():g} s", "labels are seconds from 0")
    return np.unique(times)


def _number(cell: str | None) -> float | None:
    match = _NUMBER.fullmatch(cell or "")
    return float(match[1]) if match and np.isfinite(float(match[1])) else None


def _rows(text: str) -> list[tuple[int, str]]:
    """Lines that say something, with their number; `#` begins a remark, and a backslash Audacity's range of pitch."""
    rows = [(number, line.split("#", 1)[0].strip(" ")) for number, line in enumerate(text.split("\n"), 1)]
    return [(number, line) for number, line in rows if line.strip() and not line.startswith("\\")]


def _of_numbers(path: Path, rows: Sequence[tuple[int, str]]) -> tuple[str, list[Mark]]:
    """Lines that begin with a number: an Audacity track (two numbers and a tab) or seconds with an optional label."""
    marks: list[Mark] = []
    lasting = 0
    for number, line in rows:
        match = _LINE.fullmatch(line)
        if match is None:
            raise InputError(path, f"line {number}: {line.strip()[:30]!r} begins with no time", _ADVICE)
        second = _number(re.split(r"[\t;, ]", (match["rest"] or "").strip(), maxsplit=1)[0])
        if second is not None and "\t" not in (match["between"] or ""):
            # Start and end, or a number for each beat, or a count before the time: only a head can tell.
            raise InputError(path, f"line {number}: what the second number means is not told", _ADVICE)
        first = float(match["time"])
        marks.append((first, first if second is None else second))
        lasting += second is not None
    if lasting not in (0, len(rows)):
        raise InputError(path, "has lines with one number and lines with two", _ADVICE)
    return "Audacity label track" if lasting else "seconds, one a line", marks


def _of_table(path: Path, text: str, column: str | None) -> Iterator[tuple[str, Mark]]:
    """(recording or "", mark) of each row; a row without a time carries no mark."""
    first = text.lstrip().split("\n", 1)[0]
    table = csv.DictReader(text.lstrip().split("\n"), delimiter=max(",;\t", key=first.count))
    try:
        heads = {(head or "").strip().lower(): head for head in table.fieldnames or ()}
        wanted = (column.strip().lower(),) if column else COLUMNS
        key = next((heads[name] for name in wanted if name in heads), None)
        if key is None:
            raise InputError(path, f"line 1: {first.strip()[:60]!r} names no column of times"
                             + (f" called {column!r}" if column else ""), _ADVICE)
        end = heads.get("end", key) if key.strip().lower() == "start" else key
        who = next((heads[name] for name in FILES if name in heads), None)
        for row in table:
            if (row.get(key) or "").strip():
                start, until = _number(row[key]), _number(row.get(end))
                if start is None or until is None:
                    raise InputError(path, f"line {table.line_num}: {row[key][:30]!r} is no time", "give seconds")
                name = (row[who] or "").strip() if who else ""
                if who and not name:
                    raise InputError(path, f"line {table.line_num}: names no recording", f"fill the column {who!r}")
                yield name, (start, until)
    except csv.Error as error:
        raise InputError(path, f"line {table.line_num + 1}: is no row of a table ({error})", _ADVICE) from None


def _of_json(path: Path, text: str) -> list[Mark]:
    try:
        told = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError(path, "begins as JSON and is none", "write it again") from None
    if isinstance(told, Mapping):
        told = next((told[name] for name in _LISTS if isinstance(told.get(name), list)), None)
    if not isinstance(told, list):
        raise InputError(path, "holds no list of times", f"write a list, bare or below one of {', '.join(_LISTS)}")
    return [_json_mark(path, item, place) for place, item in enumerate(told)]


def _json_mark(path: Path, item: Any, place: int) -> Mark:
    start = end = item[0] if isinstance(item, list) and item else item
    if isinstance(item, Mapping):
        start = item.get("time", item.get("start"))
        end = item.get("end", start)
    if not all(isinstance(time, int | float) and not isinstance(time, bool) and abs(time) <= _LARGEST
               for time in (start, end)):
        raise InputError(path, f"[{place}]: {shown(item)} tells no time", 'write 1.25 or {"time": 1.25}')
    return float(start), float(end)


def _of_textgrid(path: Path, text: str, tier: str | None) -> list[Mark]:
    """The entries with a text of the tier that is named, the only one, or the only one named like a gesture."""
    tiers = textgrid_tiers(str(path), text)
    names = [name for name in tiers if name == tier] if tier is not None else (
        list(tiers) if len(tiers) == 1 else [name for name in tiers if _WANTED.search(name)])
    if len(names) != 1:
        raise InputError(path, f"has the tiers {', '.join(tiers)[:200] or '(none)'}", "choose with --tier")
    marks = [(entry.start, entry.end) for entry in tiers[names[0]][1]
             if entry.start is not None and entry.end is not None and entry.text.lower() not in SILENCES]
    if not marks:
        raise InputError(path, f"has no entry with a text in the tier {names[0]!r}", "label them, or take another tier")
    return marks
