"""Bands of the mel scale (Slaney's): linear up to 1 kHz, logarithmic above."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array

_LINEAR = 200.0 / 3.0
"""Hertz of a mel up to `_BEND`."""
_BEND = 1000.0
"""Hertz."""
_OCTAVES = math.log(6.4) / 27.0
"""Natural logarithm of the ratio of two frequencies that lie a mel apart, above `_BEND`."""


def _hertz(mels: Array) -> Array:
    bend = _BEND / _LINEAR
    return np.where(mels >= bend, _BEND * np.exp(_OCTAVES * (mels - bend)), _LINEAR * mels)


def mel_bands(sample_rate: float, window: int, bands: int, unit_area: bool = True) -> NDArray[np.float32]:
    """[bands, window / 2 + 1] share of each frequency of a spectrum in each band: triangles that overlap by half, from
    0 Hz to half the sample rate, of area 1 per hertz, or of height 1. The numbers are librosa's, which takes a second
    to load."""
    top = sample_rate / 2.0
    most = _BEND / _LINEAR + math.log(top / _BEND) / _OCTAVES if top >= _BEND else top / _LINEAR
    edges = _hertz(np.linspace(0.0, most, bands + 2))
    widths = np.diff(edges)[:, None]
    away = edges[:, None] - np.fft.rfftfreq(window, 1.0 / sample_rate)
    out = np.maximum(0.0, np.minimum(-away[:-2] / widths[:-1], away[2:] / widths[1:])).astype(np.float32)
    if unit_area:
        out *= (2.0 / (edges[2:] - edges[:-2]))[:, None]
    return out
