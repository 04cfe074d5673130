"""Motion of edited plans: unchanged blocks are replayed, edited ones are generated again.

Every block has a source. With the knobs of the first generation, unedited blocks are replayed from it. Where knobs were
changed that influence generation (activity and its curve, handedness), the recording is generated again with the new
ones, from the seed and without edits, and unedited blocks are those of this generation; locked blocks are still those
of the first. Each run of edited blocks is generated from the pose and the state before it. Where a source takes over
from another one, its motion x(t) continues with the difference at that beat b added, which fades out within `BLEND`
seconds:

    x(t) + h(s) d + T k(s) v,   s = (t - b) / T,   h = 2 s^3 - 3 s^2 + 1,   k = s^3 - 2 s^2 + s

with d and v the differences in pose and velocity at the beat, and T = BLEND. Runs are independent of each other, so an
edit changes nothing elsewhere, and costs only its run. Motion is [N, K, D_m], normalised, K frames per block.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, BeatFlag, Blocks
from gesticulator.bundle.features import SpeechBlock, SpeechFeatures
from gesticulator.drawing.cutter import BlockCutter
from gesticulator.drawing.drawer import Direction, Keys
from gesticulator.drawing.drawn_blocks import DrawnBlock, DrawnTree
from gesticulator.drawing.driver import BlockRequest, Driver, GeneratedMotion, KeptDrawing, OnBlock, requests
from gesticulator.drawing.recut import Recutter, window
from gesticulator.drawing.rollout import BlockMotion
from gesticulator.plan.plan import Block, GenerationKnobs, GesturePlan, PlanKnobs, edited_blocks, edited_themselves

BLEND = 0.6
"""Seconds after an edited run in which the difference fades out: a hand half a metre off returns at 1.3 m/s at most."""
LEAST_REMEMBERED, REMEMBERED = 2000, 4
"""Drawn blocks in memory: at least, and for each block of the recording."""
WARMS_UP = 3
"""Blocks before a stretch that are drawn for a draft of it, and not shown."""
_VARYING = 0.5
"""The activity with which a driver begins whose blocks are each given their own: between none and all, so that it
hears the gate. It does not depend on the curve, so that what comes before a change of the curve is not drawn again."""
Rows = NDArray[np.float32]


@dataclass(frozen=True)
class Redrawer:
    """The functions that generate the blocks of one recording. drivers: activity -> a new driver; encode: blocks -> the
    features of the speech cut into them, and copies of the cutter; recutter: such copies -> the recutter of the speech;
    control: times [K] seconds -> rows of the hand controls [K, 2 F], or None; bias: handedness -> [S], or None."""

    drivers: Callable[[float], Driver]
    encode: Callable[[Blocks, list[BlockCutter]], SpeechFeatures]
    recutter: Callable[[Sequence[BlockCutter]], Recutter]
    control: Callable[[Array], Rows | None]
    bias: Callable[[str | None], NDArray[np.float64] | None]
    frames: int
    fps: float

    def blocks(self, edges: Sequence[float], flags: Sequence[str], silent: Sequence[bool]) -> Blocks:
        """N blocks from their edges [N + 1], seconds, the names of their flags [N], and whether they are silent [N]."""
        return Blocks(np.array(edges), np.array(flag_numbers(flags), np.int8), np.array(silent), self.frames, self.fps)


def flag_numbers(flags: Sequence[str]) -> list[BeatFlag]:
    """The flags of these names. A beat that a user added counts as an onset."""
    by_name = {flag.name.lower(): flag for flag in BeatFlag}
    return [by_name.get(name, BeatFlag.ONSET) for name in flags]


def still_frames(knobs: PlanKnobs, times: Array, start: float) -> NDArray[np.bool_] | None:
    """[K] whether the knobs require the hands to rest, in the frames at `times` [K] of a block that begins at `start`;
    None if in no frame."""
    ranges = knobs.still_at(start, float(times[-1]))
    return np.any([(times > begin) & (times <= stop) for begin, stop in ranges], axis=0) if ranges else None


@dataclass(frozen=True)
class PlayedBlock:
    """A block of a plan as it is played. motion: [K, D_m] with the fading differences; number: of this content, equal
    for equal motion."""

    block: BlockMotion
    motion: Rows
    number: int


@dataclass(frozen=True)
class _Source:
    """Where a block of a plan comes from. number: of its content; duration: seconds; after: gives the state after it,
    with a number."""

    block: BlockMotion
    number: int
    duration: float
    after: Callable[[], DrawnBlock]


@dataclass(frozen=True)
class Fade:
    """A difference that fades out from `begin`, seconds. pose, velocity: [D_m]; key: of its content."""

    begin: float
    pose: Array
    velocity: Array
    key: Hashable


@dataclass(frozen=True)
class _Generation:
    """All blocks of the recording in one generation. before: the state before each of them; numbers: of their
    contents."""

    kind: str
    before: Sequence[DrawnBlock]
    blocks: Sequence[BlockMotion]
    numbers: Sequence[int]


class PlanRenderer:
    """Renders plans of one first generation; each plan then costs only its edited blocks."""

    def __init__(self, redrawer: Redrawer, plan: GesturePlan, on_block: OnBlock | None = None,
                 drawing: KeptDrawing | None = None) -> None:
        """plan: any plan of this generation; its edits are ignored here. on_block: see `Driver.run`. drawing: the first
        generation, if it was kept; it is made here otherwise."""
        self._redrawer, self._drawn = redrawer, plan.drawn
        self._seed = plan.seed, plan.variation
        # By the number of a block in `draw`; another number is a time of its own.
        self._keys = dict(zip(plan.drawn.numbers or range(len(plan.drawn.lexemes)),
                              plan.drawn.keyed_at or plan.drawn.edges, strict=False))
        self._cut = redrawer.blocks(plan.drawn.edges, plan.drawn.flags, plan.drawn.silent)
        self._edges, self._manner = plan.drawn.edges, plan.drawn_manner
        self._index = {edge: at for at, edge in enumerate(self._edges)}
        self.drawing = drawing or self._draw(on_block)
        self._encoded = self.drawing.encoded
        count = len(self._cut)
        self._tree = DrawnTree(max(LEAST_REMEMBERED, REMEMBERED * count))
        numbers = [self._tree.new_number() for _ in range(count + 1)]
        self._first = _Generation("first", [DrawnBlock(number, state, None) for number, state in zip(
            numbers, self.drawing.states, strict=False)], self.drawing.blocks, numbers[1:])
        self._windows: dict[Hashable, int] = {window(self._edges, at): at for at in range(count)}
        self._complete: set[GenerationKnobs] = set()
        self._recut: dict[Hashable, SpeechBlock] = {}
        self._faded: dict[Hashable, tuple[int, Rows]] = {}

    def _draw(self, on_block: OnBlock | None) -> KeptDrawing:
        """The first generation, from the decisions in the plan."""
        drawn, knobs, cutters = self._drawn, self._drawn.knobs, list[BlockCutter]()
        encoded = self._redrawer.encode(self._cut, cutters)
        driver = self._redrawer.drivers(knobs.share)
        driver.begin(encoded.text is not None)
        bias, times = self._redrawer.bias(knobs.handedness), self._cut.knot_times.reshape(len(self._cut), -1)
        directions = [Direction(lexeme, still=still_frames(knobs, knots, float(start)), bias=bias)
                      for lexeme, knots, start in zip(drawn.lexemes, times, self._cut.edges, strict=False)]
        rows = [self._redrawer.control(knots) for knots in times]
        control = None if rows[0] is None else np.stack([row for row in rows if row is not None])
        following = [replace(request, speech=replace(request.speech, number=number, key=key)) for request, (number, key)
                     in zip(requests(encoded, control, directions), self._keys.items(), strict=False)]
        states: list[Driver] = []
        return KeptDrawing(encoded, driver.run(following, on_block, states), states, cutters)

    @property
    def first(self) -> Sequence[BlockMotion]:
        """The blocks of the first generation."""
        return self.drawing.blocks

    @cached_property
    def _recutter(self) -> Recutter:
        cutters: Sequence[BlockCutter] = self.drawing.cutters
        if not cutters:
            cutters = list[BlockCutter]()
            self._redrawer.encode(self._cut, cutters)
        return self._redrawer.recutter(cutters)

    def render(self, plan: GesturePlan) -> GeneratedMotion:
        """The plan's motion. `plan.drawn` must be that of this renderer."""
        blocks = self.cut(plan)
        if not any(edited_blocks(plan)):
            first = self.drawing.blocks
            return GeneratedMotion(blocks, first, self.drawing.states[0].motion(first))
        played = self.played(plan)
        return GeneratedMotion(blocks, [one.block for one in played], np.stack([one.motion for one in played]))

    def cut(self, plan: GesturePlan) -> Blocks:
        """The blocks of a plan."""
        return self._redrawer.blocks([0.0, *(block.end for block in plan.blocks)],
                                     [block.flag for block in plan.blocks], [block.silent for block in plan.blocks])

    def played(self, plan: GesturePlan, on_block: OnBlock | None = None) -> list[PlayedBlock]:
        """The blocks of a plan as they are played. on_block: see `Driver.run`; it may raise an error to abandon the
        rendering: what was drawn until then is remembered."""
        if plan.drawn != self._drawn:
            raise ValueError("the plan is of another generation")
        return _PlanRun(self, plan, on_block).played()

    # ------------------------------------------------------------------------------------------ what runs are made of

    def generation(self, manner: GenerationKnobs, on_block: OnBlock | None = None, count: int | None = None
                   ) -> _Generation:
        """The recording, or its first `count` blocks, generated in a manner, without edits: the first generation where
        it is that of the first."""
        if manner == self._manner:
            return self._first
        count = len(self._cut) if count is None else count
        begins = _begins(manner), manner.handedness
        steps = [self._tree.beginning(begins, lambda: self._begun(manner))]
        for at in range(count):
            key = "knobs", at, _activity(manner, self._edges[at])
            steps.append(self._tree.drawn(steps[-1], key, partial(self._with_manner, manner, at)))
            if on_block is not None:
                on_block(at + 1, count)
        if count == len(self._cut):
            self._complete.add(manner)
        blocks = [step.block for step in steps[1:] if step.block is not None]
        return _Generation("knobs", steps[:-1], blocks, [step.number for step in steps[1:]])

    def knows(self, manner: GenerationKnobs) -> bool:
        """Whether the whole recording has been generated in this manner, and most of it is remembered."""
        return manner in self._complete

    def _begun(self, manner: GenerationKnobs) -> Driver:
        driver = self._redrawer.drivers(_begins(manner))
        driver.begin(self._encoded.text is not None)
        return driver

    def _with_manner(self, manner: GenerationKnobs, at: int) -> BlockRequest:
        """The request for a block of the first generation in another manner."""
        number = self._drawn.numbers[at] if self._drawn.numbers else at
        times = self._cut.knot_times.reshape(len(self._cut), -1)[at]
        still = still_frames(self._drawn.knobs, times, float(self._cut.edges[at]))
        # Under a curve, as in the first generation, which it is as long as the curve does not matter.
        keys = None if manner.curves else Keys(*self._seed)
        return BlockRequest(replace(self._encoded.block(at), number=number, key=self._keys[number]),
                            self._redrawer.control(times),
                            Direction(None, keys, still, self._redrawer.bias(manner.handedness),
                                      _activity(manner, self._edges[at])))

    def draft(self, manner: GenerationKnobs, view: tuple[float, float]) -> tuple[Blocks, list[PlayedBlock], list[int]]:
        """The first generation, with the blocks of a stretch (seconds) roughly as they will be in another manner; its
        blocks, and which of them. The models begin anew shortly before the stretch, in the pose that is there."""
        first = max(int(np.searchsorted(self._cut.edges[1:], view[0])) - WARMS_UP, 0)
        last = min(int(np.searchsorted(self._cut.edges[:-1], view[1])), len(self._cut))
        driver = self._begun(manner)
        driver.stand_as(self.drawing.states[first])
        played = [PlayedBlock(block, block.motion, number) for block, number in
                  zip(self.drawing.blocks, self._first.numbers, strict=True)]
        for at in range(first, last):
            block = driver.draw(self._with_manner(manner, at))
            played[at] = PlayedBlock(block, block.motion, self._tree.new_number())
        return self._cut, played, list(range(min(first + WARMS_UP, max(last - 1, first)), last))

    def speech(self, edges: Sequence[float], flags: Sequence[BeatFlag], wanted: Sequence[int]
               ) -> dict[int, tuple[Hashable, SpeechBlock]]:
        """Number -> speech of the wanted blocks (rising) of N blocks with edges [N + 1] and flags [N], and what its
        numbers depend on."""
        places: dict[int, Hashable] = {at: window(edges, at) for at in wanted}
        moved = [at for at, place in places.items() if place not in self._windows]
        if len(self._recut) > max(LEAST_REMEMBERED, REMEMBERED * len(self._cut)):
            self._recut.clear()
        if moved:
            courses = self._recutter.courses(edges, moved)
            places |= courses
            lacking = [at for at in moved if courses[at] not in self._recut]
            self._recut |= {courses[at]: block
                            for at, block in self._recutter.blocks(edges, flags, lacking).items()}
        return {at: (place, self._recut[place] if place in self._recut else self._encoded.block(self._windows[place]))
                for at, place in places.items()}

    @property
    def index(self) -> dict[float, int]:
        """Beat of the first generation, seconds -> number of the block that begins there."""
        return self._index

    def key_of(self, number: int) -> float:
        """Seconds that key the random numbers of the block with this number in its `draw`."""
        return self._keys.get(number, float(number))

    def bias(self, hand: str | None) -> NDArray[np.float64] | None:
        """[S] what a handedness adds to the scores of lexemes; None without one."""
        return self._redrawer.bias(hand)

    def request(self, speech: SpeechBlock, times: Array, direction: Direction) -> BlockRequest:
        """The request for a block with frames at `times` [K]."""
        return BlockRequest(speech, self._redrawer.control(times), direction)

    def drawn(self, before: DrawnBlock, key: Hashable, request: Callable[[], BlockRequest]) -> DrawnBlock:
        """See `DrawnTree.drawn`."""
        return self._tree.drawn(before, key, request)

    def standing(self, state: DrawnBlock, other: DrawnBlock) -> DrawnBlock:
        """A state in the pose of another one."""
        def stand() -> Driver:
            driver = state.state.fork()
            driver.stand_as(other.state)
            return driver

        return self._tree.beginning(("standing", state.number, other.number), stand)

    def duration(self, at: int) -> float:
        """Seconds of a block of the first generation."""
        return float(self._cut.durations[at])

    def faded(self, source: _Source, fades: tuple[Fade, ...], times: Array) -> tuple[int, Rows]:
        """The number and the motion [K, D_m] of a block at `times` [K] with fading differences."""
        if not fades:
            return source.number, source.block.motion
        key = source.number, tuple(fade.key for fade in fades), times.tobytes()
        if key not in self._faded:
            if len(self._faded) > LEAST_REMEMBERED:
                self._faded.clear()
            self._faded[key] = self._tree.new_number(), _faded(source.block.motion, times, fades)
        return self._faded[key]


class _PlanRun:
    """One rendering of one plan."""

    def __init__(self, renderer: PlanRenderer, plan: GesturePlan, on_block: OnBlock | None) -> None:
        self._renderer, self._plan, self._on_block = renderer, plan, on_block
        self._manner = plan.manner
        self._alike = self._manner == plan.drawn_manner
        self._edges = [0.0, *(block.end for block in plan.blocks)]
        self._flags = flag_numbers([block.flag for block in plan.blocks])
        self._edited = edited_themselves(plan)
        self._speech = renderer.speech(self._edges, self._flags, np.flatnonzero(self._edited).tolist())
        drawn = plan.drawn
        pairs = list(zip(drawn.edges, drawn.edges[1:], strict=False))
        self._decided = dict(zip(pairs, zip(drawn.lexemes, drawn.silent, strict=True), strict=True))
        quiet = dict(zip(drawn.edges, drawn.silent, strict=False))
        # Frames of a silence that the plan removed are not quiet.
        self._removed = [quiet.get(block.start, False) and not block.silent for block in plan.blocks]
        self._first = renderer.generation(plan.drawn_manner)
        self._changed = self._first if self._alike or not self._needs_knobs() else \
            renderer.generation(self._manner, on_block)

    def _needs_knobs(self) -> bool:
        return any(not block.locked for block in self._plan.blocks)

    def played(self) -> list[PlayedBlock]:
        blocks, fades = self._plan.blocks, list[Fade]()
        times = self._renderer.cut(self._plan).knot_times.reshape(len(blocks), -1)
        sources: list[_Source] = []
        out: list[PlayedBlock] = []
        for at, block in enumerate(blocks):
            fades = [fade for fade in fades if fade.begin + BLEND > block.start]
            if self._edited[at]:
                source = self._run(at, sources[-1] if sources else None, times[at])
            else:
                source, fade = self._replayed(block, sources[-1] if sources else None)
                fades += [] if fade is None else [fade]
            sources.append(source)
            number, motion = self._renderer.faded(source, tuple(fades), times[at])
            out.append(PlayedBlock(source.block, motion, number))
        return out

    def _generation(self, block: Block) -> _Generation:
        """The generation whose knobs apply to a block."""
        return self._first if self._alike or block.locked else self._changed

    def _replayed(self, block: Block, before: _Source | None) -> tuple[_Source, Fade | None]:
        """The source of an unedited block, and the difference to the block before that fades out."""
        generation, at = self._generation(block), self._renderer.index[block.start]
        following = generation.before[at + 1] if at + 1 < len(generation.before) else None
        source = _Source(generation.blocks[at], generation.numbers[at], self._renderer.duration(at),
                         lambda: cast("DrawnBlock", following))
        if before is None or before.number == generation.numbers[at - 1]:
            return source, None
        there = generation.blocks[at - 1]
        pose, velocity = _difference(before.block, before.duration, there, self._renderer.duration(at - 1))
        return source, Fade(block.start, pose, velocity, (block.start, before.number, generation.numbers[at - 1]))

    def _run(self, at: int, before: _Source | None, times: Array) -> _Source:
        """The source of an edited block, generated after the block before."""
        block = self._plan.blocks[at]
        generation = self._generation(block)
        if before is not None and self._continues(at):
            state = before.after()
        else:
            index = self._renderer.index[block.start]
            state = generation.before[index]
            if before is not None and before.number != generation.numbers[index - 1]:
                state = self._renderer.standing(state, before.after())
        key, request = self._request(at, generation, times)
        drawn = self._renderer.drawn(state, key, request)
        if self._on_block is not None:
            self._on_block(at + 1, len(self._plan.blocks))
        assert drawn.block is not None
        return _Source(drawn.block, drawn.number, self._edges[at + 1] - self._edges[at], lambda: drawn)

    def _continues(self, at: int) -> bool:
        """Whether an edited block goes on with the run of the block before it."""
        blocks = self._plan.blocks
        if at == 0 or not self._edited[at - 1]:
            return False
        alike = self._generation(blocks[at]) is self._generation(blocks[at - 1])
        return alike or blocks[at].start not in self._renderer.index

    def _request(self, at: int, generation: _Generation, times: Array
                 ) -> tuple[Hashable, Callable[[], BlockRequest]]:
        """What is asked for in an edited block, and everything it depends on."""
        plan, block = self._plan, self._plan.blocks[at]
        lexeme, silent = self._decided.get((block.start, block.end), (None, False))
        # With new knobs the interpreter chooses again, unless the user set the lexeme or locked the block.
        chosen = None if generation is not self._first and block.lexeme == lexeme else block.lexeme
        still = None if block.locked else still_frames(plan.knobs, times, block.start)
        if block.silent and not silent:
            still = np.ones(len(times), bool)
        if still is not None and still.mean() >= 0.5:
            chosen = None
        last, count = min(at + 1, len(plan.blocks) - 1), len(plan.blocks)
        silence = plan.blocks[max(at - 1, 0)].silent, block.silent, plan.blocks[last].silent
        removed = self._removed[at], self._removed[last]
        manner = plan.drawn_manner if generation is self._first else self._manner
        hand = manner.handedness
        # Beside blocks with activities of their own, the others are given theirs, too.
        activity = manner.share_at(block.start) if self._manner.curves else None
        draw = block.draw
        place, spoken = self._speech[at]
        key = (place, at + 1 == count, silence, removed, self._flags[at], chosen,
               (draw.seed, draw.variation, draw.block), None if still is None else still.tobytes(), hand, activity)

        def request() -> BlockRequest:
            quiet, ahead = spoken.quiet & (not removed[0]), spoken.ahead
            speech = replace(spoken, number=draw.block, key=self._renderer.key_of(draw.block), flag=self._flags[at],
                             silent=silence, quiet=quiet, ahead=None if ahead is None else ahead & (not removed[1]))
            return self._renderer.request(speech, times, Direction(chosen, Keys(draw.seed, draw.variation), still,
                                                                   self._renderer.bias(hand), activity))

        return key, request


def _begins(manner: GenerationKnobs) -> float:
    """The activity of the driver that generates in a manner."""
    return _VARYING if manner.curves else manner.share


def _activity(manner: GenerationKnobs, start: float) -> float | None:
    """The activity of a block that begins at `start`, seconds; None where that of its driver stays."""
    return manner.share_at(start) if manner.curves else None


def _difference(last: BlockMotion, duration: float, there: BlockMotion, other: float) -> tuple[Array, Array]:
    """Differences [D_m] in pose and in velocity at a beat, between the ends of a block of `duration` seconds and of
    another one, of `other` seconds."""
    (pose, velocity), (first, before) = _end(last, duration), _end(there, other)
    return pose - first, velocity - before


def _end(block: BlockMotion, duration: float) -> tuple[Array, Array]:
    """[D_m] pose and velocity at the end of a block."""
    now, before = block.motion[-1].astype(np.float64), block.motion[-2].astype(np.float64)
    return now, (now - before) * len(block.motion) / duration


def _faded(motion: Rows, times: Array, fades: Sequence[Fade]) -> Rows:
    """Motion [K, D_m] at `times` [K] with the fading differences added; see the module."""
    out = motion.copy()
    for fade in fades:
        near = (times > fade.begin) & (times < fade.begin + BLEND)
        s = ((times[near] - fade.begin) / BLEND)[:, None]
        added = (2 * s**3 - 3 * s**2 + 1) * fade.pose + BLEND * (s**3 - 2 * s**2 + s) * fade.velocity
        out[near] = (out[near] + added).astype(np.float32)
    return out
