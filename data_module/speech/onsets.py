"""Streaming detection of onsets, sudden rises of the sound (RG 4.2.1), with a latency of `LOOK_AHEAD` seconds.

Nothing depends on the loudest moment of the recording, so a stream gives the same result as a file.
"""

from collections import deque
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from data_module.speech.mel import mel_bands
from data_module.speech.silence import FRAME, QUIETEST, LoudnessStep, frame_levels, loudness
from data_module.types import Array, Samples

__all__ = ["OnsetTracker", "detect_onsets"]

LOOK_AHEAD = 0.25
"""Seconds of sound after an onset that are needed to detect it."""

# Seconds between spectra.
_HOP = 0.01
# Length of a spectrum's window, seconds: librosa's default of 2048 samples at 16 kHz.
_WINDOW = 0.128
# Mel bands, librosa's default.
_BANDS = 128
# Lag of the difference of spectra (30 ms).
_LAG = 3
# Floor of the mel power, that of white noise at the limit of silence, here -60 dBFS. With a floor of 1e-6, noise at -60
# dBFS moved 28 % of the beats of eleven recordings, with this one 4 %.
_FAINTEST, _LIMIT = 1e-4, -60.0
_FAINTEST_DECIBELS = 10.0 * np.log10(_FAINTEST)
_TINY = np.float32(1e-12)
# Seconds on both sides of a peak over which its surroundings are averaged.
_AROUND = 0.1
# Seconds on both sides in which a peak must be the highest.
_PEAK = 0.03
# Least height of a peak above its surroundings, decibels.
_RISE = 1.2
# Interval about an onset, seconds, in which a frame must be louder than the noise.
_AUDIBLE = (-0.02, 0.08)
# Spectra by which an onset follows its peak: the rise enters a window half a window early, and the peak is the first
# value of the plateau of length `_LAG`.
_LATE = int(_WINDOW / 2 // _HOP) - (_LAG - 1)
# Spectra (20 ms) by which the strengths grow, and the most that are computed in one call, which bounds the memory.
_TILE, _MOST = 2, 100
# Seconds: what is closer is the same time.
_EPS = 1e-9


def detect_onsets(samples: Samples, sample_rate: int, merge: float = 0.05) -> Array:
    """Onsets of the sound in seconds, rising, [n].

    Peaks of librosa's onset strength (the mean rise of the log-mel bands over 30 ms) that are 1.2 dB above their
    surroundings of 0.1 s on both sides and louder than the running noise floor. The threshold in decibels does not
    depend on the gain, so nothing is scaled by the file's maximum. Of onsets closer than `merge` seconds the first
    counts.
    """
    return merged(np.array([time for time, _ in onsets_of(samples, sample_rate)]), merge)


def onsets_of(samples: Samples, sample_rate: int) -> list[tuple[float, float]]:
    """The onsets of a recording (seconds, dB), before merging."""
    # One step with all of the sound: a file takes the path of a stream.
    tracker = OnsetTracker(sample_rate)
    return tracker.step(samples, loudness(frame_levels(samples, sample_rate))) + tracker.finish()


def merged(times: Array, closest: float) -> Array:
    """Rising times without those that are closer than `closest` to the last one that remains."""
    distinct: list[float] = []
    for time in np.asarray(times, dtype=np.float64):
        if not distinct or time - distinct[-1] >= closest - _EPS:
            distinct.append(float(time))
    return np.array(distinct)


class RiseTracker:
    """Streaming onset strength. Each spectrum is transformed, weighted and summed alone, so that the pieces of sound do
    not change the result in the last bit: the order of sums in a matrix product depends on its columns."""

    def __init__(self, sample_rate: int) -> None:
        self._rate = sample_rate
        self._hop, self._window = round(_HOP * sample_rate), 2 * round(_WINDOW * sample_rate / 2)
        # Most weights are zero: a band covers 16 of 1025 frequencies.
        weights = mel_bands(sample_rate, self._window, _BANDS)
        bands, self._bins = np.nonzero(weights)
        self._weights, self._first_of_band = weights[bands, self._bins], np.searchsorted(bands, np.arange(_BANDS))
        self._covered = _covered(self._window, self._hop)
        self._hann = 0.5 + 0.5 * np.cos(np.linspace(-np.pi, np.pi, self._window + 1))[:-1]
        # Sound from the start of the next tile's first window on; silence lies before the recording.
        self._sound = np.zeros(self._window // 2, np.float32)
        self._ground = np.zeros(0)
        self._samples = self._frames = 0
        # Before the start there is nothing: the first rises do not count.
        self._before = np.zeros((_BANDS, _LAG), np.float32)
        self._last_ground = QUIETEST

    def step(self, samples: Samples, ground: Array) -> Array:
        """The strengths that are certain after more sound [n] and more of `LoudnessStep.ground` [F]."""
        self._take(samples, ground)
        self._samples += len(samples)
        out = [np.zeros(0)]
        while count := self._ready():
            out.append(self._strengths(count))
        return np.concatenate(out)

    def _ready(self) -> int:
        """How many spectra can be computed next."""
        whole = (len(self._sound) - self._window) // self._hop + 1
        return max(min(whole, len(self._ground), _MOST), 0) // _TILE * _TILE

    def finish(self) -> Array:
        """The remaining strengths, at the end of the recording."""
        left = self._samples // self._hop + 1 - self._frames
        out = [np.zeros(0)]
        for start in range(0, left, _TILE):
            # Silence after the end fills the last windows, as silence before the start fills the first.
            short = (_TILE - 1) * self._hop + self._window - len(self._sound)
            self._take(np.zeros(max(short, 0), np.float32), np.full(_TILE, self._last_ground))
            out.append(self._strengths(_TILE)[:left - start])
        return np.concatenate(out)

    def _take(self, samples: Samples, ground: Array) -> None:
        self._sound, self._ground = np.concatenate([self._sound, samples]), np.concatenate([self._ground, ground])
        if len(ground):
            self._last_ground = float(ground[-1])

    def _strengths(self, count: int) -> Array:
        """The strengths [count] of the next spectra."""
        spectrum = _spectra(self._sound[:(count - 1) * self._hop + self._window], self._hann, self._hop)
        power = spectrum.real ** 2 + spectrum.imag ** 2
        # A spectrum's weights lie side by side: a third of the time of the same sums down a column.
        power = np.add.reduceat(self._weights * power.take(self._bins, axis=1), self._first_of_band, axis=1)
        power = np.ascontiguousarray(power.T)
        if self._frames < len(self._covered):  # the windows after them are filled
            numbers = np.arange(self._frames, self._frames + count)
            power /= self._covered[np.minimum(numbers, len(self._covered) - 1)]
        # The floor of the power in decibels: that of `_FAINTEST`, moved with the ground.
        faintest = _FAINTEST_DECIBELS + self._ground[:count].astype(np.float32) - np.float32(_LIMIT)
        decibels = np.concatenate([self._before, 10.0 * np.log10(np.maximum(power, _TINY))], axis=1)
        # Both spectra over the same floor: a floor that moves is not a rise.
        rise = np.maximum(decibels[:, _LAG:] - np.maximum(decibels[:, :-_LAG], faintest), 0.0)
        rise = (np.add.reduce(rise, axis=0) / np.float32(_BANDS)).astype(np.float64)
        rise[:max(_LAG - self._frames, 0)] = 0.0  # there is only padding before them
        self._before = decibels[:, -_LAG:]
        self._sound, self._ground = self._sound[count * self._hop:], self._ground[count:]
        self._frames += count
        # In single precision ties depend on the platform; rounding resolves them.
        return np.asarray(np.round(rise, 3))


class OnsetTracker:
    """Streaming `detect_onsets` without merging; each onset with its strength in dB."""

    def __init__(self, sample_rate: int) -> None:
        self._rise = RiseTracker(sample_rate)
        self._around, self._reach = round(_AROUND / _HOP), round(_PEAK / _HOP)
        # The frames of the first stored strength, of the next to judge, and before which there are no further peaks.
        self._first = self._next = self._excluded = 0
        self._strengths: list[float] = []
        self._totals = [0.0]  # cumulated strengths
        self._peaks: deque[tuple[int, float]] = deque()  # not yet known to be audible
        self._audible, self._audible_from = list[bool](), 0

    def step(self, samples: Samples, loudness_step: LoudnessStep) -> list[tuple[float, float]]:
        """The onsets (seconds, dB) that are certain after more sound [n] and its loudness."""
        self._add(self._rise.step(samples, loudness_step.ground))
        self._audible += (~loudness_step.silent).tolist()
        # A peak is compared with what follows it, too.
        self._judge(self._first + len(self._strengths) - self._around)
        return self._certain(ended=False)

    def finish(self) -> list[tuple[float, float]]:
        """The remaining onsets (seconds, dB), at the end of the recording."""
        self._add(self._rise.finish())
        self._judge(self._first + len(self._strengths))
        return self._certain(ended=True)

    @property
    def known_until(self) -> float:
        """Seconds before which all onsets have been returned."""
        return (self._peaks[0][0] if self._peaks else self._excluded) * _HOP + _LATE * _HOP

    def _add(self, strengths: Array) -> None:
        for strength in strengths.tolist():
            self._strengths.append(strength)
            self._totals.append(self._totals[-1] + strength)

    def _judge(self, until: int) -> None:
        """Find the peaks before a frame: the highest within `_PEAK`, and `_RISE` above the mean within `_AROUND`."""
        while self._next < until:
            at = self._next - self._first
            low, high = max(at - self._around, 0), min(at + self._around + 1, len(self._strengths))
            strength = self._strengths[at]
            highest = max(self._strengths[max(at - self._reach, 0):at + self._reach + 1])
            if strength >= highest and strength >= (self._totals[high] - self._totals[low]) / (high - low) + _RISE:
                self._peaks.append((self._next, strength))
            self._next += 1
        self._excluded = max(self._excluded, self._next)
        while self._excluded < self._first + len(self._strengths) and self._no_peak(self._excluded - self._first):
            self._excluded += 1
        old = self._next - self._around - self._first
        if old > 0:
            del self._strengths[:old], self._totals[:old]
            self._first += old

    def _no_peak(self, at: int) -> bool:
        """Whether a stored strength cannot be a peak, whatever follows: a higher one is near, or its surroundings are
        too high already (strengths are never negative)."""
        strength, low = self._strengths[at], max(at - self._around, 0)
        # Divided by the full width: unknown strengths count as 0, so the mean can only rise.
        mean = (self._totals[min(at + self._around + 1, len(self._strengths))] - self._totals[low]) / (
            at + self._around + 1 - low)
        highest = max(self._strengths[max(at - self._reach, 0):at + self._reach + 1])
        return strength < mean + _RISE or strength < highest

    def _certain(self, ended: bool) -> list[tuple[float, float]]:
        out = []
        while self._peaks:
            frame, strength = self._peaks[0]
            time = frame * _HOP + _LATE * _HOP
            first, last = (max(round((time + shift) / FRAME), 0) for shift in _AUDIBLE)
            # The frames after the onset decide whether it is audible, so they must be known.
            if not ended and last > self._audible_from + len(self._audible):
                break
            self._peaks.popleft()
            if any(self._audible[max(first - self._audible_from, 0):last - self._audible_from]):
                out.append((time, strength))
        old = (self._peaks[0][0] if self._peaks else self._next) - self._around - self._audible_from
        if old > 0:
            del self._audible[:old]
            self._audible_from += old
        return out


def _spectra(sound: Samples, taper: Array, hop: int) -> NDArray[np.complex64]:
    """[F, bins] of the windows [F, W] that begin every `hop` samples; librosa's checks take five times as long."""
    # What NumPy's `sliding_window_view` checks takes as long as the transform of a window.
    windows = np.array([sound[start:start + len(taper)] for start in range(0, len(sound) - len(taper) + 1, hop)])
    return np.fft.rfft(windows * taper, axis=1).astype(np.complex64)


@lru_cache(maxsize=4)
def _covered(window: int, hop: int) -> Array:
    """Share of the power of the first windows that lies in the recording, up to 1, to correct for windows that are only
    partly filled: steady sound at the start is not an onset."""
    power = np.hanning(window + 1)[:-1] ** 2
    inside = np.cumsum(power[::-1])[::-1] / power.sum()
    return np.concatenate([inside[window // 2::-hop], [1.0]])
