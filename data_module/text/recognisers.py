"""Readers of JSON transcripts: one for each recogniser, found by the shape of the file.

`RECOGNISERS` lists them, the more specific shapes first. Times become seconds: recognisers count in seconds,
milliseconds, ticks of 100 ns, or write "1.400s". Errors name the place in the JSON.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from data_module.errors import InputError, shown
from data_module.files import parse_json
from data_module.text.alignment import written_words
from data_module.text.marks import marked_text
from data_module.text.transcript_formats import Content, Entry, shared_in_cue, spoken_tier

__all__ = ["RECOGNISERS", "Recogniser", "words_json"]

MILLISECOND, TICK = 1e-3, 1e-7
"""Seconds."""
LONGEST_WORD = 20.0
"""Seconds per word above which whole numbers are milliseconds: a word of 20 ms would be as short."""
# Seconds per word of the last phrase of a recording, which may have no end: the mean of spoken English.
_OPEN_WORD = 0.3
_TIME = re.compile(r"\d{1,9}(?:\.\d{1,9})?s")


@dataclass(frozen=True)
class Recogniser:
    """A recogniser or aligner. shape: whether a JSON value is its output; read: (file, value, speaker) to content."""

    name: str
    shape: Callable[[Any], bool]
    read: Callable[[str, Any, str | None], Content]


class _Segment(NamedTuple):
    """A stretch of speech: its text with its time, and its words, if the file has them."""

    cue: Entry
    words: list[Entry]


class _Clock(NamedTuple):
    """The keys of the times of a word or a segment. unit: seconds in a unit of time; lasts: the second time is a
    duration; from_zero: a start that is left out is 0."""

    start: str
    end: str
    unit: float = 1.0
    lasts: bool = False
    from_zero: bool = False


# No recogniser uses the keys of another one in another sense, so the keys of an item tell how to read it.
_TEXTS = ("punctuated_word", "word", "text", "Word", "display", "Display", "DisplayText", "transcript")
_CLOCKS = (
    _Clock("start", "end"),
    # Google's protocol buffers leave out what is zero.
    _Clock("startTime", "endTime", from_zero=True), _Clock("startOffset", "endOffset", from_zero=True),
    _Clock("start_time", "end_time", from_zero=True), _Clock("start_offset", "end_offset", from_zero=True),
    # Azure writes ticks beside an "offset" that is a text, so they come first.
    _Clock("offsetInTicks", "durationInTicks", TICK, lasts=True), _Clock("Offset", "Duration", TICK, lasts=True),
    _Clock("offsetMilliseconds", "durationMilliseconds", MILLISECOND, lasts=True),
    _Clock("offset", "duration", MILLISECOND, lasts=True),
)


def words_json(source: str, text: str, speaker: str | None = None) -> Content:
    """Words or segments with times, of any recogniser of `RECOGNISERS`. `InputError` for any other JSON."""
    content = parse_json(text, source, "write it again")
    for recogniser in RECOGNISERS:
        if recogniser.shape(content):
            return recogniser.read(source, content, speaker)
    raise InputError(source, "holds neither words nor segments of a known recogniser",
                     'write {"words": [{"word": "hello", "start": 0.1, "end": 0.4}]}')


# ---------------------------------------------------------------------------------------------------- values

def _of(item: object, *keys: str) -> Any:
    """The first of the keys that an object has, or None."""
    return next((item[key] for key in keys if item.get(key) is not None), None) if isinstance(item, Mapping) else None


def _list(item: object, *keys: str) -> list[Any]:
    """The list at the first of the keys, or an empty one."""
    value = _of(item, *keys)
    return value if isinstance(value, list) else []


def _has_list(content: object, *keys: str) -> bool:
    """Whether an object has a list at one of the keys."""
    return any(isinstance(_of(content, key), list) for key in keys)


def _numbered(items: Iterable[Any], name: str) -> Iterator[tuple[str, Any]]:
    """Each item with its place in the JSON, for messages."""
    return ((f"{name}[{n}]", item) for n, item in enumerate(items))


def _entry(source: str, item: object, where: str, unit: float = 1.0) -> Entry:
    """A JSON object as a word or a segment; both times may be missing (for a word that was not aligned). unit: of the
    keys "start" and "end", seconds."""
    if not isinstance(item, Mapping):
        raise InputError(source, f"{where}: is not an object with a word and its times", "write it again")
    text = _of(item, *_TEXTS)
    if not isinstance(text, str):
        raise InputError(source, f"{where}: has no word", "give it a 'word' or a 'text'")
    # gentle's "startOffset" is a number of letters; Google's is a text.
    clock = next((clock for clock in _CLOCKS if (time := _of(item, clock.start, clock.end)) is not None
                  and not (clock.from_zero and isinstance(time, (int, float)))), _CLOCKS[0])
    start, end = item.get(clock.start), item.get(clock.end)
    text = " ".join(text.split())
    if end is None and (start is None or clock.from_zero):
        return Entry(text, None, None, where)
    unit = unit if clock is _CLOCKS[0] else clock.unit
    first = 0.0 if start is None and clock.from_zero else _seconds(source, start, f"{where}.{clock.start}", unit)
    last = _seconds(source, end, f"{where}.{clock.end}", unit)
    return Entry(text, first, first + last if clock.lasts else last, where)


def _entries(source: str, items: Iterable[object], where: str, unit: float = 1.0) -> list[Entry]:
    return [_entry(source, item, place, unit) for place, item in _numbered(items, where)]


def _seconds(source: str, value: object, where: str, unit: float = 1.0) -> float:
    """A time in seconds: a number in a unit, "1.400s", or {"seconds": 1, "nanos": 400000000}."""
    if isinstance(value, str) and _TIME.fullmatch(value):
        return float(value[:-1])
    if isinstance(value, Mapping) and value.keys() <= {"seconds", "nanos"}:
        # Protocol buffers write large whole numbers as texts.
        parts = [str(value.get(name, 0)) for name in ("seconds", "nanos")]
        if all(re.fullmatch("[0-9]{1,11}", part) for part in parts):
            return int(parts[0]) + int(parts[1]) * 1e-9
    try:
        if isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(float(value)):
            return float(value) * unit if unit != 1.0 else float(value)
    except OverflowError:
        pass
    raise InputError(source, f"{where}: {shown(value, 30)!r} is not a time", "give seconds")


def _count(text: str) -> int:
    """Number of words of a text without its gesture marks."""
    return len(written_words(marked_text(text)[0]))


def _timed(source: str, cue: Entry) -> Entry:
    """A cue, which must have times."""
    if cue.start is None or cue.end is None:
        raise InputError(source, f"{cue.where}: has no times", "give it 'start' and 'end' in seconds")
    return cue


# -------------------------------------------------------------------------------------------------- segments

def _content(segments: Sequence[_Segment]) -> Content:
    """Segments as cues; if some have words, the words, and those of the other segments spread by their length."""
    if not any(segment.words for segment in segments):
        return Content(cues=tuple(segment.cue for segment in segments))
    words: list[Entry] = []
    for segment in segments:
        words += segment.words or shared_in_cue(segment.cue)
    return Content(words=tuple(words))


def _segments(source: str, items: Iterable[tuple[str, Any]], unit: float = 1.0) -> Content:
    """Segments, each with its place, with a text, their times and perhaps their words."""
    segments = []
    for where, item in items:
        words = _entries(source, _list(item, "words", "Words"), f"{where}.words", unit)
        # A segment with words needs no times.
        cue = Entry("", None, None, where) if words else _timed(source, _entry(source, item, where, unit))
        segments.append(_Segment(cue, words))
    return _content(segments)


def _words_or_cues(source: str, entries: Sequence[Entry]) -> Content:
    """Entries as words, or as cues where one has several words."""
    # "well-known" is one word, "well known" is two, and a sentence of a script without spaces has several.
    if not any(_count(entry.text.replace("-", "")) > 1 for entry in entries):
        return Content(words=tuple(entries))
    return Content(cues=tuple(_timed(source, entry) for entry in entries))


def _seconds_or_milliseconds(content: Content) -> Content:
    """Times without a unit: whole numbers under which a word would last 20 s are milliseconds."""
    entries = content.words or content.cues
    timed = [(entry.start, entry.end, max(1, _count(entry.text))) for entry in entries
             if entry.start is not None and entry.end is not None and entry.text]
    whole = all(start.is_integer() and end.is_integer() for start, end, _ in timed)
    if not timed or not whole or median((end - start) / count for start, end, count in timed) <= LONGEST_WORD:
        return content
    scaled = tuple(entry if entry.start is None or entry.end is None else
                   replace(entry, start=entry.start * MILLISECOND, end=entry.end * MILLISECOND) for entry in entries)
    return replace(content, words=scaled) if content.words else replace(content, cues=scaled)


# ------------------------------------------------------------------------------------------------ recognisers

def _whisper_cpp(source: str, content: Any, speaker: str | None) -> Content:
    """whisper.cpp: segments with offsets in milliseconds, with `-ojf` their tokens, too; with `-ml 1` a token each."""
    segments = []
    for where, item in _numbered(content["transcription"], "transcription"):
        tokens = [_whisper_cpp_part(source, token, place) for place, token in
                  _numbered(_list(item, "tokens"), f"{where}.tokens")
                  # Marks of whisper's, such as [_BEG_] or <|endoftext|>, are no words.
                  if not str(_of(token, "text")).strip().startswith(("[_", "<|"))]
        segments.append(_Segment(_whisper_cpp_part(source, item, where), _joined_tokens(tokens)))
    if segments and not any(segment.words for segment in segments) \
            and all(_count(segment.cue.text) <= 1 for segment in segments):
        return Content(words=tuple(_joined_tokens([segment.cue for segment in segments])))
    return _content([_Segment(_stripped(segment.cue), segment.words) for segment in segments])


def _whisper_cpp_part(source: str, item: object, where: str) -> Entry:
    """A segment or a token, with the space before it, which begins a word."""
    text, offsets = _of(item, "text"), _of(item, "offsets")
    if not isinstance(text, str) or not isinstance(offsets, Mapping):
        raise InputError(source, f"{where}: has no text with offsets", "write it again with whisper.cpp's -oj or -ojf")
    start, end = (_seconds(source, offsets.get(name), f"{where}.offsets.{name}", MILLISECOND)
                  for name in ("from", "to"))
    return Entry(text, start, end, where)


def _stripped(entry: Entry) -> Entry:
    return replace(entry, text=" ".join(entry.text.split()))


def _joined_tokens(tokens: Sequence[Entry]) -> list[Entry]:
    """The words of tokens: each token without a space before it continues the word."""
    words: list[Entry] = []
    for token in tokens:
        if words and token.text and not token.text[0].isspace():
            words[-1] = replace(words[-1], text=words[-1].text + token.text, end=token.end)
        else:
            words.append(token)
    out: list[Entry] = []
    for word in map(_stripped, words):
        # A script without spaces gives one token after the other and no word's end.
        out += shared_in_cue(word) if _count(word.text.replace("-", "")) > 1 else [word]
    return [word for word in out if word.text]


def _deepgram(source: str, content: Any, speaker: str | None) -> Content:
    """Deepgram: channels with alternatives, of which the first has the words."""
    results = content["results"]
    spoken = []
    for where, channel in _numbered(results["channels"], "results.channels"):
        best = (_list(channel, "alternatives") or [None])[0]
        words = _entries(source, _list(best, "words"), f"{where}.alternatives[0].words")
        text = _of(best, "transcript")
        if words or text:
            spoken.append((words, text))
    if len(spoken) > 1:
        raise InputError(source, f"holds the words of {len(spoken)} channels", "leave one channel in it")
    words, text = spoken[0] if spoken else ([], "")
    if not words and _list(results, "utterances"):
        return _segments(source, _numbered(results["utterances"], "results.utterances"))
    return Content(words=tuple(words), text="" if words else str(text or ""))


def _google(source: str, content: Any, speaker: str | None) -> Content:
    """Google: results with alternatives, of which the first has the words; times as "1.400s"."""
    segments: list[_Segment] = []
    texts, end = [], 0.0
    for where, result in _google_results(content):
        best = (_list(result, "alternatives") or [None])[0]
        words = _entries(source, _list(best, "words"), f"{where}.alternatives[0].words")
        until = _of(result, "resultEndTime", "resultEndOffset", "result_end_time", "result_end_offset")
        until = end if until is None else _seconds(source, until, f"{where}.resultEndTime")
        text = _of(best, "transcript")
        texts.append(text if isinstance(text, str) else "")
        segments.append(_Segment(Entry(" ".join(texts[-1].split()), end, max(end, until), where), words))
        end = max(end, until)
    spoken = [segment for segment in segments if segment.words or segment.cue.text]
    if not any(segment.words for segment in spoken) and end == 0:
        return Content(text=" ".join(texts))
    # With several speakers the last result repeats the words of all others.
    before = [word.start for segment in spoken[:-1] for word in segment.words]
    return _content(spoken[-1:] if before and [word.start for word in spoken[-1].words] == before else spoken)


def _google_results(content: Any) -> Iterator[tuple[str, Any]]:
    """The results of an answer, of a long operation, of a batch (by file), or of a bare list."""
    if isinstance(content, list):
        return _numbered(content, "")
    for outer in (content, _of(content, "response")):
        results = _of(outer, "results")
        if isinstance(results, Mapping):
            results = [result for file in results.values() for inner in (file, _of(file, "inlineResult"))
                       for result in _list(_of(inner, "transcript"), "results")]
        if isinstance(results, list):
            return _numbered(results, "results")
    return iter(())


def _is_google(content: Any) -> bool:
    results = list(_google_results(content))
    return bool(results) and all(isinstance(result, Mapping) for _, result in results) and any(
        _has_list(result, "alternatives") and not any(_has_list(inner, "result") for inner in result["alternatives"])
        for _, result in results)


def _azure(source: str, content: Any, speaker: str | None) -> Content:
    """Azure: phrases of a batch or of the SDK's detailed results, in ticks of 100 ns; or of the fast transcription, in
    milliseconds."""
    name = next((key for key in ("phrases", "recognizedPhrases") if _has_list(content, key)), "")
    phrases = content[name] if name else content if isinstance(content, list) else [content]
    spoken = []
    for where, phrase in _numbered(phrases, name):
        best = (_list(phrase, "nBest", "NBest") or [None])[0]
        if isinstance(best, Mapping):
            # The time of a phrase stands beside its alternatives.
            spoken.append((where, {**phrase, **best}))
        elif name == "phrases" or _of(phrase, "DisplayText") is not None:
            spoken.append((where, phrase))
    return _segments(source, spoken)


def _is_azure(content: Any) -> bool:
    if isinstance(content, list):
        return any(_has_list(phrase, "NBest") for phrase in content)
    return _has_list(content, "recognizedPhrases", "NBest") or (
        _has_list(content, "phrases") and _has_list(content, "combinedPhrases")) or (
        _of(content, "RecognitionStatus") is not None)


def _vosk(source: str, content: Any, speaker: str | None) -> Content:
    """vosk: a result, or a list of them; of several alternatives the first counts; or the monologues of its program."""
    words: list[Entry] = []
    for where, monologue in _numbered(_list(content, "monologues"), "monologues"):
        terms = [term for term in _list(monologue, "terms") if _of(term, "type") in (None, "WORD")]
        words += _entries(source, terms, f"{where}.terms")
    texts = []
    for where, result in _numbered(content if isinstance(content, list) else [content], ""):
        best = (_list(result, "alternatives") or [result])[0]
        words += _entries(source, _list(best, "result"), f"{where}.result")
        texts.append(str(_of(best, "text") or ""))
    return Content(words=tuple(words), text="" if words else " ".join(texts))


def _is_vosk(content: Any) -> bool:
    if isinstance(content, list):
        return any(_is_vosk(result) for result in content if isinstance(result, Mapping))
    return _has_list(content, "result", "monologues") or (
        any(_has_list(alternative, "result") for alternative in _list(content, "alternatives")))


def _transformers(source: str, content: Any, speaker: str | None) -> Content:
    """The speech recognition pipeline of transformers: chunks, which are words or phrases; the last may have no end."""
    entries = []
    for where, item in _numbered(content["chunks"], "chunks"):
        times, text = _of(item, "timestamp", "timestamps"), _of(item, "text")
        if not isinstance(times, list) or len(times) != 2:
            raise InputError(source, f"{where}: has no timestamp of two times", "write it again with return_timestamps")
        start, end = times
        if end is None and start is not None:
            start = _seconds(source, start, f"{where}.timestamp[0]")
            end = start + _OPEN_WORD * max(1, _count(str(text or "")))
        entries.append(_entry(source, {"text": text, "start": start, "end": end}, where))
    return _words_or_cues(source, entries)


def _whisper(source: str, content: Any, speaker: str | None) -> Content:
    """OpenAI's whisper and its interface, faster-whisper, whisperX: segments, perhaps with words. gentle, and whatever
    else writes words with "start" and "end"."""
    if words := _list(content, "words"):
        # gentle marks each word with a case, and sounds that the text lacks have no word.
        spoken = [word for word in words if _of(word, "word") is not None or _of(word, "case") is None]
        return _seconds_or_milliseconds(Content(words=tuple(_entries(source, spoken, "words"))))
    return _seconds_or_milliseconds(_segments(source, _numbered(_list(content, "segments"), "segments")))


def _assembly(source: str, content: Any, speaker: str | None) -> Content:
    """AssemblyAI: words in milliseconds."""
    if content.get("words") is None and _list(content, "utterances"):
        return _segments(source, _numbered(content["utterances"], "utterances"), MILLISECOND)
    words = _entries(source, _list(content, "words"), "words", MILLISECOND)
    return Content(words=tuple(words), text="" if words else str(content.get("text") or ""))


def _plain_list(source: str, content: Any, speaker: str | None) -> Content:
    """A bare list of words or of segments."""
    read = _segments(source, _numbered(content, "")) if any(_has_list(item, "words") for item in content) \
        else _words_or_cues(source, _entries(source, content, ""))
    return _seconds_or_milliseconds(read)


def _tiers(source: str, content: Any, speaker: str | None) -> Content:
    """The Montreal Forced Aligner's JSON: tiers of [start, end, word]."""
    tiers = {}
    for name, tier in content["tiers"].items():
        rows = _of(tier, "entries")
        if isinstance(rows, list) and all(isinstance(row, list) and len(row) == 3 for row in rows):
            tiers[name] = [_entry(source, {"start": a, "end": b, "word": word}, f"tiers.{name}[{n}]")
                           for n, (a, b, word) in enumerate(rows)]
    return Content(words=spoken_tier(source, tiers, speaker))


# Keys of AssemblyAI's answers.
_OF_ASSEMBLY = frozenset({"audio_duration", "audio_url", "acoustic_model", "language_model", "speech_model",
                          "utterances", "webhook_status_code", "speaker_labels"})

RECOGNISERS = (
    Recogniser("whisper.cpp", lambda content: _has_list(content, "transcription"), _whisper_cpp),
    Recogniser("Deepgram", lambda content: _has_list(_of(content, "results"), "channels"), _deepgram),
    Recogniser("Azure", _is_azure, _azure),
    Recogniser("vosk", _is_vosk, _vosk),
    Recogniser("Google", _is_google, _google),
    Recogniser("transformers", lambda content: _has_list(content, "chunks"), _transformers),
    Recogniser("AssemblyAI", lambda content: _has_list(content, "words", "utterances")
               and bool(_OF_ASSEMBLY & content.keys()) and not _has_list(content, "segments"), _assembly),
    Recogniser("whisper", lambda content: _has_list(content, "segments", "words"), _whisper),
    Recogniser("MFA", lambda content: isinstance(_of(content, "tiers"), Mapping), _tiers),
    Recogniser("list", lambda content: isinstance(content, list), _plain_list),
    Recogniser("text", lambda content: isinstance(_of(content, "text"), str),
               lambda source, content, speaker: Content(text=content["text"])),
)
"""The readers, in the order in which shapes are compared."""
