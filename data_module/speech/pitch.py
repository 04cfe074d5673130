"""Pitch of short pieces of speech, by the autocorrelation of their frames (Boersma 1993).

A frame's autocorrelation is divided by that of its window, so that the height of a peak is the share of the sound that
repeats; the lag of the highest peak is the period. Nothing depends on the level or on other pieces, so a stream gives
the same result as a file.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from data_module.types import Array, Samples

__all__ = ["PitchLevel", "pitch_of"]

LOWEST, HIGHEST = 70.0, 500.0
"""Hertz of voices."""
WINDOW, HOP = 0.04, 0.01
"""Length of a frame and time between frames, seconds: nearly three periods of the lowest voice."""
VOICED = 0.5
"""Share of a frame that must repeat for it to be voiced."""
_OCTAVE = 0.02
"""Share by which a peak must be higher than one an octave above it: twice the period repeats as well."""
_NOTHING = 1e-10
"""Mean power of a frame without sound: 16 bits end at -98 dBFS."""
_MEMORY = 20.0
"""Seconds of voice over which its mean pitch is remembered."""


def pitch_of(samples: Samples, sample_rate: int) -> tuple[Array, NDArray[np.bool_]]:
    """log2 of the frequency in hertz, and whether the sound is voiced, of each whole frame, both [F].

    samples: [n]; frame f covers `WINDOW` seconds from f x `HOP`. The frequency of an unvoiced frame means nothing.
    """
    size, hop = round(WINDOW * sample_rate), round(HOP * sample_rate)
    if len(samples) < size:
        return np.zeros(0), np.zeros(0, dtype=bool)
    frames = sliding_window_view(samples.astype(np.float64), size)[::hop]
    frames = frames - frames.mean(axis=1, keepdims=True)
    window = np.hanning(size)
    shortest, longest = int(sample_rate / HIGHEST), int(np.ceil(sample_rate / LOWEST)) + 1
    repeats = _autocorrelation(frames * window, longest + 1)
    power = repeats[:, :1]
    own = _autocorrelation(window[None], longest + 1)
    share = np.where(power > _NOTHING * size, repeats / np.maximum(power, 1e-30) / (own / own[:, :1]), 0.0)
    lags = np.arange(shortest, longest)
    peak = (share[:, lags] >= share[:, lags - 1]) & (share[:, lags] >= share[:, lags + 1])
    height = np.where(peak, share[:, lags] - _OCTAVE * np.log2(lags / shortest), -np.inf)
    best = lags[height.argmax(axis=1)]
    rows = np.arange(len(share))
    left, middle, right = (share[rows, best + step] for step in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    shift = np.where(bend < -1e-12, 0.5 * (left - right) / np.where(bend < -1e-12, bend, 1.0), 0.0)
    return np.log2(sample_rate / (best + np.clip(shift, -0.5, 0.5))), (middle >= VOICED) & np.isfinite(
        height.max(axis=1))


def _autocorrelation(frames: Array, lags: int) -> Array:
    """[F, lags] of frames [F, n]."""
    size = 1 << int(np.ceil(np.log2(2 * frames.shape[1])))
    spectrum = np.fft.rfft(frames, size, axis=1)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, size, axis=1)[:, :lags])


class PitchLevel:
    """Pitch of the blocks of a recording, in octaves over the mean of the voice so far."""

    def __init__(self) -> None:
        self._mean, self._seconds = 0.0, 0.0

    def block(self, samples: Samples, sample_rate: int, count: int) -> Array:
        """[count] octaves at equal steps of the block [n], the last at its end; 0 where it is not voiced."""
        logs, voiced = pitch_of(samples, sample_rate)
        if not voiced.any():
            return np.zeros(count)
        seconds = HOP * float(voiced.sum())
        self._seconds = min(self._seconds + seconds, _MEMORY)
        self._mean += (float(logs[voiced].mean()) - self._mean) * min(seconds / self._seconds, 1.0)
        middles = WINDOW / 2 + HOP * np.arange(len(logs))
        times = len(samples) / sample_rate * np.arange(1, count + 1) / count
        nearest = np.abs(times[:, None] - middles).argmin(axis=1)
        return np.where(voiced[nearest], logs[nearest] - self._mean, 0.0)
