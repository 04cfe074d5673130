"""Speech whose phones are known: synthetic voices that report the time of each phone, and readings that are aligned.

espeak-ng speaks nonsense words in many languages, which gives every phone of a language often, and sentences in the
languages of the performer; flite speaks English sentences. Speech is recorded as by `performer.sound`: with a room, a
level and noise, all drawn from the generator. A reading is aligned with its text by pocketsphinx, phone by phone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from data_module.speech.silence import FRAME, frame_levels
from data_module.types import Samples, Speech
from gesticulator.face.visemes import SILENT, VisemeSpan, labels, of_arpabet, of_ipa, spans
from gesticulator_performer import espeak, flite
from gesticulator_performer.sound import RATE, Phone, read_at, recorded
from gesticulator_performer.text import compose

LANGUAGES = {
    "en": ("en-us", "en-gb-x-rp", "en-gb-scotland"), "de": ("de",), "es": ("es", "es-419"), "fr": ("fr",),
    "pt": ("pt-br",), "pl": ("pl",), "fi": ("fi",), "nl": ("nl",), "sv": ("sv",), "hu": ("hu",), "ro": ("ro",),
    "id": ("id",), "cmn": ("cmn-latn-pinyin",)}
"""Language -> voices of espeak-ng that speak it for training."""
HELD_OUT_LANGUAGES = {"it": ("it",), "tr": ("tr",), "cs": ("cs",), "sw": ("sw",)}
"""The same for the test."""
VARIANTS = ("m1", "m2", "m3", "m4", "m6", "m8", "f1", "f2", "f3", "f5", "Andy", "Annie", "Gene", "adam", "anika",
            "linda", "michael", "klatt2", "steph", "victor")
"""Timbres of espeak-ng for training."""
HELD_OUT_VARIANTS = ("m5", "m7", "f4", "belinda", "edward", "klatt4")
FLITE, HELD_OUT_FLITE = ("slt", "rms", "kal16"), ("awb",)
_SENTENCES = ("en", "de", "es", "cmn")
"""Languages whose sentences are composed; nonsense is spoken in all but the tonal one."""
_STARTS = ("p", "b", "m", "f", "v", "w", "s", "z", "sh", "ch", "j", "t", "d", "k", "g", "n", "l", "r", "h", "y", "pl",
           "br", "st")
_MIDDLES = ["a", "e", "i", "o", "u", "ai", "ou", "ee", "oo"]
_ENDS = ("", "", "", "n", "m", "s", "p", "r", "l", "k", "t", "b", "f")
_PAUSES = (0.12, 0.9)
"""Shortest and longest silence between two phrases, seconds; every sixth lasts up to `_LONG_PAUSE`."""
_LONG_PAUSE = 3.0
_BREATH = (0.15, 0.5)
"""Shortest and longest breath, seconds; one in four pauses has one."""
_QUIET = 18.0
"""Decibels under the loud tenth of a reading below which a gap between its phones is silence."""
_SPEEDS = (0.88, 1.14)
"""Playing speeds: they change pitch, formants and tempo together."""


@dataclass(frozen=True)
class PhonedSpeech:
    """Speech at 16 kHz with the visemes of its phones, which rise in time. language: ISO 639; voice: who speaks;
    doubtful: (start, end) in seconds of sound that has no phone though it is loud; text: what is spoken, if it is
    English."""

    samples: Samples
    track: tuple[VisemeSpan, ...]
    language: str
    voice: str
    doubtful: tuple[tuple[float, float], ...] = ()
    text: str = ""

    @property
    def duration(self) -> float:
        return len(self.samples) / RATE

    def labels(self, rate: float) -> NDArray[np.int64]:
        """[T] the viseme of each whole frame of 1 / `rate` seconds, -1 where it is doubtful."""
        out = labels(self.track, int(self.duration * rate + 1e-6), rate)
        for start, end in self.doubtful:
            inside = slice(max(round(start * rate), 0), round(end * rate))
            out[inside] = np.where(out[inside] == SILENT, -1, out[inside])
        return out


def synthetic(rng: np.random.Generator, seconds: float, *, held_out: bool = False) -> Iterator[PhonedSpeech]:
    """About `seconds` of synthetic speech, half by flite, half by espeak-ng in all languages in turn. held_out:
    by the voices and languages, and with the sentences, that training does not have. InputError if a program lacks."""
    languages = HELD_OUT_LANGUAGES | {"en": ("en-us",), "de": ("de",)} if held_out else LANGUAGES
    variants = HELD_OUT_VARIANTS if held_out else VARIANTS
    split, voices = ("test", HELD_OUT_FLITE) if held_out else ("train", FLITE)
    used: set[str] = set()
    each = seconds / 2 / len(languages)
    for language, dialects in languages.items():
        spoken = 0.0
        while spoken < each:
            made = _by_espeak(rng, language, f"{rng.choice(dialects)}+{rng.choice(variants)}", split, used)
            spoken += made.duration
            yield made
    for voice in voices:
        spoken = 0.0
        while spoken < seconds / 2 / len(voices):
            made = _by_flite(rng, voice, split, used)
            spoken += made.duration
            yield made


def _by_espeak(rng: np.random.Generator, language: str, voice: str, split: str, used: set[str]) -> PhonedSpeech:
    texts = _sentences(rng, language, split, used) if language in _SENTENCES else []
    texts += [] if language == "cmn" else [_nonsense(rng) for _ in range(max(5 - len(texts), 2))]
    lines = [espeak.Line(voice, text, int(rng.integers(120, 230)), int(rng.integers(25, 75)), int(rng.integers(30, 80)))
             for text in texts]
    parts = [(samples, [span for name, start, end in phones for span in spans(of_ipa(name), start, end)])
             for samples, phones in espeak.ipa_phrases(lines)]
    made = _recorded(parts, language, voice, rng)
    return replace(made, text=" ".join(texts)) if language == "en" else made


def _by_flite(rng: np.random.Generator, voice: str, split: str, used: set[str]) -> PhonedSpeech:
    parts, texts = [], _sentences(rng, "en", split, used)
    for text in texts:
        samples, phones = flite.timed_phrase(voice, text, float(rng.uniform(95, 190)), float(rng.uniform(12, 40)),
                                             float(rng.uniform(0.85, 1.25)))
        parts.append((samples, [span for name, start, end in phones for span in spans(of_arpabet(name), start, end)]))
    return replace(_recorded(parts, "en", voice, rng), text=" ".join(texts))


def _sentences(rng: np.random.Generator, language: str, split: str, used: set[str]) -> list[str]:
    return [part.text for utterance in compose(rng, 9.0, split, used, language) for part in utterance.parts
            if any(letter.isalpha() for letter in part.text)]


def _nonsense(rng: np.random.Generator) -> str:
    """Words of one to three syllables, a phrase of them."""
    def word() -> str:
        return "".join(f"{rng.choice(_STARTS)}{rng.choice(_MIDDLES)}{rng.choice(_ENDS)}"
                       for _ in range(rng.integers(1, 4)))

    return " ".join(word() for _ in range(rng.integers(3, 8)))


def _recorded(parts: Sequence[tuple[Samples, list[VisemeSpan]]], language: str, voice: str,
              rng: np.random.Generator) -> PhonedSpeech:
    """Phrases with pauses between them, at one playing speed, in a room."""
    pieces: list[Samples] = []
    track: list[VisemeSpan] = []
    active: list[np.ndarray] = []
    count = 0

    def add(samples: Samples, speaks: bool) -> None:
        nonlocal count
        pieces.append(samples)
        active.append(np.full(len(samples), speaks))
        count += len(samples)

    def pause() -> Samples:
        seconds = rng.uniform(*_PAUSES) if rng.random() < 5 / 6 else rng.uniform(_PAUSES[1], _LONG_PAUSE)
        silence = np.zeros(round(seconds * RATE), np.float32)
        return silence + _breath(len(silence), rng) if rng.random() < 0.25 else silence

    add(pause(), False)
    for samples, visemes in parts:
        offset = count / RATE
        track += [VisemeSpan(one.viseme, one.start + offset, one.end + offset) for one in visemes]
        loud = float(np.sqrt(np.mean(samples**2))) + 1e-9
        add((samples * np.float32(0.1 / loud * 10 ** (rng.normal(0, 2.5) / 20))).astype(np.float32), True)
        add(pause(), False)
    speed = float(rng.uniform(*_SPEEDS))
    marks = tuple(Phone("", one.start, one.end, False, 0) for one in track)
    sound, moved = read_at(np.concatenate(pieces), np.full(count, speed), marks)
    shown = np.interp(np.arange(len(sound)) * speed, np.arange(count), np.concatenate(active)) > 0.5
    return PhonedSpeech(recorded(sound, shown, rng), tuple(
        VisemeSpan(one.viseme, mark.start, mark.end) for one, mark in zip(track, moved, strict=True)), language, voice)


def _breath(count: int, rng: np.random.Generator) -> Samples:
    """A breath somewhere in [count] samples: noise through a broad formant, 14 to 34 dB under the speech."""
    size = min(round(rng.uniform(*_BREATH) * RATE), count)
    band = butter(2, (float(rng.uniform(300, 1200)), float(rng.uniform(2500, 7000))), "band", fs=RATE, output="sos")
    noise = sosfilt(band, rng.standard_normal(size)) * np.hanning(size)
    out, at = np.zeros(count, np.float32), int(rng.integers(0, count - size + 1))
    level = 0.1 * 10 ** (-rng.uniform(14, 34) / 20)
    out[at:at + size] = noise * (level / (float(np.sqrt(np.mean(noise**2))) + 1e-9))
    return out


def aligned(speech: Speech, text: str, voice: str = "") -> PhonedSpeech:
    """An English reading with the visemes of its phones by pocketsphinx. InputError if it is not installed, or if the
    text does not follow the speech."""
    from data_module.text.alignment import phone_alignment

    track = [span for name, start, end in phone_alignment(speech, text)
             for span in spans(of_arpabet(name), start, end)]
    edges = [0.0, *(edge for span in track for edge in (span.start, span.end)), speech.duration]
    gaps = tuple((start, end) for start, end in zip(edges[::2], edges[1::2], strict=True) if end > start)
    return PhonedSpeech(speech.samples, tuple(track), "en", voice,
                        tuple(part for gap in gaps for part in _loud_parts(speech, *gap)), text)


def _loud_parts(speech: Speech, start: float, end: float) -> list[tuple[float, float]]:
    """The parts of a gap in which the sound is not `_QUIET` dB under the loud parts of the speech."""
    levels = frame_levels(speech.samples, RATE)
    loud = levels > np.percentile(levels, 90) - _QUIET
    first, last = round(start / FRAME), min(round(end / FRAME), len(loud))
    edges = first + np.flatnonzero(np.diff(np.concatenate([[0], loud[first:last], [0]]).astype(int))).reshape(-1, 2)
    return [(float(a) * FRAME, float(b) * FRAME) for a, b in edges]
