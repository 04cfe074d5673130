"""The numbers that the models take: speech as blocks of features and normalised poses, with their inverses.

Training and inference use the same functions. `Statistics` is measured once, on the training split, and stored in the
bundle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module import blocks as block_module
from data_module import controls
from data_module.motion.representation import Representation, representation
from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.front_ends import FrontEnd, MelFrontEnd
from data_module.types import Array, BeatFlag, Blocks, Samples
from gesticulator.bundle.config import Config

if TYPE_CHECKING:
    from data_module.speech.speech_encoder_run import SpeechEncoderRunner

CONTROL_WIDTH = 2 * len(controls.FEATURES)
"""2 F: the target of each style feature, and whether it is given."""
LEAST_MOVEMENT = 1e-6
"""Least distance between the bounds of a moving dimension, normalised. The bounds of a still one differ by rounding
errors (1e-27 to 1e-15 were observed), those of a moving one by more than 0.1."""
_LEAST_SPREAD = 1e-4
_CHUNK = 256
"""Blocks encoded at a time, which bounds the memory for an hour of speech."""
Features = NDArray[np.float32]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Normaliser:
    """Zero mean and unit standard deviation per dimension, fitted once and stored with the model.

    mean, spread: [D]. A dimension that never moves has spread 1, so it becomes 0 and is restored exactly.
    """

    mean: Array
    spread: Array

    @classmethod
    def fit(cls, values: NDArray[np.floating]) -> Normaliser:
        """From values [..., D]."""
        # Double precision: sums of millions of rows lose digits in single.
        rows = values.reshape(-1, values.shape[-1])
        if len(rows) == 0:
            raise ValueError("a normaliser needs a row at least")
        mean = rows.mean(axis=0, dtype=np.float64)
        # A dimension that never moves would be divided by rounding errors.
        spread = rows.std(axis=0, dtype=np.float64)
        return cls(mean, np.where(spread > _LEAST_SPREAD, spread, 1.0))

    def apply(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """(x - mean) / spread in the type of `values`, [..., D]."""
        return ((values - self.mean) / self.spread).astype(values.dtype)


@dataclass(frozen=True)
class Statistics:
    """Normalisation of poses and features, measured on the training split.

    speakers: names in order. mean_pose: [speakers, D_m] vectors of the representation; rest_pose: [speakers, D_m] the
    same in silence, or of hanging hands (`silence.rest`). deviation: [D_m]. bounds: [2, D_m] range of the normalised
    training data without one frame in a thousand at either end. low, high: normalisers of the audio features.
    quiet_low, quiet_high: [3K, d] normalised features of settled silence. levels: of the style features that can be
    controlled. A pose becomes (pose - mean_pose[speaker]) / deviation: without each speaker's own mean, lexemes would
    encode speakers.
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
    def present(self) -> Features:
        """[D_m] 1 for dimensions that ever move in training, 0 for joints absent from all sources."""
        return self._moves.astype(np.float32)

    @property
    def _moves(self) -> NDArray[np.bool_]:
        return np.asarray(self.bounds[1] - self.bounds[0] > LEAST_MOVEMENT)

    def normalise(self, poses: Array, speaker: int) -> Array:
        """Vectors [..., D_m] to normalised features, exactly 0 in dimensions that never move."""
        # The mask comes last: rounding must not bring still dimensions to life.
        return (poses - self.mean_pose[speaker]) / self.deviation * self._moves

    def denormalise(self, features: Array, speaker: int) -> Array:
        """The inverse of `normalise`."""
        return features * self.deviation + self.mean_pose[speaker]


def control_rows(levels: controls.Levels, values: Array, given: NDArray[np.bool_]) -> NDArray[np.float32]:
    """[..., 2 F] control inputs from targets in their units [..., F] and which are given [..., F]: standardised, 0 if
    not given."""
    # Zero stands for the mean, so a free feature needs a flag to differ from an average one.
    scaled = (values - levels.mean) / levels.spread * given
    return np.concatenate([scaled, np.broadcast_to(given, scaled.shape)], axis=-1).astype(np.float32)


def representation_of(config: Config) -> Representation:
    """The motion representation of these settings."""
    return representation(config.motion.representation, config.motion.joints)


def body_columns(config: Config) -> dict[str, tuple[int, ...]]:
    """Body part -> its indices in D_m under these settings."""
    from data_module.motion.movement_run import body_parts
    from data_module.motion.skeletons import CHARACTERS

    chosen = representation_of(config)
    if chosen.name != "rotations":
        # Positions of joints belong to no single limb, so all of them are one part.
        return {"body": tuple(range(chosen.width))}
    return body_parts(CHARACTERS[config.motion.joints].names)


@dataclass(frozen=True)
class Sizes:
    """Model dimensions that depend on the data.

    motion: D_m; low, high: widths d + 1 of the two audio levels, including the log duration; two_levels: whether they
    differ; speakers: P; text: d_t + 1, 0 without words; present: [D_m] 1 for dimensions that ever move in training;
    vectors: [S, D_s] the codebook, if there is one; silent: the silent lexemes; training_blocks: number of learned
    style codes, 0 at inference, where the generator has no table of them.
    """

    config: Config
    motion: int
    low: int
    high: int
    two_levels: bool
    speakers: int
    text: int
    present: Features
    vectors: Features | None = None
    silent: tuple[int, ...] = ()
    training_blocks: int = 0

    @property
    def frames(self) -> int:
        """K, frames per block."""
        return self.config.rhythm.frames

    @property
    def lexemes(self) -> Features:
        """[S, D_s] the codebook; ValueError if there is none yet."""
        if self.vectors is None:
            raise ValueError("this model is built over a codebook, and there is none yet")
        return self.vectors

    @property
    def block_audio(self) -> int:
        """Audio width of the reward models: both levels if they differ, the log duration once."""
        return self.low + self.high - 1 if self.two_levels else self.low


# ---------------------------------------------------------------------------------------------------- speech

@dataclass(frozen=True)
class SpeechFeatures:
    """The speech of N blocks. low, high: [N, 3K, d + 1] features of the block before, the block and the block after;
    the last column is the logarithm of each block's duration over the longest allowed (time-scaling hides the tempo).
    text: [N, 3K, d_t + 1] word vectors on the same windows, the last column the flag of the empty word; None for audio
    only. quiet: [N, K] whether each frame lies in a pause; None if silence is known per block only. onsets: of each
    block, [n] seconds from its start to its end, inclusive; None if they were not detected. pitch: [N, K] octaves over
    the voice's mean so far, 0 where it is unvoiced; None if it was not measured."""

    blocks: Blocks
    low: Features
    high: Features
    text: Features | None = None
    quiet: NDArray[np.bool_] | None = None
    onsets: tuple[Array, ...] | None = None
    pitch: Array | None = None

    def __len__(self) -> int:
        return len(self.blocks)

    def block(self, i: int) -> SpeechBlock:
        """Everything known when block i is generated."""
        blocks, count = self.blocks, len(self.blocks)
        # At the ends a block is its own neighbour in durations; its features there are zeros.
        three = (max(i - 1, 0), i, min(i + 1, count - 1))
        before, during, after = (float(blocks.edges[n + 1] - blocks.edges[n]) for n in three)
        was, now, then = (bool(blocks.silent[n]) for n in three)
        # A store knows silence of whole blocks, a cutter that of each frame.
        quiet = [np.full(blocks.frames, blocks.silent[n]) if self.quiet is None else self.quiet[n] for n in three[1:]]
        return SpeechBlock(i, float(blocks.edges[i]), float(blocks.edges[i + 1]), (before, during, after),
                           (was, now, then), self.low[i], self.high[i], None if self.text is None else self.text[i],
                           quiet[0], quiet[1] if i + 1 < count else None, BeatFlag(int(blocks.flags[i])),
                           onsets=np.zeros(0) if self.onsets is None else self.onsets[i],
                           pitch=None if self.pitch is None else self.pitch[i])


@dataclass(frozen=True)
class Span:
    """Silence in a block and the next. start, duration: seconds; quiet: [K] whether each frame is silent; ahead: [K]
    the same for the next block, and its duration in seconds; None at the end."""

    start: float
    duration: float
    quiet: Flags
    ahead: Flags | None = None
    ahead_duration: float = 0.0

    @property
    def times(self) -> Array:
        """[K] times of the block's frames in seconds; the last is its end."""
        count = len(self.quiet)
        return self.start + self.duration * np.arange(1, count + 1) / count


@dataclass(frozen=True)
class SpeechBlock:
    """The speech around a block, as known when it is generated.

    number: from 0. start, end: seconds; flag: of the beat at its end. key: seconds that key its random numbers, or None
    for its start. durations, silent: of the block before, the block and the block after (its own where there is none).
    low, high, text: [3K, d + 1] as in `SpeechFeatures`. quiet: [K] whether each frame lies in a pause; ahead: [K] the
    same for the block after, None at the end. foreseen: the block after is a prediction from its beginning. onsets: [n]
    seconds from its start to its end, inclusive. pitch: [K] octaves over the voice's mean so far, 0 where it is
    unvoiced; None if it was not measured.
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
    key: float | None = None
    pitch: Array | None = None

    @property
    def keyed_at(self) -> float:
        """Seconds that key its random numbers."""
        return self.start if self.key is None else self.key

    @property
    def span(self) -> Span:
        _, duration, after = self.durations
        return Span(self.start, duration, self.quiet, self.ahead, 0.0 if self.ahead is None else after)


def front_end_for(config: Config, encoder: SpeechEncoderRunner | None = None) -> FrontEnd:
    """The audio front end of the settings; encoder: that of the bundle, for "vqwav2vec"."""
    rhythm = config.rhythm
    settings = config.front_end
    mel = MelFrontEnd(settings.bands, 3 * rhythm.frames, block_module.samples_per_frame(SAMPLE_RATE, rhythm.fps),
                      SAMPLE_RATE, robust=settings.robust)
    if settings.name == "mel":
        return mel
    # Imported late, because it needs transformers.
    from data_module.speech.learned_front_ends import front_end

    return front_end(settings.name, mel, encoder=encoder, layers=settings.layers or None)


def tempo_column(durations: Array, longest: float, frames: int) -> Features:
    """[N, 3K, 1]: log(duration / longest) of the block before, the block and the block after, on their rows."""
    # Stretching blocks to one length hides how long they were; this column tells the models.
    logs = np.log(durations / longest)
    # The ends are repeated: beyond them there is no block whose length could be given.
    padded = np.concatenate([logs[:1], logs, logs[-1:]])
    three = np.stack([padded[:-2], padded[1:-1], padded[2:]], axis=1)
    return np.repeat(three, frames, axis=1)[..., None].astype(np.float32)


def three_blocks(rows: NDArray, empty: NDArray) -> NDArray:
    """[N, K, ...] to [N, 3K, ...]: the block before, the block and the block after; `empty` [...] beyond the ends."""
    # The caller says what lies beyond the ends: silence, or the empty word.
    edge = np.broadcast_to(empty, rows[:1].shape).astype(rows.dtype)
    padded = np.concatenate([edge, rows, edge])
    return np.concatenate([padded[:-2], padded[1:-1], padded[2:]], axis=1)


def encode(stretched: Samples, reference: Array, durations: Array, config: Config, front: FrontEnd
           ) -> tuple[Features, Features]:
    """Low and high level [N, 3K, d + 1] of blocks stretched to one length [N, L]; one array for both if they are
    equal."""
    # In chunks: the windows of an hour overlap threefold and would take gigabytes.
    windows = block_module.windows_of(stretched)
    levels = [front.encode(windows[at:at + _CHUNK], reference[at:at + _CHUNK]) for at in range(0, len(windows), _CHUNK)]
    tempo = tempo_column(durations, config.rhythm.beats.d_max, config.rhythm.frames)
    low = np.concatenate([np.concatenate([level.low for level in levels]), tempo], axis=-1)
    # The same array, not a copy: an hour of one level takes half the memory of two.
    if levels[0].low is levels[0].high:
        return low, low
    return low, np.concatenate([np.concatenate([level.high for level in levels]), tempo], axis=-1)
