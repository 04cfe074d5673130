"""The language of a text, by its commonest words."""

from collections.abc import Sequence

_COMMONEST = {language: frozenset(words.split()) for language, words in {
    "en": "the and of to a in is that it you i we for on with this was are be have not at they but",
    "de": "der die das und ich nicht ist zu es wir ein eine mit den auf sie auch dass für von",
    "es": "el la los las que de y no en es un una con por para lo se del como más"}.items()}
LANGUAGES = tuple(_COMMONEST)
"""Languages in which the program knows words: cue phrases of gestures, and voices for pronunciations."""


def language_of(words: Sequence[str]) -> str:
    """The language of `LANGUAGES` whose commonest words are most frequent here; English where none is clearly so."""
    counts = {language: sum(word.lower().strip(".,;:!?¿¡\"'") in common for word in words)
              for language, common in _COMMONEST.items()}
    best = max(counts, key=lambda language: counts[language])
    # At least two words: a short text shares "no" or "de" with its neighbours by chance.
    return best if counts[best] >= 2 and counts[best] > counts["en"] else "en"
