"""Speech whose phones are known: synthetic voices that report the time of each phone.

espeak-ng speaks nonsense words in many languages, which gives every phone of a language often, and sentences in the
languages of the performer; flite speaks English sentences. Speech is recorded as by `performer.sound`: with a room, a
level and noise, all drawn from the generator.
"""

from __future__ import annotations

import itertools
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from data_module.types import Samples
from gesticulator.face.visemes import RATE as VISEME_RATE
from gesticulator.face.visemes import SILENT, VISEMES, of_arpabet
from gesticulator_performer import espeak, flite
from gesticulator_performer.sound import RATE, Phone, read_at, recorded
from gesticulator_performer.tables import table
from gesticulator_performer.text import compose

_TABLE = table("face/phones.toml")
LANGUAGES: dict[str, list[str]] = _TABLE["languages"]
"""Language -> voices of espeak-ng that speak it for training."""
VARIANTS, FLITE = _TABLE["variants"].split(), _TABLE["flite"].split()
"""Timbres of espeak-ng, and voices of flite, for training."""
# Languages whose sentences are composed; nonsense is spoken in all but the tonal one.
_SENTENCES = ("en", "de", "es", "cmn")
_STARTS, _MIDDLES, _ENDS = ([part.strip("-") for part in _TABLE["syllables"][name].split()]
                            for name in ("starts", "middles", "ends"))
# Shortest and longest silence between two phrases, seconds; every sixth lasts up to `_LONG_PAUSE`.
_PAUSES = (0.12, 0.9)
_LONG_PAUSE = 3.0
# Shortest and longest breath, seconds; one in four pauses has one.
_BREATH = (0.15, 0.5)
# Playing speeds: they change pitch, formants and tempo together.
_SPEEDS = (0.88, 1.14)
_OF_IPA = {letter: name for name, letters in _TABLE["visemes"].items() for letter in letters.split()}
_VOWELS = tuple(VISEMES.index(name) for name in ("aa", "E", "ih", "oh", "ou"))


class VisemeSpan(NamedTuple):
    """One viseme (an index in `VISEMES`) from `start` to `end` seconds."""

    viseme: int
    start: float
    end: float


Labelled = tuple[Samples, NDArray[np.int64]]
"""Samples at 16 kHz, and the viseme of each whole frame of `gesticulator.face.visemes.RATE`."""


@lru_cache(maxsize=4096)
def of_ipa(phone: str) -> tuple[int, ...]:
    """The visemes of an IPA symbol, such as ("aa", "ih") as indices for "aɪ"; marks of length, stress and tone are
    ignored, and () means that the symbol has no sound."""
    letters = [letter for letter in unicodedata.normalize("NFD", phone) if letter in _OF_IPA]
    return tuple(viseme for viseme, _ in itertools.groupby(VISEMES.index(_OF_IPA[letter]) for letter in letters))


def spans(visemes: Sequence[int], start: float, end: float) -> list[VisemeSpan]:
    """A phone's visemes in equal shares of its time; the first of a diphthong takes 0.6 of it."""
    if not visemes:
        return []
    shares = [0.6, 0.4] if len(visemes) == 2 and visemes[0] in _VOWELS else [1 / len(visemes)] * len(visemes)
    edges = start + (end - start) * np.concatenate([[0.0], np.cumsum(shares)])
    return [VisemeSpan(viseme, float(a), float(b)) for viseme, a, b in zip(visemes, edges, edges[1:], strict=False)]


def labels(track: Sequence[VisemeSpan], count: int, rate: float) -> NDArray[np.int64]:
    """[count] the viseme at the middle of each frame of 1 / `rate` seconds; silence where there is none."""
    out = np.full(count, SILENT, np.int64)
    for span in track:
        first, last = round(span.start * rate), round(span.end * rate)
        out[max(first, 0):max(min(max(last, first + 1), count), 0)] = span.viseme
    return out


def synthetic(rng: np.random.Generator, seconds: float) -> Iterator[Labelled]:
    """About `seconds` of synthetic speech, half by flite, half by espeak-ng in all languages in turn. InputError if a
    program lacks."""
    used: set[str] = set()
    speakers: list[tuple[int, Callable[[], Labelled]]] = [
        *((len(LANGUAGES), partial(_by_espeak, rng, language, used)) for language in LANGUAGES),
        *((len(FLITE), partial(_by_flite, rng, voice, used)) for voice in FLITE)]
    for share, speak in speakers:
        spoken = 0.0
        while spoken < seconds / 2 / share:
            samples, visemes = speak()
            spoken += len(samples) / RATE
            yield samples, visemes


def _by_espeak(rng: np.random.Generator, language: str, used: set[str]) -> Labelled:
    voice = f"{rng.choice(LANGUAGES[language])}+{rng.choice(VARIANTS)}"
    texts = _sentences(rng, language, used) if language in _SENTENCES else []
    texts += [] if language == "cmn" else [_nonsense(rng) for _ in range(max(5 - len(texts), 2))]
    lines = [espeak.Line(voice, text, int(rng.integers(120, 230)), int(rng.integers(25, 75)), int(rng.integers(30, 80)))
             for text in texts]
    parts = [(samples, [span for name, start, end in phones for span in spans(of_ipa(name), start, end)])
             for samples, phones in espeak.ipa_phrases(lines)]
    return _recorded(parts, rng)


def _by_flite(rng: np.random.Generator, voice: str, used: set[str]) -> Labelled:
    parts = []
    for text in _sentences(rng, "en", used):
        samples, phones = flite.timed_phrase(voice, text, float(rng.uniform(95, 190)), float(rng.uniform(12, 40)),
                                             float(rng.uniform(0.85, 1.25)))
        parts.append((samples, [span for name, start, end in phones for span in spans(of_arpabet(name), start, end)]))
    return _recorded(parts, rng)


def _sentences(rng: np.random.Generator, language: str, used: set[str]) -> list[str]:
    return [part.text for utterance in compose(rng, 9.0, "train", used, language) for part in utterance.parts
            if any(letter.isalpha() for letter in part.text)]


def _nonsense(rng: np.random.Generator) -> str:
    """Words of one to three syllables, a phrase of them."""
    def word() -> str:
        return "".join(f"{rng.choice(_STARTS)}{rng.choice(_MIDDLES)}{rng.choice(_ENDS)}"
                       for _ in range(rng.integers(1, 4)))

    return " ".join(word() for _ in range(rng.integers(3, 8)))


def _recorded(parts: Sequence[tuple[Samples, list[VisemeSpan]]], rng: np.random.Generator) -> Labelled:
    """Phrases with pauses between them, at one playing speed, in a room."""
    def pause() -> Samples:
        seconds = rng.uniform(*_PAUSES) if rng.random() < 5 / 6 else rng.uniform(_PAUSES[1], _LONG_PAUSE)
        silence = np.zeros(round(seconds * RATE), np.float32)
        return silence + _breath(len(silence), rng) if rng.random() < 0.25 else silence

    pieces = [pause()]
    track: list[VisemeSpan] = []
    for samples, visemes in parts:
        offset = sum(map(len, pieces)) / RATE
        track += [VisemeSpan(viseme, start + offset, end + offset) for viseme, start, end in visemes]
        loud = float(np.sqrt(np.mean(samples**2))) + 1e-9
        pieces += [(samples * np.float32(0.1 / loud * 10 ** (rng.normal(0, 2.5) / 20))).astype(np.float32), pause()]
    count, speed = sum(map(len, pieces)), float(rng.uniform(*_SPEEDS))
    active = np.concatenate([np.full(len(piece), place % 2) for place, piece in enumerate(pieces)])
    marks = tuple(Phone("", start, end, False, 0) for _, start, end in track)
    sound, moved = read_at(np.concatenate(pieces), np.full(count, speed), marks)
    speaks = np.interp(np.arange(len(sound)) * speed, np.arange(count), active) > 0.5
    frames = int(len(sound) / RATE * VISEME_RATE + 1e-6)
    return recorded(sound, speaks, rng), labels([VisemeSpan(span.viseme, mark.start, mark.end)
                                                 for span, mark in zip(track, moved, strict=True)], frames, VISEME_RATE)


def _breath(count: int, rng: np.random.Generator) -> Samples:
    """A breath somewhere in [count] samples: noise through a broad formant, 14 to 34 dB under the speech."""
    size = min(round(rng.uniform(*_BREATH) * RATE), count)
    band = butter(2, (float(rng.uniform(300, 1200)), float(rng.uniform(2500, 7000))), "band", fs=RATE, output="sos")
    noise = sosfilt(band, rng.standard_normal(size)) * np.hanning(size)
    out, at = np.zeros(count, np.float32), int(rng.integers(0, count - size + 1))
    level = 0.1 * 10 ** (-rng.uniform(14, 34) / 20)
    out[at:at + size] = noise * (level / (float(np.sqrt(np.mean(noise**2))) + 1e-9))
    return out
