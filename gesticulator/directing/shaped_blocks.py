"""The poses of a plan's blocks with knobs and named gestures applied; each is computed once for what it depends on."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence

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
    """The poses of a block, computed when they are asked for. times: [K] seconds; number: of this content."""

    def __init__(self, number: int, times: Array, make: Callable[[], Array]) -> None:
        self.number, self.times = number, times
        self._make: Callable[[], Array] | None = make
        self._poses: Array | None = None

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
        passed: list[ShapedBlock] = []
        for at, block in enumerate(plain):
            passed.append(block)
            named = tuple([one for one in shaping.named(times[at]) if _overlaps(one.cue.gesture, one.time, times[at])])
            if not sized[at] and not turned[at] and not named:
                yield block
                continue
            rows = levels.rows(slice(at * knots, (at + 1) * knots))
            before = passed[since[at]:at] if sized[at] else []
            key = ("shaped", block.number, tuple([one.number for one in before]), _bytes(rows), named)
            yield self._remembered(key, times[at], _shaped(shaping, before, block, rows, named))

    def _plain(self, played: PlayedBlock) -> Callable[[], Array]:
        return lambda: self._statistics.denormalise(played.motion.astype(np.float64), self._speaker)

    def _remembered(self, key: Hashable, times: Array, make: Callable[[], Array]) -> ShapedBlock:
        known = self._known.get(key)
        if known is not None:
            self._known.move_to_end(key)
            return known
        self._count += 1
        made = self._known[key] = ShapedBlock(self._count, times, make)
        while len(self._known) > self._most:
            self._known.popitem(last=False)
        return made


def _overlaps(gesture: str, time: float, times: Array) -> bool:
    before, after = span_of_gesture(gesture)
    return time - before < float(times[-1]) and time + after > float(times[0])


def _bytes(levels: ShapeLevels) -> tuple[bytes, ...]:
    arms = levels.arms
    return tuple(rows.tobytes() for rows in (arms.intensity, arms.share, arms.both, levels.mirrored))


def _shaped(shaping: Shaping, before: Sequence[ShapedBlock], block: ShapedBlock, levels: ShapeLevels,
            named: Sequence[MeantCue]) -> Callable[[], Array]:
    def make() -> Array:
        shaper = shaping.new_shaper()
        if before:
            shaper.push(np.concatenate([one.poses for one in before]), np.concatenate([one.times for one in before]))
        return shaping.shaped(shaper, block.poses, block.times, levels, named)

    return make
