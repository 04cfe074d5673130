"""English words that ask for a stroke by meaning, and the beat strokes that any stressed syllable may take.

The names are those of `data/strokes` and of the procedural strokes; a performer without a stroke takes the next name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

LOW, MID, HIGH = "low", "mid", "high"
BEATS: dict[str, tuple[str, ...]] = {
    LOW: ("BeatLow", "BeatFlip", "BeatFistMid"),
    MID: ("BeatMid", "BeatForward", "BeatPointMid", "BeatFistMid"),
    HIGH: ("BeatHigh", "Chop", "BeatForward"),
}
"""Lexemes of beats by prominence of the syllable."""

_YOU = ("You", "YouForward", "YouPoint", "YouLeft", "YouRight")
_ME = ("Me",)
_WE = ("We", "InclusivityPos", "Surround", "All")
_NEGATE = ("Negative", "Negate", "NegateForwardLow", "NegateForwardMid", "NegateLeftLow", "NegateRightLow",
           "NegateLeftMid", "NegateRightMid")
_NO = ("NoForward", "NoLeft", "NoRight", *_NEGATE)
_STOP = ("Stop", "StopForward", "StopLeft", "StopRight", *_NEGATE)
_NONE = ("InclusivityNeg", *_NEGATE)
_ALL = ("Surround", "InclusivityPos", "EmptyLarge", "All")
_BIG = ("EmptyLarge", "Frame", "Surround", "All")
_SMALL = ("EmptyMedium", "Frame")
_LEFT = ("IndicateLeft", "DeicticLeft", "Left", "YouLeft")
_RIGHT = ("IndicateRight", "DeicticRight", "Right", "YouRight")
_HERE = ("Here", "Point", "BeatPointMid")
_THERE = ("Point", "IndicateLeft", "IndicateRight", "DeicticLeft", "DeicticRight", "YouForward")
_BUT = ("However", "Besides", "BeatFlip")
_ALSO = ("Besides", "However", "BeatFlip")
_EXAMPLE = ("Example", "BeatFlip")
_GIVE = ("Offer", "BeatFlip")
_TAKE = ("Receive",)
_PLEASE = ("Plea", "Offer")
_DOUBT = ("Shrug", "BeatFlip")
_SURE = ("Safe", "Chop")
_WHEN = ("When",)
_CUT = ("Chop",)

_WORDS: dict[tuple[str, ...], str] = {
    _YOU: "you your yours yourself yourselves",
    _ME: "i me my mine myself",
    _WE: "we us our ours ourselves together",
    _NEGATE: "not never neither nor cannot can't don't won't isn't wasn't doesn't didn't couldn't shouldn't wouldn't "
             "aren't weren't hasn't haven't hadn't without refuse wrong false bad worse",
    _NO: "no",
    _STOP: "stop wait enough halt stay quiet",
    _NONE: "nothing none nobody nowhere empty lost gone",
    _ALL: "all everything everybody everyone everywhere every whole entire always around world",
    _BIG: "huge big large great enormous wide vast long giant tall",
    _SMALL: "small little tiny short narrow box picture frame size",
    _LEFT: "left",
    _RIGHT: "right",
    _HERE: "here now today this these",
    _THERE: "there that those look see over far away yonder",
    _BUT: "but however although though yet still instead rather otherwise",
    _ALSO: "also besides moreover too another other",
    _EXAMPLE: "example instance namely such like kind",
    _GIVE: "give gives gave offer offers offered show shows showed bring take have open",
    _TAKE: "receive get gets got accept come comes came welcome find found",
    _PLEASE: "please hope beg pray want need wish must help sorry",
    _DOUBT: "maybe perhaps guess doubt unsure possibly probably whatever who what why how wonder",
    _SURE: "sure certain certainly safe clear clearly calm exactly true truth indeed fine",
    _WHEN: "when time then while before after until later soon ago",
    _CUT: "first second third one two three four cut break once only",
}
_OFTEN = ("i my your our we us me what how who one like have this that these those there then other still over no not "
          "now so see get got too come take long time only great little right")
_WEAK = frozenset(_OFTEN.split())
"""Words so common that a stroke on them is rare."""
_PHRASES: dict[tuple[str, ...], tuple[str, ...]] = {
    ("on", "the", "other", "hand"): _BUT, ("on", "the", "one", "hand"): _BUT, ("for", "example"): _EXAMPLE,
    ("for", "instance"): _EXAMPLE, ("not", "at", "all"): _NEGATE, ("do", "not", "know"): _DOUBT,
    ("don't", "know"): _DOUBT, ("not", "sure"): _DOUBT, ("of", "course"): _SURE, ("all", "of", "us"): _WE,
    ("all", "of", "you"): _ALL, ("come", "in"): _TAKE, ("over", "there"): _THERE, ("right", "here"): _HERE,
    ("right", "now"): _HERE, ("to", "the", "left"): _LEFT, ("to", "the", "right"): _RIGHT, ("no", "one"): _NONE,
}
_LOOKUP = {word: lexemes for lexemes, words in _WORDS.items() for word in words.split()}
_LONGEST = max(map(len, _PHRASES))


def plain(word: str) -> str:
    """A word in the spelling of the tables: lower case, one kind of apostrophe, no punctuation."""
    return re.sub(r"[^a-z']", "", word.lower().replace("\u2019", "'")).strip("'")


def lexemes_of(words: Sequence[str], index: int) -> tuple[tuple[str, ...], float]:
    """Candidate lexemes for the word at `index`, best first, and the weight of the request (0 to 1). Phrases take
    precedence over words; the last word of a phrase carries its stroke. ((), 0) for other words."""
    for length in range(min(_LONGEST, index + 1), 1, -1):
        phrase = tuple(plain(word) for word in words[index - length + 1:index + 1])
        if phrase in _PHRASES:
            return _PHRASES[phrase], 1.0
    word = plain(words[index])
    if word in _LOOKUP:
        return _LOOKUP[word], 0.35 if word in _WEAK else 1.0
    return (), 0.0


def beat_level(prominence: float) -> str:
    """Level of the beats for a syllable of this prominence: low, mid or high."""
    if prominence < 0.35:
        return LOW
    return MID if prominence < 1.1 else HIGH


MOVEMENTS: dict[str, tuple[tuple[str, ...], ...]] = {
    "large": (_BIG, _ALL), "small": (_SMALL,), "self": (_ME,), "forward": (_YOU, _THERE, _GIVE), "left": (_LEFT,),
    "right": (_RIGHT,), "sideways": (_NEGATE, _NO),
}
"""Movement feature that a word can ask for, in the order of `movements.features_of` -> the lexemes that ask for it."""


def movements_of(words: Sequence[str]) -> list[int]:
    """For each word the index of its feature in `MOVEMENTS`, -1 for none and for words that are too common."""
    out = []
    for index in range(len(words)):
        lexemes, strength = lexemes_of(words, index)
        kinds = [kind for kind, known in enumerate(MOVEMENTS.values()) if lexemes in known]
        out.append(kinds[0] if kinds and strength == 1.0 else -1)
    return out
