"""Visemes: the 15 mouth shapes of Oculus lip sync, the phones that they stand for, and how far each opens the mouth.

Phones come as ARPABET (pocketsphinx). A phone of several sounds, such as a diphthong or an affricate, is a sequence of
visemes.
"""

import numpy as np

from data_module.types import Array

VISEMES = ("sil", "PP", "FF", "TH", "DD", "kk", "CH", "SS", "nn", "RR", "aa", "E", "ih", "oh", "ou")
"""Names of the mouth shapes in the order of Oculus lip sync: silence, ten consonants and five vowels."""
RATE = 50
"""Rows of viseme weights per second; row k is centred at (k + 0.5) / RATE."""
SILENT, CLOSED = VISEMES.index("sil"), VISEMES.index("PP")
OPENINGS = np.array([0.0, 0.0, 0.12, 0.3, 0.25, 0.3, 0.25, 0.15, 0.25, 0.25, 1.0, 0.65, 0.4, 0.75, 0.35])
"""[15] opening of the mouth in each viseme as a share of the widest, that of aa."""

_ARPABET = {
    "PP": "b p m em", "FF": "f v", "TH": "th dh", "DD": "t d dx", "kk": "k g hh", "CH": "sh zh", "SS": "s z",
    "nn": "n ng l en el", "RR": "r", "aa": "aa ae ah", "E": "eh ax er axr", "ih": "ih iy y ix", "oh": "ao",
    "ou": "uw uh w",
}
_OF_ARPABET = {phone: (name,) for name, phones in _ARPABET.items() for phone in phones.split()} | {
    "ch": ("DD", "CH"), "jh": ("DD", "CH"), "aw": ("aa", "ou"), "ay": ("aa", "ih"), "ey": ("E", "ih"),
    "ow": ("oh", "ou"), "oy": ("oh", "ih")}


def of_arpabet(phone: str) -> tuple[int, ...]:
    """The visemes of an ARPABET phone with or without stress, in any case; () for silence and noises."""
    return tuple(VISEMES.index(name) for name in _OF_ARPABET.get(phone.lower().rstrip("012"), ()))


def opening(weights: Array) -> Array:
    """[...] opening of the mouth, 0 to 1, for weights [..., 15] of the visemes."""
    return np.asarray(np.clip(weights @ OPENINGS, 0.0, 1.0))
