"""Gesture marks in what a language model writes, such as `[shrug] no idea`: out of the voice, and to the server.

The server knows which gestures there are; here they are only told from words. A mark is a name in square brackets,
SSML's `<mark name="gesture.shrug"/>` or `<bookmark mark="gesture.shrug"/>`, or one of twelve emoji.
"""

from __future__ import annotations

import re

_EMOJI = ("\U0001f937\U0001f44b\u270b\U0001f932\U0001f44d\U0001f44e"
          "\U0001f44c\U0001f44f\U0001f64f\U0001f914\U0001f91e\U0001f4aa")
_MARK = re.compile(
    r"\[[^\W\d_][\w '’.:/-]{0,39}(?<![\s:])\](?!\()|</?(?:mark|bookmark)\b[^<>]{0,200}>"
    rf"|[{_EMOJI}][\U0001f3fb-\U0001f3ff]?\ufe0f?(?:\u200d[\u2640\u2642]\ufe0f?)?", re.IGNORECASE)
LONGEST = 200
"""Characters of a word that the server takes."""
LETTER_SECONDS = 0.065
"""How long a voice takes for a letter, where nothing more is known of it."""


def without_marks(text: str) -> str:
    """A text as it is spoken. Where a mark stood between words there is one space."""
    return re.sub(r"[ \t]{2,}", " ", _MARK.sub(" ", text)) if _MARK.search(text) else text


async def spoken_text(text: str, text_type: str = "") -> str:
    """`without_marks` as a text transform of a Pipecat synthesiser: text_transforms=[("*", spoken_text)]."""
    return without_marks(text)


def timed_words(text: str, start: float, letter: float) -> list[tuple[str, float, float]]:
    """The words of a text and its marks, which stand between them and take no time. A letter takes `letter` seconds, as
    does the space after a word."""
    words: list[tuple[str, float, float]] = []
    at = 0
    for match in [*_MARK.finditer(text), None]:
        for word in text[at:match.start() if match else len(text)].split():
            end = start + letter * len(word)
            words.append((word[:LONGEST], start, end))
            start = end + letter
        if match:
            at = match.end()
            words += [(match.group(), start, start)] if at - match.start() <= LONGEST else []
    return words
