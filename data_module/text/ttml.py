"""The reader of TTML, the timed text of broadcasters and players (.ttml, .dfxp).

Times are clocks (00:00:01.500, 00:00:01:12 with frames) or offsets (1.5s, 1500ms, 36f, 15000000t), whose frames and
ticks the root element defines. Spans may have times as well: words, or the syllables of a word where no space is
between. By the standard a time counts from the beginning of the element around; several writers count from that of the
recording.
"""

import re
from collections.abc import Iterable, Mapping
from xml.etree.ElementTree import Element, ParseError, fromstring

from data_module.errors import InputError, shown
from data_module.text.transcript_formats import Content, Entry, content_of, plain_text, usual_length

_CLOCK = re.compile(r"(?:(?:(\d{1,4}):)?(\d{1,4}):)?(\d{1,6}(?:\.\d+)?)(?::(\d{1,6})(?:\.\d+)?)?")
_OFFSET = re.compile(r"(\d{1,20}(?:\.\d+)?)(h|ms|m|s|f|t)")
# Times between two syllables of a word.
_WITHIN_WORD = re.compile(r"(?<=[^\s>])(?:<[\d:.]+>)+(?=[^\s<])")


def ttml(source: str, text: str, speaker: str | None = None) -> Content:
    """The lines as cues, or the words if spans have times; `InputError` for what is not XML or no time."""
    try:
        root = fromstring(text)
    except ParseError as error:
        raise InputError(source, f"is not XML ({error})", "export it again") from None
    for element in root.iter():
        # Whatever the prefixes of names are.
        element.tag = element.tag.rpartition("}")[2]
        element.attrib = {key.rpartition("}")[2]: value for key, value in element.items()}
    times, cues = _Times(source, root.attrib), list[Entry]()
    zeros = {root: 0.0}
    for element in root.iter():
        start, stop = times.of(element, zeros[element])
        zero = times.zero(element, start, zeros[element])
        zeros |= dict.fromkeys(element, zero)
        if element.tag == "p":
            spoken = _text(element, times, zero)
            if stop is None:
                stop = start + usual_length(plain_text(spoken))
            cues.append(Entry(spoken, start, stop, f"the line {shown(plain_text(spoken), 30)!r}"))
    return content_of(cues)


class _Times:
    """Times of a file in seconds."""

    def __init__(self, source: str, root: Mapping[str, str]) -> None:
        """root: the attributes of the root element."""
        self._source = source
        try:
            above, below = map(float, re.split(r"[\s:]+", root.get("frameRateMultiplier", "1 1")))
            frames = float(root.get("frameRate", 30)) * above / below
            ticks = float(root.get("tickRate", frames if "frameRate" in root else 1))
            self._units = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "f": 1.0 / frames, "t": 1.0 / ticks}
        except (ValueError, ZeroDivisionError):
            raise InputError(source, "has a rate of frames or ticks that is no number above 0",
                             "export it again") from None

    def of(self, element: Element, zero: float) -> tuple[float, float | None]:
        """Start and end of an element, None without an end. zero: where its times count from."""
        begin, end, length = (self._seconds(element.attrib.get(key)) for key in ("begin", "end", "dur"))
        start = zero + (begin or 0.0)
        return start, zero + end if end is not None else start + length if length is not None else None

    def zero(self, inside: Iterable[Element], start: float, zero: float) -> float:
        """Where the times inside of an element count from: its `start`, or where its own do if the first time inside is
        not before that."""
        first = next((element for element in inside if "begin" in element.attrib), None)
        # A thousandth of a second for the rounding of ticks.
        return start if first is not None and self.of(first, zero)[0] < start - 1e-3 else zero

    def _seconds(self, value: str | None) -> float | None:
        if value is None:
            return None
        if offset := _OFFSET.fullmatch(value.strip()):
            return float(offset[1]) * self._units[offset[2]]
        if clock := _CLOCK.fullmatch(value.strip()):
            return sum(float(part or 0) * self._units[unit] for part, unit in zip(clock.groups(), "hmsf", strict=True))
        raise InputError(self._source, f"{shown(value, 30)!r} is not a time", "write 00:00:01.000 or 1.5s")


def _text(line: Element, times: _Times, zero: float) -> str:
    """What is said in a line, with the times of its spans as WebVTT has them; without titles and comments. zero: where
    the times of spans count from."""
    for inner in line.iter():
        if inner.tag == "br":
            inner.tail = f" {inner.tail or ''}"
        elif inner.tag not in ("p", "span"):
            inner.text = ""
        elif inner.tag == "span" and "begin" in inner.attrib:
            begin, end = times.of(inner, zero)
            inner.text, inner.tail = _mark(begin) + (inner.text or ""), _mark(end) + (inner.tail or "")
    return " ".join(_WITHIN_WORD.sub("", "".join(line.itertext())).split())


def _mark(time: float | None) -> str:
    """A time inside of a line of WebVTT."""
    return "" if time is None else f"<{time // 3600:02.0f}:{time // 60 % 60:02.0f}:{time % 60:09.6f}>"
