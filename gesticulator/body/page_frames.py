"""The frames of a motion as the page has them: at its rate, as whole numbers, and as many as memory allows."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_module.motion import rotation
from data_module.types import Array

V = TypeVar("V")

BUDGET = 256 << 20
"""Bytes of pieces in memory for the motions of one performer: an hour at 30 frames a second on standing legs takes
50 MB."""
LEAST = 2
"""Motions whose pieces are in memory whatever they take: all pieces are looked up at each edit, those that it changes
with those that they were."""


@dataclass(frozen=True)
class PageFrames:
    """made, fps: frames per second of the motion and of the page; steps: of the int16 per unit; numbers: of the
    contents of pieces."""

    made: float
    fps: float
    steps: int
    numbers: Iterator[int]

    @property
    def ahead(self) -> int:
        """Frames after its last one on which a stretch depends: a frame of the page may lie between two."""
        return 0 if (self.made / self.fps).is_integer() else 1

    def edges(self, edges: Sequence[int]) -> list[int]:
        """Edges between frames of the motion, the last one its end, as edges between those of the page."""
        if self.made == self.fps:
            return list(edges)
        return [*np.searchsorted(self._where(0, self.count(edges[-1])), edges).tolist()]

    def count(self, count: int) -> int:
        """The frames of the page of a motion of `count` frames, as in `kinematics.resample`."""
        if self.made == self.fps:
            return count
        return max(1, int(np.floor((count - 1) * self.fps / self.made + 1e-9)) + 1)

    def turns(self, turns: Array, begin: int, shown: tuple[int, int]) -> Array:
        """The frames (first, last + 1) of the page of rotations [T, J, 4], which begin with frame `begin` of the
        motion: the same bits as those of the whole motion."""
        if self.made == self.fps or not len(turns):
            return turns
        return rotation.interpolate(turns, self._where(*shown) - begin)

    def places(self, places: Array, begin: int, shown: tuple[int, int]) -> Array:
        """As `turns`, of positions [T, 3]."""
        if self.made == self.fps or not len(places):
            return places
        where, numbers = self._where(*shown) - begin, np.arange(len(places))
        return np.stack([np.interp(where, numbers, column) for column in places.T], axis=-1)

    def rounded(self, turns: Array) -> NDArray[np.int16]:
        """Rotations as whole numbers."""
        return np.round(turns * self.steps).astype("<i2")

    def _where(self, first: int, last: int) -> Array:
        """The places of frames of the page among those of the motion."""
        return np.asarray(np.arange(first, last, dtype=np.float64) * self.made / self.fps)


class Recent(Generic[V]):
    """Values by key, of which those used last are in memory: `least` of them, and more as far as they take no more than
    `BUDGET` bytes."""

    def __init__(self) -> None:
        self.least = self._bytes = 0
        self._values: OrderedDict[Hashable, tuple[V, int]] = OrderedDict()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._values

    def __len__(self) -> int:
        return len(self._values)

    def use(self, key: Hashable) -> V | None:
        """The value, if it is in memory, where it stays for longer."""
        if key not in self._values:
            return None
        self._values.move_to_end(key)
        return self._values[key][0]

    def pop(self, key: Hashable) -> V | None:
        """The value, if it is in memory, which it leaves."""
        value, size = self._values.pop(key, (None, 0))
        self._bytes -= size
        return value

    def put(self, key: Hashable, value: V, size: int) -> None:
        """A value of `size` bytes."""
        self.pop(key)
        self._values[key] = value, size
        self._bytes += size
        while self._bytes > BUDGET and len(self._values) > self.least:
            self._bytes -= self._values.popitem(last=False)[1][1]
