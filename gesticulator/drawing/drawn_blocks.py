"""Remembers drawn blocks by the content of what was drawn before them and of what was asked for.

Blocks form a tree: a block is drawn from the state after another one, and the same request from the same state gives
the same block. Undo, redo, and edits elsewhere find their blocks there.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from itertools import count

from gesticulator.drawing.driver import BlockRequest, Driver
from gesticulator.sampling.loop import BlockMotion


@dataclass(frozen=True)
class DrawnBlock:
    """A drawn block. number: of this content, unique in its tree; state: after the block; block: None for a beginning
    (a state from which blocks are drawn)."""

    number: int
    state: Driver
    block: BlockMotion | None


class DrawnTree:
    """The tree, which forgets what was not used for the longest time."""

    def __init__(self, most: int) -> None:
        """most: number of blocks that are remembered."""
        self._most = most
        self._known: OrderedDict[Hashable, DrawnBlock] = OrderedDict()
        self._numbers: Iterator[int] = count()

    def new_number(self) -> int:
        """A number that no block of the tree has."""
        return next(self._numbers)

    def beginning(self, key: Hashable, state: Callable[[], Driver]) -> DrawnBlock:
        """A state from which blocks are drawn, made where it is not known."""
        return self._remembered(("beginning", key), lambda: DrawnBlock(self.new_number(), state(), None))

    def drawn(self, before: DrawnBlock, key: Hashable, request: Callable[[], BlockRequest]) -> DrawnBlock:
        """The block drawn after another one. key: everything that the request depends on."""
        def draw() -> DrawnBlock:
            state = before.state.fork()
            block = state.draw(request())
            return DrawnBlock(self.new_number(), state, block)

        return self._remembered((before.number, key), draw)

    def _remembered(self, key: Hashable, make: Callable[[], DrawnBlock]) -> DrawnBlock:
        known = self._known.get(key)
        if known is not None:
            self._known.move_to_end(key)
            return known
        made = self._known[key] = make()
        while len(self._known) > self._most:
            self._known.popitem(last=False)
        return made
