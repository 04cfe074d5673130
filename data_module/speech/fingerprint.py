"""A fingerprint of a recording: small enough for a gesture plan, and enough to find the same speech in another export.

The sound is seen in `BANDS` bands, evenly spaced in mel from `LOWEST` to `HIGHEST` Hz, `RATE` times a second. Each
value is the level of a band in steps of 3 dB below what is loud in that band,

    q = clip(round((L - R) / 3) + 13, 0, 15),

with L in dB and R the 95th percentile of the band's levels in frames that are at most 30 dB below the loudest. Gain and
equalisation cancel out, and so does what lies 39 dB below the voice: noise, dither, the artefacts of MP3.
"""

import base64
import binascii
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.types import Array, Samples, Speech

__all__ = ["fingerprint", "fingerprint_frames", "fingerprint_text"]

RATE = 50
"""Frames per second; frame f is centred on f / RATE seconds."""
BANDS = 12
LOWEST, HIGHEST = 100.0, 3800.0
"""Hertz; recordings of telephone quality have all bands."""
Frames = NDArray[np.uint8]
"""[F, BANDS] values of 0 to 15."""

# Seconds of sound in a frame.
_WINDOW = 0.05
# Decibels per step, the value of the loud level of a band, and the largest value: four bits.
_STEP_DB, _ZERO, _MOST = 3.0, 13, 15
# Percentile of the loud level of a band, and decibels below the loudest frames in which a frame counts for it.
_LOUD, _SPEECH_RANGE = 95.0, 30.0
# Floor of a band's power, relative to full scale: -90 dB.
_FAINTEST = 1e-9
# Frames at a time: a minute.
_PIECE = 3000
_FRAME_BYTES = BANDS // 2


def fingerprint(speech: Speech) -> Frames:
    """The fingerprint of a recording at any sample rate of 8 kHz or more, [F, BANDS]."""
    levels = 10.0 * np.log10(np.maximum(_band_powers(speech.samples, speech.sample_rate), _FAINTEST))
    total = levels.max(axis=1)
    # The 99th percentile and no maximum, which one click would set.
    spoken = levels[total >= np.percentile(total, 99.0) - _SPEECH_RANGE]
    loud = np.percentile(spoken, _LOUD, axis=0)
    return np.clip(np.round((levels - loud) / _STEP_DB) + _ZERO, 0, _MOST).astype(np.uint8)


def _band_powers(samples: Samples, rate: int) -> Array:
    """[F, BANDS] power of the bands."""
    size = round(_WINDOW * rate)
    count = int(len(samples) / rate * RATE) + 1
    padded = np.pad(samples, (size // 2, size))
    window, bands = np.hanning(size + 1)[:-1], _bands(rate, size)
    out = np.empty((count, BANDS))
    for first in range(0, count, _PIECE):
        starts = np.round(np.arange(first, min(first + _PIECE, count)) * (rate / RATE)).astype(np.int64)
        spectra = np.fft.rfft(padded[starts[:, None] + np.arange(size)] * window, axis=1)
        out[first:first + _PIECE] = (spectra.real ** 2 + spectra.imag ** 2) @ bands.T / (window.sum() / 2) ** 2
    return out


@lru_cache(maxsize=4)
def _bands(rate: int, size: int) -> Array:
    """[BANDS, size // 2 + 1] triangles of area 1 on the mel scale m(f) = 2595 log10(1 + f / 700)."""
    lowest, highest = (2595.0 * np.log10(1.0 + hertz / 700.0) for hertz in (LOWEST, HIGHEST))
    mel = np.linspace(lowest, highest, BANDS + 2)
    corners = 700.0 * (10.0 ** (mel / 2595.0) - 1.0)
    hertz = np.arange(size // 2 + 1) * rate / size
    low, middle, high = (corners[shift:shift + BANDS, None] for shift in range(3))
    bands = np.maximum(np.minimum((hertz - low) / (middle - low), (high - hertz) / (high - middle)), 0.0)
    return bands / bands.sum(axis=1, keepdims=True)


def fingerprint_text(frames: Frames) -> str:
    """A fingerprint as text, base64 of two values a byte: 400 characters per second."""
    return base64.b64encode((frames[:, ::2] << 4 | frames[:, 1::2]).tobytes()).decode("ascii")


def fingerprint_frames(text: str) -> Frames:
    """The inverse of `fingerprint_text`; `InputError` for a text that is not a fingerprint."""
    try:
        packed = np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    except (binascii.Error, ValueError):
        packed = np.zeros(1, np.uint8)
    if len(packed) % _FRAME_BYTES or not len(packed):
        raise InputError("fingerprint", "is not a fingerprint", "leave it as --plan-out wrote it, or remove it")
    packed = packed.reshape(-1, _FRAME_BYTES)
    return np.stack([packed >> 4, packed & _MOST], axis=-1).reshape(len(packed), BANDS)
