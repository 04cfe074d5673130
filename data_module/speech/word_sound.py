"""The sound of words: where the stressed vowel of a word begins, and how emphatic the word is.

Both are found from the samples around the word alone, and neither depends on the level of the whole recording.
"""

import functools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfiltfilt

from data_module.speech.silence import PITCH_HOP, PITCH_WINDOW, pitch_of
from data_module.types import Array, Speech, Word

_EXPECTED, _TO_PEAK = 0.3, 0.04
"""A stressed vowel is expected to begin at this share of its word, and to be loudest so many seconds later."""
_AROUND = 0.1
"""Seconds of sound around a word that are filtered with it, so that its ends are not those of the filter."""
_STRAYS = 60.0
"""Decibels that a vowel must be louder for each second that it is further from where it is expected. Without, every
tenth word of several syllables takes an unstressed one; 30 to 100 make no difference."""
_RISES, _LONGEST_RISE = 5.0, 0.15
"""A vowel begins where its level is so many decibels under its peak, at most so many seconds before it."""
_NEIGHBOURS, _FEWEST = 2.5, 3
"""Seconds on both sides of a word within which its neighbours begin, and how many are needed."""
_SPREAD = (6.0, 4.0, 0.4)
"""Decibels, semitones, and natural logarithms of duration by which a word stands out plainly from its neighbours."""


class WordSounds:
    """The sound of a recording, word by word."""

    def __init__(self, speech: Speech, words: Sequence[Word]) -> None:
        """words: those that are spoken, in order of their start."""
        self._samples, self._rate = speech.samples, speech.sample_rate
        self._words = list(words)
        self._measured = functools.cache(self._measure)

    def vowel(self, word: Word) -> float | None:
        """Seconds at which the stressed vowel of a word begins: the loudest voiced one, the nearer to where it is
        expected the better. None where nothing is voiced."""
        level, voiced, _ = self._frames(word)
        if not voiced.any():
            return None
        times = word.start + PITCH_HOP * np.arange(len(level))
        # The best frame, then uphill to the top of its vowel, then back to where the vowel rises.
        expected = word.start + _EXPECTED * (word.end - word.start) + _TO_PEAK
        peak = int(np.argmax(np.where(voiced, level - _STRAYS * np.abs(times - expected), -np.inf)))
        while peak + 1 < len(level) and level[peak + 1] > level[peak]:
            peak += 1
        while peak > 0 and level[peak - 1] > level[peak]:
            peak -= 1
        begin, first = peak, max(peak - round(_LONGEST_RISE / PITCH_HOP), 0)
        while begin > first and level[begin - 1] > level[peak] - _RISES:
            begin -= 1
        return float(times[begin])

    def emphasis(self, word: Word) -> float:
        """[-1, 1]: above 0 for a word that is louder, higher and longer than the words around it, and 0 where too
        little is known."""
        near = [other for other in self._words
                if abs(other.start - word.start) <= _NEIGHBOURS and other.start != word.start]
        rows = np.array([self._measured(other) for other in near]).reshape(len(near), 3)
        others = [column[np.isfinite(column)] for column in rows.T]
        differences = [float(np.clip((mine - np.median(column)) / spread, -1.0, 1.0)) for mine, spread, column
                       in zip(self._measured(word), _SPREAD, others, strict=True)
                       if len(column) >= _FEWEST and math.isfinite(mine)]
        return sum(differences) / max(len(differences), 1)

    def _measure(self, word: Word) -> tuple[float, float, float]:
        """Peak level, decibels; median pitch, semitones; logarithm of duration over what its letters take; or NaN."""
        level, voiced, pitch = self._frames(word)
        letters = sum(mark.isalnum() for mark in word.text)
        lasts = math.log(max(word.end - word.start, PITCH_HOP) / (0.12 + 0.045 * letters))
        if not voiced.any():
            return math.nan, math.nan, lasts
        return float(level[voiced].max()), float(np.median(pitch[voiced])), lasts

    def _frames(self, word: Word) -> tuple[Array, NDArray[np.bool_], Array]:
        """Of a word every 10 ms: [T] level of vowels, decibels; whether it is voiced; its pitch, semitones."""
        # Frames are centred on their moment.
        hop, length = round(PITCH_HOP * self._rate), round(PITCH_WINDOW * self._rate)
        count = max(round((word.end - word.start) / PITCH_HOP), 1)
        first, margin = round(word.start * self._rate), round(_AROUND * self._rate)
        # The frames of the word, with room for the filter; silence beyond the recording.
        wanted = np.arange(first - margin, first + count * hop + margin + length)
        inside = (wanted >= 0) & (wanted < len(self._samples))
        sound = np.where(inside, self._samples[np.clip(wanted, 0, len(self._samples) - 1)], 0.0).astype(np.float64)
        # Between 300 and 2500 Hz, where vowels are loud.
        band = butter(2, (300, min(2500, 0.45 * self._rate)), "bandpass", fs=self._rate, output="sos")
        power = sosfiltfilt(band, sound) ** 2
        means = power[:len(power) // hop * hop].reshape(-1, hop).mean(axis=1)
        level = gaussian_filter1d(10.0 * np.log10(means + 1e-12 * power.max() + 1e-300), 2.0)
        begin = margin + hop // 2 - length // 2
        pitch, voiced = pitch_of(sound[begin:begin + (count - 1) * hop + length].astype(np.float32), self._rate)
        return level[margin // hop:margin // hop + count], voiced, 12.0 * pitch
