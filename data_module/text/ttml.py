"""The reader of TTML, the timed text of broadcasters and players (.ttml, .dfxp).

Times are clocks (00:00:01.500, 00:00:01:12 with frames) or offsets (1.5s, 1500ms, 36f, 15000000t), whose frames and
ticks the root element defines. Spans may have times as well: words, or the syllables of a word where no space is
between. By the standard they count from the beginning of their line; several writers count from that of the recording.
"""

import re
from collections.abc import Mapping
from xml.etree.ElementTree import Element, ParseError, fromstring

from data_module.errors import InputError, shown
from data_module.text.transcript_formats import Content, Entry, content_of, plain_text, usual_length

_CLOCK = re.compile(r"(?:(?:(\d{1,4}):)?(\d{1,4}):)?(\d{1,4}(?:\.\d+)?)(?::(\d{1,6})(?:\.\d+)?)?")
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
    units, cues = _units(source, root.attrib), list[Entry]()
    for line in root.iter("p"):
        start, stop = _place(source, line, units, 0.0)
        spoken = _text(source, line, units, start)
        if stop is None:
            stop = start + usual_length(plain_text(spoken))
        cues.append(Entry(spoken, start, stop, f"the line {shown(plain_text(spoken), 30)!r}"))
    return content_of(cues)


def _units(source: str, root: Mapping[str, str]) -> dict[str, float]:
    """Unit of an offset -> seconds. root: the attributes of the root element."""
    try:
        above, below = map(float, re.split(r"[\s:]+", root.get("frameRateMultiplier", "1 1")))
        frames = float(root.get("frameRate", 30)) * above / below
        return {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "f": 1.0 / frames,
                "t": 1.0 / float(root.get("tickRate", frames if "frameRate" in root else 1))}
    except (ValueError, ZeroDivisionError):
        raise InputError(source, "has a rate of frames or ticks that is no number above 0", "export it again") from None


def _place(source: str, element: Element, units: Mapping[str, float], zero: float) -> tuple[float, float | None]:
    """Start and end of an element in seconds, None without an end. zero: where its times count from."""
    begin, end, length = (_seconds(source, element.attrib.get(key), units) for key in ("begin", "end", "dur"))
    start = zero + (begin or 0.0)
    return start, zero + end if end is not None else start + length if length is not None else None


def _seconds(source: str, value: str | None, units: Mapping[str, float]) -> float | None:
    if value is None:
        return None
    if offset := _OFFSET.fullmatch(value.strip()):
        return float(offset[1]) * units[offset[2]]
    if clock := _CLOCK.fullmatch(value.strip()):
        return sum(float(part or 0) * units[unit] for part, unit in zip(clock.groups(), "hmsf", strict=True))
    raise InputError(source, f"{shown(value, 30)!r} is not a time", "write 00:00:01.000 or 1.5s")


def _text(source: str, line: Element, units: Mapping[str, float], start: float) -> str:
    """What is said in a line, with the times of its spans as WebVTT has them; without titles and comments."""
    spans = [inner for inner in line.iter("span") if "begin" in inner.attrib]
    # A thousandth of a second for the rounding of ticks.
    zero = start if spans and _place(source, spans[0], units, 1e-3)[0] < start else 0.0
    for inner in line.iter():
        if inner.tag == "br":
            inner.tail = f" {inner.tail or ''}"
        elif inner.tag not in ("p", "span"):
            inner.text = ""
    for inner in spans:
        before, behind = ("" if time is None else f"<{time // 3600:02.0f}:{time // 60 % 60:02.0f}:{time % 60:09.6f}>"
                          for time in _place(source, inner, units, zero))
        inner.text, inner.tail = before + (inner.text or ""), behind + (inner.tail or "")
    return " ".join(_WITHIN_WORD.sub("", "".join(line.itertext())).split())
