"""Audible styles: amplitude and tempo of speech and movement, which drift through a talk.

Amplitude makes the voice louder, brighter and more contrasted, and movements larger; tempo makes speech faster, pauses
shorter, and strokes faster and denser. The style of the motion can therefore be predicted from the sound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, lfilter

from data_module.types import Array, Samples
from gesticulator_performer import voices
from gesticulator_performer.sound import RATE, Sounded
from gesticulator_performer.text import Part, Utterance
from gesticulator_performer.types import Spoken

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
    speaker = voices.VOICES[voice]
    parts: list[Part] = []
    spoken: list[Sounded] = []
    clock = voices.LEAD
    for part in (part for utterance in utterances for part in utterance.parts):
        amplitude, tempo = style.at(clock).tolist()
        effort = float(np.clip(_TEXT_EFFORT * part.effort + _EFFORT * amplitude, -1.0, 1.0))
        new = Part(part.text, effort, part.pause * float(np.exp(-_PAUSES * tempo)))
        sounded = voices.sound_all([new], replace(speaker, rate=speaker.rate * float(np.exp(_RATE * tempo))))[0]
        bright = shelved(sounded.samples, _SHELF * amplitude)
        sounded = replace(sounded, samples=contrasted(bright, _CONTRAST * amplitude))
        parts.append(new)
        spoken.append(sounded)
        clock += len(sounded.samples) / RATE + new.pause
    return voices.on_the_clock(parts, spoken, speaker, rng)


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
