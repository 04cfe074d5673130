"""Motion of edited plans: unchanged blocks are replayed, edited ones are generated again.

Every block has a source. With the knobs of the first generation, unedited blocks are replayed from it. Where knobs were
changed that influence generation (activity), the recording is generated again with the new ones, from the
seed and without edits, and unedited blocks are those of this generation; locked blocks are still those of the first.
Each run of edited blocks is generated from the pose and the state before it. Where a source takes over from another
one, its motion x(t) continues with the difference at that beat b added, which fades out within `BLEND` seconds:

    x(t) + h(s) d + T k(s) v,   s = (t - b) / T,   h = 2 s^3 - 3 s^2 + 1,   k = s^3 - 2 s^2 + s

with d and v the differences in pose and velocity at the beat, and T = BLEND. Runs are independent of each other, so an
edit changes nothing elsewhere, and costs only its run. Motion is [N, K, D_m], normalised, K frames per block.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, BeatFlag, Blocks, Samples
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock, SpeechFeatures
from gesticulator.directing.directions import still_frames
from gesticulator.plan.plan import Block, GesturePlan, PlanKnobs, edited_themselves
from gesticulator.sampling import loop
from gesticulator.sampling.cutter import CUTTER_EVERY, BlockCutter

BLEND = 0.6
"""Seconds after an edited run in which the difference fades out: a hand half a metre off returns at 1.3 m/s at most."""
LEAST_REMEMBERED, REMEMBERED = 2000, 4
"""Sampled blocks in memory: at least, and for each block of the recording, so that undo finds whole generations."""
Rows = NDArray[np.float32]
Window = tuple[float, float, float, float]
"""Start of the block before, start and end of a block, end of the block after; seconds, the block's own at an end."""
Course = tuple[int, tuple[float, ...]]
"""What the features of a block depend on: the copy of the cutter that goes on, and the edges from there to the end of
the block after. The level of the voice is known block by block, so the edges before the window count, too."""


def flag_numbers(flags: Sequence[str]) -> list[BeatFlag]:
    """The flags of these names. A beat that a user added counts as an onset."""
    by_name = {flag.name.lower(): flag for flag in BeatFlag}
    return [by_name.get(name, BeatFlag.ONSET) for name in flags]


@dataclass(frozen=True, eq=False)
class SampledBlock:
    """A block, and the state after it with its setup. block: None where sampling begins.

    The same request after the same block gives the same object, so that equal sources are recognised by identity."""

    setup: loop.Setup
    state: loop.State
    block: loop.BlockMotion | None = None

    @property
    def motion(self) -> loop.BlockMotion:
        """The block, which is not a beginning."""
        assert self.block is not None
        return self.block

    @property
    def end(self) -> tuple[Array, Array]:
        """[D_m] pose and velocity at the end of the block."""
        # In float64: the velocity is a small difference of large numbers.
        motion, block = self.motion.motion, self.motion.block
        now, before = motion[-1].astype(np.float64), motion[-2].astype(np.float64)
        return now, (now - before) * len(motion) / (block.end - block.start)


class PlanRenderer:
    """Renders plans of one first generation; each plan then costs only its edited blocks."""

    def __init__(self, bundle: Bundle, setup: loop.Setup, samples: Samples,
                 encode: Callable[[Blocks, list[BlockCutter]], SpeechFeatures], plan: GesturePlan,
                 generation: loop.Generation | None = None) -> None:
        """setup: of the first generation; samples: of the speech, at 16 kHz; encode: blocks -> the features of the
        speech cut into them, and copies of the cutter (`encode_speech`). plan: any plan of the first generation; its
        edits are ignored here. generation: the first one; it is sampled again where it is missing."""
        self._bundle, self._setup, self._samples, self._encode = bundle, setup, samples, encode
        self._original, self._keys = plan.drawn, loop.Keys(plan.seed, plan.variation)
        self.noise_times = dict(zip(plan.drawn.numbers or range(len(plan.drawn.lexemes)),
                                    plan.drawn.keyed_at or plan.drawn.edges, strict=False))
        """Number of a block in `draw` -> seconds that key its random numbers."""
        self._cut = self._blocks_of(plan.drawn.edges, plan.drawn.flags, plan.drawn.silent)
        self._times = self._cut.knot_times.reshape(len(self._cut), -1)
        self.index = {edge: at for at, edge in enumerate(plan.drawn.edges)}
        """Beat of the first generation, seconds -> number of the block that begins there."""
        self._windows: dict[Hashable, int] = {window(plan.drawn.edges, at): at for at in range(len(self._cut))}
        self._cutters: Sequence[BlockCutter] = ()
        if generation is None:
            cutters = list[BlockCutter]()
            self._speech, self._cutters = encode(self._cut, cutters), cutters
            self._first = [self._beginning(plan.drawn.knobs)]
        else:
            self._speech, self._cutters = generation.speech, generation.cutters
            first = replace(setup, activity=plan.drawn.knobs.share)
            self._first = [SampledBlock(first, state, block) for state, block in
                           zip(generation.states, [None, *generation.blocks], strict=True)]
        self._sampled: dict[Hashable, SampledBlock] = {}
        self._recut: dict[Hashable, SpeechBlock] = {}
        self._most = max(LEAST_REMEMBERED, REMEMBERED * len(self._cut))

    def generation(self, on_block: loop.OnBlock | None = None) -> loop.Generation:
        """The first generation, sampled as far as it is missing."""
        steps = self.steps(self._original.knobs, on_block)
        return loop.Generation(self._speech, [step.motion for step in steps[1:]], [step.state for step in steps],
                               self._cutters)

    def cut(self, plan: GesturePlan) -> Blocks:
        """The blocks of a plan."""
        return self._blocks_of([0.0, *(block.end for block in plan.blocks)], [block.flag for block in plan.blocks],
                               [block.silent for block in plan.blocks])

    def render(self, plan: GesturePlan, on_block: loop.OnBlock | None = None) -> loop.GeneratedMotion:
        """The motion of a plan of this first generation. on_block: called with the number of finished blocks and the
        total after each sampled block, and may raise an error to abandon it: what was sampled is remembered."""
        edited = edited_themselves(plan)
        if not any(edited) and plan.knobs.share == self._original.knobs.share:
            # Without edits the plan is its first generation, which needs no fades and no second one.
            blocks, bundle = self.generation(on_block).blocks, self._bundle
            return loop.GeneratedMotion(self.cut(plan), blocks, bundle.system.motion_of(bundle, self._setup, blocks))
        return _PlanRun(self, plan, edited, on_block).rendered()

    # ------------------------------------------------------------------------------------------ what runs are made of

    def steps(self, knobs: PlanKnobs, on_block: loop.OnBlock | None) -> list[SampledBlock]:
        """[N + 1] the recording generated with these knobs, without edits: the state before it, and its blocks."""
        first = knobs.share == self._original.knobs.share
        steps = self._first if first else [self._remembered(("beginning", knobs.share), lambda: self._beginning(knobs))]
        for at in range(len(steps) - 1, len(self._cut)):
            if first:
                steps.append(self._sample(steps[-1], replace(self._request(at), lexeme=self._original.lexemes[at])))
                if on_block is not None:
                    on_block(at + 1, len(self._cut))
            else:
                steps.append(self.sampled(steps[-1], ("knobs", at), lambda at=at: replace(  # type: ignore[misc]
                    self._request(at), keys=self._keys), on_block, at + 1))
        return steps

    def _beginning(self, knobs: PlanKnobs) -> SampledBlock:
        setup = replace(self._setup, activity=knobs.share)
        return SampledBlock(setup, loop.begin(self._bundle, setup, self._speech.text is not None, self._keys))

    def _sample(self, before: SampledBlock, request: loop.Request) -> SampledBlock:
        """The block after another one."""
        block, after = loop.step(self._bundle, before.setup, before.state, request)
        return SampledBlock(before.setup, after, block)

    def _request(self, at: int) -> loop.Request:
        """The request for a block of the first generation, whose lexeme is chosen."""
        number = self._original.numbers[at] if self._original.numbers else at
        still = still_frames(self._original.knobs, self._times[at], float(self._cut.edges[at]))
        return loop.Request(replace(self._speech.block(at), number=number, key=self.noise_times[number]),
                            self.control(self._times[at]), still=still)

    def control(self, times: Array) -> loop.ControlRows | None:
        """[K, 2 F] rows of the hand controls at `times` [K] seconds, or None."""
        return loop.controls_at(self._bundle.levels, self._setup.controls, times)

    def sampled(self, before: SampledBlock, key: Hashable, request: Callable[[], loop.Request],
                on_block: loop.OnBlock | None, done: int) -> SampledBlock:
        """The block that is sampled after another one. key: all that the request depends on; done: blocks with it."""
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
        """Number -> what the speech of a wanted block depends on, and it; of N blocks with edges [N + 1], flags [N]."""
        if len(self._recut) > self._most:
            self._recut.clear()
        # Blocks whose window was there before have the features of the first encoding; only the others are cut again.
        places: dict[int, Hashable] = {at: window(edges, at) for at in wanted}
        places |= {at: self._recutter.course(edges, at) for at, place in places.items() if place not in self._windows}
        missing = [at for at, place in places.items() if place not in self._windows and place not in self._recut]
        self._recut |= {places[at]: block for at, block in self._recutter.blocks(edges, flags, missing).items()
                        if at in missing} if missing else {}
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
class _Fade:
    """A difference that fades out from `begin`, seconds. pose, velocity: [D_m]."""

    begin: float
    pose: Array
    velocity: Array


class _PlanRun:
    """One rendering of one plan."""

    def __init__(self, renderer: PlanRenderer, plan: GesturePlan, edited: Sequence[bool], on_block: loop.OnBlock | None
                 ) -> None:
        """edited: [N] whether a block is sampled and not replayed."""
        self._renderer, self._plan, self._edited, self._on_block = renderer, plan, edited, on_block
        self._alike = plan.knobs.share == plan.drawn.knobs.share
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
        self._first = renderer.steps(plan.drawn.knobs, on_block) if self._alike or any(locked) else []
        self._changed = self._first if self._alike or all(locked) else renderer.steps(plan.knobs, on_block)

    def rendered(self) -> loop.GeneratedMotion:
        """All blocks of the plan."""
        plan_blocks, fades = self._plan.blocks, list[_Fade]()
        cut = self._renderer.cut(self._plan)
        times = cut.knot_times.reshape(len(cut), -1)
        blocks, motion, before = list[loop.BlockMotion](), list[Rows](), None
        for at, block in enumerate(plan_blocks):
            # Fades add up: an edit may follow another one before its difference is gone.
            fades = [fade for fade in fades if fade.begin + BLEND > block.start]
            if self._edited[at]:
                before = self._run(at, before, times[at])
            else:
                before, fade = self._replayed(block, before)
                fades += [] if fade is None else [fade]
            blocks.append(before.motion)
            motion.append(_faded(before.motion.motion, times[at], fades))
        return loop.GeneratedMotion(cut, blocks, np.stack(motion))

    def _anew(self, block: Block) -> bool:
        """Whether the new knobs apply to a block."""
        return not self._alike and not block.locked

    def _steps(self, block: Block) -> list[SampledBlock]:
        """The generation whose knobs apply to a block."""
        return self._changed if self._anew(block) else self._first

    def _replayed(self, block: Block, before: SampledBlock | None) -> tuple[SampledBlock, _Fade | None]:
        """The source of an unedited block, and the difference to the block before that fades out."""
        steps, at = self._steps(block), self._renderer.index[block.start]
        if before is None or before is steps[at]:
            return steps[at + 1], None
        pose, velocity = (here - there for here, there in zip(before.end, steps[at].end, strict=True))
        return steps[at + 1], _Fade(block.start, pose, velocity)

    def _run(self, at: int, before: SampledBlock | None, times: Array) -> SampledBlock:
        """The source of an edited block, sampled after the block before."""
        block, state = self._plan.blocks[at], before
        if state is None or not self._continues(at):
            state = self._steps(block)[self._renderer.index[block.start]]
            if before is not None and before is not state:
                state = self._renderer.standing(state, before)
        return self._renderer.sampled(state, *self._request(at, times), self._on_block, at + 1)

    def _continues(self, at: int) -> bool:
        """Whether an edited block goes on with the run of the block before it."""
        blocks = self._plan.blocks
        if at == 0 or not self._edited[at - 1]:
            return False
        # Runs with other knobs have other states; a block at a moved beat has no state of a generation to begin with.
        alike = self._anew(blocks[at]) == self._anew(blocks[at - 1])
        return alike or blocks[at].start not in self._renderer.index

    def _request(self, at: int, times: Array) -> tuple[Hashable, Callable[[], loop.Request]]:
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
        wanted = chosen is not None and chosen != lexeme
        # Everything that the request depends on, and nothing else: an equal key is an equal block, which undo finds.
        last, count = min(at + 1, len(plan.blocks) - 1), len(plan.blocks)
        silence = plan.blocks[max(at - 1, 0)].silent, block.silent, plan.blocks[last].silent
        removed = self._removed[at], self._removed[last]
        draw = block.draw
        place, spoken = self._speech[at]
        key = (place, at + 1 == count, silence, removed, self._flags[at], chosen, wanted,
               (draw.seed, draw.variation, draw.block), None if still is None else still.tobytes())

        def request() -> loop.Request:
            quiet, ahead = spoken.quiet & (not removed[0]), spoken.ahead
            # The number of no block of the first generation is a time of its own.
            noise_time = self._renderer.noise_times.get(draw.block, float(draw.block))
            speech = replace(spoken, number=draw.block, key=noise_time, flag=self._flags[at], silent=silence,
                             quiet=quiet, ahead=None if ahead is None else ahead & (not removed[1]))
            keys = loop.Keys(draw.seed, draw.variation)
            return loop.Request(speech, self._renderer.control(times), chosen, keys, still, wanted=wanted)

        return key, request


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


def _standing(state: loop.State, other: loop.State) -> loop.State:
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
                   offset=source.offset, rest=rest, roles=source.roles, varied=varied)


# ------------------------------------------------------------------------------------------------------- moved beats

def window(edges: Sequence[float], at: int) -> Window:
    """The window of block `at` of N blocks with edges [N + 1]."""
    return (edges[max(at - 1, 0)], edges[at], edges[at + 1], edges[min(at + 2, len(edges) - 1)])


class Recutter:
    """Cuts blocks of one recording at other beats, N blocks with edges [N + 1], seconds, as cutting all of it would. A
    block's features depend on the sound of the block and its two neighbours, and on what the cutter knew at its end
    about the sound before. So a copy of the first cutter from shortly before an edited part goes on with these
    beats."""

    def __init__(self, samples: Samples, cutters: Sequence[BlockCutter]) -> None:
        """samples: at 16 kHz; cutters: copies before every `CUTTER_EVERY` of them (`encode_speech`)."""
        self._samples, self._cutters = samples, cutters

    def course(self, edges: Sequence[float], at: int) -> Course:
        """What the features of block `at` depend on."""
        copy, _ = self._start(edges, at)
        return copy, tuple(edges[edges.index(self._cutters[copy].uncut[-1]):at + 3])

    def blocks(self, edges: Sequence[float], flags: Sequence[BeatFlag], wanted: Sequence[int]
               ) -> dict[int, SpeechBlock]:
        """Number -> block, for the wanted ones (rising). flags: [N] of the beats at the ends of the blocks."""
        ends, out = list(zip(edges[1:], flags, strict=True)), dict[int, SpeechBlock]()
        # Neighbours are cut in one go: an edit of a beat moves four blocks.
        for (copy, number), run in groupby(wanted, lambda at: self._start(edges, at)):
            *_, last = run
            # A copy of the copy, which must serve other edits as well.
            cutter = self._cutters[copy].fork()
            cutter.cut_at(ends[edges.index(cutter.uncut[-1]):last + 2])
            out |= zip(range(number, last + 1), self._fed(cutter, copy), strict=False)
        return out

    def _fed(self, cutter: BlockCutter, copy: int) -> Iterator[SpeechBlock]:
        for piece in range(copy * CUTTER_EVERY, len(self._samples), CUTTER_EVERY):
            yield from cutter.feed(self._samples[piece:piece + CUTTER_EVERY])
        yield from cutter.finish()

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
