"""Encodes the parts of a recording again whose beats were moved; the numbers are those of encoding all of it again.

A block's features depend on the sound of the block and its two neighbours, and on what the cutter knew at its end about
the sound before. So a copy of the first cutter from shortly before an edited part goes on with the edited beats.
"""

from __future__ import annotations

from collections.abc import Sequence

from data_module.types import BeatFlag, Samples
from gesticulator.bundle.features import SpeechBlock
from gesticulator.drawing.cutter import CUTTER_EVERY, BlockCutter

Window = tuple[float, float, float, float]
"""Start of the block before, start and end of a block, end of the block after; seconds, the block's own at an end."""
_GAP = 12
"""Blocks between two wanted ones from which on it is faster to start from another copy of the cutter."""


def window(edges: Sequence[float], at: int) -> Window:
    """The window of block `at` of N blocks with edges [N + 1]."""
    return (edges[max(at - 1, 0)], edges[at], edges[at + 1], edges[min(at + 2, len(edges) - 1)])


class Recutter:
    """Cuts parts of one recording at other beats."""

    def __init__(self, samples: Samples, cutters: Sequence[BlockCutter]) -> None:
        """samples: at 16 kHz; cutters: copies before every `CUTTER_EVERY` of them (`encode_speech`)."""
        self._samples, self._cutters = samples, cutters

    def blocks(self, edges: Sequence[float], flags: Sequence[BeatFlag], wanted: Sequence[int]
               ) -> dict[int, SpeechBlock]:
        """Number -> block, for the wanted ones (rising) of N blocks with edges [N + 1], seconds, and the flags [N] of
        the beats at their ends."""
        index = {edge: at for at, edge in enumerate(edges)}
        found: dict[int, SpeechBlock] = {}
        left = list(wanted)
        while left:
            near = next((at for at in range(1, len(left)) if left[at] - left[at - 1] > _GAP), len(left))
            self._cut(edges, flags, left[:near], index, found)
            left = left[near:]
        return {at: found[at] for at in wanted}

    def _cut(self, edges: Sequence[float], flags: Sequence[BeatFlag], wanted: Sequence[int], index: dict[float, int],
             found: dict[int, SpeechBlock]) -> None:
        at, number = self._start(edges, wanted[0], index)
        cutter = self._cutters[at].fork()
        first = index[cutter.uncut[-1]]
        cutter.cut_on_at(list(zip(edges[first + 1:wanted[-1] + 3], flags[first:wanted[-1] + 2], strict=False)))
        for piece in range(at * CUTTER_EVERY, len(self._samples), CUTTER_EVERY):
            for block in cutter.feed(self._samples[piece:piece + CUTTER_EVERY]):
                found[number] = block
                number += 1
            if number > wanted[-1]:
                return
        for block in cutter.finish():
            found[number] = block
            number += 1

    def _start(self, edges: Sequence[float], wanted: int, index: dict[float, int]) -> tuple[int, int]:
        """The last copy of the cutter that has cut nothing but these blocks and has not returned the wanted one, and
        the number of the block that it returns next."""
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
