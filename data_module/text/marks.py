"""Gesture marks in a text: `[shrug]`, `[count:3]`, SSML's `<mark name="gesture.shrug"/>`, and a few emoji.

A mark stands before the word at which its gesture is made. It is never spoken: readers take it out of the words and
note its name. This module knows how marks are written; `gesticulator.directing.marks` knows which gestures there are.
"""

import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TypeAlias

from data_module.types import Word

__all__ = ["EMOJI", "NONE", "WordMarks", "mark_name", "marked_text", "marked_words", "with_marks"]

NONE = "none"
"""The mark that keeps a word free of gestures."""
EMOJI = {
    "\N{SHRUG}": "shrug", "\N{WAVING HAND SIGN}": "wave", "\N{RAISED HAND}": "stop",
    "\N{PALMS UP TOGETHER}": "open palms", "\N{THUMBS UP SIGN}": "thumbs up", "\N{THUMBS DOWN SIGN}": "thumbs down",
    "\N{OK HAND SIGN}": "ok ring", "\N{CLAPPING HANDS SIGN}": "clap", "\N{PERSON WITH FOLDED HANDS}": "prayer hands",
    "\N{THINKING FACE}": "chin think", "\N{HAND WITH INDEX AND MIDDLE FINGERS CROSSED}": "fingers crossed",
    "\N{FLEXED BICEPS}": "flex arm",
}
"""Emoji -> the gesture that it marks. None of them points: to whose left an arrow of a hand points is ambiguous."""
SOUNDS = frozenset((
    "applause", "background noise", "beep", "blank audio", "breath", "breathing", "cheering", "cheers", "chuckle",
    "chuckles", "clapping", "clears throat", "cough", "coughing", "coughs", "cross talk", "crosstalk", "crying", "gasp",
    "gasps", "inaudible", "indistinct", "laugh", "laughing", "laughs", "laughter", "music", "music playing", "no audio",
    "noise", "pause", "phone ringing", "sic", "sigh", "sighs", "silence", "silent", "singing", "sound", "static",
    "unclear", "unintelligible"))
"""Notes in brackets that recognisers and typists write; they are left out like marks, without a warning."""

# A skin tone, the emoji form of a character, and a gender; "shrug" often comes with all three.
_VARIANT = "[\U0001f3fb-\U0001f3ff]?\ufe0f?(?:\u200d[\u2640\u2642]\ufe0f?)?"
_BRACKET = r"\[(?P<bracket>[^\W\d_][\w '’.:/-]{0,39})(?<![\s:])\](?!\()"
_TAG = r"</?(?:mark|bookmark)\b(?P<tag>[^<>]{0,200})>"
# Whom recognisers name before what is said, as a mark would be written.
_SPEAKER = re.compile(r"speaker \w{1,2}|unknown")
_MARK = re.compile(rf"{_BRACKET}|{_TAG}|(?P<emoji>{'|'.join(EMOJI)}){_VARIANT}", re.IGNORECASE)
_ATTRIBUTE = re.compile(r"""\b(?:name|mark)\s*=\s*["']\s*gesture[.:]\s*([^"']{1,60})["']""", re.IGNORECASE)
_OTHER_TAG = re.compile(r"<[/?!]?[a-zA-Z][^<>]*>")
_SSML = re.compile(r"<speak\b|<(?:mark|bookmark)\b[^<>]{0,200}>", re.IGNORECASE)

WordMarks: TypeAlias = "tuple[str, tuple[str, ...]]"
"""A word without marks, and the names of the marks before it."""


def mark_name(text: str) -> str:
    """The name of a gesture as it is written in a mark, in plain words: "gesture:count_3" and "Count:3" are "count 3".
    """
    plain = " ".join(re.split(r"[\s_:.-]+", text.strip().casefold()))
    return plain.removeprefix("gesture ").strip()


def is_mark(text: str) -> bool:
    """Whether a whole text is one mark."""
    return _MARK.fullmatch(text) is not None


def marked_text(text: str) -> tuple[str, tuple[tuple[int, str], ...]]:
    """A text without its marks, and (offset in it, name) of each mark, in order. A mark between two words leaves a
    space. In a text with SSML, other tags are left out, too."""
    if _SSML.search(text):
        text = _OTHER_TAG.sub(lambda tag: tag[0] if is_mark(tag[0]) else " ", text)
    parts: list[str] = []
    marks: list[tuple[int, str]] = []
    at = length = 0
    for match in _MARK.finditer(text):
        piece = text[at:match.start()]
        parts.append(piece)
        length += len(piece)
        at = match.end()
        before = text[match.start() - 1:match.start()]
        if before and not before.isspace():
            parts.append(" ")
            length += 1
        elif text[at:at + 1] == " ":
            at += 1
        marks += [(length, name) for name in _names(match)]
    parts.append(text[at:])
    return "".join(parts), tuple(marks)


def _names(match: re.Match[str]) -> Iterator[str]:
    """The name of a mark, unless it is a mark for another program (another `<mark>`) or a note of a sound."""
    if match["emoji"]:
        yield EMOJI[match["emoji"]]
    elif match["bracket"]:
        name = mark_name(match["bracket"])
        if name not in SOUNDS and not _SPEAKER.fullmatch(name):
            yield name
    elif match["tag"] and (attribute := _ATTRIBUTE.search(match["tag"])):
        yield mark_name(attribute[1])


def marked_words(texts: Sequence[str]) -> tuple[list[WordMarks], tuple[str, ...]]:
    """Each text of a list of words without marks, with the names of the marks before it; and the marks after the last
    word. A mark may be spread over several texts, as "[thumbs" and "up]" are. Texts without a mark stay as they are."""
    # A mark may begin in one text and end in another, so all are searched at once.
    joined = " ".join(texts)
    waiting = deque((match.end(), name) for match in _MARK.finditer(joined) for name in _names(match))
    plain = _MARK.sub(lambda match: "\0" * len(match[0]), joined)
    out: list[WordMarks] = []
    begin = 0
    for text in texts:
        piece = plain[begin:begin + len(text)]
        # A mark is on the first text of which something spoken is behind it.
        spoken = piece.replace("\0", " ").rstrip()
        names = []
        while spoken and waiting and waiting[0][0] < begin + len(spoken):
            names.append(waiting.popleft()[1])
        out.append((" ".join(piece.replace("\0", "").split()) if "\0" in piece else text, tuple(names)))
        begin += len(text) + 1
    return out, tuple(name for _, name in waiting)


def with_marks(words: Sequence[Word], text: str, marks: Sequence[tuple[int, str]],
               tokens: Callable[[str], Sequence[object]]) -> tuple[tuple[Word, ...], tuple[str, ...]]:
    """The words of a text, as `tokens` cuts it, with the marks of `marked_text` on the word after each; and the names
    of the marks after the last word."""
    out, late, at, count = list(words), [], 0, 0
    for offset, name in marks:
        count += len(tokens(text[at:offset]))
        at = offset
        if count < len(out):
            out[count] = replace(out[count], marks=(*out[count].marks, name))
        else:
            late.append(name)
    return tuple(out), tuple(late)
