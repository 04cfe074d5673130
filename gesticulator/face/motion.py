"""The motion of a face: mouth shapes, lids, brows, smile and gaze, whatever the character has to show them with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array

_PARTS = ("visemes", "blink", "brows", "smile", "gaze")
"""Fields over time, in the order of `FaceMotion.values`."""


@dataclass(frozen=True)
class FaceMotion:
    """A face over T frames; frame t is the face at t / fps seconds.

    visemes: [T, 15] weights of `visemes.VISEMES`, 0 to 1; what is missing to 1 is the mouth at rest. blink:
    [T] how far the lids are shut, 0 to 1. brows: [T] how far they are raised, -1 (drawn together) to 1. smile: [T] -1
    (the corners of the mouth down) to 1. gaze: [T, 2] direction of the eyes in the head, radians: to the character's
    left, and up. lips_only: the face has no blinks, brows, smile or gaze, and what a character has for them is left
    alone.
    """

    visemes: Array
    blink: Array
    brows: Array
    smile: Array
    gaze: Array
    fps: float
    lips_only: bool = False

    def __len__(self) -> int:
        return len(self.visemes)

    @property
    def times(self) -> Array:
        """[T] seconds."""
        return np.arange(len(self)) / self.fps

    def values(self) -> Array:
        """[T, 20] everything in one table: visemes, blink, brows, smile, and gaze to the left and up."""
        return np.column_stack([getattr(self, name) for name in _PARTS])

    def at(self, times: Array) -> Array:
        """[K, 20] `values` at times [K] in seconds, in proportion between frames; the last frame is held."""
        values = self.values()
        # Later times hold the last frame, as the motion of the body does.
        where = np.clip(np.asarray(times) * self.fps, 0.0, len(self) - 1)
        low = np.floor(where).astype(np.int64)
        share = (where - low)[:, None]
        return np.asarray(values[low] * (1.0 - share) + values[np.minimum(low + 1, len(self) - 1)] * share)

    def fitted(self, count: int) -> FaceMotion:
        """The first `count` frames, the last one held where there are fewer."""
        return self if count == len(self) else self[np.minimum(np.arange(count), len(self) - 1)]

    def __getitem__(self, frames: slice | NDArray[np.int64]) -> FaceMotion:
        """Some of the frames."""
        parts: dict[str, Any] = {name: getattr(self, name)[frames] for name in _PARTS}
        return replace(self, **parts)


def joined(faces: Sequence[FaceMotion]) -> FaceMotion:
    """Successive parts of a face as a whole; at least one part."""
    parts: dict[str, Any] = {name: np.concatenate([getattr(face, name) for face in faces]) for name in _PARTS}
    return replace(faces[0], **parts)
