"""The reader of TTML, the timed text of broadcasters and players (.ttml, .dfxp).

Times are clocks (00:00:01.500, 00:00:01:12 with frames) or offsets (1.5s, 1500ms, 36f, 15000000t), whose frames and
ticks the root element defines. By the standard they count from the beginning of the element around them; several
writers count all from the beginning of the recording, which shows where a line would begin after its paragraph ends.
Spans may have times of their own: words, or the syllables of a word where no space is between.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from xml.parsers import expat

from data_module.errors import InputError, shown
from data_module.text.transcript_formats import Content, Entry, plain_text, shared_in_cue, usual_length

_CLOCK = re.compile(r"(?:(?:(\d{1,4}):)?(\d{1,4}):)?(\d{1,4}(?:[.,]\d+)?)(?::(\d{1,6})(?:\.\d+)?)?")
_OFFSET = re.compile(r"(\d{1,20}(?:[.,]\d+)?)(h|ms|m|s|f|t)")
# What is no entity of XML is taken as it is written: "R & B", and names of HTML's, which are resolved later.
_BARE = re.compile(r"&(?!(?:amp|lt|gt|quot|apos|#\d{1,7}|#x[0-9a-fA-F]{1,6});)")
_DEEPEST = 50
"""Largest depth of elements; real files have six."""


@dataclass
class _Element:
    """An element with its times as they are written, and what is in it. start, stop: seconds of the recording."""

    name: str
    line: int
    times: Mapping[str, float]
    in_sequence: bool = False
    inside: "list[_Element | str]" = field(default_factory=list)
    start: float = 0.0
    stop: float = math.inf

    def elements(self, name: str) -> "Iterator[_Element]":
        """The elements of a name in it, in their order."""
        for part in self.inside:
            if isinstance(part, _Element):
                yield from [part] if part.name == name else []
                yield from part.elements(name)


def ttml(source: str, text: str, speaker: str | None = None) -> Content:
    """The lines as cues, or the words if spans have times. `InputError` names the line of what is not XML or no time.
    """
    root = _parsed(source, text)
    if not _place(root, 0.0, math.inf, nested=True):
        _place(root, 0.0, math.inf, nested=False)
    lines = list(root.elements("p"))
    for line, after in zip(lines, [*lines[1:], None], strict=False):
        if math.isinf(line.stop):
            usual = line.start + usual_length(_text(line))
            line.stop = after.start if after and after.start > line.start else usual
    if any("begin" in span.times for line in lines for span in line.elements("span")):
        return Content(words=tuple(word for line in lines for word in _words(line)))
    return Content(cues=tuple(Entry(_text(line), line.start, line.stop, f"line {line.line}") for line in lines))


def _parsed(source: str, text: str) -> _Element:
    """The elements of a file, whatever the prefixes of its names are."""
    parser = expat.ParserCreate()
    parser.buffer_text = True
    root = _Element("", 1, {})
    path = [root]
    rates: dict[str, str] = {}

    def opened(name: str, attributes: dict[str, str]) -> None:
        known = {key.rpartition(":")[2]: value for key, value in attributes.items()}
        if len(path) == 1:
            rates.update(known)
        line = parser.CurrentLineNumber
        times: dict[str, float] = {key: _seconds(source, line, known[key], rates)
                                   for key in ("begin", "end", "dur") if key in known}
        element = _Element(name.rpartition(":")[2], line, times, known.get("timeContainer") == "seq")
        path[-1].inside.append(element)
        path.append(element)
        if len(path) > _DEEPEST:
            raise InputError(source, f"line {line}: has elements in more than {_DEEPEST} others", "export it again")

    parser.StartElementHandler = opened
    parser.EndElementHandler = lambda name: path.pop()
    parser.CharacterDataHandler = lambda part: path[-1].inside.append(part)
    try:
        parser.Parse(_BARE.sub("&amp;", text), True)
    except expat.ExpatError as error:
        raise InputError(source, f"line {error.lineno}: is not XML ({expat.ErrorString(error.code)})",
                         "export it again") from None
    return root


def _seconds(source: str, line: int, value: str, rates: Mapping[str, str]) -> float:
    """A time in seconds. rates: the attributes of the root element."""
    try:
        nominal = float(rates.get("frameRate", 30))
        above, below = map(float, re.split(r"[\s:]+", rates.get("frameRateMultiplier", "1 1")))
        frames = nominal * above / below
        parts = frames * float(rates.get("subFrameRate", 1))
        ticks = float(rates.get("tickRate", parts if "frameRate" in rates else 1))
        if offset := _OFFSET.fullmatch(value.strip()):
            unit = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "f": 1.0 / frames, "t": 1.0 / ticks}[offset[2]]
            return float(offset[1].replace(",", ".")) * unit
        if clock := _CLOCK.fullmatch(value.strip()):
            hours, minutes, seconds, frame = clock.groups()
            whole = int(hours or 0) * 3600 + int(minutes or 0) * 60 + float(seconds.replace(",", "."))
            # A time code counts as many frames a second as the nominal rate has, at 29.97 more than a second lasts.
            coded = rates.get("timeBase") == "smpte" and rates.get("dropMode", "nonDrop") == "nonDrop"
            return whole * (nominal / frames if coded else 1.0) + int(frame or 0) / frames
    except (ValueError, ZeroDivisionError):
        pass
    raise InputError(source, f"line {line}: {shown(value, 30)!r} is not a time", "write 00:00:01.000 or 1.5s")


def _place(element: _Element, base: float, until: float, nested: bool) -> bool:
    """Set the times of an element and of all in it, which count from `base` if `nested`, else from 0. False if one of
    them begins after what it is in has ended."""
    first = base if nested else 0.0
    element.start = first + element.times["begin"] if "begin" in element.times else base
    ends = [until, *([first + element.times["end"]] if "end" in element.times else []),
            *([element.start + element.times["dur"]] if "dur" in element.times else [])]
    # A line that ends before it begins keeps its times, for the message.
    element.stop = ends[-1] if len(ends) > 1 and ends[-1] < element.start else min(ends)
    good, at = element.start <= until, element.start
    for part in element.inside:
        if isinstance(part, _Element):
            good &= _place(part, at, element.stop, nested)
            at = part.stop if element.in_sequence and math.isfinite(part.stop) else at
    return good


def _text(element: _Element) -> str:
    return plain_text("".join(piece for piece, _ in _pieces(element)))


def _pieces(element: _Element) -> Iterator[tuple[str, _Element]]:
    """The texts of a line in their order, each with the element whose time it has; titles and comments are left out."""
    for part in element.inside:
        if isinstance(part, str):
            yield part, element
        elif part.name == "span":
            yield from ((text, inner if "begin" in inner.times else element) for text, inner in _pieces(part))
        elif part.name == "br":
            yield " ", element


def _words(line: _Element) -> Iterator[Entry]:
    """The words of a line; those outside of spans with times have none."""
    if not any("begin" in span.times for span in line.elements("span")):
        yield from shared_in_cue(Entry(_text(line), line.start, line.stop, f"line {line.line}"))
        return
    word: Entry | None = None
    ended = True
    for text, element in _pieces(line):
        piece = Entry(plain_text(text), element.start, element.stop, f"line {element.line}")
        if element is line:
            piece = replace(piece, start=None, end=None)
        single = " " not in piece.text
        if piece.text and word and single and not ended and not text[0].isspace():
            # The next syllable.
            word = replace(word, text=word.text + piece.text, end=word.end if piece.end is None else piece.end)
        elif piece.text:
            yield from [word] if word else []
            *before, word = [piece] if single else shared_in_cue(piece) if piece.start is not None else [
                replace(piece, text=one) for one in piece.text.split()]
            yield from before
        ended = text[-1:].isspace() or not piece.text
    yield from [word] if word else []
