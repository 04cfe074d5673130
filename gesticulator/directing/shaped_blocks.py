"""The poses of a plan's blocks with knobs and named gestures applied; each is computed once for what it depends on.

The size of strokes depends on the strokes before, as far back as the arms have not moved on by the length of path in
which a stroke is forgotten: three or four seconds as a rule, 20 at most. Poses that knobs have changed are known by
their content, too: after an edit, many blocks are found to have the poses that they had.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator
from functools import partial

import numpy as np

from data_module.types import Array, Blocks
from gesticulator.bundle.features import Statistics
from gesticulator.directing.directions import ShapeLevels, Shaping
from gesticulator.directing.editing import PlayedBlock
from gesticulator.directing.named_gestures import span_of_gesture
from gesticulator.directing.shaping import CALM, LAG
from gesticulator.directing.strokes import LARGE, REMEMBERED, stroke_age

_LEAST, _EACH = 4000, 6
"""Blocks in memory: at least, and for each block of the recording. A block takes 10 kB."""
_TOGETHER = 8
"""Neighbouring blocks whose poses are computed together, which takes little longer than one of them."""


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

    @property
    def is_made(self) -> bool:
        """Whether the poses are there."""
        return self._make is None

    def learn(self, poses: Array) -> None:
        """Take the poses [K, D_m] as they were computed elsewhere."""
        self._poses, self._make = poses, None

    def made_by(self, make: Callable[[], Array]) -> None:
        """Compute the poses in another way, with the same result."""
        self._make = make


class ShapedBlocks:
    """Makes the poses of the blocks of one performer."""

    def __init__(self, statistics: Statistics, speaker: int, count: int) -> None:
        """count: of the blocks of a recording, about."""
        self._statistics, self._speaker = statistics, speaker
        self._known: OrderedDict[Hashable, ShapedBlock] = OrderedDict()
        self._most = max(_LEAST, _EACH * count)
        self._ways: dict[tuple[int, int], tuple[float, ...]] = {}
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
        run = _Run(shaping)
        since = _Since(cut.edges, lambda number: self._way(run, number))
        for at, block in enumerate(plain):
            run.blocks.append(block)
            named = tuple([one for one in shaping.named(times[at]) if _overlaps(one.cue.gesture, one.time, times[at])])
            if not sized[at] and not turned[at] and not named:
                yield block
                continue
            rows = levels.rows(slice(at * knots, (at + 1) * knots))
            first = since(at) if sized[at] else at
            key = ("shaped", block.number, tuple([one.number for one in run.blocks[first:at]]), _bytes(rows), named)
            shaped = self._remembered(key, times[at], partial(run.shaped, at), by_content=True)
            if not shaped.is_made:
                run.lacking[at] = shaped, first, rows
                shaped.made_by(partial(run.shaped, at))
            yield shaped

    def _way(self, run: _Run, at: int) -> tuple[float, ...]:
        """See `_Run.way`."""
        key = run.blocks[at - 1].number, run.blocks[at].number
        if key not in self._ways:
            if len(self._ways) > self._most:
                self._ways.clear()
            self._ways[key] = run.way(at)
        return self._ways[key]

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


class _Since:
    """Finds the first block on which the size of strokes depends."""

    def __init__(self, edges: Array, way: Callable[[int], tuple[float, ...]]) -> None:
        """edges: [N + 1] seconds of the blocks; way: the number of a block -> radians by which each arm's path becomes
        longer in it."""
        ends, begins = edges[1:], edges[:-1]
        self._ends, self._way = ends.tolist(), way
        # The mean of the lift needs one more knot. The earliest strokes that are asked for are those of the other hand.
        self._calm = (np.searchsorted(ends, begins - CALM) - 1).tolist()
        self._last = (np.searchsorted(ends, begins - LAG) - 1).tolist()
        self._forgotten = (np.searchsorted(ends, begins - REMEMBERED - LAG) - 1).tolist()
        self._begin, self._first, self._paths = 0, 0, list[tuple[float, ...]]()

    def __call__(self, at: int) -> int:
        """The first block that counts for block `at`, of which the last knot counts alone; numbers must rise."""
        last, least = self._last[at], max(self._forgotten[at], 0)
        if last < 0:
            return 0
        if not self._paths or least >= self._begin + len(self._paths):
            way = self._way(least) if least else (0.0, 0.0)
            self._begin, self._first, self._paths = least, least, [tuple([0.0 for _ in way])]
        while self._begin + len(self._paths) <= last:
            more = self._way(self._begin + len(self._paths))
            self._paths.append(tuple([path + each for path, each in zip(self._paths[-1], more, strict=True)]))
        self._first = max(self._first, least)
        while self._first < last and self._is_forgotten(self._first + 1, last):
            self._first += 1
        return max(min(self._first, self._calm[at]), 0)

    def _is_forgotten(self, at: int, last: int) -> bool:
        """Whether strokes up to the end of block `at` are forgotten at the end of block `last`."""
        seconds = self._ends[last] - self._ends[at]
        paths = zip(self._paths[last - self._begin], self._paths[at - self._begin], strict=True)
        return all(stroke_age(now - before, seconds, LARGE) >= 1.0 for now, before in paths)


class _Run:
    """Shapes blocks of one plan. A block that is asked for after one not far before it goes on with the same memory of
    strokes, which is longer then than it has to be, and gives the same numbers."""

    def __init__(self, shaping: Shaping) -> None:
        self._shaping, self._shaper = shaping, shaping.new_shaper()
        self.blocks: list[ShapedBlock] = []
        """The blocks without knobs, as far as they are there."""
        self.lacking: dict[int, tuple[ShapedBlock, int, ShapeLevels]] = {}
        """By number, blocks with knobs whose poses are not known, the first block that counts for them, and their
        levels."""
        self._begin = self._end = 0  # what the shaper has been given

    def way(self, at: int) -> tuple[float, ...]:
        """Radians by which the large strokes of each arm lengthen its path in block `at`, which is not the first."""
        before, block = self.blocks[at - 1], self.blocks[at]
        return self._shaper.ways(before.poses[-1:], block.poses, np.concatenate([before.times[-1:], block.times]))

    def shaped(self, at: int) -> Array:
        """[K, D_m] poses of block `at`; those of the next ones that are lacking are computed with it."""
        last = at
        while last - at < _TOGETHER and last in self.lacking and not self.lacking[last][0].is_made:
            last += 1
        taken = [self.lacking[number] for number in range(at, last)]
        first = min(begin for _, begin, _ in taken)
        if not self._begin <= first <= self._end <= at:
            self._shaper, self._begin, self._end = self._shaping.new_shaper(), first, first
        before, blocks = self.blocks[self._end:at], self.blocks[at:last]
        if before:
            self._shaper.push(*_joined(before))
        self._end = last
        poses, times = _joined(blocks)
        made = self._shaping.shaped(self._shaper, poses, times, ShapeLevels.joined([levels for _, _, levels in taken]),
                                    self._shaping.named(times))
        rows = np.split(made, len(blocks))
        for number, ((block, _, _), part) in enumerate(zip(taken, rows, strict=True), at):
            block.learn(part)
            del self.lacking[number]
        return rows[0]


def _joined(blocks: list[ShapedBlock]) -> tuple[Array, Array]:
    """The poses [M, D_m] and times [M] of blocks."""
    return np.concatenate([one.poses for one in blocks]), np.concatenate([one.times for one in blocks])
