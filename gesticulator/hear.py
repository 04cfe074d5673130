"""What the models hear of speech: blocks, and audio features on three-block windows.

The same function serves training and inference, so both hear the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module import blocks as block_module
from data_module.audio import SAMPLE_RATE
from data_module.features import FRONT_ENDS, FrontEnd, reference_level
from data_module.types import Array, Blocks, Speech
from gesticulator.config import Config

_CHUNK = 256
"""Blocks encoded at a time, which bounds the memory for an hour of speech."""


@dataclass(frozen=True)
class Heard:
    """blocks: N of them. low, high: [N, 3K, d + 1] features of the block before, the block and the block after; the
    last column is the logarithm of each block's duration over the longest allowed (time-scaling hides the tempo)."""

    blocks: Blocks
    low: NDArray[np.float32]
    high: NDArray[np.float32]


def front_end_for(config: Config) -> FrontEnd:
    """The audio front end that the settings name."""
    rhythm = config.rhythm
    return FRONT_ENDS[config.front_end.name](
        bands=config.front_end.bands, frames=3 * rhythm.frames,
        samples_per_frame=block_module.samples_per_frame(SAMPLE_RATE, rhythm.fps), sample_rate=SAMPLE_RATE)


def tempo_column(durations: Array, longest: float, frames: int) -> NDArray[np.float32]:
    """[N, 3K, 1]: log(duration / longest) of the block before, the block and the block after, on their rows."""
    logs = np.log(durations / longest)
    padded = np.concatenate([logs[:1], logs, logs[-1:]])
    three = np.stack([padded[:-2], padded[1:-1], padded[2:]], axis=1)
    return np.repeat(three, frames, axis=1)[..., None].astype(np.float32)


def hear(speech: Speech, config: Config, front_end: FrontEnd | None = None) -> Heard:
    """Cut speech (16 kHz) into blocks and encode every window of three."""
    front_end = front_end or front_end_for(config)
    blocks = block_module.cut(speech, config.rhythm)
    reference = reference_level(speech.samples, speech.sample_rate, blocks.edges)
    low: list[NDArray[np.float32]] = []
    high: list[NDArray[np.float32]] = []
    for start in range(0, len(blocks), _CHUNK):
        stop = min(start + _CHUNK, len(blocks))
        first, last = max(start - 1, 0), min(stop + 1, len(blocks))
        part = Blocks(blocks.edges[first:last + 1], blocks.flags[first:last], blocks.silent[first:last],
                      blocks.frames, blocks.fps)
        stretched = block_module.stretch_speech(speech, part)
        windows = block_module.windows_of(stretched)[start - first:stop - first]
        levels = front_end.encode(windows, reference[start:stop])
        low.append(levels.low)
        high.append(levels.high)
    tempo = tempo_column(blocks.durations, config.rhythm.beats.d_max, blocks.frames)
    return Heard(blocks, np.concatenate([np.concatenate(low), tempo], axis=-1),
                 np.concatenate([np.concatenate(high), tempo], axis=-1))
