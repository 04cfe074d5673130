"""Mel bands: overlapping triangles over the spectrum, as narrow as hearing resolves it (Slaney's scale)."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

# The scale is linear up to 1000 Hz; above it 27 mel are a factor of 6.4.
_HERTZ_PER_MEL, _BREAK, _LOG_STEP = 200.0 / 3.0, 1000.0, np.log(6.4) / 27.0
_BREAK_MEL = _BREAK / _HERTZ_PER_MEL


@lru_cache(maxsize=8)
def mel_bands(sample_rate: int, window: int, bands: int, top: float | None = None, *, equal_area: bool = True
              ) -> NDArray[np.float32]:
    """[bands, window / 2 + 1] weights of the spectrum of a window of `window` samples, up to `top` Hz (None: half the
    sample rate). A triangle has peak 1, or area 1 over the hertz with `equal_area`. The same numbers as
    `librosa.filters.mel` to the last bit, without an import that takes seconds."""
    top = sample_rate / 2 if top is None else top
    top_mel = top / _HERTZ_PER_MEL if top < _BREAK else _BREAK_MEL + np.log(top / _BREAK) / _LOG_STEP
    mels = np.linspace(0.0, top_mel, bands + 2)
    corners = np.where(mels < _BREAK_MEL, _HERTZ_PER_MEL * mels, _BREAK * np.exp(_LOG_STEP * (mels - _BREAK_MEL)))
    # Each triangle rises from one corner to the next and falls to the one after it.
    over = corners[:, None] - np.fft.rfftfreq(window, 1.0 / sample_rate)
    steps = np.diff(corners)[:, None]
    weights = np.maximum(0.0, np.minimum(-over[:-2] / steps[:-1], over[2:] / steps[1:])).astype(np.float32)
    if equal_area:
        weights *= (2.0 / (corners[2:] - corners[:-2]))[:, None]
    return weights
