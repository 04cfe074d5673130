"""Encodes the parts of a recording again whose beats were moved; the numbers are those of encoding all of it again.

A block's features depend on the sound of the block and its two neighbours, and on what the cutter knew at its end about
the sound before. So a copy of the first cutter from shortly before an edited part goes on with the edited beats.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

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
    """Cuts blocks of one recording at other beats, N blocks with edges [N + 1], seconds."""

    def __init__(self, samples: Samples, cutters: Sequence[BlockCutter]) -> None:
        """samples: at 16 kHz; cutters: copies before every `CUTTER_EVERY` of them (`encode_speech`)."""
        self._samples, self._cutters = samples, cutters

    def course(self, edges: Sequence[float], at: int) -> Course:
        """What the features of block `at` depend on."""
        copy, _ = self._start(edges, at)
        return copy, tuple(edges[edges.index(self._cutters[copy].uncut[-1]):at + 3])

    def block(self, edges: Sequence[float], flags: Sequence[BeatFlag], at: int) -> SpeechBlock:
        """Block `at`. flags: [N] of the beats at the ends of the blocks."""
        copy, number = self._start(edges, at)
        # A copy of the copy, which must serve other edits as well.
        cutter = self._cutters[copy].fork()
        cutter.cut_at(list(zip(edges[1:], flags, strict=True))[edges.index(cutter.uncut[-1]):at + 2])

        def blocks() -> Iterator[SpeechBlock]:
            for piece in range(copy * CUTTER_EVERY, len(self._samples), CUTTER_EVERY):
                yield from cutter.feed(self._samples[piece:piece + CUTTER_EVERY])
            yield from cutter.finish()

        return next(islice(blocks(), at - number, None))

    def _start(self, edges: Sequence[float], wanted: int) -> tuple[int, int]:
        """The last copy of the cutter that has cut nothing but these blocks and has not returned the wanted one, and
        the number of the block that it returns next."""
        index = {edge: at for at, edge in enumerate(edges)}
        # From the last copy backwards: the later it is, the less sound is encoded again.
        for at in range(len(self._cutters) - 1, 0, -1):
            starts, returned = self._cutters[at].uncut, self._cutters[at].returned > 0
            last = index.get(starts[-1], -1)
            first = last - len(starts) + 1
            if 0 <= first <= wanted - returned and list(edges[first:last + 1]) == starts:
                return at, first + returned
        return 0, 0
