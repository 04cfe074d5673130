"""What the models hear of speech: blocks, audio features on three-block windows, and word vectors on their frames.

The same functions serve training and inference, so both hear the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module import blocks as block_module
from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.features import FrontEnd, reference_level
from data_module.speech.front_ends import front_end
from data_module.types import Array, Blocks, Samples, Speech
from gesticulator.config import Config

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder
    from data_module.text.word_vectors import WordEncoder

_CHUNK = 256
"""Blocks encoded at a time, which bounds the memory for an hour of speech."""
Features = NDArray[np.float32]


@dataclass(frozen=True)
class SpeechFeatures:
    """blocks: N of them. low, high: [N, 3K, d + 1] features of the block before, the block and the block after; the
    last column is the logarithm of each block's duration over the longest allowed (time-scaling hides the tempo).
    text: [N, 3K, d_t + 1] word vectors on the same windows, the last column the flag of the empty word; None in the
    audio-only path."""

    blocks: Blocks
    low: Features
    high: Features
    text: Features | None = None


def front_end_for(config: Config, encoder: SpeechEncoder | None = None) -> FrontEnd:
    """The audio front end that the settings name; encoder: the bundle's own, for "vqwav2vec"."""
    rhythm = config.rhythm
    return front_end(
        config.front_end.name, bands=config.front_end.bands, frames=3 * rhythm.frames,
        samples_per_frame=block_module.samples_per_frame(SAMPLE_RATE, rhythm.fps), sample_rate=SAMPLE_RATE,
        encoder=encoder, layers=config.front_end.layers or None)


def tempo_column(durations: Array, longest: float, frames: int) -> Features:
    """[N, 3K, 1]: log(duration / longest) of the block before, the block and the block after, on their rows."""
    logs = np.log(durations / longest)
    padded = np.concatenate([logs[:1], logs, logs[-1:]])
    three = np.stack([padded[:-2], padded[1:-1], padded[2:]], axis=1)
    return np.repeat(three, frames, axis=1)[..., None].astype(np.float32)


def three_blocks(rows: NDArray, empty: NDArray) -> NDArray:
    """[N, K, ...] to [N, 3K, ...]: the block before, the block and the block after; `empty` [...] beyond the ends."""
    edge = np.broadcast_to(empty, rows[:1].shape).astype(rows.dtype)
    padded = np.concatenate([edge, rows, edge])
    return np.concatenate([padded[:-2], padded[1:-1], padded[2:]], axis=1)


def _encoded(parts: Iterator[tuple[slice, Samples]], reference: Array, front: FrontEnd) -> tuple[Features, Features]:
    low, high = [], []
    for part, windows in parts:
        levels = front.encode(windows, reference[part])
        low.append(levels.low)
        high.append(levels.high)
    first = np.concatenate(low)
    return first, first if low[0] is high[0] else np.concatenate(high)


def encode(stretched: Samples, reference: Array, durations: Array, config: Config, front: FrontEnd
           ) -> tuple[Features, Features]:
    """Low and high level [N, 3K, d + 1] of blocks already stretched to one length, [N, L]."""
    windows = block_module.windows_of(stretched)
    parts = ((slice(at, at + _CHUNK), windows[at:at + _CHUNK]) for at in range(0, len(windows), _CHUNK))
    return _with_tempo(*_encoded(parts, reference, front), durations, config)


def _with_tempo(low: Features, high: Features, durations: Array, config: Config) -> tuple[Features, Features]:
    tempo = tempo_column(durations, config.rhythm.beats.d_max, config.rhythm.frames)
    first = np.concatenate([low, tempo], axis=-1)
    return first, first if high is low else np.concatenate([high, tempo], axis=-1)


def _stretched(speech: Speech, blocks: Blocks) -> Iterator[tuple[slice, Samples]]:
    for start in range(0, len(blocks), _CHUNK):
        stop = min(start + _CHUNK, len(blocks))
        first, last = max(start - 1, 0), min(stop + 1, len(blocks))
        part = Blocks(blocks.edges[first:last + 1], blocks.flags[first:last], blocks.silent[first:last],
                      blocks.frames, blocks.fps)
        stretched = block_module.stretch_speech(speech, part)
        yield slice(start, stop), block_module.windows_of(stretched)[start - first:stop - first]


def encode_speech(speech: Speech, config: Config, front: FrontEnd | None = None, words: WordEncoder | None = None
                  ) -> SpeechFeatures:
    """Cut speech (16 kHz) into blocks and encode every window of three; with `words`, the text it carries too."""
    front = front or front_end_for(config)
    blocks = block_module.cut(speech, config.rhythm)
    reference = reference_level(speech.samples, speech.sample_rate, blocks.edges)
    low, high = _with_tempo(*_encoded(_stretched(speech, blocks), reference, front), blocks.durations, config)
    text = None
    if words is not None and speech.words is not None:
        from data_module.text.word_vectors import word_frames  # only where words are read

        table = word_table(words.encode(speech.words), words.width)
        text = table[three_blocks(word_frames(speech.words, blocks, config.text.bridge) + 1, np.zeros(()))]
    return SpeechFeatures(blocks, low, high, text)


def word_table(vectors: NDArray[np.floating], width: int) -> Features:
    """[W + 1, d + 1]: row 0 is the empty word (zeros and the flag 1), row w + 1 the vector of word w and the flag 0."""
    table = np.zeros((len(vectors) + 1, width + 1), np.float32)
    table[0, -1] = 1.0
    table[1:, :-1] = vectors
    return table
