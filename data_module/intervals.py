"""Histograms of the intervals between onsets of the speech and between beats (RG Fig. 5), to choose the bounds d_min
and d_max for a corpus: most intervals between onsets should lie within them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_module.blocks import BlockSettings, cut
from data_module.speech.onsets import detect_onsets
from data_module.types import Array, Speech

STEP = 0.05
LONGEST = 2.0
"""Width of a bin, and start of the last bin, which contains everything longer, seconds."""
_BINS = round(LONGEST / STEP) + 1


@dataclass(frozen=True)
class Intervals:
    """Counts of intervals. onsets, beats: bin i holds [i * STEP, (i + 1) * STEP) seconds, the last all from LONGEST."""

    onsets: Sequence[int] = (0,) * _BINS
    beats: Sequence[int] = (0,) * _BINS

    def __add__(self, other: Intervals) -> Intervals:
        return Intervals(tuple(a + b for a, b in zip(self.onsets, other.onsets, strict=True)),
                         tuple(a + b for a, b in zip(self.beats, other.beats, strict=True)))

    def line(self) -> str:
        """One line: the share of the onsets within the default bounds of a block."""
        bounds = BlockSettings().beats
        # The bounds are rounded to whole bins, in which the counts are.
        within = self.onsets[round(bounds.d_min / STEP):round(bounds.d_max / STEP)]
        share = sum(within) / max(1, sum(self.onsets))
        return f"{share:.0%} of the intervals between onsets lie between {bounds.d_min:g} and {bounds.d_max:g} s"


def measure(speech: Speech) -> tuple[int, Intervals]:
    settings = BlockSettings()
    blocks = cut(speech, settings)
    onsets = detect_onsets(speech.samples, speech.sample_rate, settings.beats.merge)
    return len(blocks), Intervals(_counts(np.diff(onsets)), _counts(blocks.durations))


def _counts(seconds: Array) -> tuple[int, ...]:
    # Beats lie on a grid of 10 ms, so many intervals fall on the edge of a bin, up to rounding errors.
    places = np.minimum(np.floor(seconds / STEP + 1e-6).astype(int), _BINS - 1)
    return tuple(np.bincount(places, minlength=_BINS).tolist())
