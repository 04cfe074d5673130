"""Encodes the parts of a recording again whose beats were moved; the numbers are those of encoding all of it again.

A block's features depend on the sound of the block and its two neighbours, and on what the cutter knew at its end about
the sound before. So a copy of the first cutter from shortly before an edited part goes on with the edited beats.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from data_module.types import BeatFlag, Samples
from gesticulator.bundle.features import SpeechBlock
from gesticulator.sampling.cutter import CUTTER_EVERY, BlockCutter

Window = tuple[float, float, float, float]
"""Start of the block before, start and end of a block, end of the block after; seconds, the block's own at an end."""
Course = tuple[int, tuple[float, ...]]
"""What the features of a block depend on: the copy of the cutter that goes on, and the edges from there to the end of
the block after. The level of the voice is known block by block, so the edges before the window count, too."""


def window(edges: Sequence[float], at: int) -> Window:
    """The window of block `at` of N blocks with edges [N + 1]."""
    return (edges[max(at - 1, 0)], edges[at], edges[at + 1], edges[min(at + 2, len(edges) - 1)])


class Recutter:
    """Cuts parts of one recording at other beats."""

    def __init__(self, samples: Samples, cutters: Sequence[BlockCutter]) -> None:
        """samples: at 16 kHz; cutters: copies before every `CUTTER_EVERY` of them (`encode_speech`)."""
        self._samples, self._cutters = samples, cutters

    def courses(self, edges: Sequence[float], wanted: Sequence[int]) -> dict[int, Course]:
        """Number -> what the features of each wanted block of N blocks with edges [N + 1], seconds, depend on."""
        index = {edge: at for at, edge in enumerate(edges)}
        courses = {}
        for at in wanted:
            # The edges from the copy on, too: the level of the voice before the window depends on them.
            copy, _ = self._start(edges, at, index)
            courses[at] = copy, tuple(edges[index[self._cutters[copy].uncut[-1]]:at + 3])
        return courses

    def blocks(self, edges: Sequence[float], flags: Sequence[BeatFlag], wanted: Sequence[int]
               ) -> dict[int, SpeechBlock]:
        """Number -> block, for the wanted ones (rising) of N blocks with edges [N + 1], seconds, and the flags [N] of
        the beats at their ends. Each is cut from the last possible copy, whatever else is wanted."""
        index = {edge: at for at, edge in enumerate(edges)}
        blocks: dict[int, SpeechBlock] = {}
        for (copy, number), run in itertools.groupby(wanted, lambda at: self._start(edges, at, index)):
            self._cut(list(zip(edges[1:], flags, strict=True)), list(run), (copy, number), index, blocks)
        return {at: blocks[at] for at in wanted}

    def _cut(self, ends: Sequence[tuple[float, BeatFlag]], wanted: Sequence[int], start: tuple[int, int],
             index: dict[float, int], blocks: dict[int, SpeechBlock]) -> None:
        """Add the wanted blocks. ends: [N] edge and flag at the end of each block; start: see `_start`."""
        at, number = start
        # A copy of the copy, which must serve other edits as well.
        cutter = self._cutters[at].fork()
        cutter.cut_at(list(ends[index[cutter.uncut[-1]]:wanted[-1] + 2]))
        for piece in range(at * CUTTER_EVERY, len(self._samples), CUTTER_EVERY):
            for block in cutter.feed(self._samples[piece:piece + CUTTER_EVERY]):
                blocks[number] = block
                number += 1
            if number > wanted[-1]:
                return
        for block in cutter.finish():
            blocks[number] = block
            number += 1

    def _start(self, edges: Sequence[float], wanted: int, index: dict[float, int]) -> tuple[int, int]:
        """The last copy of the cutter that has cut nothing but these blocks and has not returned the wanted one, and
        the number of the block that it returns next."""
        # From the last copy backwards: the later it is, the less sound is encoded again.
        for at in range(len(self._cutters) - 1, 0, -1):
            cutter = self._cutters[at]
            starts = cutter.uncut
            last = index.get(starts[-1], -1)
            first = last - len(starts) + 1
            if first < 0 or list(edges[first:last + 1]) != starts:
                continue
            number = first + (cutter.returned > 0)
            if number <= wanted:
                return at, number
        return 0, 0
