"""The reader of JSON transcripts, whatever recogniser or aligner wrote them.

The keys of an object tell what it is, because no recogniser uses the keys of another one in another sense: it has
words, or parts that have words, or a text with its times. Times become seconds: recognisers count in seconds,
milliseconds, ticks of 100 ns, or write "1.400s". Errors name the place in the JSON.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import median
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from data_module.errors import InputError, shown
from data_module.files import parse_json
from data_module.text.alignment import written_words
from data_module.text.marks import marked_text
from data_module.text.transcript_formats import Content, Entry, filled, shared_in_cue, spoken_tier, usual_length

__all__ = ["words_json"]

MILLISECOND, TICK = 1e-3, 1e-7
"""Seconds."""
LONGEST_WORD = 20.0
"""Seconds per word above which whole numbers are milliseconds: a word of 20 ms would be as short."""
_TIME = re.compile(r"\d{1,9}(?:\.\d{1,9})?s?")
# Between the objects of a file that holds one after the other, as NeMo's manifests and the results of streams.
_NEXT_OBJECT = re.compile(r"\}[ \t\r]*\n\s*\{")


_Segment: TypeAlias = tuple[Entry, list[Entry]]
"""A stretch of speech: its text with its time, and its words, if the file has them."""


class _Clock(NamedTuple):
    """The keys of the times of a word or a segment. unit: seconds in a unit of time; lasts: the second time is a
    duration; texts: times are not numbers."""

    start: str
    end: str
    unit: float = 1.0
    lasts: bool = False
    texts: bool = False


_CLOCKS = (
    _Clock("start", "end"), _Clock("startTime", "endTime"), _Clock("start_time", "end_time"),
    _Clock("start_ms", "end_ms", MILLISECOND), _Clock("begin_time", "end_time", MILLISECOND),
    _Clock("StartTime", "EndTime"), _Clock("time_begin", "time_end"),
    # Google's. As numbers, gentle's count letters and NeMo's the steps of a model, whatever a step lasts.
    _Clock("startOffset", "endOffset", texts=True), _Clock("start_offset", "end_offset", texts=True),
    # Azure writes ticks beside an "offset" that is a text, so they come first.
    _Clock("offsetInTicks", "durationInTicks", TICK, lasts=True), _Clock("Offset", "Duration", TICK, lasts=True),
    _Clock("offsetMilliseconds", "durationMilliseconds", MILLISECOND, lasts=True),
    _Clock("offset", "duration", MILLISECOND, lasts=True),
    # whisper.cpp's, which it writes below "offsets".
    _Clock("from", "to", MILLISECOND),
)
# Google's results have an end alone, and begin where the one before ends.
_RESULT_ENDS = ("resultEndTime", "resultEndOffset", "result_end_time", "result_end_offset")
_TEXTS = ("punctuated_word", "word", "text", "Word", "display", "Display", "DisplayText", "transcript", "content",
          "Content", "segment", "sentence", "pred_text", "Transcript")
# Alternatives, of which the first is the best; lists of words; and what holds further parts, the better times first.
_ALTERNATIVES = ("alternatives", "nBest", "NBest", "Alternatives")
_WORDS = ("words", "Words", "result", "terms", "tokens", "items", "Items", "word", "timestamps_word", "results",
          "entries")
_PARTS = ("segments", "chunks", "transcription", "phrases", "recognizedPhrases", "monologues", "response", "results",
          "inlineResult", "inline_result", "transcript", "Transcript", "Results", "channels", "utterances",
          "prediction", "word_segments", "timestamp", "timestep", "timestamps_segment", "segment", "sentences",
          "audio_segments", "transcripts")


def words_json(source: str, text: str, speaker: str | None = None) -> Content:
    """Words or segments with times, or a text, of any recogniser. `InputError` for any other JSON."""
    joined = _NEXT_OBJECT.sub("},\n{", text)
    content = parse_json(text if joined == text else f"[{joined}]", source, "write it again")
    if isinstance(content, Mapping) and isinstance(content.get("tiers"), Mapping):
        return _tiers(source, content["tiers"], speaker)
    items = [item for item in content if isinstance(item, Mapping)] if isinstance(content, list) else []
    if len({str(item["audio_filepath"]) for item in items if "audio_filepath" in item}) > 1:
        raise InputError(source, "holds the words of several recordings", "leave those of one in it")
    segments = _segments(source, content, "")
    if not segments:
        raise InputError(source, "holds neither words nor segments of a known recogniser",
                         'write {"words": [{"word": "hello", "start": 0.1, "end": 0.4}]}')
    tokens = isinstance(content, Mapping) and "transcription" in content
    single = tokens or isinstance(content, list) or "chunks" in content or "word_segments" in content
    return _seconds_or_milliseconds(_content(source, segments, tokens, single))


def _tiers(source: str, content: Mapping[str, Any], speaker: str | None) -> Content:
    """The Montreal Forced Aligner's JSON: tiers of [start, end, word]."""
    tiers = {}
    for name, tier in content.items():
        rows = tier.get("entries") if isinstance(tier, Mapping) else None
        if isinstance(rows, list) and all(isinstance(row, list) and len(row) == 3 for row in rows):
            tiers[name] = [_stripped(_entry(source, {"start": a, "end": b, "word": word}, f"tiers.{name}[{n}]"))
                           for n, (a, b, word) in enumerate(rows)]
    return Content(words=spoken_tier(source, tiers, speaker))


# ---------------------------------------------------------------------------------------------------- the walk

def _segments(source: str, item: object, where: str) -> list[_Segment]:
    """The segments in a value: those of its words, else of the first of its parts that has times, else its text."""
    if isinstance(item, list):
        return [segment for place, inner in _numbered(item, where) for segment in _segments(source, inner, place)]
    if not isinstance(item, Mapping):
        return []
    item, where = _best(item, where)
    if words := _words(source, item, where):
        # The time of a segment bounds those of its words that were not aligned.
        lacking = any(word.start is None for word in words)
        times = {**item, **dict.fromkeys(_TEXTS)} if lacking else {}
        return [(_entry(source, {**times, "text": ""}, where), words)]
    text = _of(item, *_TEXTS)
    text = text.strip() if isinstance(text, str) else ""
    # Google's results of several files lie below the names of the files.
    files = [] if text else [key for key, part in item.items() if isinstance(part, Mapping) and key not in _PARTS]
    without_times: list[_Segment] = []
    for key in (*_PARTS, *files):
        segments = _segments(source, item.get(key), _below(where, key))
        if key in ("channels", "transcripts") and len(segments) > 1:
            raise InputError(source, f"holds the words of {len(segments)} channels", "leave one channel in it")
        if any(inner or cue.end is not None for cue, inner in segments):
            return segments
        without_times = without_times or segments
    return without_times or ([(_entry(source, item, where), [])] if text else [])


def _best(item: Mapping[str, Any], where: str) -> tuple[Mapping[str, Any], str]:
    """An object with the keys of the best of its alternatives, beside which stands its time; and their place."""
    for key in _ALTERNATIVES:
        if isinstance(item.get(key), list) and item[key] and isinstance(item[key][0], Mapping):
            item, where = {**item, key: None, **item[key][0]}, f"{_below(where, key)}[0]"
    return item, where


def _words(source: str, item: Mapping[str, Any], where: str) -> list[Entry]:
    """The words of an object, without what is not spoken."""
    key = next((key for key in _WORDS if _is_words(key, item.get(key))), "")
    entries: list[Entry] = []
    for place, word in _numbered(item[key] if key else (), _below(where, key)):
        kind = str(_of(word, "type", "Type") or "").lower() if isinstance(word, Mapping) else ""
        if kind == "punctuation":
            mark = str(_of(_best(word, place)[0], *_TEXTS) or "").strip()
            entries[-1:] = [replace(last, text=last.text + mark) for last in entries[-1:]]
        # whisper's tokens are numbers, or marks such as [_BEG_] and <|endoftext|>.
        elif kind not in ("spacing", "audio_event") and not (key == "tokens" and isinstance(word, int)) and not (
                isinstance(word, Mapping) and str(word.get("text")).strip().startswith(("[_", "<|"))):
            entries.append(_entry(source, word, place))
    return _joined_tokens(source, entries) if key == "tokens" else entries


def _is_words(key: str, items: object) -> bool:
    """Whether the value of one of `_WORDS` is a list of words; results are words if they have a type."""
    return isinstance(items, list) and bool(items) and (
        key != "results" or (isinstance(items[0], Mapping) and "type" in items[0]))


def _of(item: Mapping[str, Any], *keys: str) -> Any:
    """The first of the keys that an object has, or None."""
    return next((item[key] for key in keys if item.get(key) is not None), None)


def _numbered(items: Iterable[Any], name: str) -> Iterator[tuple[str, Any]]:
    """Each item with its place in the JSON, for messages."""
    return ((f"{name}[{n}]", item) for n, item in enumerate(items))


def _below(where: str, key: str) -> str:
    return f"{where}.{key}" if where else key


# ---------------------------------------------------------------------------------------------------- values

def _entry(source: str, item: object, where: str) -> Entry:
    """A JSON object as a word or a segment; both times may be missing (for a word that was not aligned), or the start
    alone (of a result)."""
    if isinstance(item, list) and len(item) == 3:  # the Montreal Forced Aligner's
        item = dict(zip(("start", "end", "word"), item, strict=True))
    if not isinstance(item, Mapping):
        raise InputError(source, f"{where}: is not an object with a word and its times", "write it again")
    item, _ = _best(item, where)
    text = _of(item, *_TEXTS)
    if not isinstance(text, str):
        raise InputError(source, f"{where}: has no word", "give it a 'word' or a 'text'")
    times: Mapping[str, Any] = item
    pair = _of(item, "timestamp", "timestamps")
    if isinstance(pair, list) and len(pair) == 2:
        if pair[1] is None and pair[0] is not None:
            # The last phrase of a recording may have no end.
            pair[1] = _seconds(source, pair[0], f"{where}.timestamp[0]") + usual_length(text)
        times = {"start": pair[0], "end": pair[1]}
    elif isinstance(item.get("offsets"), Mapping):
        times = item["offsets"]
    clock = next((clock for both in (True, False) for clock in _CLOCKS if _tells(times, clock, both)), _CLOCKS[0])
    if "audio_filepath" in item:
        clock = clock._replace(unit=1.0)  # NeMo's manifests count in seconds
    start, end = times.get(clock.start), times.get(clock.end)
    if end is None and (start is None or clock.texts):
        until = _of(item, *_RESULT_ENDS)
        return Entry(text, None, None if until is None else _seconds(source, until, f"{where}.resultEndTime"), where)
    first = 0.0 if start is None else _seconds(source, start, f"{where}.{clock.start}", clock.unit)
    last = _seconds(source, end, f"{where}.{clock.end}", clock.unit)
    return Entry(text, first, first + last if clock.lasts else last, where)


def _tells(item: Mapping[str, Any], clock: _Clock, both: bool) -> bool:
    """Whether an object has the times of a clock, or one of them. A length alone may be that of the whole recording."""
    if both and (item.get(clock.start) is None or item.get(clock.end) is None):
        return False
    time = _of(item, clock.start) if clock.lasts else _of(item, clock.start, clock.end)
    return time is not None and not (clock.texts and isinstance(time, (int, float)))


def _seconds(source: str, value: object, where: str, unit: float = 1.0) -> float:
    """A time in seconds: a number in a unit, "1.400s", "1.4", or {"seconds": 1, "nanos": 400000000}."""
    if isinstance(value, str) and _TIME.fullmatch(value):
        return float(value.removesuffix("s"))
    if isinstance(value, Mapping) and value.keys() <= {"seconds", "nanos"}:
        # Protocol buffers write large whole numbers as texts.
        parts = [str(value.get(name, 0)) for name in ("seconds", "nanos")]
        if all(re.fullmatch("[0-9]{1,11}", part) for part in parts):
            return int(parts[0]) + int(parts[1]) * 1e-9
    if isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(float(value)):
        return float(value) * unit if unit != 1.0 else float(value)
    raise InputError(source, f"{where}: {shown(value, 30)!r} is not a time", "give seconds")


def _count(text: str) -> int:
    """Number of words of a text without its gesture marks. "well-known" is one word, "well known" is two, and a
    sentence of a script without spaces has several."""
    return len(written_words(marked_text(text.replace("-", ""))[0]))


# -------------------------------------------------------------------------------------------------- content

def _content(source: str, segments: Sequence[_Segment], tokens: bool, single: bool) -> Content:
    """Segments as cues; if some have words, the words, and those of the other segments spread by their length.

    tokens: they are whisper.cpp's; single: segments may be words themselves, where none has more than one.
    """
    cues, end = list[Entry](), 0.0
    for cue, inner in segments:
        until = max([end, *(entry.end for entry in (cue, *inner) if entry.end is not None)])
        cues.append(replace(cue, start=end, end=until) if cue.start is None and cue.end is not None else cue)
        end = until
    words: list[Entry] = []
    if any(inner for _, inner in segments):
        for cue, (_, inner) in zip(cues, segments, strict=True):
            if cue is cues[-1] and [word.start for word in words] == [word.start for word in inner]:
                words = []  # with several speakers the last of Google's results repeats the words of all others
            words += filled(inner, cue.start, cue.end) if inner and cue.start is not None else \
                inner or shared_in_cue(_timed(source, cue))
    elif all(cue.start is None for cue in cues):
        return Content(text=" ".join(cue.text for cue in cues))
    elif single and all(_count(cue.text) <= 1 for cue in cues):
        words = _joined_tokens(source, cues) if tokens else cues
    else:
        return Content(cues=tuple(_stripped(_timed(source, cue)) for cue in cues))
    return Content(words=tuple(map(_stripped, words)))


def _timed(source: str, cue: Entry) -> Entry:
    """A cue, which must have times."""
    if cue.start is None:
        raise InputError(source, f"{cue.where}: has no times", "give it 'start' and 'end' in seconds")
    return cue


def _seconds_or_milliseconds(content: Content) -> Content:
    """Times without a unit: whole numbers under which a word would last 20 s are milliseconds."""
    entries = content.words or content.cues
    timed = [(entry.start, entry.end, max(1, _count(entry.text))) for entry in entries
             if entry.start is not None and entry.end is not None and entry.text and not entry.guessed]
    whole = all(start.is_integer() and end.is_integer() for start, end, _ in timed)
    if not timed or not whole or median((end - start) / count for start, end, count in timed) <= LONGEST_WORD:
        return content
    scaled = tuple(entry if entry.start is None or entry.end is None else
                   replace(entry, start=entry.start * MILLISECOND, end=entry.end * MILLISECOND) for entry in entries)
    return replace(content, words=scaled) if content.words else replace(content, cues=scaled)


def _stripped(entry: Entry) -> Entry:
    return replace(entry, text=" ".join(entry.text.split()))


def _joined_tokens(source: str, tokens: Sequence[Entry]) -> list[Entry]:
    """The words of tokens: each token without a space before it continues the word."""
    words: list[Entry] = []
    for token in tokens:
        if words and token.text and not token.text[0].isspace():
            # A token without times leaves the word's end where it was.
            words[-1] = replace(words[-1], text=words[-1].text + token.text, end=token.end or words[-1].end)
        else:
            words.append(token)
    out: list[Entry] = []
    for word in map(_stripped, words):
        # A script without spaces gives one token after the other and no word's end.
        out += shared_in_cue(_timed(source, word)) if _count(word.text) > 1 else [word]
    return [word for word in out if word.text]
