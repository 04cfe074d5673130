"""Histograms of the intervals between onsets of the speech and between beats (RG Fig. 5), to choose the bounds d_min
and d_max for a corpus: most intervals between onsets should lie within them."""

import numpy as np
from numpy.typing import NDArray

from data_module.blocks import BlockSettings, cut
from data_module.speech.onsets import detect_onsets
from data_module.types import Speech

STEP = 0.05
LONGEST = 2.0
"""Width of a bin, and start of the last bin, which contains everything longer, seconds."""
BINS = round(LONGEST / STEP) + 1
Counts = NDArray[np.int64]
"""[2, BINS] intervals between onsets and between beats: bin i holds [i * STEP, (i + 1) * STEP) seconds."""


def within_bounds(onsets: Counts) -> str:
    """One line: the share of the intervals between onsets [BINS] within the default bounds of a block."""
    bounds = BlockSettings().beats
    # The bounds are rounded to whole bins, in which the counts are.
    share = sum(onsets[round(bounds.d_min / STEP):round(bounds.d_max / STEP)]) / max(1, sum(onsets))
    return f"{share:.0%} of the intervals between onsets lie between {bounds.d_min:g} and {bounds.d_max:g} s"


def measure(speech: Speech) -> Counts:
    """The intervals of a recording with the default settings."""
    settings = BlockSettings()
    blocks = cut(speech, settings)
    onsets = detect_onsets(speech.samples, speech.sample_rate, settings.beats.merge)
    # Beats lie on a grid of 10 ms, so many intervals fall on the edge of a bin, up to rounding errors.
    places = (np.minimum((part / STEP + 1e-6).astype(int), BINS - 1) for part in (np.diff(onsets), blocks.durations))
    return np.array([np.bincount(part, minlength=BINS) for part in places])
