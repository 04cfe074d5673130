"""In time with the voice: beats against onsets by two detectors, speech against silence.

Theory: one detector of beats can be pleased by accident, so there are two that share nothing.

- First: onsets where the logarithm of energy in 40 bands of 80 to 7600 Hz rises (flux over 20 ms, above its median over
  1 s by .35 of its deviation); beats where either hand brakes hardest (2 m/s^2 or more, after a speed of .25 m/s).
- Second: onsets where the loudness of the voice's middle (300 to 3000 Hz) rises fastest, by 3 dB or more; beats where
  the summed speed of both hands falls fastest.

For each, PMB above chance at 0.1 s: 100 (PMB - chance) / (100 - chance), one to one as in `eval.metrics.pmb`, chance
the mean over 100 circular shifts. Percent. A system that moves on the grid of its blocks alone is above chance, too.

- hand speed in speech and in silence, m/s, and their ratio. Silence is told by level against the recording's own
  quiet 5 % and loud 5 %.

Good: near a speaker's own (45 and -1 above chance; ratio 2.1 and 1.1).

What fools them: bobbing at the onsets reaches 100 above chance and is no gesture. Jitter makes beats of noise, at
chance. A motion played backwards, or with mirrored arms, keeps speeds and ratio, and where a speaker's own timing is
near chance, as on one of two real takes, it passes by timing, too.

Half a second of voice after half a second without one:

    >>> int(_silent(np.repeat([-60.0, -20.0], 50)).sum())
    50
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter
from scipy.signal import find_peaks, stft

from data_module.speech.audio import SAMPLE_RATE, resample
from data_module.types import Array, Speech
from eval.metrics import pmb
from eval.metrics.eye.body import HZ, CommonBody

DELTA = 0.1
"""Seconds: see `eval.metrics.pmb`."""
SHIFTS, _SEED = 100, 1
TRACK_HZ = 100
"""Levels and spectra a second."""
_SHORTEST = 8
"""Frames of 10 ms between two onsets."""
_FEW_SILENT = 30
"""Frames of silence at most for which a mean speed says nothing."""
_FLOOR = 1e-12
"""Power of what is silent: -120 dB."""


@dataclass(frozen=True)
class VoiceActivity:
    """duration: seconds; onsets: of both detectors, seconds; level: [F] dB, and silent: [F], 100 a second."""

    duration: float
    onsets: tuple[Array, Array]
    level: Array
    silent: NDArray[np.bool_]


def hear(speech: Speech) -> VoiceActivity:
    """The voice activity of a recording, for the figures of this chapter."""
    samples = resample(speech, SAMPLE_RATE).samples.astype(np.float64)
    frequencies, times, spectrum = stft(samples, SAMPLE_RATE, nperseg=512, noverlap=352)
    power = np.abs(spectrum) ** 2
    hop = SAMPLE_RATE // TRACK_HZ
    # Whole frames of 10 ms; what is left over at the end is no level.
    whole = len(samples) // hop
    level = 10.0 * np.log10((samples[:whole * hop].reshape(whole, hop) ** 2).mean(axis=1) + _FLOOR)
    onsets = _flux_onsets(frequencies, times, power), _rise_onsets(frequencies, times, power)
    return VoiceActivity(len(samples) / SAMPLE_RATE, onsets, level, _silent(level))


def _flux_onsets(frequencies: Array, times: Array, power: Array) -> Array:
    """Where energy rises in many bands at once."""
    edges = np.geomspace(80, 7600, 41)
    # A band narrower than a bin of the spectrum still holds one.
    bands = np.array([power[(frequencies >= low) & (frequencies < max(high, low + 32))].sum(axis=0)
                      for low, high in zip(edges[:-1], edges[1:], strict=True)])
    # 40 dB under the loudest band: below that a logarithm would make onsets of the noise floor.
    logs = np.log10(bands + 1e-4 * max(float(bands.max()), _FLOOR))
    if logs.shape[1] < 3:
        return np.zeros(0)
    # The rise over two frames, 20 ms: the difference of neighbours is noisier.
    flux = gaussian_filter1d(np.maximum(logs[:, 2:] - logs[:, :-2], 0.0).sum(axis=0), 1.5)
    limit = median_filter(flux, 101) + 0.35 * flux.std()
    peaks = find_peaks(flux, distance=_SHORTEST)[0]
    onsets: Array = times[1:-1][peaks[flux[peaks] > limit[peaks]]]
    return onsets


def _rise_onsets(frequencies: Array, times: Array, power: Array) -> Array:
    """Where the voice's middle grows loud fastest, by 3 dB or more."""
    middle = 10.0 * np.log10(power[(frequencies >= 300) & (frequencies < 3000)].sum(axis=0) + _FLOOR)
    middle = np.maximum(middle, np.percentile(middle, 95) - 35.0)
    smooth = gaussian_filter1d(middle, 2.5)
    if len(smooth) < 2:
        return np.zeros(0)
    # 35 dB a second over 120 ms is the slowest rise that gains 3 dB and is heard as an onset.
    peaks = find_peaks(np.gradient(smooth, 1.0 / TRACK_HZ), height=35.0, distance=_SHORTEST)[0]
    gains = [smooth[k:k + 12].max() - smooth[max(0, k - 12):k + 1].min() for k in peaks]
    return np.asarray(times[peaks[np.array(gains, dtype=np.float64) > 3.0]], dtype=np.float64)


def _silent(level: Array) -> NDArray[np.bool_]:
    """[F] frames near the recording's own quiet level, and well below its loud one."""
    if len(level) == 0:
        return np.zeros(0, dtype=bool)
    quiet, loud = np.percentile(level, [5, 95])
    # Near the quiet level and 15 dB under the loud one, but never lower than 38 dB under that or -60 dB: all below is
    # silence, however clean the recording.
    limit = max(min(quiet + 8.0, loud - 15.0), loud - 38.0, -60.0)
    return np.asarray(median_filter(level, 5) < limit, dtype=bool)


def hand_beats(hands: Array) -> Array:
    """First detector: seconds at which a hand of [T, 2, 3] brakes hard; beats within 0.1 s are one."""
    brakes: list[float] = []
    for k in range(hands.shape[1]):
        speed = np.linalg.norm(np.gradient(gaussian_filter1d(hands[:, k], 1.6, axis=0), 1.0 / HZ, axis=0), axis=1)
        braking = -np.gradient(gaussian_filter1d(speed, 2), 1.0 / HZ)
        brakes += [peak / HZ for peak in find_peaks(braking, height=2.0, distance=9)[0]
                  if speed[max(0, peak - 24):peak + 1].max() > 0.25]
    # Both hands often brake together, and that is one beat.
    beats: list[float] = []
    for time in sorted(brakes):
        if not beats or time - beats[-1] >= 0.1:
            beats.append(time)
    return np.array(beats, dtype=np.float64)


def summed_beats(hands: Array) -> Array:
    """Second detector: seconds at which the summed speed of hands [T, 2, 3] falls fastest."""
    # Speeds are smoothed here and places in the first detector: the two must not share their errors.
    velocity = np.gradient(hands, 1.0 / HZ, axis=0)
    speed = np.linalg.norm(gaussian_filter1d(velocity, 3, axis=0), axis=-1).sum(axis=1)
    braking = -np.gradient(speed, 1.0 / HZ)
    peaks = find_peaks(braking, height=max(0.5, 0.5 * float(braking.std())), distance=6)[0]
    return np.array([peak / HZ for peak in peaks if speed[max(0, peak - 18):peak + 1].max() > 0.1], dtype=np.float64)


def above_chance(beats: Array, onsets: Array, duration: float) -> float:
    """PMB above chance at `DELTA`, percent; NaN without beats, and for clips too short to be shifted."""
    # Sound and motion may differ in length by a frame, and a shift wraps around at one length.
    beats, onsets = beats[beats < duration], onsets[onsets < duration]
    if len(beats) == 0 or duration <= 2.5:
        return math.nan
    by_chance = pmb.chance(beats, onsets, duration, DELTA, seed=_SEED, shifts=SHIFTS)
    return 100.0 * pmb.above_chance(pmb.pmb(beats, onsets, DELTA), by_chance)


def figures(body: CommonBody, voice: VoiceActivity) -> dict[str, float]:
    """Every figure of this chapter."""
    speed = body.hand_speed
    at = (np.arange(len(speed)) / HZ * TRACK_HZ).astype(int)
    inside = at < len(voice.silent)
    quiet, moved = voice.silent[at[inside]], speed[inside]
    talking = float(moved[~quiet].mean()) if (~quiet).any() else math.nan
    silence = float(moved[quiet].mean()) if quiet.sum() > _FEW_SILENT else math.nan
    duration = min(voice.duration, body.duration)
    return {"eye_speech_speed": talking, "eye_silence_speed": silence,
            "eye_speech_over_silence": talking / silence if silence > 1e-6 else math.nan,
            "eye_above_1": above_chance(hand_beats(body.hands), voice.onsets[0], duration),
            "eye_above_2": above_chance(summed_beats(body.hands), voice.onsets[1], duration)}
