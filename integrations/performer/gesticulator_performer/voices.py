"""The voices: their table, the effect of effort, the simulated recording of their speech, and audible styles.

A style is the amplitude and the tempo of speech and movement, which drift through a talk. Amplitude makes the voice
louder, brighter and more contrasted, and movements larger; tempo makes speech faster, pauses shorter, and strokes
faster and denser. The style of the motion can therefore be predicted from the sound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, lfilter

from data_module.types import Array, Samples, Speech, Word
from gesticulator_performer import espeak, flite
from gesticulator_performer.sound import RATE, Phone, Sounded, decibels, read_at, recorded, with_tilt, word_spans
from gesticulator_performer.syllables import Nucleus, Phrase, Spoken, listen, pitch_track
from gesticulator_performer.tables import table
from gesticulator_performer.text import Part, Utterance

# At effort 1: decibels louder, log factors on rate and pitch range, semitones higher. At -1 the reverse.
LOUDER, FASTER, WIDER, HIGHER = 9.0, 0.10, 0.55, 1.5
LEAD = 0.4
"""Silence before the first word, seconds."""
# Seconds between the knots of a track.
_KNOTS = 8.0
# Standard deviations of a talk's mean style and of the drift about it; correlation of the drift from knot to knot.
_TALK, _DRIFT, _KEEP = 0.45, 0.85, 0.75
_MOST = 1.6
# Factor on the effort of the text, and the effort that an amplitude of 1 adds.
_TEXT_EFFORT, _EFFORT = 0.4, 0.7
# DB over `_SHELF_HERTZ` that an amplitude of 1 adds.
_SHELF, _SHELF_HERTZ = 7.0, 1500.0
# Exponent on the level contour at an amplitude of 1, and the smoothing of the contour, seconds.
_CONTRAST, _ENVELOPE = 0.3, 0.01
# Log of the factors on the speaking rate and, negative, on the pauses at a tempo of 1.
_RATE, _PAUSES = 0.22, 0.5


@dataclass(frozen=True)
class Voice:
    """A voice. engine: "flite" or "espeak"; base: the engine's name for it. pitch: Hz (espeak: 0 to 99); spread: the
    engine's measure of pitch range (flite: Hz; espeak: 0 to 99); tract: factor on the formants (flite); rate: factor on
    the engine's normal speed."""

    name: str
    engine: str
    base: str
    pitch: float
    spread: float
    tract: float = 1.0
    rate: float = 1.0


VOICES = {name: Voice(name, **settings) for name, settings in table("voices.toml")["voices"].items()}
TRAIN_VOICES = ("slt", "rms", "kal", "us_f3", "slt_deep", "rms_light", "gb_m3", "slt_high", "rms_deep", "scot_f2")
TEST_VOICES = ("awb", "rp_m7", "awb_high")


def speak(utterances: Sequence[Utterance], voice: str, rng: np.random.Generator) -> Spoken:
    """Speak the utterances with a voice of `VOICES` and record them: 16 kHz, word times, phrases with their effort.

    Effort drives loudness (9 dB either way), brightness, pitch, pitch range and rate together. Phrases are spoken one
    by one and placed by counting samples. The generator determines the room, the noise and the level.
    InputError names the Debian package of a missing program.
    """
    parts = [part for utterance in utterances for part in utterance.parts]
    return on_the_clock(parts, sound_all(parts, VOICES[voice]), VOICES[voice], rng)


def nuclei_of(phones: Sequence[Phone]) -> list[Nucleus]:
    """The syllables of phones: each vowel with the consonant before it; other consonants close the syllable before. A
    word without a vowel ("hm") is one syllable; its first phone counts as the vowel."""
    nuclei: list[Nucleus] = []
    for word in sorted({phone.word for phone in phones}):
        inside = [phone for phone in phones if phone.word == word]
        vowels = [i for i, phone in enumerate(inside) if phone.vowel] or [0]
        # The last consonant between two vowels belongs to the second; none if they touch.
        cuts = [max(vowel - 1, before + 1) for before, vowel in zip(vowels, vowels[1:], strict=False)]
        bounds = [inside[0].start, *(inside[cut].start for cut in cuts), inside[-1].end]
        nuclei += [Nucleus(left, inside[vowel].start, right, word)
                   for vowel, left, right in zip(vowels, bounds, bounds[1:], strict=False)]
    return nuclei


def sound_all(parts: Sequence[Part], voice: Voice) -> list[Sounded]:
    """Speak each part at its effort, dry."""
    if voice.engine == "espeak":
        # espeak's pitch unit is about a sixth of a semitone; its range 50 is normal.
        return espeak.sound_phrases([espeak.Line(
            voice.base, part.text, round(165 * voice.rate * np.exp(FASTER * part.effort)),
            round(voice.pitch + 6 * part.effort), round(min(99, voice.spread * np.exp(WIDER * part.effort))))
            for part in parts])
    return [_flite_phrase(part, voice) for part in parts]


def _flite_phrase(part: Part, voice: Voice) -> Sounded:
    pitch = voice.pitch * 2 ** (HIGHER * part.effort / 12)
    # The tract is changed by the playing speed; flite's rate and pitch are changed the other way to compensate.
    stretch = voice.tract / (voice.rate * np.exp(FASTER * part.effort))
    wider = float(np.exp(WIDER * part.effort))
    deviation = voice.spread * wider
    sounded = flite.sound_phrase(voice.base, part.text, pitch / voice.tract, deviation / voice.tract, stretch)
    speed = np.full(len(sounded.samples), voice.tract)
    if voice.base == "rms":
        # This voice ignores the pitch settings; its contour is widened and raised by a varying playing speed.
        speed = speed * _widened(sounded.samples, wider) * 2 ** (HIGHER * part.effort / 24)
    if np.ptp(speed) == 0 and speed[0] == 1:
        return sounded
    samples, phones = read_at(sounded.samples, speed, sounded.phones)
    return Sounded(samples, word_spans([word.text for word in sounded.words], phones), phones)


def _widened(samples: Samples, times: float) -> Array:
    """[N] the playing speed that widens a pitch contour around its median by the factor `times`; 1 if it is unknown."""
    track = pitch_track(samples, RATE)
    voiced = np.flatnonzero(track > 0)
    if len(voiced) < 5:
        return np.ones(len(samples))
    height = np.clip(np.log(track[voiced] / np.median(track[voiced])), -0.35, 0.35)
    frames = np.interp(np.arange(len(track)), voiced, height)
    smooth = np.convolve(np.pad(frames, 4, mode="edge"), np.hanning(11)[1:-1] / np.hanning(11).sum(), "valid")
    return np.exp((times - 1) * np.interp(np.arange(len(samples)) / 160, np.arange(len(smooth)), smooth))


def on_the_clock(parts: Sequence[Part], spoken: Sequence[Sounded], voice: Voice,
                 rng: np.random.Generator) -> Spoken:
    """Join English phrases and pauses at the loudness of their effort, record them, and measure the syllables."""
    lengths = [len(s.samples) + round(p.pause * RATE) for s, p in zip(spoken, parts, strict=True)]
    starts = np.cumsum([round(LEAD * RATE), *lengths])
    dry = np.zeros(int(starts[-1]), dtype=np.float32)
    active = np.zeros(len(dry), dtype=bool)
    words: list[Word] = []
    phones: list[Phone] = []
    phrases: list[Phrase] = []
    # One gain for the whole recording brings the voice to -20 dBFS, so that only effort differs between phrases.
    level = float(np.sqrt(np.mean(np.concatenate([s.samples for s in spoken]) ** 2))) + 1e-9
    for part, sounded, start in zip(parts, spoken, starts.tolist(), strict=False):
        offset, stop = start / RATE, start + len(sounded.samples)
        tilted = with_tilt(sounded.samples, part.effort)
        dry[start:stop] = tilted * np.float32(0.1 / level * decibels(LOUDER * part.effort))
        active[start:stop] = True
        phones += [phone.moved(offset, len(words)) for phone in sounded.phones]
        words += [replace(word, start=word.start + offset, end=word.end + offset) for word in sounded.words]
        phrases.append(Phrase(offset, stop / RATE, part.effort))
    samples = recorded(dry, active, rng)
    speech = Speech(samples, RATE, tuple(words), voice.name)
    return Spoken(speech, listen(speech, phrases, nuclei_of(phones), "en"), tuple(phrases), "en")


@dataclass(frozen=True)
class StyleTrack:
    """Style through a talk. times: [K] seconds; values: [K, 2] amplitude and tempo, 0 is neutral, 1 is strong."""

    times: Array
    values: Array

    def at(self, seconds: Array | float) -> Array:
        return np.stack([np.interp(seconds, self.times, column) for column in self.values.T], axis=-1)


NEUTRAL = StyleTrack(np.zeros(1), np.zeros((1, 2)))
"""No style."""


def draw_style(seconds: float, rng: np.random.Generator) -> StyleTrack:
    """A random style that drifts within tens of seconds."""
    count = int(np.ceil(seconds / _KNOTS)) + 2
    mean = rng.normal(0.0, _TALK, 2)
    drift = np.zeros((count, 2))
    drift[0] = rng.normal(0.0, _DRIFT, 2)
    for k in range(1, count):
        drift[k] = _KEEP * drift[k - 1] + rng.normal(0.0, _DRIFT * np.sqrt(1.0 - _KEEP ** 2), 2)
    return StyleTrack(_KNOTS * np.arange(count, dtype=np.float64), _MOST * np.tanh((mean + drift) / _MOST))


def styled_speech(utterances: Sequence[Utterance], voice: str, style: StyleTrack, rng: np.random.Generator) -> Spoken:
    """Speak utterances; the style of each phrase is that of `style` at the time where the phrase begins."""
    speaker = VOICES[voice]
    parts: list[Part] = []
    spoken: list[Sounded] = []
    clock = LEAD
    for part in (part for utterance in utterances for part in utterance.parts):
        amplitude, tempo = style.at(clock).tolist()
        effort = float(np.clip(_TEXT_EFFORT * part.effort + _EFFORT * amplitude, -1.0, 1.0))
        new = Part(part.text, effort, part.pause * float(np.exp(-_PAUSES * tempo)))
        sounded = sound_all([new], replace(speaker, rate=speaker.rate * float(np.exp(_RATE * tempo))))[0]
        bright = shelved(sounded.samples, _SHELF * amplitude)
        sounded = replace(sounded, samples=contrasted(bright, _CONTRAST * amplitude))
        parts.append(new)
        spoken.append(sounded)
        clock += len(sounded.samples) / RATE + new.pause
    return on_the_clock(parts, spoken, speaker, rng)


def shelved(samples: Samples, decibel: float) -> Samples:
    """Raise samples at 16 kHz by `decibel` dB over 1.5 kHz, at constant energy."""
    b, a = butter(1, _SHELF_HERTZ, "high", fs=RATE)
    out = samples + (10.0 ** (decibel / 20.0) - 1.0) * lfilter(b, a, samples)
    return _at_the_level_of(samples, out)


def contrasted(samples: Samples, exponent: float) -> Samples:
    """Increase (exponent > 0) or decrease the deviation of the level from its mean, at constant energy."""
    level = np.sqrt(gaussian_filter1d(samples.astype(np.float64) ** 2, _ENVELOPE * RATE) + 1e-9)
    gain = np.clip(level / (_rms(samples) + 1e-9), 0.05, 4.0) ** exponent
    return _at_the_level_of(samples, samples * gain)


def _at_the_level_of(samples: Samples, out: Array) -> Samples:
    return np.asarray(out * (_rms(samples) / max(_rms(out), 1e-9)), dtype=np.float32)


def _rms(samples: Array | Samples) -> float:
    return float(np.sqrt(np.mean(np.asarray(samples, dtype=np.float64) ** 2)))
