"""The poses of a plan's blocks with knobs and named gestures applied; each is computed once for what it depends on.

The size of strokes depends on the strokes before, up to 20 seconds back, but mostly on the last few. So poses that were
changed by knobs are known by their content: after an edit, many blocks are found to have the poses that they had.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from data_module.types import Array, Blocks
from gesticulator.bundle.features import Statistics
from gesticulator.directing.directions import MeantCue, ShapeLevels, Shaping
from gesticulator.directing.editing import PlayedBlock
from gesticulator.directing.named_gestures import span_of_gesture
from gesticulator.directing.shaping import LAG
from gesticulator.directing.strokes import REMEMBERED

_LEAST, _EACH = 4000, 6
"""Blocks in memory: at least, and for each block of the recording. A block takes 10 kB."""


class ShapedBlock:
    """The poses of a block, computed when they are asked for. times: [K] seconds."""

    def __init__(self, number: int | None, times: Array, make: Callable[[], Array]) -> None:
        """number: of the content; None for one that is found by computing it."""
        self._number, self.times = number, times
        self._make: Callable[[], Array] | None = make
        self._poses: Array | None = None

    @property
    def is_known(self) -> bool:
        """Whether the number is there without any computing."""
        return self._number is not None

    @property
    def number(self) -> int:
        """The number of this content."""
        if self._number is None:
            content = self.times.tobytes() + self.poses.tobytes()
            self._number = int(hashlib.blake2b(content, digest_size=16).hexdigest(), 16)
        return self._number

    @property
    def poses(self) -> Array:
        """[K, D_m]"""
        if self._poses is None:
            assert self._make is not None
            self._poses, self._make = self._make(), None
        return self._poses


class ShapedBlocks:
    """Makes the poses of the blocks of one performer."""

    def __init__(self, statistics: Statistics, speaker: int, count: int) -> None:
        """count: of the blocks of a recording, about."""
        self._statistics, self._speaker = statistics, speaker
        self._known: OrderedDict[Hashable, ShapedBlock] = OrderedDict()
        self._most = max(_LEAST, _EACH * count)
        self._count = 0

    def blocks(self, played: Iterable[PlayedBlock], cut: Blocks, shaping: Shaping | None) -> Iterator[ShapedBlock]:
        """The poses of N blocks, one after the other. cut: the N blocks; shaping: None to change nothing."""
        times = cut.knot_times.reshape(len(cut), -1)
        edges = cut.edges.tolist()
        plain = (self._remembered((one.number, *edges[at:at + 2]), times[at], self._plain(one))
                 for at, one in enumerate(played))
        if shaping is None:
            yield from plain
            return
        knots = times.shape[1]
        levels = shaping.levels(times.ravel())
        arms = np.zeros(times.size, bool)
        arms[levels.arms.changed] = True
        sized, turned = ([bool(row.any()) for row in each.reshape(times.shape)] for each in (arms, levels.mirrored))
        # One more knot before those that are remembered, from which the first movement goes.
        since = np.maximum(np.searchsorted(cut.edges[1:], cut.edges[:-1] - REMEMBERED - LAG) - 1, 0).tolist()
        run = _Run(shaping)
        for at, block in enumerate(plain):
            run.blocks.append(block)
            named = tuple([one for one in shaping.named(times[at]) if _overlaps(one.cue.gesture, one.time, times[at])])
            if not sized[at] and not turned[at] and not named:
                yield block
                continue
            rows = levels.rows(slice(at * knots, (at + 1) * knots))
            first = since[at] if sized[at] else at
            key = ("shaped", block.number, tuple([one.number for one in run.blocks[first:at]]), _bytes(rows), named)
            yield self._remembered(key, times[at], partial(run.shaped, at, first, rows, named), by_content=True)

    def _plain(self, played: PlayedBlock) -> Callable[[], Array]:
        return lambda: self._statistics.denormalise(played.motion.astype(np.float64), self._speaker)

    def _remembered(self, key: Hashable, times: Array, make: Callable[[], Array], by_content: bool = False
                    ) -> ShapedBlock:
        known = self._known.get(key)
        if known is not None:
            self._known.move_to_end(key)
            return known
        self._count += 1
        made = self._known[key] = ShapedBlock(None if by_content else self._count, times, make)
        while len(self._known) > self._most:
            self._known.popitem(last=False)
        return made


def _overlaps(gesture: str, time: float, times: Array) -> bool:
    before, after = span_of_gesture(gesture)
    return time - before < float(times[-1]) and time + after > float(times[0])


def _bytes(levels: ShapeLevels) -> tuple[bytes, ...]:
    arms = levels.arms
    return tuple(rows.tobytes() for rows in (arms.intensity, arms.share, arms.both, levels.mirrored))


class _Run:
    """Shapes blocks of one plan. A block that is asked for after one not far before it goes on with the same memory of
    strokes, which is longer then than it has to be, and gives the same numbers."""

    def __init__(self, shaping: Shaping) -> None:
        self._shaping, self._shaper = shaping, shaping.new_shaper()
        self.blocks: list[ShapedBlock] = []
        """The blocks without knobs, as far as they are there."""
        self._begin = self._end = 0  # what the shaper has been given

    def shaped(self, at: int, first: int, levels: ShapeLevels, named: Sequence[MeantCue]) -> Array:
        """[K, D_m] poses of block `at` with these levels and gestures; first: the first block that counts for them."""
        if not self._begin <= first <= self._end <= at:
            self._shaper, self._begin, self._end = self._shaping.new_shaper(), first, first
        before, block = self.blocks[self._end:at], self.blocks[at]
        if before:
            self._shaper.push(np.concatenate([one.poses for one in before]),
                              np.concatenate([one.times for one in before]))
        self._end = at + 1
        return self._shaping.shaped(self._shaper, block.poses, block.times, levels, named)
