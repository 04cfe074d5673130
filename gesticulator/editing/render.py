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
from functools import cache, cached_property, partial

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, BeatFlag, Blocks, Samples
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock, SpeechFeatures
from gesticulator.directing.directions import bias_of, still_frames
from gesticulator.editing.recut import Recutter, window
from gesticulator.plan.plan import Block, GenerationKnobs, GesturePlan, edited_themselves
from gesticulator.sampling import loop
from gesticulator.sampling.cutter import BlockCutter
from gesticulator.sampling.loop import BlockMotion, GeneratedMotion, OnBlock, Request, Setup, State, controls_at
from gesticulator.sampling.noise import Keys

BLEND = 0.6
"""Seconds after an edited run in which the difference fades out: a hand half a metre off returns at 1.3 m/s at most."""
LEAST_REMEMBERED, REMEMBERED = 2000, 4
"""Sampled blocks in memory: at least, and for each block of the recording, so that undo finds whole generations."""
_VARYING = 0.5
"""The activity with which a generation begins whose blocks are each given their own: between none and all, so that it
uses the gate. It does not depend on the curve, so what comes before a change of the curve is not sampled again."""
Rows = NDArray[np.float32]


def flag_numbers(flags: Sequence[str]) -> list[BeatFlag]:
    """The flags of these names. A beat that a user added counts as an onset."""
    by_name = {flag.name.lower(): flag for flag in BeatFlag}
    return [by_name.get(name, BeatFlag.ONSET) for name in flags]


@dataclass(frozen=True)
class Generation:
    """A generated recording from which edits start. speech: its features; blocks: its N blocks; states: [N + 1] the
    state before each of them, and after the last; cutters: copies of the cutter of its speech (`Recutter`)."""

    speech: SpeechFeatures
    blocks: Sequence[BlockMotion]
    states: Sequence[State]
    cutters: Sequence[BlockCutter] = ()


@dataclass(frozen=True, eq=False)
class SampledBlock:
    """A block, and the state after it with its setup. block: None where sampling begins.

    The same request after the same block gives the same object, so that equal sources are recognised by identity."""

    setup: Setup
    state: State
    block: BlockMotion | None = None

    @property
    def motion(self) -> BlockMotion:
        """The block. ValueError for a beginning."""
        if self.block is None:
            raise ValueError("nothing was sampled yet")
        return self.block


class PlanRenderer:
    """Renders plans of one first generation; each plan then costs only its edited blocks."""

    def __init__(self, bundle: Bundle, setup: Setup, samples: Samples,
                 encode: Callable[[Blocks, list[BlockCutter]], SpeechFeatures], plan: GesturePlan,
                 generation: Generation | None = None) -> None:
        """setup: of the first generation; samples: of the speech, at 16 kHz; encode: blocks -> the features of the
        speech cut into them, and copies of the cutter (`encode_speech`). plan: any plan of the first generation; its
        edits are ignored here. generation: the first one; it is sampled again where it is missing."""
        self._bundle, self._setup, self._samples, self._encode = bundle, setup, samples, encode
        self._original, self._manner, self._seed = plan.drawn, plan.drawn_manner, (plan.seed, plan.variation)
        self.bias = cache(partial(bias_of, bundle))
        """Handedness -> [S] its addition to the scores of lexemes; None for none."""
        self.noise_times = dict(zip(plan.drawn.numbers or range(len(plan.drawn.lexemes)),
                                    plan.drawn.keyed_at or plan.drawn.edges, strict=False))
        """Number of a block in `draw` -> seconds that key its random numbers."""
        self._cut = self._blocks_of(plan.drawn.edges, plan.drawn.flags, plan.drawn.silent)
        self._times = self._cut.knot_times.reshape(len(self._cut), -1)
        self.durations: list[float] = self._cut.durations.tolist()
        """[N] seconds of the blocks of the first generation."""
        self.index = {edge: at for at, edge in enumerate(plan.drawn.edges)}
        """Beat of the first generation, seconds -> number of the block that begins there."""
        self._windows: dict[Hashable, int] = {window(plan.drawn.edges, at): at for at in range(len(self._cut))}
        self._cutters: Sequence[BlockCutter] = ()
        if generation is None:
            cutters = list[BlockCutter]()
            self._speech, self._cutters = encode(self._cut, cutters), cutters
            self._first = [self._beginning(self._manner)]
        else:
            self._speech, self._cutters = generation.speech, generation.cutters
            first = self._setup_of(self._manner)
            self._first = [SampledBlock(first, state, block) for state, block in
                           zip(generation.states, [None, *generation.blocks], strict=True)]
        self._sampled: dict[Hashable, SampledBlock] = {}
        self._recut: dict[Hashable, SpeechBlock] = {}
        self._most = max(LEAST_REMEMBERED, REMEMBERED * len(self._cut))

    def generation(self, on_block: OnBlock | None = None) -> Generation:
        """The first generation, sampled as far as it is missing."""
        steps = self._first_steps(on_block)
        return Generation(self._speech, [step.motion for step in steps[1:]], [step.state for step in steps],
                          self._cutters)

    def cut(self, plan: GesturePlan) -> Blocks:
        """The blocks of a plan."""
        return self._blocks_of([0.0, *(block.end for block in plan.blocks)], [block.flag for block in plan.blocks],
                               [block.silent for block in plan.blocks])

    def render(self, plan: GesturePlan, on_block: OnBlock | None = None) -> GeneratedMotion:
        """The plan's motion. `plan.drawn` must be that of this renderer. on_block: called with the number of finished
        blocks and the total after each block that is sampled, and may raise an error to abandon the rendering: what
        was sampled until then is remembered."""
        if plan.drawn != self._original:
            raise ValueError("the plan is of another generation")
        edited = edited_themselves(plan)
        if not any(edited) and plan.manner == self._manner:
            # Without edits the plan is its first generation, which needs no fades and no second one.
            steps = self._first_steps(on_block)
            blocks = [step.motion for step in steps[1:]]
            return GeneratedMotion(self.cut(plan), blocks, loop.motion_of(self._bundle, self._setup, blocks))
        return _PlanRun(self, plan, edited, on_block).rendered()

    # ------------------------------------------------------------------------------------------ what runs are made of

    def steps(self, manner: GenerationKnobs, on_block: OnBlock | None) -> list[SampledBlock]:
        """[N + 1] the recording generated with these knobs, without edits: the state before it, and its blocks."""
        if manner == self._manner:
            return self._first_steps(on_block)
        begins = "beginning", _begins(manner), manner.handedness
        steps = [self._remembered(begins, lambda: self._beginning(manner))]
        for at in range(len(self._cut)):
            steps.append(self.sampled(steps[-1], ("knobs", at, _activity(manner, float(self._cut.edges[at]))),
                                      partial(self._with_knobs, manner, at), on_block, at + 1))
        return steps

    def _first_steps(self, on_block: OnBlock | None) -> list[SampledBlock]:
        for at in range(len(self._first) - 1, len(self._cut)):
            request = replace(self._request(at, self._original.knobs.handedness), lexeme=self._original.lexemes[at])
            self._first.append(self._sample(self._first[-1], request))
            if on_block is not None:
                on_block(at + 1, len(self._cut))
        return self._first

    def _setup_of(self, manner: GenerationKnobs) -> Setup:
        return replace(self._setup, activity=_begins(manner))

    def _beginning(self, manner: GenerationKnobs) -> SampledBlock:
        setup = self._setup_of(manner)
        return SampledBlock(setup, loop.begin(self._bundle, setup, self._speech.text is not None, Keys(*self._seed)))

    def _sample(self, before: SampledBlock, request: Request) -> SampledBlock:
        """The block after another one."""
        block, after = loop.step(self._bundle, before.setup, before.state, request)
        return SampledBlock(before.setup, after, block)

    def _with_knobs(self, manner: GenerationKnobs, at: int) -> Request:
        """The request for a block of the recording generated with other knobs."""
        # Under a curve, as in the first generation, which it is as long as the curve does not matter.
        return replace(self._request(at, manner.handedness), keys=None if manner.curves else Keys(*self._seed),
                       activity=_activity(manner, float(self._cut.edges[at])))

    def _request(self, at: int, hand: str | None) -> Request:
        """The request for a block of the first generation, whose lexeme is chosen."""
        number = self._original.numbers[at] if self._original.numbers else at
        still = still_frames(self._original.knobs, self._times[at], float(self._cut.edges[at]))
        return Request(replace(self._speech.block(at), number=number, key=self.noise_times[number]),
                       self.control(self._times[at]), still=still, bias=self.bias(hand))

    def control(self, times: Array) -> loop.ControlRows | None:
        """[K, 2 F] rows of the hand controls at `times` [K] seconds, or None."""
        return controls_at(self._bundle.levels, self._setup.controls, times)

    def sampled(self, before: SampledBlock, key: Hashable, request: Callable[[], Request],
                on_block: OnBlock | None, done: int) -> SampledBlock:
        """The block that is sampled after another one. key: everything that the request depends on; done: number of
        finished blocks after it."""
        known = (before, key) in self._sampled
        block = self._remembered((before, key), lambda: self._sample(before, request()))
        if on_block is not None and not known:  # which may raise an error: the block is remembered by now
            on_block(done, len(self._cut))
        return block

    def standing(self, state: SampledBlock, other: SampledBlock) -> SampledBlock:
        """A state in the pose of another one."""
        return self._remembered(("standing", state, other),
                                lambda: SampledBlock(state.setup, _standing(state.state, other.state)))

    def _remembered(self, key: Hashable, make: Callable[[], SampledBlock]) -> SampledBlock:
        # A dict keeps the order of insertion: to take out and put in again makes it a list by last use.
        block = self._sampled.pop(key, None) or make()
        self._sampled[key] = block  # the most recently used comes last
        while len(self._sampled) > self._most:
            del self._sampled[next(iter(self._sampled))]
        return block

    def speech(self, edges: Sequence[float], flags: Sequence[BeatFlag], wanted: Sequence[int]
               ) -> dict[int, tuple[Hashable, SpeechBlock]]:
        """Number -> speech of the wanted blocks (rising) of N blocks with edges [N + 1] and flags [N], and what its
        numbers depend on."""
        # Blocks whose window was there before have the features of the first encoding; only the others are cut again.
        places: dict[int, Hashable] = {at: window(edges, at) for at in wanted}
        moved = [at for at, place in places.items() if place not in self._windows]
        if len(self._recut) > self._most:
            self._recut.clear()
        if moved:
            courses = self._recutter.courses(edges, moved)
            places |= courses
            missing = [at for at in moved if courses[at] not in self._recut]
            self._recut |= {courses[at]: block
                            for at, block in self._recutter.blocks(edges, flags, missing).items()}
        return {at: (place, self._recut[place] if place in self._recut else self._speech.block(self._windows[place]))
                for at, place in places.items()}

    @cached_property
    def _recutter(self) -> Recutter:
        cutters = self._cutters
        if not cutters:
            cutters = list[BlockCutter]()
            self._encode(self._cut, cutters)
        return Recutter(self._samples, cutters)

    def _blocks_of(self, edges: Sequence[float], flags: Sequence[str], silent: Sequence[bool]) -> Blocks:
        rhythm = self._bundle.config.rhythm
        return Blocks(np.array(edges), np.array(flag_numbers(flags), np.int8), np.array(silent), rhythm.frames,
                      rhythm.fps)


@dataclass(frozen=True)
class _Source:
    """Where a block of a plan comes from, and its duration in seconds."""

    sampled: SampledBlock
    duration: float


@dataclass(frozen=True)
class _Fade:
    """A difference that fades out from `begin`, seconds. pose, velocity: [D_m]."""

    begin: float
    pose: Array
    velocity: Array


class _PlanRun:
    """One rendering of one plan."""

    def __init__(self, renderer: PlanRenderer, plan: GesturePlan, edited: Sequence[bool], on_block: OnBlock | None
                 ) -> None:
        """edited: [N] whether a block is sampled and not replayed."""
        self._renderer, self._plan, self._edited, self._on_block = renderer, plan, edited, on_block
        self._manner = plan.manner
        self._alike = self._manner == plan.drawn_manner
        self._edges = [0.0, *(block.end for block in plan.blocks)]
        self._flags = flag_numbers([block.flag for block in plan.blocks])
        self._speech = renderer.speech(self._edges, self._flags, np.flatnonzero(edited).tolist())
        drawn = plan.drawn
        # By their edges, not by their numbers: a deleted or an added beat shifts all later numbers.
        pairs = list(zip(drawn.edges, drawn.edges[1:], strict=False))
        self._decided = dict(zip(pairs, zip(drawn.lexemes, drawn.silent, strict=True), strict=True))
        quiet = dict(zip(drawn.edges, drawn.silent, strict=False))
        # Frames of a silence that the plan removed are not quiet.
        self._removed = [quiet.get(block.start, False) and not block.silent for block in plan.blocks]
        # A generation is sampled only if some block is replayed from it.
        locked = [block.locked for block in plan.blocks]
        self._first = renderer.steps(plan.drawn_manner, on_block) if self._alike or any(locked) else []
        self._changed = self._first if self._alike or all(locked) else renderer.steps(self._manner, on_block)

    def rendered(self) -> GeneratedMotion:
        """All blocks of the plan."""
        plan_blocks, fades = self._plan.blocks, list[_Fade]()
        cut = self._renderer.cut(self._plan)
        times = cut.knot_times.reshape(len(cut), -1)
        blocks, motion, before = list[BlockMotion](), list[Rows](), None
        for at, block in enumerate(plan_blocks):
            # Fades add up: an edit may follow another one before its difference is gone.
            fades = [fade for fade in fades if fade.begin + BLEND > block.start]
            if self._edited[at]:
                before = self._run(at, before, times[at])
            else:
                before, fade = self._replayed(block, before)
                fades += [] if fade is None else [fade]
            blocks.append(before.sampled.motion)
            motion.append(_faded(before.sampled.motion.motion, times[at], fades))
        return GeneratedMotion(cut, blocks, np.stack(motion))

    def _anew(self, block: Block) -> bool:
        """Whether the new knobs apply to a block."""
        return not self._alike and not block.locked

    def _steps(self, block: Block) -> list[SampledBlock]:
        """The generation whose knobs apply to a block."""
        return self._changed if self._anew(block) else self._first

    def _number(self, block: Block) -> int:
        """The number in the first generation of the block that begins with this one."""
        # A block at a moved beat is not asked for: it goes on with the run before it.
        return self._renderer.index[block.start]

    def _replayed(self, block: Block, before: _Source | None) -> tuple[_Source, _Fade | None]:
        """The source of an unedited block, and the difference to the block before that fades out."""
        steps, at = self._steps(block), self._number(block)
        source = _Source(steps[at + 1], self._renderer.durations[at])
        if before is None or before.sampled is steps[at]:
            return source, None
        pose, velocity = _difference(before.sampled.motion, before.duration, steps[at].motion,
                                     self._renderer.durations[at - 1])
        return source, _Fade(block.start, pose, velocity)

    def _run(self, at: int, before: _Source | None, times: Array) -> _Source:
        """The source of an edited block, sampled after the block before."""
        block = self._plan.blocks[at]
        if before is not None and self._continues(at):
            state = before.sampled
        else:
            state = self._steps(block)[self._number(block)]
            if before is not None and before.sampled is not state:
                state = self._renderer.standing(state, before.sampled)
        key, request = self._request(at, times)
        return _Source(self._renderer.sampled(state, key, request, self._on_block, at + 1),
                       self._edges[at + 1] - self._edges[at])

    def _continues(self, at: int) -> bool:
        """Whether an edited block goes on with the run of the block before it."""
        blocks = self._plan.blocks
        if at == 0 or not self._edited[at - 1]:
            return False
        # Runs with other knobs have other states; a block at a moved beat has no state of a generation to begin with.
        alike = self._anew(blocks[at]) == self._anew(blocks[at - 1])
        return alike or blocks[at].start not in self._renderer.index

    def _request(self, at: int, times: Array) -> tuple[Hashable, Callable[[], Request]]:
        """What is asked for in an edited block, and everything it depends on."""
        plan, block = self._plan, self._plan.blocks[at]
        lexeme, silent = self._decided.get((block.start, block.end), (None, False))
        # With new knobs the interpreter chooses again, unless the user set the lexeme or locked the block.
        chosen = None if self._anew(block) and block.lexeme == lexeme else block.lexeme
        still = None if block.locked else still_frames(plan.knobs, times, block.start)
        if block.silent and not silent:
            still = np.ones(len(times), bool)
        # A block that mostly rests shows no lexeme, so the interpreter chooses it, as in a first generation.
        if still is not None and still.mean() >= 0.5:
            chosen = None
        # Everything that the request depends on, and nothing else: an equal key is an equal block, which undo finds.
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

        def request() -> Request:
            quiet, ahead = spoken.quiet & (not removed[0]), spoken.ahead
            # The number of no block of the first generation is a time of its own.
            noise_time = self._renderer.noise_times.get(draw.block, float(draw.block))
            speech = replace(spoken, number=draw.block, key=noise_time, flag=self._flags[at], silent=silence,
                             quiet=quiet, ahead=None if ahead is None else ahead & (not removed[1]))
            return Request(speech, self._renderer.control(times), chosen, Keys(draw.seed, draw.variation), still,
                           self._renderer.bias(hand), activity)

        return key, request


def _begins(manner: GenerationKnobs) -> float:
    """The activity with which a generation begins."""
    return _VARYING if manner.curves else manner.share


def _activity(manner: GenerationKnobs, start: float) -> float | None:
    """The activity of a block that begins at `start`, seconds; None where that of the beginning stays."""
    return manner.share_at(start) if manner.curves else None


def _difference(last: BlockMotion, duration: float, there: BlockMotion, other: float) -> tuple[Array, Array]:
    """Differences [D_m] in pose and in velocity at a beat, between the ends of a block of `duration` seconds and of
    another one, of `other` seconds."""
    (pose, velocity), (first, before) = _end(last, duration), _end(there, other)
    return pose - first, velocity - before


def _end(block: BlockMotion, duration: float) -> tuple[Array, Array]:
    """[D_m] pose and velocity at the end of a block."""
    # In float64: the velocity is a small difference of large numbers.
    now, before = block.motion[-1].astype(np.float64), block.motion[-2].astype(np.float64)
    return now, (now - before) * len(block.motion) / duration


def _faded(motion: Rows, times: Array, fades: Sequence[_Fade]) -> Rows:
    """Motion [K, D_m] at `times` [K] with the fading differences added; see the module."""
    if not fades:
        return motion
    out = motion.copy()
    for fade in fades:
        # A cubic Hermite curve with h(0) = 1 and k'(0) = 1: pose and velocity meet at the beat, and both end at zero.
        near = (times > fade.begin) & (times < fade.begin + BLEND)
        s = ((times[near] - fade.begin) / BLEND)[:, None]
        added = (2 * s**3 - 3 * s**2 + 1) * fade.pose + BLEND * (s**3 - 2 * s**2 + s) * fade.velocity
        out[near] = (out[near] + added).astype(np.float32)
    return out


def _standing(state: State, other: State) -> State:
    """A state with the pose and the last block of another one of the same bundle."""
    # A varied state carries a second one with the variation; what is seen is that one's pose.
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
