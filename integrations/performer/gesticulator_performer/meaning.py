"""English words that ask for a stroke by meaning, and the beat strokes that any stressed syllable may take.

The names are those of `data/strokes`; a performer without a stroke takes the next name.
"""

from __future__ import annotations

from collections.abc import Sequence

from gesticulator_performer.cues import plain
from gesticulator_performer.tables import table

LOW, MID, HIGH = "low", "mid", "high"
BEATS: dict[str, tuple[str, ...]] = {
    LOW: ("BeatLow", "BeatFlip", "BeatFistMid"),
    MID: ("BeatMid", "BeatForward", "BeatPointMid", "BeatFistMid"),
    HIGH: ("BeatHigh", "Chop", "BeatForward"),
}
"""Lexemes of beats by prominence of the syllable."""

_TABLE = table("words.toml")
# Groups of strokes with one meaning, best first.
_STROKES: dict[str, tuple[str, ...]] = {
    name: tuple(group["strokes"].split()) for name, group in _TABLE["lexemes"].items()}
# Words so common that a stroke on them is rare.
_SELDOM = frozenset(_TABLE["common"]["words"].split())
_ASKING = {tuple(phrase.split()): _STROKES[name] for phrase, name in _TABLE["phrases"].items()}
_LOOKUP = {word: _STROKES[name] for name, group in _TABLE["lexemes"].items() for word in group["words"].split()}
_LONGEST_PHRASE = max(map(len, _ASKING))


def lexemes_of(words: Sequence[str], index: int) -> tuple[tuple[str, ...], float]:
    """Candidate lexemes for the word at `index`, best first, and the weight of the request (0 to 1). Phrases take
    precedence over words; the last word of a phrase carries its stroke. ((), 0) for other words."""
    for length in range(min(_LONGEST_PHRASE, index + 1), 1, -1):
        phrase = tuple(plain(word) for word in words[index - length + 1:index + 1])
        if phrase in _ASKING:
            return _ASKING[phrase], 1.0
    word = plain(words[index])
    if word in _LOOKUP:
        return _LOOKUP[word], 0.35 if word in _SELDOM else 1.0
    return (), 0.0


def beat_level(prominence: float) -> str:
    """Level of the beats for a syllable of this prominence: low, mid or high."""
    if prominence < 0.35:
        return LOW
    return MID if prominence < 1.1 else HIGH


MOVEMENTS: dict[str, tuple[tuple[str, ...], ...]] = {
    movement: tuple(_STROKES[name] for name in names.split()) for movement, names in {
        "large": "big all", "small": "small", "self": "me", "forward": "you there give", "left": "left",
        "right": "right", "sideways": "negate no"}.items()}
"""Movement feature that a word can ask for, in the order of `talks.features_of` -> the lexemes that ask for it."""


def movements_of(words: Sequence[str]) -> list[int]:
    """For each word the index of its feature in `MOVEMENTS`, -1 for none and for words that are too common."""
    out = []
    for index in range(len(words)):
        lexemes, strength = lexemes_of(words, index)
        kinds = [kind for kind, known in enumerate(MOVEMENTS.values()) if lexemes in known]
        out.append(kinds[0] if kinds and strength == 1.0 else -1)
    return out
