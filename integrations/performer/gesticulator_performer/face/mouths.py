"""Mouths without a network: by volume alone, and by a rule on the formants, as games and toolkits have them.

Both give weights of the 15 visemes, 50 times a second, so that they are judged as the network is.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from data_module.speech.silence import FRAME, frame_levels
from data_module.types import Array, Samples
from gesticulator.face.visemes import SILENT, VISEMES

RATE = 50
_SAMPLE_RATE = 16000
_QUIET, _LOUD = 30.0, 5.0
"""Decibels under the loud frames at which the mouth is shut, and wide open."""
_ORDER = 18
"""Coefficients of the linear prediction at 16 kHz: two per formant and a few for the slope."""
_VOWELS = {"aa": (750.0, 1250.0), "E": (540.0, 1800.0), "ih": (350.0, 2200.0), "oh": (520.0, 950.0),
           "ou": (350.0, 1100.0)}
"""F1 and F2, hertz, between the means of men and women (Peterson and Barney 1952; Hillenbrand et al. 1995)."""
_SIBILANT = 3.0
"""Ratio of the energy above 3.5 kHz to that below 1.5 kHz from which sound is a sibilant."""


def loudness(samples: Samples) -> Array:
    """[T] 0 to 1 from shut to loud, by the level of frames of 20 ms under that of the loud frames."""
    levels = frame_levels(samples, _SAMPLE_RATE)
    step = round(1 / (RATE * FRAME))
    levels = levels[:len(levels) // step * step].reshape(-1, step).mean(axis=1)
    return np.asarray(np.clip((levels - np.percentile(levels, 95) + _QUIET) / (_QUIET - _LOUD), 0.0, 1.0))


def by_volume(samples: Samples) -> Array:
    """[T, 15] the widest vowel by the volume, and silence."""
    out = np.zeros((len(loudness(samples)), len(VISEMES)))
    out[:, VISEMES.index("aa")] = loudness(samples)
    out[:, SILENT] = 1.0 - out[:, VISEMES.index("aa")]
    return out


def by_formants(samples: Samples) -> Array:
    """[T, 15] the vowel whose formants are nearest, a sibilant where the sound is high, p, b, m where the level dips
    between loud frames, by the volume; silence for the rest."""
    loud, measured = loudness(samples), formants(samples)
    count = min(len(loud), len(measured[0]))  # the last frame may lack sound
    loud, (f1, f2, ratio) = loud[:count], (each[:count] for each in measured)
    out = np.zeros((count, len(VISEMES)))
    targets = np.log(np.array(list(_VOWELS.values())))
    distance = ((np.log(np.stack([f1, f2], axis=1))[:, None] - targets) ** 2).sum(axis=-1)
    chosen = np.array([VISEMES.index(name) for name in _VOWELS])[distance.argmin(axis=1)]
    chosen = np.where(ratio > _SIBILANT, VISEMES.index("SS"), chosen)
    padded = np.pad(loud, 4, mode="edge")
    around = np.minimum(padded[:-8], padded[8:])
    chosen = np.where(loud < 0.5 * around, VISEMES.index("PP"), chosen)
    strength = np.where(chosen == VISEMES.index("PP"), 1.0, np.sqrt(loud))
    out[np.arange(len(loud)), chosen] = strength
    out[:, SILENT] = 1.0 - strength
    return out


def formants(samples: Samples) -> tuple[Array, Array, Array]:
    """F1 and F2 in hertz and the ratio of high to low energy, [T] each; a frame without a clear formant has 500 and
    1500 Hz."""
    import librosa

    step = _SAMPLE_RATE // RATE
    count = len(samples) // step
    raised = lfilter([1.0, -0.97], [1.0], samples.astype(np.float64))
    padded = np.pad(raised, (step // 2, step))
    f1, f2, ratio = np.full(count, 500.0), np.full(count, 1500.0), np.zeros(count)
    taper, frequencies = np.hanning(2 * step), np.fft.rfftfreq(2 * step, 1 / _SAMPLE_RATE)
    for frame in range(count):
        window = padded[frame * step:frame * step + 2 * step] * taper
        power = np.abs(np.fft.rfft(window)) ** 2
        ratio[frame] = power[frequencies > 3500].sum() / (power[frequencies < 1500].sum() + 1e-12)
        if np.abs(window).max() < 1e-6:
            continue
        roots = np.roots(librosa.lpc(window, order=_ORDER))
        roots = roots[np.imag(roots) > 0.01]
        hertz = np.angle(roots) * _SAMPLE_RATE / (2 * np.pi)
        width = -np.log(np.abs(roots)) * _SAMPLE_RATE / np.pi
        clear = np.sort(hertz[(width < 400) & (hertz > 200) & (hertz < 3500)])
        if len(clear) >= 2:
            f1[frame], f2[frame] = clear[:2]
    return f1, f2, ratio
