"""A plan rendered: what was drawn is replayed, and what was edited is drawn anew in its place.

First every block is drawn as it was, from the seed and the decisions that the plan holds. Then each run of edited
blocks is drawn again, from the place and the state that the body had where the run begins, and what follows is the
first drawing, to which the difference at the run's end is added and fades within `BLEND` seconds:

    x(t) + h(s) d + T k(s) v,   s = (t - b) / T,   h = 2 s^3 - 3 s^2 + 1,   k = s^3 - 2 s^2 + s

with d and v the difference in place and velocity at the run's end b, and T = BLEND. Runs do not know of each other, so
an edit changes nothing elsewhere. Motion is [N, K, D_m], normalised, on the blocks' own clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, BeatFlag, Blocks
from gesticulator.bundle.features import SpeechFeatures
from gesticulator.drawing.drawer import Direction, Keys
from gesticulator.drawing.driver import BlockRequest, Driver, OnBlock, Rendering, requests
from gesticulator.drawing.rollout import BlockMotion
from gesticulator.plan.plan import Block, DrawnBlocks, GesturePlan, PlanKnobs, edited_blocks

BLEND = 0.6
"""Seconds after an edited run in which the motion finds back: a hand half a metre off does so at 1.3 m/s at most."""
Rows = NDArray[np.float32]


@dataclass(frozen=True)
class Redrawer:
    """Draws the blocks of one recording. drivers: activity -> a fresh driver; encode: blocks -> the speech cut into
    them; control: the rows of the hand controls [N, K, 2 F], or None; bias: handedness -> [S] or None."""

    drivers: Callable[[float], Driver]
    encode: Callable[[Blocks], SpeechFeatures]
    control: Callable[[SpeechFeatures], Rows | None]
    bias: Callable[[str | None], NDArray[np.float64] | None]
    frames: int
    fps: float


def still_frames(knobs: PlanKnobs, times: Array, start: float) -> NDArray[np.bool_] | None:
    """[K] the frames at `times` [K] of a block that begins at `start` in which the hands are told to rest; None where
    there are none."""
    ranges = knobs.still_at(start, float(times[-1]))
    return np.any([(times > begin) & (times <= stop) for begin, stop in ranges], axis=0) if ranges else None


def knob_directions(knobs: PlanKnobs, blocks: Blocks, bias: NDArray[np.float64] | None,
                    lexemes: Sequence[int | None]) -> list[Direction]:
    """What the knobs say of each block. bias: [S] of the handedness; lexemes: [N] what must be played."""
    times = blocks.knot_times.reshape(len(blocks), -1)
    return [Direction(lexeme, still=still_frames(knobs, own, float(start)), bias=bias)
            for lexeme, own, start in zip(lexemes, times, blocks.edges, strict=False)]


def drawn_blocks(drawn: DrawnBlocks, frames: int, fps: float) -> Blocks:
    """The blocks of the first drawing."""
    return Blocks(np.array(drawn.edges), _flags(drawn.flags), np.array(drawn.silent), frames, fps)


def planned_blocks(blocks: Sequence[Block], frames: int, fps: float) -> Blocks:
    """The blocks of a plan."""
    return Blocks(np.array([0.0, *(block.end for block in blocks)]), _flags([block.flag for block in blocks]),
                  np.array([block.silent for block in blocks]), frames, fps)


def _flags(names: Sequence[str]) -> NDArray[np.int8]:
    by_name = {flag.name.lower(): int(flag) for flag in BeatFlag}
    # A beat that a user made stands where she heard one.
    return np.array([by_name.get(name, int(BeatFlag.ONSET)) for name in names], np.int8)


class PlanRenderer:
    """Renders plans of one first drawing. That is made once; after it, a plan costs what its edited blocks cost."""

    def __init__(self, redrawer: Redrawer, plan: GesturePlan, on_block: OnBlock | None = None) -> None:
        """plan: any of this drawing; its edits do not matter yet. on_block: see `Driver.run`."""
        self._redrawer, self._drawn = redrawer, plan.drawn
        self._blocks = drawn_blocks(plan.drawn, redrawer.frames, redrawer.fps)
        self._encoded = redrawer.encode(self._blocks)
        self._states, self._first = self._run(plan.drawn.knobs, plan.drawn.lexemes, len(self._blocks), on_block)

    def _run(self, knobs: PlanKnobs, lexemes: Sequence[int | None], count: int, on_block: OnBlock | None = None
             ) -> tuple[list[Driver], list[BlockMotion]]:
        """The state before each of the first `count` blocks, and the blocks."""
        driver = self._redrawer.drivers(knobs.share)
        driver.begin(self._encoded.text is not None)
        directions = knob_directions(knobs, self._blocks, self._redrawer.bias(knobs.handedness), lexemes)
        states, blocks = [], []
        for request in requests(self._encoded, self._redrawer.control(self._encoded), directions)[:count]:
            states.append(driver.fork())
            blocks.append(driver.draw(request))
            if on_block is not None:
                on_block(len(blocks), count)
        return states, blocks

    def render(self, plan: GesturePlan) -> Rendering:
        """The plan's motion. `plan.drawn` must be that of this renderer."""
        if plan.drawn != self._drawn:
            raise ValueError("the plan is of another drawing")
        changed = edited_blocks(plan)
        blocks = planned_blocks(plan.blocks, self._redrawer.frames, self._redrawer.fps)
        if not any(changed):
            encoded = replace(self._encoded, blocks=blocks)
            return Rendering(encoded, self._first, self._states[0].motion(self._first))
        encoded = self._edited_speech(blocks)
        place = {float(edge): at for at, edge in enumerate(self._blocks.edges)}
        drawn: list[BlockMotion] = [self._first[place[block.start]] if not changed[i] else self._first[0]
                                    for i, block in enumerate(plan.blocks)]
        states = self._states_for(plan, changed, place)
        fades = []
        for begin, stop in runs(changed):
            state = states[place[plan.blocks[begin].start]]
            drawn[begin:stop] = self._redrawn(plan, encoded, state, (begin, stop))
            if stop < len(drawn):
                end = place[plan.blocks[stop].start]
                fades.append((float(blocks.edges[stop]), *self._difference(drawn[stop - 1], blocks, stop, end)))
        return Rendering(encoded, drawn, _faded(self._states[0].motion(drawn), blocks, fades))

    def _edited_speech(self, blocks: Blocks) -> SpeechFeatures:
        """The speech in the plan's blocks: as it was encoded, or anew where beats were moved. A silence that was taken
        back is none."""
        same = np.array_equal(blocks.edges, self._blocks.edges)
        encoded = replace(self._encoded, blocks=blocks) if same else self._redrawer.encode(blocks)
        if encoded.quiet is None:
            return encoded
        found = {float(start): bool(silent) for start, silent in
                 zip(self._blocks.edges, self._blocks.silent, strict=False)}
        woken = [found.get(float(start), False) and not silent
                 for start, silent in zip(blocks.edges, blocks.silent, strict=False)]
        return replace(encoded, quiet=encoded.quiet & ~np.array(woken)[:, None])

    def _states_for(self, plan: GesturePlan, changed: Sequence[bool], place: dict[float, int]) -> list[Driver]:
        """The state before each block: of the first drawing, or, where knobs were turned that change the drawing, of
        one with the new knobs that stands where the first one stood."""
        if plan.knobs.draws_as(plan.drawn.knobs):
            return self._states
        last = max(place[plan.blocks[begin].start] for begin, _ in runs(changed))
        kept = {place[block.start]: block.lexeme for block, anew in zip(plan.blocks, changed, strict=True) if not anew}
        states, _ = self._run(plan.knobs, [kept.get(i) for i in range(len(self._blocks))], last + 1)
        for state, first in zip(states, self._states, strict=False):
            state.stand_as(first)
        return states

    def _redrawn(self, plan: GesturePlan, encoded: SpeechFeatures, state: Driver, run: tuple[int, int]
                 ) -> Iterator[BlockMotion]:
        """The blocks of a run, drawn from the state before it."""
        driver, control = state.fork(), self._redrawer.control(encoded)
        bias = self._redrawer.bias(plan.knobs.handedness)
        times = encoded.blocks.knot_times.reshape(len(encoded), -1)
        turned = not plan.knobs.draws_as(plan.drawn.knobs)
        first = {(start, end): (lexeme, silent) for start, end, lexeme, silent in zip(
            plan.drawn.edges, plan.drawn.edges[1:], plan.drawn.lexemes, plan.drawn.silent, strict=False)}
        for i in range(*run):
            block = plan.blocks[i]
            lexeme, silent = first.get((block.start, block.end), (None, False))
            # A lexeme that nobody chose is chosen anew where knobs were turned.
            chosen = None if turned and not block.locked and block.lexeme == lexeme else block.lexeme
            still = None if block.locked else still_frames(plan.knobs, times[i], block.start)
            if block.silent and not silent:
                still = np.ones(encoded.blocks.frames, bool)
            if still is not None and still.mean() >= 0.5:
                chosen = None
            draw = block.draw
            yield driver.draw(BlockRequest(
                replace(encoded.block(i), number=draw.block), None if control is None else control[i],
                Direction(chosen, Keys(draw.seed, draw.variation), still, bias)))

    def _difference(self, last: BlockMotion, blocks: Blocks, stop: int, end: int) -> tuple[Array, Array]:
        """[D_m] of place and of velocity, between the last frame of a run and the first drawing at that beat. stop,
        end: the block that follows, in the plan and in the first drawing."""
        now, before = last.motion[-1].astype(np.float64), last.motion[-2].astype(np.float64)
        speed = (now - before) * blocks.frames / float(blocks.durations[stop - 1])
        was, earlier = (self._first[end - 1].motion[at].astype(np.float64) for at in (-1, -2))
        return now - was, speed - (was - earlier) * blocks.frames / float(self._blocks.durations[end - 1])


def runs(flags: Sequence[bool]) -> list[tuple[int, int]]:
    """The runs of true flags, each from its first to behind its last."""
    ends = np.flatnonzero(np.diff(np.array([False, *flags, False]))).tolist()
    return list(zip(ends[::2], ends[1::2], strict=True))


def _faded(motion: NDArray[np.float32], blocks: Blocks, fades: Sequence[tuple[float, Array, Array]]
           ) -> NDArray[np.float32]:
    """Motion [N, K, D_m] with each difference (from, place, velocity) added, where it fades."""
    out, times = motion.copy(), blocks.knot_times.reshape(motion.shape[:2])
    for begin, place, velocity in fades:
        near = (times > begin) & (times < begin + BLEND)
        s = ((times[near] - begin) / BLEND)[:, None]
        added = (2 * s**3 - 3 * s**2 + 1) * place + BLEND * (s**3 - 2 * s**2 + s) * velocity
        out[near] = (out[near] + added).astype(np.float32)
    return out
