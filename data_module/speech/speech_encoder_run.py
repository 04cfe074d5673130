"""The speech encoder on arrays: eight convolutions over samples (RG 4.1.3). `data_module.speech.speech_encoder` trains
it."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from data_module.layers_run import Conv, Floats, Norm, Tensors, gelu
from data_module.types import Samples

SHAPES = ((10, 5), (8, 4), (4, 2), (4, 2), (4, 2), (1, 1), (1, 1), (1, 1))
"""Kernel and stride of the eight convolutions; the last four levels have 100 rows a second of 16 kHz sound."""
LEVELS = len(SHAPES)
LOW, HIGH = 2, 8
"""The levels that the paper takes as a_low and a_high."""


def hop_and_reach(level: int) -> tuple[int, int]:
    """Hop and receptive field of a level (1 to 8), samples."""
    hop, reach = 1, 1
    for kernel, stride in SHAPES[:level]:
        reach += (kernel - 1) * hop
        hop *= stride
    return hop, reach


@lru_cache(maxsize=64)
def pooling(level: int, samples: int, frames: int) -> Floats:
    """[T_l, frames] weights that average a level over each frame; a row belongs to the frame that contains the middle
    of its receptive field."""
    hop, reach = hop_and_reach(level)
    # No padding: row i covers samples [i hop, i hop + reach).
    middles = hop * np.arange((samples - reach) // hop + 1) + (reach - 1) / 2
    weights = (np.floor(middles * frames / samples)[:, None] == np.arange(frames)).astype(np.float32)
    # Frames shorter than a row's hop may own none: they take the nearest.
    for empty in np.flatnonzero(weights.sum(0) == 0):
        weights[np.abs(middles - (empty + 0.5) * samples / frames).argmin(), empty] = 1.0
    return np.asarray(weights / weights.sum(0))


class SpeechEncoderRunner:
    """vq-wav2vec's feature extractor: each convolution is followed by normalisation and GELU."""

    def __init__(self, width: int, tensors: Tensors) -> None:
        """width: channels of every convolution."""
        self.width, widths = width, (1, *[width] * LEVELS)
        self._layers = [
            (Conv(tensors.take(f"convolutions.{layer}.weight", width, widths[layer], kernel), stride=stride),
             Norm(tensors.within(f"norms.{layer}"), width, axes=2)) for layer, (kernel, stride) in enumerate(SHAPES)]

    def levels(self, samples: Samples, frames: int, which: Sequence[int] = (LOW, HIGH)) -> tuple[Floats, ...]:
        """The levels `which` (1 to 8) of windows [B, T], averaged over each motion frame: [B, frames, C] each."""
        x, out = samples[..., None], {}
        for level, (convolve, norm) in enumerate(self._layers[:max(which)], 1):
            x = gelu(norm(convolve(x)))
            if level in which:
                last = np.log1p(np.abs(x)) if level == LEVELS else x
                out[level] = pooling(level, samples.shape[1], frames).T @ last
        return tuple(out[level] for level in which)
