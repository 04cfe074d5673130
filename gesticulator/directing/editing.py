"""GeneratedMotion of edited plans: unchanged blocks are replayed, edited ones are generated again.

First every block is generated as before, from the seed and the decisions in the plan. Then each run of edited blocks is
generated again, from the pose and the state before the run. After the run the first motion x(t) continues, with the
difference at the run's end added, which fades out within `BLEND` seconds:

    x(t) + h(s) d + T k(s) v,   s = (t - b) / T,   h = 2 s^3 - 3 s^2 + 1,   k = s^3 - 2 s^2 + s

with d and v the differences in pose and velocity at the run's end b, and T = BLEND. Runs are independent of each other,
so an edit changes nothing elsewhere. Motion is [N, K, D_m], normalised, K frames per block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, BeatFlag, Blocks
from gesticulator.bundle.features import SpeechFeatures
from gesticulator.drawing.drawer import Direction, Keys
from gesticulator.drawing.driver import BlockRequest, Driver, GeneratedMotion, OnBlock, requests
from gesticulator.drawing.rollout import BlockMotion
from gesticulator.plan.plan import GesturePlan, PlanKnobs, edited_blocks

BLEND = 0.6
"""Seconds after an edited run in which the difference fades out: a hand half a metre off returns at 1.3 m/s at most."""
Rows = NDArray[np.float32]


@dataclass(frozen=True)
class Redrawer:
    """The functions that generate the blocks of one recording. drivers: activity -> a new driver; encode: blocks -> the
    features of the speech cut into them; control: features -> rows of the hand controls [N, K, 2 F], or None; bias:
    handedness -> [S], or None."""

    drivers: Callable[[float], Driver]
    encode: Callable[[Blocks], SpeechFeatures]
    control: Callable[[SpeechFeatures], Rows | None]
    bias: Callable[[str | None], NDArray[np.float64] | None]
    frames: int
    fps: float

    def blocks(self, edges: Sequence[float], flags: Sequence[str], silent: Sequence[bool]) -> Blocks:
        """N blocks from their edges [N + 1], seconds, the names of their flags [N], and whether they are silent [N]."""
        by_name = {flag.name.lower(): int(flag) for flag in BeatFlag}
        # A beat that a user added counts as an onset.
        numbers = np.array([by_name.get(name, int(BeatFlag.ONSET)) for name in flags], np.int8)
        return Blocks(np.array(edges), numbers, np.array(silent), self.frames, self.fps)


def still_frames(knobs: PlanKnobs, times: Array, start: float) -> NDArray[np.bool_] | None:
    """[K] whether the knobs require the hands to rest, in the frames at `times` [K] of a block that begins at `start`;
    None if in no frame."""
    ranges = knobs.still_at(start, float(times[-1]))
    return np.any([(times > begin) & (times <= stop) for begin, stop in ranges], axis=0) if ranges else None


class PlanRenderer:
    """Renders plans of one first generation, which runs once; each plan then costs only its edited blocks."""

    def __init__(self, redrawer: Redrawer, plan: GesturePlan, on_block: OnBlock | None = None) -> None:
        """plan: any plan of this generation; its edits are ignored here. on_block: see `Driver.run`."""
        self._redrawer, self._drawn = redrawer, plan.drawn
        # By the number of a block in `draw`; another number is a time of its own.
        self._keys = dict(zip(plan.drawn.numbers or range(len(plan.drawn.lexemes)),
                              plan.drawn.keyed_at or plan.drawn.edges, strict=False))
        self._blocks = redrawer.blocks(plan.drawn.edges, plan.drawn.flags, plan.drawn.silent)
        self._encoded = redrawer.encode(self._blocks)
        self._states, self._first = self._run(plan.drawn.knobs, plan.drawn.lexemes, len(self._blocks), on_block)

    def _run(self, knobs: PlanKnobs, lexemes: Sequence[int | None], count: int, on_block: OnBlock | None = None
             ) -> tuple[list[Driver], list[BlockMotion]]:
        """The state before each of the first `count` blocks, and the blocks."""
        driver = self._redrawer.drivers(knobs.share)
        driver.begin(self._encoded.text is not None)
        bias, times = self._redrawer.bias(knobs.handedness), self._blocks.knot_times.reshape(len(self._blocks), -1)
        directions = [Direction(lexeme, still=still_frames(knobs, knots, float(start)), bias=bias)
                      for lexeme, knots, start in zip(lexemes, times, self._blocks.edges, strict=False)]
        states: list[Driver] = []
        following = requests(self._encoded, self._redrawer.control(self._encoded), directions)[:count]
        following = [replace(request, speech=replace(request.speech, number=number, key=key))
                     for request, (number, key) in zip(following, self._keys.items(), strict=False)]
        return states, driver.run(following, on_block, states)

    @property
    def first(self) -> Sequence[BlockMotion]:
        """The blocks of the first generation."""
        return self._first

    def render(self, plan: GesturePlan) -> GeneratedMotion:
        """The plan's motion. `plan.drawn` must be that of this renderer."""
        if plan.drawn != self._drawn:
            raise ValueError("the plan is of another generation")
        edited = edited_blocks(plan)
        blocks = self._redrawer.blocks([0.0, *(block.end for block in plan.blocks)],
                                       [block.flag for block in plan.blocks], [block.silent for block in plan.blocks])
        if not any(edited):
            encoded = replace(self._encoded, blocks=blocks)
            return GeneratedMotion(encoded, self._first, self._states[0].motion(self._first))
        encoded = self._edited_speech(blocks)
        index = {float(edge): at for at, edge in enumerate(self._blocks.edges)}
        # Edited blocks get a placeholder until their run is generated.
        generated: list[BlockMotion] = [self._first[index[block.start]] if not edited[i] else self._first[0]
                                        for i, block in enumerate(plan.blocks)]
        states = self._states_for(plan, edited, index)
        fades = []
        for begin, stop in runs(edited):
            state = states[index[plan.blocks[begin].start]]
            generated[begin:stop] = self._redrawn(plan, encoded, state, (begin, stop))
            if stop < len(generated):
                end = index[plan.blocks[stop].start]
                fades.append((float(blocks.edges[stop]), *self._difference(generated[stop - 1], blocks, stop, end)))
        return GeneratedMotion(encoded, generated, _faded(self._states[0].motion(generated), blocks, fades))

    def _edited_speech(self, blocks: Blocks) -> SpeechFeatures:
        """The features of the speech in the plan's blocks, encoded again if beats were moved. Frames of a silence that
        the plan removed are not quiet."""
        same = np.array_equal(blocks.edges, self._blocks.edges)
        encoded = replace(self._encoded, blocks=blocks) if same else self._redrawer.encode(blocks)
        if encoded.quiet is None:
            return encoded
        detected = {float(start): bool(silent) for start, silent in
                    zip(self._blocks.edges, self._blocks.silent, strict=False)}
        removed = [detected.get(float(start), False) and not silent
                   for start, silent in zip(blocks.edges, blocks.silent, strict=False)]
        return replace(encoded, quiet=encoded.quiet & ~np.array(removed)[:, None])

    def _states_for(self, plan: GesturePlan, edited: Sequence[bool], index: dict[float, int]) -> list[Driver]:
        """The state before each block of the first generation; if knobs that influence generation were changed, of a
        new one with these knobs, in the poses of the first."""
        if plan.knobs.draws_as(plan.drawn.knobs):
            return self._states
        last = max(index[plan.blocks[begin].start] for begin, _ in runs(edited))
        replayed = {index[block.start]: block.lexeme
                    for block, changed in zip(plan.blocks, edited, strict=True) if not changed}
        states, _ = self._run(plan.knobs, [replayed.get(i) for i in range(len(self._blocks))], last + 1)
        for state, first in zip(states, self._states, strict=False):
            state.stand_as(first)
        return states

    def _redrawn(self, plan: GesturePlan, encoded: SpeechFeatures, state: Driver, run: tuple[int, int]
                 ) -> Iterator[BlockMotion]:
        """The blocks of a run, generated from the state before it."""
        driver, control = state.fork(), self._redrawer.control(encoded)
        bias = self._redrawer.bias(plan.knobs.handedness)
        times = encoded.blocks.knot_times.reshape(len(encoded), -1)
        new_knobs = not plan.knobs.draws_as(plan.drawn.knobs)
        first = {(start, end): (lexeme, silent) for start, end, lexeme, silent in zip(
            plan.drawn.edges, plan.drawn.edges[1:], plan.drawn.lexemes, plan.drawn.silent, strict=False)}
        for i in range(*run):
            block = plan.blocks[i]
            lexeme, silent = first.get((block.start, block.end), (None, False))
            # With new knobs the interpreter chooses again, unless the user set the lexeme or locked the block.
            chosen = None if new_knobs and not block.locked and block.lexeme == lexeme else block.lexeme
            still = None if block.locked else still_frames(plan.knobs, times[i], block.start)
            if block.silent and not silent:
                still = np.ones(encoded.blocks.frames, bool)
            if still is not None and still.mean() >= 0.5:
                chosen = None
            draw = block.draw
            yield driver.draw(BlockRequest(
                replace(encoded.block(i), number=draw.block, key=self._keys.get(draw.block, float(draw.block))),
                None if control is None else control[i],
                Direction(chosen, Keys(draw.seed, draw.variation), still, bias)))

    def _difference(self, last: BlockMotion, blocks: Blocks, stop: int, end: int) -> tuple[Array, Array]:
        """Differences [D_m] in pose and in velocity between the last frame of a run and the first generation at that
        beat. stop, end: index of the block after it, in the plan and in the first generation."""
        now, before = last.motion[-1].astype(np.float64), last.motion[-2].astype(np.float64)
        velocity = (now - before) * blocks.frames / float(blocks.durations[stop - 1])
        first, earlier = (self._first[end - 1].motion[at].astype(np.float64) for at in (-1, -2))
        return now - first, velocity - (first - earlier) * blocks.frames / float(self._blocks.durations[end - 1])


def runs(flags: Sequence[bool]) -> list[tuple[int, int]]:
    """The runs of true flags, as (first, last + 1)."""
    ends = np.flatnonzero(np.diff(np.array([False, *flags, False]))).tolist()
    return list(zip(ends[::2], ends[1::2], strict=True))


def _faded(motion: NDArray[np.float32], blocks: Blocks, fades: Sequence[tuple[float, Array, Array]]
           ) -> NDArray[np.float32]:
    """Motion [N, K, D_m] with the fading differences (time, pose, velocity) added; see the module."""
    out, times = motion.copy(), blocks.knot_times.reshape(motion.shape[:2])
    for begin, pose, velocity in fades:
        near = (times > begin) & (times < begin + BLEND)
        s = ((times[near] - begin) / BLEND)[:, None]
        added = (2 * s**3 - 3 * s**2 + 1) * pose + BLEND * (s**3 - 2 * s**2 + s) * velocity
        out[near] = (out[near] + added).astype(np.float32)
    return out
