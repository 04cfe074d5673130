"""The loop of inference over blocks, the same for a file, a stream and an edited plan (RG 6, Eq. 15; RACER 4.3)."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_module.controls import Controls, Levels
from data_module.types import Array, Blocks
from gesticulator.body.rest import RestKnots
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock, SpeechFeatures, control_rows
from gesticulator.drawing.drawer import FREE, Direction
from gesticulator.drawing.rollout import BlockMotion, CodecRollout, Rollout, Sampling
from interpreters.base import Interpreter

OnBlock = Callable[[int, int], None]
"""Called after each block with the number of finished blocks and the total."""
ControlRows = NDArray[np.float32]
"""[K, 2 F] or [N, K, 2 F]: standardised control features, and whether each is given (`control_rows`)."""


@dataclass(frozen=True)
class Cast:
    """The performer of a recording. speaker: index; activity: share of the speaking time with gestures, 0 to 1; beta:
    of the interpreter, or None."""

    interpreter: Interpreter
    speaker: int
    sampling: Sampling
    activity: float
    controls: Controls
    variation: int = 0
    beta: float | None = None

    @property
    def score_is(self) -> str:
        """The kind of the interpreter's scores."""
        return "Q value" if self.interpreter.gives_values else "log-probability"


@dataclass(frozen=True)
class BlockRequest:
    """Everything that the next block depends on, apart from the blocks before it. control: rows [K, 2 F], or None."""

    speech: SpeechBlock
    control: ControlRows | None = None
    direction: Direction = FREE


@dataclass(frozen=True)
class GeneratedMotion:
    """A recording's N generated blocks and their normalised motion [N, K, D_m], K frames per block. cut: the N blocks
    of its speech."""

    cut: Blocks
    blocks: Sequence[BlockMotion]
    motion: NDArray[np.float32]


def requests(encoded: SpeechFeatures, control: ControlRows | None = None,
             directions: Sequence[Direction] | None = None) -> list[BlockRequest]:
    """A request for each of N blocks. control: [N, K, 2 F], or None; directions: [N], or None for none."""
    return [BlockRequest(encoded.block(i), None if control is None else control[i],
                         FREE if directions is None else directions[i]) for i in range(len(encoded))]


def controls_at(levels: Levels | None, controls: Controls, times: Array) -> ControlRows | None:
    """[K, 2 F] rows of the controls at `times` [K] seconds; None without controls."""
    if levels is None or controls == Controls.free():
        return None
    values, given = controls.at(times)
    return control_rows(levels, values, np.broadcast_to(given, values.shape))


class Driver:
    """Generates the blocks of one performance in order.

    One rollout chooses the lexemes. A variation needs a second one, which samples other motion for the same lexemes;
    the motion of the performance is then that of the second one.
    """

    def __init__(self, bundle: Bundle, cast: Cast) -> None:
        kind = Rollout if bundle.system.BLOCKS else CodecRollout
        variations = (0, cast.variation) if cast.variation else (cast.sampling.variation,)
        self._rollouts = [kind(bundle, cast.interpreter, cast.speaker, replace(cast.sampling, variation=variation),
                               cast.activity) for variation in variations]

    def begin(self, text: bool = False) -> None:
        """Go back to the start. text: the blocks that follow come with words."""
        for rollout in self._rollouts:
            rollout.begin(text)

    def draw(self, request: BlockRequest) -> BlockMotion:
        """The next block."""
        first, *varied = self._rollouts
        block = first.step(request.speech, request.control, request.direction)
        for rollout in varied:
            block = rollout.step(request.speech, request.control, replace(request.direction, lexeme=block.lexeme))
        return block

    def run(self, blocks: Sequence[BlockRequest]) -> list[BlockMotion]:
        """The next blocks, one after the other."""
        return [self.draw(request) for request in blocks]

    def motion(self, blocks: Sequence[BlockMotion]) -> NDArray[np.float32]:
        """[N, K, D_m] motion of all blocks of a performance."""
        return self._rollouts[-1].motion(blocks)

    def fork(self) -> Driver:
        """An independent copy with the same state, to generate the following blocks in another way."""
        twin = copy.copy(self)
        twin._rollouts = [rollout.fork() for rollout in self._rollouts]
        return twin

    def stand_as(self, other: Driver) -> None:
        """Take over the pose and the last block from another driver of the same bundle."""
        alike = len(self._rollouts) == len(other._rollouts)  # with a variation or without one
        sources = other._rollouts if alike else other._rollouts[-1:] * len(self._rollouts)
        for rollout, source in zip(self._rollouts, sources, strict=True):
            rollout.stand_as(source)

    def hurry(self, on: bool) -> None:
        """Generate the following blocks at lower cost, or at full quality again."""
        for rollout in self._rollouts:
            rollout.hurry(on)

    def idle(self, start: float, seconds: float, knots: int) -> NDArray[np.float32]:
        """[k, D_m] frames of rest; see `Rollout.idle`."""
        return [rollout.idle(start, seconds, knots) for rollout in self._rollouts][-1]

    def break_off(self, knots: RestKnots, time: float) -> None:
        """Return to these knots and go to rest from there; see `Rollout.break_off`."""
        for rollout in self._rollouts:
            rollout.break_off(knots, time)

    def knots(self, times: Array) -> RestKnots:
        """The last generated frames, without idle motion, as knots at `times` [M] seconds."""
        rollout = self._rollouts[-1]
        assert rollout.life is not None
        return RestKnots(times, rollout.past[-len(times):], rollout.life.gains)
