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

Generations are drawn block by block, as far as they are asked for. What has to be drawn from the start of the
recording can be shown roughly before: a draft of a stretch begins shortly before it, in the pose that another
generation has there.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, BeatFlag, Blocks
from gesticulator.bundle.features import SpeechBlock, SpeechFeatures
from gesticulator.drawing.drawn_blocks import DrawnBlock, DrawnTree
from gesticulator.drawing.driver import BlockRequest, Direction, Driver, GeneratedMotion, KeptDrawing
from gesticulator.drawing.recut import Recutter, window
from gesticulator.plan.plan import Block, GenerationKnobs, GesturePlan, PlanKnobs, edited_blocks, edited_themselves
from gesticulator.sampling.cutter import BlockCutter
from gesticulator.sampling.loop import BlockMotion, OnBlock
from gesticulator.sampling.noise import Keys

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


class Generation:
    """The blocks of the recording in one generation, in order; each is drawn when it is first asked for."""

    def __init__(self, steps: list[DrawnBlock], draw: Callable[[int, DrawnBlock], DrawnBlock], begin: int = 0) -> None:
        """steps: the state before block `begin`, and the blocks from there on that are known; draw: the number of the
        next block and the one before it -> the next block."""
        self._steps, self._draw, self._begin = steps, draw, begin

    @property
    def drawn(self) -> int:
        """How far the recording has been drawn: the number of the first block that has not."""
        return self._begin + len(self._steps) - 1

    def before(self, at: int, on_block: Callable[[int], None] | None = None) -> DrawnBlock:
        """The block before block `at`, with the state from which that one is drawn. on_block: called with the number of
        finished blocks after each that is drawn."""
        while self.drawn < at:
            self._steps.append(self._draw(self.drawn, self._steps[-1]))
            if on_block is not None:
                on_block(self.drawn)
        return self._steps[at - self._begin]

    def block(self, at: int, on_block: Callable[[int], None] | None = None) -> DrawnBlock:
        """Block `at`, with the state after it. on_block: see `before`."""
        return self.before(at + 1, on_block)

    def known(self, count: int) -> list[DrawnBlock]:
        """The state before the first block, and at most `count` blocks that are drawn."""
        return self._steps[:count + 1]


class PlanRenderer:
    """Renders plans of one first generation; each plan then costs only its edited blocks."""

    def __init__(self, redrawer: Redrawer, plan: GesturePlan, drawing: KeptDrawing | None = None) -> None:
        """plan: any plan of this generation; its edits are ignored here. drawing: the first generation, or its first
        blocks, or its speech alone; what is missing is drawn when it is needed."""
        self._redrawer, self._drawn = redrawer, plan.drawn
        self._seed = plan.seed, plan.variation
        # By the number of a block in `draw`; another number is a time of its own.
        self._keys = dict(zip(plan.drawn.numbers or range(len(plan.drawn.lexemes)),
                              plan.drawn.keyed_at or plan.drawn.edges, strict=False))
        self._cut = redrawer.blocks(plan.drawn.edges, plan.drawn.flags, plan.drawn.silent)
        self._times = self._cut.knot_times.reshape(len(self._cut), -1)
        self._edges, self._manner = plan.drawn.edges, plan.drawn_manner
        self._durations = self._cut.durations.tolist()
        self._index = {edge: at for at, edge in enumerate(self._edges)}
        if drawing is None:
            cutters = list[BlockCutter]()
            drawing = KeptDrawing(redrawer.encode(self._cut, cutters), (), (), cutters)
        self._encoded, self._cutters = drawing.encoded, drawing.cutters
        self._tree = DrawnTree(max(LEAST_REMEMBERED, REMEMBERED * len(self._cut)))
        states = drawing.states or [self._begun(self._manner)]
        self._first = Generation([DrawnBlock(self._tree.new_number(), state, block) for state, block in zip(
            states, [None, *drawing.blocks], strict=True)], self._next_of_first)
        self._windows: dict[Hashable, int] = {window(self._edges, at): at for at in range(len(self._cut))}
        self._complete: set[GenerationKnobs] = set()
        self._recut: dict[Hashable, SpeechBlock] = {}
        self._faded: dict[Hashable, tuple[int, Rows]] = {}

    def _next_of_first(self, at: int, before: DrawnBlock) -> DrawnBlock:
        """The next block of the first generation, from the decisions in the plan."""
        state = before.state.fork()
        return DrawnBlock(self._tree.new_number(), state, state.draw(self._as_first(at)))

    def _as_first(self, at: int) -> BlockRequest:
        """The request for a block of the first generation."""
        drawn = self._drawn
        still = still_frames(drawn.knobs, self._times[at], float(self._cut.edges[at]))
        return self._asked(at, Direction(drawn.lexemes[at], still=still,
                                         bias=self._redrawer.bias(drawn.knobs.handedness)))

    def _asked(self, at: int, direction: Direction) -> BlockRequest:
        number = self._drawn.numbers[at] if self._drawn.numbers else at
        return BlockRequest(replace(self._encoded.block(at), number=number, key=self._keys[number]),
                            self._redrawer.control(self._times[at]), direction)

    def complete(self, on_block: OnBlock | None = None) -> Sequence[BlockMotion]:
        """The blocks of the first generation, all of which are drawn. on_block: see `OnBlock`."""
        count = len(self._cut)
        self._first.before(count, None if on_block is None else lambda done: on_block(done, count))
        return [cast("BlockMotion", step.block) for step in self._first.known(count)[1:]]

    @property
    def drawing(self) -> KeptDrawing:
        """The first generation, all of which is drawn."""
        return KeptDrawing(self._encoded, self.complete(), [step.state for step in self._first.known(len(self._cut))],
                           self._cutters)

    @property
    def is_drawn(self) -> bool:
        """Whether all of the first generation is drawn."""
        return self._first.drawn == len(self._cut)

    def speech_of(self, plan: GesturePlan) -> KeptDrawing | None:
        """A drawing with the speech alone, for a plan that is cut as those of this renderer; None for another one."""
        drawn, ours = plan.drawn, self._drawn
        alike = (drawn.edges, drawn.flags, drawn.silent) == (ours.edges, ours.flags, ours.silent)
        return KeptDrawing(self._encoded, (), (), self._cutters) if alike else None

    @cached_property
    def _recutter(self) -> Recutter:
        cutters = self._cutters
        if not cutters:
            cutters = list[BlockCutter]()
            self._redrawer.encode(self._cut, cutters)
        return self._redrawer.recutter(cutters)

    def render(self, plan: GesturePlan) -> GeneratedMotion:
        """The plan's motion. `plan.drawn` must be that of this renderer."""
        blocks = self.cut(plan)
        if not any(edited_blocks(plan)):
            first = self.complete()
            return GeneratedMotion(blocks, first, self._first.before(0).state.motion(first))
        played = self.played(plan)
        return GeneratedMotion(blocks, [one.block for one in played], np.stack([one.motion for one in played]))

    def cut(self, plan: GesturePlan) -> Blocks:
        """The blocks of a plan."""
        return self._redrawer.blocks([0.0, *(block.end for block in plan.blocks)],
                                     [block.flag for block in plan.blocks], [block.silent for block in plan.blocks])

    def played(self, plan: GesturePlan) -> list[PlayedBlock]:
        """The blocks of a plan as they are played."""
        return list(self.playing(plan))

    def playing(self, plan: GesturePlan, on_block: OnBlock | None = None) -> Iterator[PlayedBlock]:
        """The blocks of a plan as they are played, one after the other as they are drawn. on_block: called after each
        drawn block with the number of finished blocks and the total; it may raise an error to abandon the rendering:
        what was drawn until then is remembered."""
        if plan.drawn != self._drawn:
            raise ValueError("the plan is of another generation")
        return _PlanRun(self, plan, on_block).playing(0, len(plan.blocks))

    # ------------------------------------------------------------------------------------------ what runs are made of

    def generation(self, manner: GenerationKnobs) -> Generation:
        """The recording generated in a manner, without edits: the first generation where it is that of the first."""
        if manner == self._manner:
            return self._first
        begins = _begins(manner), manner.handedness

        def draw(at: int, before: DrawnBlock) -> DrawnBlock:
            key = "knobs", at, _activity(manner, self._edges[at])
            drawn = self._tree.drawn(before, key, partial(self._with_manner, manner, at))
            if at + 1 == len(self._cut):
                self._complete.add(manner)
            return drawn

        return Generation([self._tree.beginning(begins, lambda: self._begun(manner))], draw)

    def knows(self, plan: GesturePlan) -> bool:
        """Whether the generations that a plan needs have been drawn as a whole, and most of them is remembered."""
        locked = [block.locked for block in plan.blocks]
        first = plan.manner == self._manner or any(locked)
        return (not first or self.is_drawn) and (
            plan.manner == self._manner or all(locked) or plan.manner in self._complete)

    def _begun(self, manner: GenerationKnobs) -> Driver:
        driver = self._redrawer.drivers(_begins(manner))
        driver.begin(self._encoded.text is not None)
        return driver

    def _with_manner(self, manner: GenerationKnobs, at: int) -> BlockRequest:
        """The request for a block of the first generation in another manner."""
        still = still_frames(self._drawn.knobs, self._times[at], float(self._cut.edges[at]))
        # Under a curve, as in the first generation, which it is as long as the curve does not matter.
        keys = None if manner.curves else Keys(*self._seed)
        return self._asked(at, Direction(None, keys, still, self._redrawer.bias(manner.handedness),
                                         _activity(manner, self._edges[at])))

    def draft(self, plan: GesturePlan, view: tuple[float, float], other: PlanRenderer
              ) -> tuple[list[PlayedBlock], tuple[int, int]] | None:
        """The blocks of a plan, those of a stretch (seconds) roughly as they will be played; and which of them: the
        first, and the one after the last.

        The models begin anew shortly before the stretch, in the pose that the first generation of another renderer has
        there, and sample at low cost. Before the stretch and after it, the body is still. None where the other renderer
        cuts the recording elsewhere, or has not drawn as far.
        """
        blocks, count = plan.blocks, len(plan.blocks)
        seen = bisect_right(blocks, view[0], key=lambda block: block.end)
        last = bisect_left(blocks, view[1], key=lambda block: block.start)
        first = max(min(seen, count - 1) - WARMS_UP, 0)
        while first and blocks[first].start not in self._index:
            first -= 1
        begin = self._index[blocks[first].start]
        if last <= first or other._edges != self._edges or other._first.drawn < begin:
            return None
        state = self._begun(plan.manner)
        state.hurry(True)
        state.stand_as(other._first.before(begin).state)
        draft = Generation([DrawnBlock(self._tree.new_number(), state, None)],
                           partial(self._next_of_draft, plan.manner), begin)
        played = list(_PlanRun(self, plan, None, draft).playing(first, last))
        before, after = (replace(one, motion=np.repeat(row, len(one.motion), axis=0), number=self._tree.new_number())
                         for one, row in ((played[0], played[0].motion[:1]), (played[-1], played[-1].motion[-1:])))
        return [before] * first + played + [after] * (count - last), (min(seen, last - 1), last)

    def _next_of_draft(self, manner: GenerationKnobs, at: int, before: DrawnBlock) -> DrawnBlock:
        state = before.state.fork()
        request = self._as_first(at) if manner == self._manner else self._with_manner(manner, at)
        return DrawnBlock(self._tree.new_number(), state, state.draw(request))

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

    def plays(self, block: BlockMotion) -> PlayedBlock:
        """A block that was drawn elsewhere, as it is."""
        return PlayedBlock(block, block.motion, self._tree.new_number())

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
        return float(self._durations[at])

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
    """One rendering of one plan, or of a stretch of it."""

    def __init__(self, renderer: PlanRenderer, plan: GesturePlan, on_block: OnBlock | None,
                 draft: Generation | None = None) -> None:
        """draft: takes the place of the generations that have not been drawn."""
        self._renderer, self._plan = renderer, plan
        self._on_block = None if on_block is None else lambda done: on_block(done, len(plan.drawn.lexemes))
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
        self._changed = self._first if self._alike else renderer.generation(self._manner)
        if draft is not None:
            self._changed = draft
            self._first = draft if self._first.drawn < len(drawn.lexemes) else self._first

    def playing(self, first: int, last: int) -> Iterator[PlayedBlock]:
        """The blocks from `first` to `last` - 1; the first of them begins where one of the first generation does."""
        blocks, fades = self._plan.blocks, list[Fade]()
        times = self._renderer.cut(self._plan).knot_times.reshape(len(blocks), -1)
        before: _Source | None = None
        for at in range(first, last):
            block = blocks[at]
            fades = [fade for fade in fades if fade.begin + BLEND > block.start]
            if self._edited[at]:
                before = self._run(at, before, times[at])
            else:
                before, fade = self._replayed(block, before)
                fades += [] if fade is None else [fade]
            number, motion = self._renderer.faded(before, tuple(fades), times[at])
            yield PlayedBlock(before.block, motion, number)

    def _anew(self, block: Block) -> bool:
        """Whether the new knobs apply to a block."""
        return not self._alike and not block.locked

    def _generation(self, block: Block) -> Generation:
        """The generation whose knobs apply to a block."""
        return self._first if block.locked and not self._alike else self._changed

    def _replayed(self, block: Block, before: _Source | None) -> tuple[_Source, Fade | None]:
        """The source of an unedited block, and the difference to the block before that fades out."""
        generation, at = self._generation(block), self._renderer.index[block.start]
        drawn = generation.block(at, self._on_block)
        assert drawn.block is not None
        source = _Source(drawn.block, drawn.number, self._renderer.duration(at), lambda: drawn)
        if before is None or before.number == generation.before(at).number:
            return source, None
        there = generation.before(at)
        assert there.block is not None
        pose, velocity = _difference(before.block, before.duration, there.block, self._renderer.duration(at - 1))
        return source, Fade(block.start, pose, velocity, (block.start, before.number, there.number))

    def _run(self, at: int, before: _Source | None, times: Array) -> _Source:
        """The source of an edited block, generated after the block before."""
        block = self._plan.blocks[at]
        generation = self._generation(block)
        if before is not None and self._continues(at):
            state = before.after()
        else:
            state = generation.before(self._renderer.index[block.start], self._on_block)
            if before is not None and before.number != state.number:
                state = self._renderer.standing(state, before.after())
        key, request = self._request(at, times)
        drawn = self._renderer.drawn(state, key, request)
        if self._on_block is not None:
            self._on_block(at + 1)
        assert drawn.block is not None
        return _Source(drawn.block, drawn.number, self._edges[at + 1] - self._edges[at], lambda: drawn)

    def _continues(self, at: int) -> bool:
        """Whether an edited block goes on with the run of the block before it."""
        blocks = self._plan.blocks
        if at == 0 or not self._edited[at - 1]:
            return False
        alike = self._anew(blocks[at]) == self._anew(blocks[at - 1])
        return alike or blocks[at].start not in self._renderer.index

    def _request(self, at: int, times: Array) -> tuple[Hashable, Callable[[], BlockRequest]]:
        """What is asked for in an edited block, and everything it depends on."""
        plan, block = self._plan, self._plan.blocks[at]
        lexeme, silent = self._decided.get((block.start, block.end), (None, False))
        # With new knobs the interpreter chooses again, unless the user set the lexeme or locked the block.
        chosen = None if self._anew(block) and block.lexeme == lexeme else block.lexeme
        still = None if block.locked else still_frames(plan.knobs, times, block.start)
        if block.silent and not silent:
            still = np.ones(len(times), bool)
        if still is not None and still.mean() >= 0.5:
            chosen = None
        last, count = min(at + 1, len(plan.blocks) - 1), len(plan.blocks)
        silence = plan.blocks[max(at - 1, 0)].silent, block.silent, plan.blocks[last].silent
        removed = self._removed[at], self._removed[last]
        manner = self._manner if self._anew(block) else plan.drawn_manner
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
