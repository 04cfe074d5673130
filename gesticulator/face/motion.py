"""The motion of a face: mouth shapes, lids, brows, smile and gaze, whatever the character has to show them with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_module.types import Array
from gesticulator.face.visemes import SILENT, VISEMES, opening


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

    def __post_init__(self) -> None:
        count = len(self.visemes)
        shapes = self.visemes.shape, self.blink.shape, self.brows.shape, self.smile.shape, self.gaze.shape
        if shapes != ((count, len(VISEMES)), (count,), (count,), (count,), (count, 2)):
            raise ValueError(f"{shapes} are not the shapes of one face")
        if not all(np.isfinite(part).all() for part in (self.visemes, self.blink, self.brows, self.smile, self.gaze)):
            raise ValueError("a face needs finite numbers")

    def __len__(self) -> int:
        return len(self.visemes)

    @property
    def times(self) -> Array:
        """[T] seconds."""
        return np.arange(len(self)) / self.fps

    @property
    def opening(self) -> Array:
        """[T] opening of the mouth, 0 to 1."""
        return opening(self.visemes)

    def values(self) -> Array:
        """[T, 20] everything in one table: visemes, blink, brows, smile, and gaze to the left and up."""
        return np.concatenate([self.visemes, self.blink[:, None], self.brows[:, None], self.smile[:, None], self.gaze],
                              axis=1)

    def at(self, times: Array) -> Array:
        """[K, 20] `values` at times [K] in seconds, in proportion between frames; the last frame is held."""
        values = self.values()
        where = np.clip(np.asarray(times) * self.fps, 0.0, len(self) - 1)
        low = np.floor(where).astype(np.int64)
        share = (where - low)[:, None]
        return np.asarray(values[low] * (1.0 - share) + values[np.minimum(low + 1, len(self) - 1)] * share)

    def fitted(self, count: int) -> FaceMotion:
        """The first `count` frames, the last one held where there are fewer."""
        if count == len(self):
            return self
        frames = np.minimum(np.arange(count), len(self) - 1)
        parts = [part[frames] for part in (self.visemes, self.blink, self.brows, self.smile, self.gaze)]
        visemes, blink, brows, smile, gaze = parts
        return FaceMotion(visemes, blink, brows, smile, gaze, self.fps, self.lips_only)

    def __getitem__(self, frames: slice) -> FaceMotion:
        """Some of the frames."""
        return FaceMotion(self.visemes[frames], self.blink[frames], self.brows[frames], self.smile[frames],
                          self.gaze[frames], self.fps, self.lips_only)


def joined(faces: list[FaceMotion]) -> FaceMotion:
    """Successive parts of one face as a whole; at least one."""
    visemes, blink, brows, smile, gaze = (np.concatenate([getattr(face, name) for face in faces])
                                          for name in ("visemes", "blink", "brows", "smile", "gaze"))
    return FaceMotion(visemes, blink, brows, smile, gaze, faces[0].fps, faces[0].lips_only)


def at_rest(count: int, fps: float) -> FaceMotion:
    """A face that does nothing, with a shut mouth."""
    visemes = np.zeros((count, len(VISEMES)))
    visemes[:, SILENT] = 1.0
    return FaceMotion(visemes, np.zeros(count), np.zeros(count), np.zeros(count), np.zeros((count, 2)), fps)
