"""The types that all stages exchange.

Units: seconds, hertz, metres, radians. Y is up, the character faces +Z, its left is +X. Quaternions are w first.
Letters: B batch, N blocks, K frames per block, T frames, J joints, D features, S lexemes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError

__all__ = ["Array", "BeatFlag", "Beats", "Blocks", "Motion", "Samples", "Skeleton", "Speech", "Word"]

Array = NDArray[np.float64]
Samples = NDArray[np.float32]


class BeatFlag(IntEnum):
    """The reason for the position of a beat."""

    BOUNDARY = 0
    """The start or the end of the recording."""
    ONSET = 1
    """An onset of the sound."""
    LOUD_PSEUDO = 2
    """A pseudo-beat on the first frame louder than the noise floor."""
    EVEN_PSEUDO = 3
    """A pseudo-beat at an even interval, where nothing is loud."""


@dataclass(frozen=True)
class Skeleton:
    """A tree of joints in its rest pose. names: J joint names, parents before children, the root first. parents: J
    indices, -1 for the root alone. offsets: [J, 3] metres from the parent, in the parent's frame at rest (all rest
    rotations are the identity). end_sites: joint index -> [3] offset of the tip of that joint's bone, if known."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Array
    end_sites: dict[int, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len({len(self.names), len(self.parents), len(self.offsets)}) != 1:
            raise ValueError("names, parents and offsets differ in length")
        if len(set(self.names)) != len(self.names):
            raise ValueError("two joints share a name")
        if not self.names or self.parents[0] != -1 or any(not 0 <= p < j for j, p in enumerate(self.parents) if j):
            raise ValueError("parents must come before children, with one root first")
        if self.offsets.shape != (len(self.names), 3) or not np.isfinite(self.offsets).all():
            raise ValueError("offsets must be finite, [J, 3]")

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(name) from None

    def same_joints(self, other: Skeleton) -> bool:
        """True when both have the same joints in the same tree (the proportions may differ)."""
        return self.names == other.names and self.parents == other.parents


@dataclass(frozen=True)
class Motion:
    """A motion of a skeleton; frame t is the pose at t / fps seconds.

    rotations: [T, J, 4] local rotations, unit quaternions, w first.
    root_positions: [T, 3] metres.
    absent: names of joints that the source lacks; they have the identity rotation and are masked in losses and metrics.
    filled: names of joints that the source lacks and that have synthetic motion.
    """

    skeleton: Skeleton
    rotations: Array
    root_positions: Array
    fps: float
    absent: tuple[str, ...] = ()
    filled: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        frames = len(self.rotations)
        if self.rotations.shape != (frames, len(self.skeleton), 4) or self.root_positions.shape != (frames, 3):
            raise ValueError(f"rotations {self.rotations.shape} and root positions {self.root_positions.shape} "
                             f"do not fit a skeleton of {len(self.skeleton)} joints")
        if frames == 0:
            raise ValueError("a motion needs at least one frame")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise ValueError(f"fps must be positive, not {self.fps}")
        if not (np.isfinite(self.rotations).all() and np.isfinite(self.root_positions).all()):
            raise ValueError("rotations and positions must be finite")

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def duration(self) -> float:
        return len(self) / self.fps

    def crop(self, start: int, stop: int) -> Motion:
        return replace(self, rotations=self.rotations[start:stop], root_positions=self.root_positions[start:stop])


@dataclass(frozen=True)
class Word:
    """A word as spoken, seconds. An empty text is a silence. marks: names of the gesture marks before it
    (`data_module.text.marks`)."""

    text: str
    start: float
    end: float
    marks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (np.isfinite(self.start) and np.isfinite(self.end) and self.end >= self.start):
            raise ValueError(f"word {self.text!r} has no valid time: {self.start} to {self.end}")


@dataclass(frozen=True)
class Speech:
    """Recorded speech: mono samples in [-1, 1], the words and the speaker if known."""

    samples: Samples
    sample_rate: int
    words: tuple[Word, ...] | None = None
    speaker: str | None = None

    def __post_init__(self) -> None:
        if self.samples.ndim != 1 or self.samples.dtype != np.float32:
            raise ValueError("samples must be mono float32")
        if self.sample_rate <= 0:
            raise ValueError("the sample rate must be positive")
        if len(self.samples) == 0:
            raise InputError("speech", "holds no samples", "give a recording")
        if not np.isfinite(self.samples).all():
            raise InputError("speech", "holds samples that are not numbers (NaN or infinite)", "export it again")

    @property
    def duration(self) -> float:
        return len(self.samples) / self.sample_rate


@dataclass(frozen=True)
class Beats:
    """Beats in seconds, strictly rising, from 0 to the end of the recording, with a flag for each. times: [N + 1];
    flags: [N + 1] of `BeatFlag`."""

    times: Array
    flags: NDArray[np.int8]

    def __post_init__(self) -> None:
        if self.times.ndim != 1 or len(self.times) < 2 or self.times.shape != self.flags.shape:
            raise ValueError("beats need at least two times, and a flag for each")
        if self.times[0] != 0 or (np.diff(self.times) <= 0).any():
            raise ValueError("beats must rise strictly from 0")


@dataclass(frozen=True)
class Blocks:
    """Speech cut at its beats. Block i covers (edges[i], edges[i + 1]]; its last frame lies on the beat. edges: [N + 1]
    seconds; flags: [N] the flag of the beat that closes each block; silent: [N]; frames: K frames per block in
    normalised time; fps: frames per second of normalised time."""

    edges: Array
    flags: NDArray[np.int8]
    silent: NDArray[np.bool_]
    frames: int
    fps: float

    def __post_init__(self) -> None:
        n = len(self.edges) - 1
        if n < 1 or self.flags.shape != (n,) or self.silent.shape != (n,):
            raise ValueError("edges [N + 1], flags [N] and silent [N] do not agree")
        if (np.diff(self.edges) <= 0).any() or self.frames < 2:
            raise ValueError("edges must rise strictly and a block needs at least two frames")

    def __len__(self) -> int:
        return len(self.flags)

    @property
    def durations(self) -> Array:
        """[N] seconds."""
        return np.diff(self.edges)

    @property
    def knot_times(self) -> Array:
        """[N * K] seconds of the normalised frames 1..K of every block, in the recording's own time."""
        return knot_times(self.edges, self.frames)


def knot_times(edges: Array, frames: int) -> Array:
    """`Blocks.knot_times` of blocks with these edges [N + 1] seconds."""
    times = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(1, frames + 1) / frames)
    # Exactly, not by rounding: the last frame of a block lies on its beat.
    times[:, -1] = edges[1:]
    return times.ravel()
