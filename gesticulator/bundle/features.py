"""What the models see and hear, as numbers: speech in blocks and features, poses normalised, and both ways back.

Training and inference go through the same functions, so both hear the same. `Statistics` is measured once, on the
training split, and travels in the bundle.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module import blocks as block_module
from data_module import controls
from data_module.errors import InputError
from data_module.motion.representation import REPRESENTATIONS, Representation, representation
from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.front_ends import FrontEnd, front_end
from data_module.types import Array, BeatFlag, Blocks, Samples
from gesticulator.bundle.config import Config

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder

CONTROL_WIDTH = 2 * len(controls.FEATURES)
"""2 F: what is asked of each feature, and whether it is asked."""
LEAST_MOVEMENT = 1e-6
"""Normalised units between the bounds of a dimension that moves. One that does not has bounds a rounding error apart
(1e-27 to 1e-15 were met), one that does has more than 0.1."""
_LEAST_SPREAD = 1e-4
_CHUNK = 256
"""Blocks encoded at a time, which bounds the memory for an hour of speech."""
Features = NDArray[np.float32]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Normaliser:
    """Zero mean and unit spread per dimension, fitted once and kept with the model.

    mean, spread: [D]. A dimension that never moves has spread 1, so it becomes 0 and comes back exactly.
    """

    mean: Array
    spread: Array

    @classmethod
    def fit(cls, values: NDArray[np.floating], mask: NDArray[np.bool_] | None = None) -> Normaliser:
        """From values [..., D]; `mask` [...] picks the rows that count."""
        rows = values[mask] if mask is not None else values.reshape(-1, values.shape[-1])
        if len(rows) == 0:
            raise ValueError("a normaliser needs a row at least")
        mean = rows.mean(axis=0, dtype=np.float64)
        spread = rows.std(axis=0, dtype=np.float64)
        return cls(mean, np.where(spread > _LEAST_SPREAD, spread, 1.0))

    def apply(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """(x - mean) / spread in the type of `values`, [..., D]."""
        return ((values - self.mean) / self.spread).astype(values.dtype)

    def invert(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """The inverse of `apply`."""
        return (values * self.spread + self.mean).astype(values.dtype)

    def to_dict(self) -> dict[str, Array]:
        """The arrays to store."""
        return {"mean": self.mean, "spread": self.spread}

    @classmethod
    def from_dict(cls, arrays: Mapping[str, Array]) -> Normaliser:
        """The inverse of `to_dict`; KeyError or ValueError where the arrays are not a normaliser's."""
        mean, spread = (np.asarray(arrays[name], dtype=np.float64) for name in ("mean", "spread"))
        if mean.ndim != 1 or mean.shape != spread.shape or not (spread > 0).all():
            raise ValueError("mean and spread must be [D], spread positive")
        return cls(mean, spread)


@dataclass(frozen=True)
class Statistics:
    """What turns poses and features into numbers near 1, measured on the training split.

    speakers: names in order. mean_pose: [speakers, D_m] vectors of the representation; rest_pose: [speakers, D_m] the
    same in silence. deviation: [D_m]. bounds: [2, D_m] the least and the most of the normalised training data, but for
    one frame in a thousand at either end. low, high: normalisers of the audio features. quiet_low, quiet_high:
    [3K, d] the normalised features of a settled silence. levels: the features of style that can be asked for.
    A pose becomes (pose - mean_pose[speaker]) / deviation: without the speaker's own mean every lexeme would be a
    speaker.
    """

    speakers: tuple[str, ...]
    mean_pose: Array
    rest_pose: Array
    deviation: Array
    bounds: Array
    low: Normaliser
    high: Normaliser
    quiet_low: Array | None = None
    quiet_high: Array | None = None
    levels: controls.Levels | None = None

    @property
    def present(self) -> Tensor:
        """[D_m] 1 where any training motion ever moved, 0 for joints that no source has."""
        return torch.as_tensor(self._moves, dtype=torch.float32)

    @property
    def _moves(self) -> NDArray[np.bool_]:
        moves: NDArray[np.bool_] = self.bounds[1] - self.bounds[0] > LEAST_MOVEMENT
        return moves

    def normalise(self, poses: Array, speaker: int) -> Array:
        """Vectors [..., D_m] to normalised features, exactly 0 in what never moves."""
        return (poses - self.mean_pose[speaker]) / self.deviation * self._moves

    def denormalise(self, features: Array, speaker: int) -> Array:
        """The inverse of `normalise`."""
        return features * self.deviation + self.mean_pose[speaker]


def control_rows(levels: controls.Levels, values: Array, given: NDArray[np.bool_]) -> NDArray[np.float32]:
    """[..., 2 F] of features in their units [..., F] and which are asked for [..., F]: standardised, 0 where free."""
    scaled = (values - levels.mean) / levels.spread * given
    return np.concatenate([scaled, np.broadcast_to(given, scaled.shape)], axis=-1).astype(np.float32)


def representation_of(config: Config) -> Representation:
    """How motion becomes numbers under these settings; InputError for a name that is unknown."""
    name = config.motion.representation
    if name not in REPRESENTATIONS:
        raise InputError("motion.representation", f"is {name!r}", f"choose among {', '.join(REPRESENTATIONS)}")
    return representation(name, config.motion.joints)


# ---------------------------------------------------------------------------------------------------- speech

@dataclass(frozen=True)
class SpeechFeatures:
    """blocks: N of them. low, high: [N, 3K, d + 1] features of the block before, the block and the block after; the
    last column is the logarithm of each block's duration over the longest allowed (time-scaling hides the tempo).
    text: [N, 3K, d_t + 1] word vectors on the same windows, the last column the flag of the empty word; None in the
    audio-only path. quiet: [N, K] whether each frame lies in a pause; None where only whole blocks are known to.
    onsets: of each block, [n] seconds from its start to its end, both included; None where nobody listened for them."""

    blocks: Blocks
    low: Features
    high: Features
    text: Features | None = None
    quiet: NDArray[np.bool_] | None = None
    onsets: tuple[Array, ...] | None = None

    def __len__(self) -> int:
        return len(self.blocks)

    def block(self, i: int) -> SpeechBlock:
        """What is known when block i is drawn."""
        blocks, count = self.blocks, len(self.blocks)
        three = (max(i - 1, 0), i, min(i + 1, count - 1))
        before, own, after = (float(blocks.edges[n + 1] - blocks.edges[n]) for n in three)
        was, now, then = (bool(blocks.silent[n]) for n in three)
        quiet = [np.full(blocks.frames, blocks.silent[n]) if self.quiet is None else self.quiet[n] for n in three[1:]]
        return SpeechBlock(i, float(blocks.edges[i]), float(blocks.edges[i + 1]), (before, own, after),
                           (was, now, then), self.low[i], self.high[i], None if self.text is None else self.text[i],
                           quiet[0], quiet[1] if i + 1 < count else None, BeatFlag(int(blocks.flags[i])),
                           onsets=np.zeros(0) if self.onsets is None else self.onsets[i])


@dataclass(frozen=True)
class Span:
    """What is known of the sound of a block and of the one after it. start, duration: seconds; quiet: [K] whether each
    frame lies in silence; ahead: [K] the same of the next block, and how many seconds it lasts, None at the end."""

    start: float
    duration: float
    quiet: Flags
    ahead: Flags | None = None
    ahead_duration: float = 0.0

    @property
    def times(self) -> Array:
        """[K] seconds of the block's frames; the last lies on its end."""
        count = len(self.quiet)
        return self.start + self.duration * np.arange(1, count + 1) / count


@dataclass(frozen=True)
class SpeechBlock:
    """What is known of the speech of a block when it is drawn; all that a performance needs of it.

    number: from 0. start, end: seconds; flag: of the beat at its end. durations, silent: of the block before, the block
    and the block after (its own where there is none). low, high, text: [3K, d + 1] as in `SpeechFeatures`. quiet: [K]
    whether each frame lies in a pause; ahead: [K] the same of the block after, None where the speech ends. foreseen:
    the block after is what was heard of it when it was not known yet. onsets: [n] seconds from its start to its end,
    both included.
    """

    number: int
    start: float
    end: float
    durations: tuple[float, float, float]
    silent: tuple[bool, bool, bool]
    low: Features
    high: Features
    text: Features | None
    quiet: Flags
    ahead: Flags | None = None
    flag: BeatFlag = BeatFlag.EVEN_PSEUDO
    foreseen: bool = False
    onsets: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def span(self) -> Span:
        """What is known of its silence when it is drawn."""
        _, own, after = self.durations
        if self.ahead is None:
            return Span(self.start, own, self.quiet)
        return Span(self.start, own, self.quiet, self.ahead, after)


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


def word_table(vectors: NDArray[np.floating], width: int) -> Features:
    """[W + 1, d + 1]: row 0 is the empty word (zeros and the flag 1), row w + 1 the vector of word w and the flag 0."""
    table = np.zeros((len(vectors) + 1, width + 1), np.float32)
    table[0, -1] = 1.0
    table[1:, :-1] = vectors
    return table
