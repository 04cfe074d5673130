"""The reader of TTML, the timed text of broadcasters and players (.ttml, .dfxp).

Times are clocks (00:00:01.500, 00:00:01:12 with frames) or offsets (1.5s, 1500ms, 36f, 15000000t), whose frames and
ticks the root element defines. By the standard they count from the beginning of the element around them; several
writers count all from the beginning of the recording, which shows where a line would begin after its paragraph ends.
Spans may have times as well: words, or the syllables of a word where no space is between.
"""

import math
import re
from collections.abc import Mapping
from typing import TypeAlias
from xml.etree.ElementTree import Element, ParseError, fromstring

from data_module.errors import InputError, shown
from data_module.text.transcript_formats import Content, Entry, content_of, plain_text, usual_length

_CLOCK = re.compile(r"(?:(?:(\d{1,4}):)?(\d{1,4}):)?(\d{1,4}(?:\.\d+)?)(?::(\d{1,6})(?:\.\d+)?)?")
_OFFSET = re.compile(r"(\d{1,20}(?:\.\d+)?)(h|ms|m|s|f|t)")
# What is no entity of XML is taken as it is written: "R & B", and names of HTML's, which are resolved later.
_BARE = re.compile(r"&(?!(?:amp|lt|gt|quot|apos|#\d{1,7}|#x[0-9a-fA-F]{1,6});)")
# Times between two syllables of a word.
_WITHIN_WORD = re.compile(r"(?<=[^\s>])(?:<[\d:.]+>)+(?=[^\s<])")
_DEEPEST = 50
"""Largest depth of elements; real files have six."""

_Places: TypeAlias = dict[Element, tuple[float, float]]
"""Element -> its start and its end in the recording, seconds."""


def ttml(source: str, text: str, speaker: str | None = None) -> Content:
    """The lines as cues, or the words if spans have times; `InputError` for what is not XML or no time."""
    try:
        root = fromstring(_BARE.sub("&amp;", text))
    except ParseError as error:
        raise InputError(source, f"is not XML ({error})", "export it again") from None
    for element in root.iter():
        # Whatever the prefixes of names are.
        element.tag = element.tag.rpartition("}")[2]
        element.attrib = {key.rpartition("}")[2]: value for key, value in element.items()}
    times: dict[Element, dict[str, float]] = {
        element: {key: _seconds(source, element.attrib[key], root.attrib)
                  for key in ("begin", "end", "dur") if key in element.attrib} for element in root.iter()}
    places: _Places = {}
    try:
        if not _place(root, times, places, 0.0, math.inf, nested=True):
            _place(root, times, places, 0.0, math.inf, nested=False)
    except RecursionError:
        raise InputError(source, f"has elements in more than {_DEEPEST} others", "export it again") from None
    lines, cues = list(root.iter("p")), list[Entry]()
    for line, after in zip(lines, lines[1:] + lines[-1:], strict=True):
        (start, stop), following = places[line], places[after][0]
        spoken = " ".join(_WITHIN_WORD.sub("", _text(line, places)).split())
        if math.isinf(stop):
            stop = following if following > start else start + usual_length(plain_text(spoken))
        cues.append(Entry(spoken, start, stop, f"the line {shown(plain_text(spoken), 30)!r}"))
    return content_of(cues)


def _seconds(source: str, value: str, rates: Mapping[str, str]) -> float:
    """A time in seconds. rates: the attributes of the root element."""
    try:
        nominal = float(rates.get("frameRate", 30))
        above, below = map(float, re.split(r"[\s:]+", rates.get("frameRateMultiplier", "1 1")))
        frames = nominal * above / below
        parts = frames * float(rates.get("subFrameRate", 1))
        ticks = float(rates.get("tickRate", parts if "frameRate" in rates else 1))
        if offset := _OFFSET.fullmatch(value.strip()):
            return float(offset[1]) * {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "f": 1.0 / frames,
                                       "t": 1.0 / ticks}[offset[2]]
        if clock := _CLOCK.fullmatch(value.strip()):
            hours, minutes, seconds, frame = (float(part or 0) for part in clock.groups())
            # A time code counts as many frames a second as the nominal rate has: at 29.97 more than a second lasts.
            coded = rates.get("timeBase") == "smpte" and rates.get("dropMode", "nonDrop") == "nonDrop"
            return (3600 * hours + 60 * minutes + seconds) * (nominal / frames if coded else 1.0) + frame / frames
    except (ValueError, ZeroDivisionError):
        pass
    raise InputError(source, f"{shown(value, 30)!r} is not a time", "write 00:00:01.000 or 1.5s")


def _place(element: Element, times: Mapping[Element, Mapping[str, float]], places: _Places, base: float, until: float,
           nested: bool, depth: int = 0) -> bool:
    """Find the places of an element and of all in it, whose times count from `base` if `nested`, else from 0. False if
    one of them begins after what it is in has ended."""
    if depth > _DEEPEST:
        raise RecursionError
    given, zero = times[element], base if nested else 0.0
    start = zero + given["begin"] if "begin" in given else base
    stop = min(zero + given.get("end", math.inf), start + given.get("dur", math.inf))
    # A line that ends before it begins keeps its times, for the message.
    places[element] = start, stop = start, stop if stop < start else min(stop, until)
    good, begin = start <= until, start
    for inner in element:
        good &= _place(inner, times, places, begin, stop, nested, depth + 1)
        if element.get("timeContainer") == "seq" and math.isfinite(places[inner][1]):
            begin = places[inner][1]
    return good


def _text(element: Element, places: _Places) -> str:
    """What is said in a line, with the times of its spans as WebVTT has them; without titles and comments."""
    out = element.text or ""
    for inner in element:
        if inner.tag == "span":
            edges = [f"<{time // 3600:02.0f}:{time // 60 % 60:02.0f}:{time % 60:09.6f}>" if math.isfinite(time) else ""
                     for time in (places[inner] if "begin" in inner.attrib else ())] or ["", ""]
            out += edges[0] + _text(inner, places) + edges[1]
        out += (" " if inner.tag == "br" else "") + (inner.tail or "")
    return out
