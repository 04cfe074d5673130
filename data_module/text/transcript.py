"""What was said, from the user's file, and its words on the clock of the recording.

A file may tell the times of the words (TextGrid, JSON), of whole cues (SRT, VTT) or none (plain text). What it does
not tell is heard by the aligner, in English, or guessed; the result says which.
"""

from __future__ import annotations

import itertools
import math
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from data_module.errors import InputError
from data_module.files import read_text
from data_module.text import alignment as aligner
from data_module.text import transcript_formats as formats
from data_module.text.transcript_formats import Content, Entry
from data_module.types import Speech, Word

__all__ = ["Text", "Transcript", "as_transcript", "read_transcript", "with_transcript"]

FORMATS: dict[str, Callable[[str, str, str | None], Content]] = {
    ".txt": formats.plain, ".textgrid": formats.textgrid, ".srt": formats.srt, ".vtt": formats.vtt,
    ".json": formats.words_json,
}
"""Readers by the ending of the file's name: (file, its text, speaker) to what it holds."""

_OVERLAP = 0.02
"""Seconds by which words may overlap without a note: half of what an aligner's frames of 10 ms leave open."""
_UNTIMED = 0.3
"""Seconds for a word without times where nothing bounds it: the mean of spoken English."""

How = Literal["given", "heard", "guessed"]

Text: TypeAlias = "str | os.PathLike[str]"
"""What is said: a `str` is the words themselves, a path (`pathlib.Path`) names a transcript's file."""


@dataclass(frozen=True)
class Transcript:
    """What was said.

    words: with their times, None where the file gives none. timing: "words" (the file times them), "cues" (the file
    times cues; `words` share them out by length, until `with_transcript` listens) or "none". cues: the text of each
    cue and its time. guessed: how many of the words the file left without a time. notes: what had to be put right.
    """

    words: tuple[Word, ...] | None
    text: str
    timing: Literal["words", "cues", "none"]
    source: str = "transcript"
    cues: tuple[Word, ...] = ()
    guessed: int = 0
    notes: tuple[str, ...] = ()


MOST_WORDS = 8.0
"""Words a second; fast talkers reach five or six."""
_ENGLISH_ONLY = "the aligner reads English only"


class TranscriptWarning(UserWarning):
    """A transcript that may be of another recording."""


@dataclass(frozen=True)
class Timing:
    """How the words got their times.

    words: how many there are, silences not counted. how: "given" by the file, "heard" by the aligner, or "guessed".
    guessed: how many of them were. note: one line for the user.
    """

    words: int
    how: How
    guessed: int
    note: str


def read_transcript(path: str | os.PathLike[str], speech: Speech | None = None) -> Transcript:
    """Read .txt, .TextGrid (long or short), .srt, .vtt or .json (word times, or whisper's segments).

    speech: the recording, if it is known: its speaker chooses among the tiers of several, and words beyond its end
    are left out at once. `InputError` names the file and the line where it is broken, has no words, or lies beyond
    the recording altogether.
    """
    name = Path(path)
    reader = FORMATS.get(name.suffix.lower())
    if reader is None:
        raise InputError(name, "is no transcript that can be read", f"give one of {', '.join(FORMATS)}")
    content = reader(str(name), read_text(name, "save it as text in UTF-8"), speech.speaker if speech else None)
    transcript = _transcript(str(name), content)
    if not (aligner.written_words(transcript.text) if transcript.words is None else _spoken(transcript.words)):
        raise InputError(name, "has no words", "give the text that is spoken")
    return _within(transcript, speech.duration) if speech else transcript


def as_transcript(text: Text, speech: Speech) -> Transcript:
    """The transcript of a recording: of the words themselves (`str`), or of a file (a path).

    `InputError` for words that are none, and for a `str` that is the name of a file.
    """
    if not isinstance(text, str):
        return read_transcript(Path(text), speech)
    names_file = Path(text[-80:]).suffix.lower() in FORMATS and (len(text.split()) < 2 or os.path.isfile(text))  # noqa: PTH113
    if names_file:
        raise InputError(f"text {text!r}", "is the name of a file, where a str is what is said",
                         "give pathlib.Path(...) for a file")
    if not any(letter.isalnum() for letter in text):
        raise InputError("text", "has no words", "give what is said, or leave it out")
    return Transcript(None, text, "none", "text")


def with_transcript(speech: Speech, transcript: Transcript) -> tuple[Speech, Timing]:
    """The speech with the words of the transcript, and how they got their times.

    Given times are kept. Words in cues are heard within their cue where the aligner can, else they share out its
    loud parts. Plain English is aligned (`InputError` without the aligner); other languages share out the loud parts
    of the recording.
    """
    transcript = _within(transcript, speech.duration)
    how: How
    if transcript.timing == "words":
        words, how, guessed, told = transcript.words or (), "given", transcript.guessed, ""
    elif transcript.timing == "cues":
        words, guessed = _in_cues(speech, transcript.cues)
        how = "guessed" if 2 * guessed > len(words) else "heard"
        told = "they share out their cues" if guessed else ""
    else:
        words, told = _without_times(speech, transcript.text)
        guessed = len(words) if told else 0
        how = "guessed" if told else "heard"
    count = _spoken(words)
    doubt = _doubt(transcript, count, told, speech.duration)
    if doubt:
        _warn(transcript.source, doubt)
    note = "; ".join([_summary(count, how, guessed, told), *transcript.notes])
    return replace(speech, words=words), Timing(count, how, guessed, note)


def _doubt(transcript: Transcript, count: int, told: str, duration: float) -> str:
    """Why a transcript may be of another recording; "" where nothing speaks for it. count: its words; told: why times
    were guessed; duration: seconds of sound."""
    if transcript.timing == "none" and told and told != _ENGLISH_ONLY:
        return told
    if count > MOST_WORDS * duration + 2:
        return f"{count} words in {duration:.1f} s are more than anybody says"
    return ""


def _warn(source: str, doubt: str) -> None:
    warnings.warn(TranscriptWarning(f"{source}: {doubt}; is it the transcript of this recording?"), stacklevel=3)


def _summary(count: int, how: How, guessed: int, told: str) -> str:
    plural = "word" if count == 1 else "words"
    if guessed == 0:
        return f"{count} {plural}, times {'given' if how == 'given' else 'heard in the recording'}"
    some = ("word times were guessed" if guessed == count
            else "1 word time was guessed" if guessed == 1 else f"{guessed} word times were guessed")
    return f"{count} {plural}, {some}" + (f": {told}" if told else "")


def _spoken(words: Sequence[Word]) -> int:
    return sum(bool(word.text) for word in words)


def _transcript(source: str, content: Content) -> Transcript:
    """What a reader found, its times checked and put in order."""
    if content.cues:
        cues, notes = _in_order(source, content.cues)
        words = tuple(word for cue in cues for word in _as_words(formats.shared_in_cue(_entry_of(cue))))
        return Transcript(words, " ".join(cue.text for cue in cues), "cues", source, cues, len(words), notes)
    text = content.text or " ".join(entry.text for entry in content.words if entry.text)
    if all(entry.start is None for entry in content.words):
        return Transcript(None, text, "none", source)
    filled = _filled(content.words)
    words, notes = _in_order(source, filled)
    return Transcript(words, text, "words", source, guessed=sum(e.guessed for e in filled), notes=notes)


def _entry_of(cue: Word) -> Entry:
    return Entry(cue.text, cue.start, cue.end, "")


def _as_words(entries: Sequence[Entry]) -> tuple[Word, ...]:
    return tuple(Word(e.text, e.start, e.end) for e in entries if e.start is not None and e.end is not None)


def _filled(entries: Sequence[Entry]) -> list[Entry]:
    """Words without times share out the gap between their timed neighbours."""
    out: list[Entry] = []
    for timed, group in itertools.groupby(entries, lambda entry: entry.start is not None):
        run = list(group)
        if timed:
            out += run
            continue
        after = entries[len(out) + len(run)].start if len(out) + len(run) < len(entries) else None
        start = out[-1].end if out else None
        if start is None:
            start = max(0.0, (after or 0.0) - _UNTIMED * len(run))
        end = max(start, after) if after is not None else start + _UNTIMED * len(run)
        edges = np.linspace(start, end, len(run) + 1).tolist()
        out += [replace(e, start=a, end=b, guessed=True) for e, a, b in zip(run, edges, edges[1:], strict=False)]
    return out


def _in_order(source: str, entries: Sequence[Entry]) -> tuple[tuple[Word, ...], tuple[str, ...]]:
    """Words that rise in time from 0 and do not overlap, and what was done to them."""
    notes = []
    for entry in entries:
        assert entry.start is not None and entry.end is not None
        if entry.end < entry.start:
            raise InputError(source, f"{entry.where}: ends at {entry.end:g} s, before it starts at {entry.start:g} s",
                             "put its times right")
    kept = [e for e in entries if e.end is not None and (e.end > 0 or e.start == 0)]
    early = sum(e.start is not None and e.start < 0 for e in entries)
    if early:
        notes.append(f"{_times(early)} began before the recording")
    words = [Word(w.text, max(0.0, w.start), w.end) for w in _as_words(kept)]
    if any(a.start > b.start for a, b in itertools.pairwise(words)):
        notes.append("the times were not in order and were sorted")
        words.sort(key=lambda word: word.start)
    overlaps = sum(a.end - b.start > _OVERLAP for a, b in itertools.pairwise(words))
    if overlaps:
        notes.append(f"{_times(overlaps)} overlapped the next and was cut" if overlaps == 1
                     else f"{_times(overlaps)} overlapped the next and were cut")
    ends = [min(a.end, b.start) for a, b in itertools.pairwise(words)] + [word.end for word in words[-1:]]
    return tuple(replace(word, end=end) for word, end in zip(words, ends, strict=True)), tuple(notes)


def _times(count: int) -> str:
    return "1 time" if count == 1 else f"{count} times"


def _within(transcript: Transcript, duration: float) -> Transcript:
    """The transcript within the recording: what begins after its end is left out, the last is cut."""
    words, cues = (tuple(replace(w, end=min(w.end, duration)) for w in words if w.start < duration)
                   for words in (transcript.words or (), transcript.cues))
    lost = _spoken(transcript.words or ()) - _spoken(words)
    if not lost:
        return replace(transcript, words=words if transcript.words is not None else None, cues=cues)
    if not _spoken(words):
        raise InputError(transcript.source, f"all its words come after the end of the recording ({duration:.1f} s)",
                         "give the transcript of this recording, its times in seconds")
    if lost > _spoken(words):
        _warn(transcript.source, f"{lost} of its {lost + _spoken(words)} words come after the end of the recording")
    note = f"{lost} {'word' if lost == 1 else 'words'} after the end of the recording left out"
    return replace(transcript, words=words, cues=cues, notes=(*transcript.notes, note))


def _in_cues(speech: Speech, cues: Sequence[Word]) -> tuple[tuple[Word, ...], int]:
    """The words of every cue, heard or shared out within it, and how many were shared out."""
    out: list[Word] = []
    guessed = 0
    for cue in cues:
        samples = speech.samples[math.floor(cue.start * speech.sample_rate):math.ceil(cue.end * speech.sample_rate)]
        written = aligner.written_words(cue.text)
        if not written or len(samples) == 0:
            continue
        piece = replace(speech, samples=samples, words=None)
        found = None
        if aligner.can_follow(cue.text) and aligner.aligner_installed():
            found = aligner.alignment(piece, cue.text, warn=False)
        heard = found is not None and found.heard
        words = found.words if found is not None and heard else aligner.shared_out(piece, written)
        guessed += 0 if heard else len(words)
        out += [Word(w.text, w.start + cue.start, min(w.end + cue.start, max(cue.end, w.start + cue.start)))
                for w in words]
    return tuple(out), guessed


def _without_times(speech: Speech, text: str) -> tuple[tuple[Word, ...], str]:
    """The words of a plain text, and why their times are a guess ("" where they were heard)."""
    if not aligner.can_follow(text):
        return aligner.shared_out(speech, aligner.written_words(text)), _ENGLISH_ONLY
    found = aligner.alignment(speech, text, warn=False)
    return found.words, found.doubt
