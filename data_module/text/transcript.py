"""Transcripts from files, and the times of their words in the recording.

A file may contain the times of words (TextGrid, JSON), of cues (SRT, VTT, TSV) or none (plain text). Missing times come
from the aligner, for English, or are estimates; the result says which. Word times that no speaker can have spoken are
refused. Marks of gestures (`data_module.text.marks`) are taken out of the text and noted on the word after them.
"""

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
from data_module.text.marks import marked_text, marked_words, with_marks
from data_module.text.recognisers import words_json
from data_module.text.transcript_formats import Content, Entry
from data_module.text.ttml import ttml
from data_module.types import Speech, Word

__all__ = ["Text", "Transcript", "as_transcript", "read_transcript", "timed_transcript", "with_transcript"]

FORMATS: dict[str, Callable[[str, str, str | None], Content]] = {
    ".txt": lambda source, text, speaker: Content(text=text), ".textgrid": formats.textgrid,
    ".tsv": formats.tsv, ".csv": formats.comma_separated, ".ctm": formats.ctm, ".ttml": ttml, ".dfxp": ttml,
    ".json": words_json, ".jsonl": words_json, **dict.fromkeys(formats.TIMED_LINES, formats.timed_lines),
}
"""Readers by suffix: (file, its text, speaker) to its content."""

# Overlap of words, seconds, without a note: two frames of an aligner.
_OVERLAP = 0.02

How = Literal["given", "heard", "guessed"]

Text: TypeAlias = "str | os.PathLike[str]"
"""A transcript: a `str` is the text itself, a path (`pathlib.Path`) names its file."""


@dataclass(frozen=True)
class Transcript:
    """A transcript.

    words: with their times, None if the file has none. timing: "words" (the file has their times), "cues" (the file has
    the times of cues; `words` are spread over them by length, until `with_transcript` aligns them) or "none". cues: the
    text of each cue, gesture marks included, and its time. guessed: number of words without a time in the file. notes:
    corrections. marks: (offset in `text`, name) of each gesture mark of a text without times; else they are on the
    words.
    """

    words: tuple[Word, ...] | None
    text: str
    timing: Literal["words", "cues", "none"]
    source: str = "transcript"
    cues: tuple[Word, ...] = ()
    guessed: int = 0
    notes: tuple[str, ...] = ()
    marks: tuple[tuple[int, str], ...] = ()


MOST_WORDS = 8.0
"""Most plausible words per second; fast talkers reach five or six."""
IMPOSSIBLE = 15.0
"""Words per second above which a file is refused: no speaker is that fast, so its times mean something else."""
LONGEST_MEDIAN = 5.0
"""Longest plausible median duration of a word, seconds: beyond it, times are not in seconds, or not of words."""
# Words below which a rate says nothing.
_FEW = 8
_ENGLISH_ONLY = "the aligner supports English only"
# In which subtitles of Western languages come that are not in UTF-8; a superset of Latin-1.
_WESTERN = "windows-1252"
# Seconds, 115 days: numbers beyond are no times, and sums of them overflow.
_LATEST = 1e7


class TranscriptWarning(UserWarning):
    """A transcript that may be of another recording."""


@dataclass(frozen=True)
class Timing:
    """The source of the word times. words: number of words without silences. how: "given" by the file, "heard" by the
    aligner, or "guessed". guessed: number of estimated times. note: one line for the user."""

    words: int
    how: How
    guessed: int
    note: str


def read_transcript(path: str | os.PathLike[str], speech: Speech | None = None) -> Transcript:
    """Read .txt, .TextGrid (long or short), .srt, .vtt, .tsv, or .json of any recogniser of
    `data_module.text.recognisers`.

    speech: the recording, if it is known: its speaker selects among the tiers of several, and words beyond its end are
    left out. `InputError` names the file and the line of an error, a file without words, one with impossible times (see
    `IMPOSSIBLE` and `LONGEST_MEDIAN`), and one with most of its words beyond the recording.
    """
    name = Path(path)
    reader = FORMATS.get(name.suffix.lower())
    if reader is None:
        raise InputError(name, "is not a supported transcript", f"give one of {', '.join(FORMATS)}")
    text = read_text(name, "save it as text in UTF-8", other=_WESTERN)
    content = reader(str(name), text, speech.speaker if speech else None)
    transcript = _transcript(str(name), content)
    if not (aligner.written_words(transcript.text) if transcript.words is None else _spoken(transcript.words)):
        raise InputError(name, "has no words", "give the text that is spoken")
    return _within(transcript, speech.duration) if speech else transcript


def as_transcript(text: Text, speech: Speech) -> Transcript:
    """The transcript of a recording from a text (`str`) or a file (a path). `InputError` for a text without words, and
    for a `str` that is the name of a file."""
    if not isinstance(text, str):
        return read_transcript(Path(text), speech)
    # Nearly always a forgotten Path: a single word with a suffix, or the name of a file that is there.
    names_file = Path(text[-80:]).suffix.lower() in FORMATS and (len(text.split()) < 2 or os.path.isfile(text))  # noqa: PTH113
    if names_file:
        raise InputError(f"text {text!r}", "is the name of a file, but a str must be the spoken text",
                         "give pathlib.Path(...) for a file")
    plain, marks = marked_text(text)
    if not any(letter.isalnum() for letter in plain):
        raise InputError("text", "has no words", "give the spoken text, or leave it out")
    return Transcript(None, plain, "none", "text", marks=marks)


def timed_transcript(source: str, words: Sequence[Word], duration: float) -> Transcript:
    """The transcript of words with their times, seconds, after the checks that a file goes through. source: for
    messages; duration: of the sound, seconds."""
    entries = tuple(Entry(word.text, word.start, word.end, f"word {number}") for number, word in enumerate(words, 1))
    return _within(_transcript(source, Content(words=entries)), duration)


def with_transcript(speech: Speech, transcript: Transcript) -> tuple[Speech, Timing]:
    """The speech with the words of the transcript, and the source of their times. Given times are used. Words of cues
    are aligned within their cue if possible, else spread over its loud parts. Plain English is aligned (`InputError`
    without the aligner); other languages are spread over the loud parts of the recording."""
    # Once more: a transcript may have been read without its recording.
    transcript = _within(transcript, speech.duration)
    if transcript.timing == "words":
        words, guessed, reason = transcript.words or (), transcript.guessed, ""
    elif transcript.timing == "cues":
        words, guessed = _in_cues(speech, transcript)
        reason = "they are spread over their cues" if guessed else ""
    else:
        follows = aligner.can_follow(transcript.text)
        placed, late, reason, missing = _placed(speech, transcript.text, transcript.marks, follows)
        words = _with_late(placed, late)
        guessed = len(words) if reason else 0
        if missing:
            _warn(transcript.source, missing)
    how: How = "given" if transcript.timing == "words" else "guessed" if 2 * guessed > len(words) else "heard"
    count = _spoken(words)
    if transcript.timing == "none" and reason not in ("", _ENGLISH_ONLY):
        _warn(transcript.source, reason)
    elif count > MOST_WORDS * speech.duration + 2:
        _warn(transcript.source, f"{count} words in {speech.duration:.1f} s are too many for speech")
    note = "; ".join([_summary(count, how, guessed, reason), *transcript.notes])
    return replace(speech, words=words), Timing(count, how, guessed, note)


def _warn(source: str, doubt: str) -> None:
    warnings.warn(TranscriptWarning(f"{source}: {doubt}; is it the transcript of this recording?"), stacklevel=3)


def _summary(count: int, how: How, guessed: int, reason: str) -> str:
    total = f"{count} word" + "s" * (count != 1)
    if guessed == 0:
        return f"{total}, times {'given' if how == 'given' else 'aligned with the recording'}"
    return f"{total}, {guessed} word times are estimates" + (f": {reason}" if reason else "")


def _spoken(words: Sequence[Word]) -> int:
    return sum(bool(word.text) for word in words)


def _transcript(source: str, content: Content) -> Transcript:
    """A transcript from a file's content, its times checked and sorted, the marks out of its words."""
    # Before anything is added up: numbers of this size overflow in sums.
    for entry in (*content.cues, *content.words):
        for time in (entry.start, entry.end):
            if time is not None and abs(time) > _LATEST:
                raise InputError(source, f"{entry.where}: {time:g} s is no time of a recording",
                                 "give times in seconds from its start")
    if content.cues:
        cues, notes = _in_order(source, content.cues)
        spread = [word for cue in cues for word in formats.shared_in_cue(Entry(cue.text, cue.start, cue.end, ""))]
        words = _as_words(_unmarked(spread))
        _check_rate(source, words)
        text = " ".join(marked_text(cue.text)[0] for cue in cues)
        return Transcript(words, text, "cues", source, cues, len(words), notes)
    if all(entry.start is None for entry in content.words):
        text, marks = marked_text(content.text or " ".join(entry.text for entry in content.words if entry.text))
        return Transcript(None, text, "none", source, marks=marks)
    filled = formats.filled(_unmarked(content.words))
    text = " ".join(entry.text for entry in filled if entry.text)
    words, notes = _in_order(source, filled)
    _check_rate(source, words)
    return Transcript(words, text, "words", source, guessed=sum(e.guessed for e in filled), notes=notes)


def _as_words(entries: Sequence[Entry]) -> tuple[Word, ...]:
    return tuple(Word(e.text, e.start, e.end, e.marks) for e in entries if e.start is not None and e.end is not None)


def _unmarked(entries: Sequence[Entry]) -> list[Entry]:
    """Entries without marks in their texts, and each mark on the word after it, or on the last word."""
    parts, late = marked_words([entry.text for entry in entries])
    out = [replace(entry, text=text, marks=(*entry.marks, *marks))
           for entry, (text, marks) in zip(entries, parts, strict=True) if text or not entry.text]
    last = next((at for at in reversed(range(len(out))) if out[at].text), None)
    if late and last is not None:
        out[last] = replace(out[last], marks=(*out[last].marks, *late))
    return out


def _check_rate(source: str, words: Sequence[Word]) -> None:
    """`InputError` for words that no speaker could say in their times."""
    spoken = [word for word in words if word.text]
    if len(spoken) < 3:
        return
    # The median, because a single word may well have a wrong end.
    lasts = float(np.median([word.end - word.start for word in spoken]))
    seconds = max(word.end for word in spoken) - spoken[0].start
    if lasts > LONGEST_MEDIAN:
        raise InputError(source, f"half of its words last over {lasts:.0f} s, which nobody speaks",
                         "give the times of words in seconds")
    if len(spoken) >= _FEW and len(spoken) > IMPOSSIBLE * seconds:
        raise InputError(source, f"{len(spoken)} words in {seconds:.2f} s are more than anybody speaks",
                         "give each word once, with its time in seconds")


def _in_order(source: str, entries: Sequence[Entry]) -> tuple[tuple[Word, ...], tuple[str, ...]]:
    """The words rising in time from 0 without overlap, and notes on the corrections."""
    notes = []
    for entry in entries:
        assert entry.start is not None and entry.end is not None
        if entry.end < entry.start:
            raise InputError(source, f"{entry.where}: ends at {entry.end:g} s, before it starts at {entry.start:g} s",
                             "correct its times")
    # Words that end before the recording begins are of a part that was cut off.
    inside = [e for e in entries if e.end is not None and (e.end > 0 or e.start == 0)]
    early = sum(e.start is not None and e.start < 0 for e in entries)
    if early:
        notes.append(f"{early} of them began before the recording")
    words = [replace(word, start=max(0.0, word.start)) for word in _as_words(inside)]
    if any(a.start > b.start for a, b in itertools.pairwise(words)):
        notes.append("the times were not in order and were sorted")
        words.sort(key=lambda word: word.start)
    overlaps = sum(a.end - b.start > _OVERLAP for a, b in itertools.pairwise(words))
    if overlaps:
        notes.append(f"{overlaps} of them overlapped the next and were cut")
    # A frame has one word: each ends where the next begins, at the latest.
    ends = [min(a.end, b.start) for a, b in itertools.pairwise(words)] + [word.end for word in words[-1:]]
    return tuple(replace(word, end=end) for word, end in zip(words, ends, strict=True)), tuple(notes)


def _within(transcript: Transcript, duration: float) -> Transcript:
    """Cut the transcript at the end of the recording."""
    words, cues = (tuple(replace(w, end=min(w.end, duration)) for w in words if w.start < duration)
                   for words in (transcript.words or (), transcript.cues))
    lost = _spoken(transcript.words or ()) - _spoken(words)
    if transcript.words is None or not lost:
        return replace(transcript, words=None if transcript.words is None else words, cues=cues)
    # With more words lost than left this is another recording; a few are a cut end.
    if lost > _spoken(words):
        raise InputError(transcript.source, f"{lost} of its {lost + _spoken(words)} words come after the end of the "
                         f"recording ({duration:.1f} s)", "give the transcript of this recording, its times in seconds")
    note = f"{lost} of them left out after the end of the recording"
    return replace(transcript, words=words, cues=cues, notes=(*transcript.notes, note))


def _in_cues(speech: Speech, transcript: Transcript) -> tuple[tuple[Word, ...], int]:
    """The words of all cues, aligned or spread within their cue, and the number of the latter."""
    out: list[Word] = []
    guessed, late = 0, tuple[str, ...]()
    for cue in transcript.cues:
        text, marks = marked_text(cue.text)
        # Marks after the last word of a cue belong to the first word of the next.
        marks = (*((0, name) for name in late), *marks)
        late = tuple(name for _, name in marks)
        first, last = math.floor(cue.start * speech.sample_rate), math.ceil(cue.end * speech.sample_rate)
        piece = speech.samples[first:last]
        if not aligner.written_words(text) or len(piece) == 0:
            continue
        follows = aligner.can_follow(text) and aligner.aligner_installed()
        part = replace(speech, samples=piece, words=None)
        words, late, doubt, missing = _placed(part, text, marks, follows)
        if follows and (doubt or missing):
            words, late, doubt, _ = _placed(part, text, marks, follows=False)
        guessed += len(words) if doubt else 0
        out += [replace(w, start=w.start + cue.start, end=min(w.end + cue.start, max(cue.end, w.start + cue.start)))
                for w in words]
    return _with_late(out, late), guessed


def _placed(speech: Speech, text: str, marks: Sequence[tuple[int, str]], follows: bool
            ) -> tuple[tuple[Word, ...], tuple[str, ...], str, str]:
    """The words of a text in its recording, with the gesture marks on them; the marks after the last word; why the
    times are estimates ("" if they are aligned); and what is missing (see `aligner.alignment`). follows: whether the
    aligner can read the text."""
    # The aligner spells words otherwise than they are written: marks are counted in the words that get times.
    if not follows:
        words = aligner.shared_out(speech, aligner.written_words(text))
        return (*with_marks(words, text, marks, aligner.written_words), _ENGLISH_ONLY, "")
    words, doubt, missing = aligner.alignment(speech, text)
    placed, late = with_marks(words, text, marks, aligner.spoken_words)
    # Marks at words that are not in the recording are not shown.
    return placed, late if len(words) == len(aligner.spoken_words(text)) else (), doubt, missing


def _with_late(words: Sequence[Word], late: tuple[str, ...]) -> tuple[Word, ...]:
    """The words, with the marks after the last one on it."""
    if not words or not late:
        return tuple(words)
    return (*words[:-1], replace(words[-1], marks=(*words[-1].marks, *late)))
