"""Performances whose states are kept, so that edits can start from them (`gesticulator.directing.editing`)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_module.types import Blocks
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import Flags, SpeechBlock, SpeechFeatures
from gesticulator.sampling.cutter import BlockCutter
from gesticulator.sampling.loop import BlockMotion, ControlRows, Request, Scores, Setup, State, begin, motion_of, step
from gesticulator.sampling.noise import Keys


@dataclass(frozen=True)
class Direction:
    """Instructions for one block; see `Request`."""

    lexeme: int | None = None
    keys: Keys | None = None
    still: Flags | None = None
    bias: Scores | None = None
    activity: float | None = None


@dataclass(frozen=True)
class BlockRequest:
    """Everything that the next block depends on, apart from the blocks before it. control: rows [K, 2 F], or None."""

    speech: SpeechBlock
    control: ControlRows | None = None
    direction: Direction = Direction()


@dataclass(frozen=True)
class GeneratedMotion:
    """A recording's N generated blocks and their normalised motion [N, K, D_m], K frames per block. cut: the N blocks
    of its speech."""

    cut: Blocks
    blocks: Sequence[BlockMotion]
    motion: NDArray[np.float32]


@dataclass(frozen=True)
class KeptDrawing:
    """A first generation, or its beginning, kept so that edits can start from it: the speech; the first n of its N
    blocks; the state before each of these and after the last, or no state where nothing is drawn; and the cutter of the
    speech at some times (`BlockCutter.fork`)."""

    encoded: SpeechFeatures
    blocks: Sequence[BlockMotion]
    states: Sequence[Driver]
    cutters: Sequence[BlockCutter] = ()


class Driver:
    """Generates the blocks of one performance in order. state: the present one."""

    def __init__(self, bundle: Bundle, setup: Setup, keys: Keys | None = None, state: State | None = None) -> None:
        """keys: of the noise, if not those of the setup."""
        self._bundle, self._setup, self._keys = bundle, setup, keys
        self.state = begin(bundle, setup, False, keys) if state is None else state

    def begin(self, text: bool = False) -> None:
        """Go back to the start. text: the blocks that follow come with words."""
        self.state = begin(self._bundle, self._setup, text, self._keys)

    def draw(self, request: BlockRequest) -> BlockMotion:
        """The next block."""
        block, self.state = step(self._bundle, self._setup, self.state, Request(
            request.speech, request.control, **vars(request.direction)))
        return block

    def motion(self, blocks: Sequence[BlockMotion]) -> NDArray[np.float32]:
        """[N, K, D_m] motion of all blocks of a performance."""
        return motion_of(self._bundle, self._setup, blocks)

    def fork(self) -> Driver:
        """An independent copy with the same state."""
        return copy.copy(self)

    def stand_as(self, other: Driver) -> None:
        """Take over the pose and the last block from another driver of the same bundle."""
        self.state = _standing(self.state, other.state)


def _standing(state: State, other: State) -> State:
    shown = other.varied or other
    rest = state.rest
    if rest is not None and shown.rest is not None:
        rest = rest.fork()
        rest.stand_as(shown.rest)
    source = other if state.varied is not None else shown
    varied = None if state.varied is None else _standing(state.varied, shown)
    if state.varied is not None and rest is not None and source.rest is not None:
        rest.stand_as(source.rest)
    return replace(state, past=source.past, lexeme=source.lexeme, quiet=source.quiet, generated=source.generated,
                   offset=source.offset, rest=rest, varied=varied)
