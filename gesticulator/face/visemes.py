"""Visemes: the 15 mouth shapes of Oculus lip sync, the phones that they stand for, and how far each opens the mouth.

Phones come as IPA (espeak-ng) or as ARPABET (flite, pocketsphinx). A phone of several sounds, such as a diphthong or an
affricate, is a sequence of visemes that share its time.
"""

from __future__ import annotations

import itertools
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array

VISEMES = ("sil", "PP", "FF", "TH", "DD", "kk", "CH", "SS", "nn", "RR", "aa", "E", "ih", "oh", "ou")
"""Names of the mouth shapes in the order of Oculus lip sync: silence, ten consonants and five vowels."""
RATE = 50
"""Rows of viseme weights per second; row k is centred at (k + 0.5) / RATE."""
SILENT, CLOSED = VISEMES.index("sil"), VISEMES.index("PP")
VOWELS = tuple(VISEMES.index(name) for name in ("aa", "E", "ih", "oh", "ou"))
OPENINGS = np.array([0.0, 0.0, 0.12, 0.3, 0.25, 0.3, 0.25, 0.15, 0.25, 0.25, 1.0, 0.65, 0.4, 0.75, 0.35])
"""[15] opening of the mouth in each viseme as a share of the widest, that of aa."""

_IPA = {
    "PP": "p b m ɓ", "FF": "f v ɱ ʋ ɸ β", "TH": "θ ð", "DD": "t d ʈ ɖ ɗ ɾ r", "kk": "k ɡ g q ɢ x ɣ χ ʁ h ɦ ħ ʕ ʔ c ɟ ɰ",
    "CH": "ʃ ʒ ɕ ʑ ʂ ʐ ɧ", "SS": "s z ɬ ɮ", "nn": "n ŋ ɲ ɳ ɴ l ɫ ɭ ʎ ʟ ɽ", "RR": "ɹ ɻ ʀ",
    "aa": "a ɑ ɐ ʌ ɒ æ ɶ", "E": "e ɛ ə ɜ ɚ ɝ ɘ ɞ ɤ œ", "ih": "i ɪ ɨ j ʝ ç ʲ", "oh": "o ɔ ɵ",
    "ou": "u ʊ y ʏ ø ʉ ɯ w ɥ ʍ",
}
_OF_IPA = {letter: name for name, letters in _IPA.items() for letter in letters.split()}
_ARPABET = {
    "PP": "b p m em", "FF": "f v", "TH": "th dh", "DD": "t d dx", "kk": "k g hh", "CH": "sh zh", "SS": "s z",
    "nn": "n ng l en el", "RR": "r", "aa": "aa ae ah", "E": "eh ax er axr", "ih": "ih iy y ix", "oh": "ao",
    "ou": "uw uh w",
}
_OF_ARPABET = {phone: (name,) for name, phones in _ARPABET.items() for phone in phones.split()} | {
    "ch": ("DD", "CH"), "jh": ("DD", "CH"), "aw": ("aa", "ou"), "ay": ("aa", "ih"), "ey": ("E", "ih"),
    "ow": ("oh", "ou"), "oy": ("oh", "ih")}


@dataclass(frozen=True)
class VisemeSpan:
    """One viseme (an index in `VISEMES`) from `start` to `end` seconds."""

    viseme: int
    start: float
    end: float


@lru_cache(maxsize=4096)
def of_ipa(phone: str) -> tuple[int, ...]:
    """The visemes of an IPA symbol, such as ("aa", "ih") as indices for "aɪ"; marks of length, stress and tone are
    ignored, and () means that the symbol has no sound."""
    letters = [letter for letter in unicodedata.normalize("NFD", phone) if letter in _OF_IPA]
    return tuple(viseme for viseme, _ in itertools.groupby(VISEMES.index(_OF_IPA[letter]) for letter in letters))


def of_arpabet(phone: str) -> tuple[int, ...]:
    """The visemes of an ARPABET phone with or without stress, in any case; () for silence and noises."""
    return tuple(VISEMES.index(name) for name in _OF_ARPABET.get(phone.lower().rstrip("012"), ()))


def spans(visemes: Sequence[int], start: float, end: float) -> list[VisemeSpan]:
    """A phone's visemes in equal shares of its time; the first of a diphthong takes 0.6 of it."""
    if not visemes:
        return []
    shares = [0.6, 0.4] if len(visemes) == 2 and visemes[0] in VOWELS else [1 / len(visemes)] * len(visemes)
    edges = start + (end - start) * np.concatenate([[0.0], np.cumsum(shares)])
    return [VisemeSpan(viseme, float(a), float(b)) for viseme, a, b in zip(visemes, edges, edges[1:], strict=False)]


def labels(track: Sequence[VisemeSpan], count: int, rate: float) -> NDArray[np.int64]:
    """[count] the viseme at the middle of each frame of 1 / `rate` seconds; silence where there is none."""
    out = np.full(count, SILENT, np.int64)
    for span in track:
        first, last = round(span.start * rate), round(span.end * rate)
        out[max(first, 0):max(min(max(last, first + 1), count), 0)] = span.viseme
    return out


def opening(weights: Array) -> Array:
    """[...] opening of the mouth, 0 to 1, for weights [..., 15] of the visemes."""
    return np.asarray(np.clip(weights @ OPENINGS, 0.0, 1.0))
