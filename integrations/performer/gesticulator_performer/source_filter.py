"""A source-filter voice in numpy: pulses and noise through formants, with exact syllable times. Needs no program.

It reads letters, not phonemes: a run of vowel letters is a vowel. It is hardly intelligible, but its energy, pitch and
timing are those of speech.
"""

from __future__ import annotations

import re

import numpy as np
from scipy.signal import lfilter

from data_module.types import Array
from gesticulator_performer.sound import RATE, Phone, Sounded, word_spans
from gesticulator_performer.syllables import is_function_word

_FORMANTS = {"a": (730, 1200, 2500), "e": (520, 1850, 2500), "i": (300, 2250, 2900), "o": (560, 880, 2400),
             "u": (330, 850, 2300), "y": (310, 2000, 2700)}
_PLOSIVES, _FRICATIVES = "bpdtkgcq", "sfvzhxj"
_BANDWIDTHS = (80.0, 110.0, 160.0)
_CHUNK = re.compile(r"[aeiouy]+|sh|th|ch|ph|ck|ng|[bcdfghjklmnpqrstvwxz]")


def sounds_of(word: str) -> list[str]:
    """Split a word into vowels (runs of vowel letters) and consonants, without a silent final e; there is always a
    vowel."""
    letters = re.sub(r"[^a-z]", "", word.lower())
    if re.fullmatch(".*[aeiouy].*[^aeiouy]e", letters):
        letters = letters[:-1]
    if letters[:1] == "y" and len(letters) > 1 and letters[1] in "aeiou":
        letters = "j" + letters[1:]
    sounds = _CHUNK.findall(letters)
    return sounds if any(is_vowel(sound) for sound in sounds) else [*sounds, "e"]


def is_vowel(sound: str) -> bool:
    return sound[0] in _FORMANTS


def sound_phrase(text: str, effort: float, pitch: float, tract: float, rate: float, spread: float,
                 rng: np.random.Generator) -> Sounded:
    """Speak a phrase. pitch: Hz; tract: factor on the formants; rate: factor on the normal rate; spread: semitones of
    an accent."""
    tokens = [token for token in (re.sub(r"[^\w']", "", t) for t in text.split()) if token]
    phones = _timed(tokens, rate, rng)
    total = round((phones[-1].end + 0.02) * RATE)
    contour = pitch * 2 ** (_intonation(tokens, phones, total, spread, text.endswith("?")) / 12)
    voiced = _pulses(contour)
    breath = rng.standard_normal(total)
    out = np.zeros(total)
    state: dict[int, Array] = {}
    formants = _FORMANTS["e"]
    for phone in phones:
        first, last = round(phone.start * RATE), round(phone.end * RATE)
        formants = _FORMANTS[phone.name[0]] if phone.vowel else formants
        stress = 1.0 if not is_function_word(tokens[phone.word]) else 0.6
        source = _source(phone, voiced[first:last], breath[first:last], stress, effort)
        out[first:last] = source
        out[first:last] = _resonated(out[first:last], formants, tract, state)
    out /= np.sqrt(np.mean(out ** 2)) + 1e-9
    samples = np.asarray(0.1 * out, dtype=np.float32)
    return Sounded(samples, word_spans(tokens, phones), phones)


def _timed(tokens: list[str], rate: float, rng: np.random.Generator) -> tuple[Phone, ...]:
    clock, phones = 0.02, []
    for index, token in enumerate(tokens):
        sounds = sounds_of(token)
        stress = 0.75 if is_function_word(token) else 1.0
        first_vowel = next(i for i, sound in enumerate(sounds) if is_vowel(sound))
        for position, sound in enumerate(sounds):
            length = 0.07 if sound[0] in _FRICATIVES or len(sound) == 2 else 0.06
            if is_vowel(sound):
                length = (0.125 if position == first_vowel else 0.095) + 0.02 * (len(sound) - 1)
                length *= 1.35 if index == len(tokens) - 1 else 1.0
            length *= stress * float(np.exp(rng.normal(0, 0.12))) / rate
            phones.append(Phone(sound, clock, clock + length, is_vowel(sound), index))
            clock += length
    return tuple(phones)


def _intonation(tokens: list[str], phones: tuple[Phone, ...], total: int, spread: float, asks: bool) -> Array:
    """[total] semitones: a falling line, an accent on the first vowel of each content word, a rise for a question."""
    time = np.arange(total) / RATE
    line = spread * (0.4 - 0.8 * time / time[-1])
    done: set[int] = set()
    for phone in phones:
        if phone.vowel and phone.word not in done:
            done.add(phone.word)
            if not is_function_word(tokens[phone.word]):
                middle, width = phone.start + 0.05, 0.07
                line += spread * np.exp(-0.5 * ((time - middle) / width) ** 2)
    if asks:
        line += 1.5 * spread * np.clip((time - time[-1] + 0.3) / 0.3, 0, 1)
    return line


def _pulses(contour: Array) -> Array:
    """[N] glottal pulses at contour Hz: one impulse per period, smoothed by two poles."""
    phase = np.cumsum(contour / RATE)
    impulses = np.diff(np.floor(phase), prepend=0.0) * np.sqrt(RATE / contour)
    return np.asarray(lfilter([1.0, -1.0], [1.0, -1.7, 0.7225], impulses))


def _source(phone: Phone, voiced: Array, breath: Array, stress: float, effort: float) -> Array:
    count = len(voiced)
    ramp = np.minimum(1.0, np.minimum(np.arange(count) / 160, (count - np.arange(count)) / 160))
    if phone.vowel:
        return stress * ramp * (voiced + 0.03 * breath)
    if phone.name[0] in _FRICATIVES or phone.name in ("sh", "th", "ch", "ph"):
        return 0.06 * ramp * np.diff(breath, prepend=0.0) * (1 + 0.3 * effort)
    if phone.name[0] in _PLOSIVES:
        burst = np.zeros(count)
        burst[-min(count, 160):] = 0.1 * breath[-min(count, 160):]
        return burst
    return 0.2 * ramp * voiced


def _resonated(source: Array, formants: tuple[int, ...], tract: float, state: dict[int, Array]) -> Array:
    """The source through three resonators in series, whose state carries over from sound to sound."""
    for index, (frequency, width) in enumerate(zip(formants, _BANDWIDTHS, strict=True)):
        radius = np.exp(-np.pi * width / RATE)
        b1, b2 = 2 * radius * np.cos(2 * np.pi * frequency * tract / RATE), -radius ** 2
        before = state.get(index, np.zeros(2))
        source, state[index] = lfilter([1 - b1 - b2], [1.0, -b1, -b2], source, zi=before)
    return source
