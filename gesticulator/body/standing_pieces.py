"""The frames of a motion on standing legs in pieces, of which only those are made that have changed.

Legs follow the body through everything before. Their state never forgets a change to the last bit: the hips follow
through low-pass filters, and shifts of weight run on a clock that the movement of the trunk advances. But all that a
frame takes from the past are five numbers, the lead of the hips (`Follower`), and they are cheap: they are made again
from the first changed block to the end. A piece is made again where its lead has changed by so much that a number of
its frames might be rounded to another one. With x(l) a number of a piece before rounding, l its lead, l0 the lead with
which the piece was made, and L a bound on the slope of x(l),

    L max |l - l0| < distance of x(l0) from the nearest place where rounding changes

leaves every number as it is. So the frames are those of the whole motion, bit for bit. The lead and the pieces of one
plan are a run; the last ones are remembered, so that undo makes nothing.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.blocks import KnotPath
from data_module.motion import rotation
from data_module.motion.skeletons import WHOLE_BODY, resized
from data_module.types import Array, Motion
from gesticulator.body.frame_pieces import FramePiece, FramePieces, PieceLayout, PosedBlock
from gesticulator.body.mirror import exchanged_joints, mirrored_motion
from gesticulator.body.page_frames import LEAST, PageFrames, Recent
from gesticulator.body.stance import LEGGED, Course, Follower, Signals, Stance, course_of, joined, on_legs
from gesticulator.bundle.bundle import Bundle
from gesticulator.options import InferenceOptions
from gesticulator.plan.plan import GesturePlan

STEEPEST, STEEPEST_ROOT = 150.0, 5.0
"""Bounds on the slopes of rotations and of the root by the lead, for each metre and degree: a knee, which bends by 5
degrees or more, has 24, and the root 1.2. A frame between two has hardly more than they have."""
RUNS = 8
"""Runs in memory. One of ten minutes at 60 frames a second takes 2 MB."""
_MARK = 128
"""Pieces between two states of a run that are kept."""
_COURSES = 60_000
"""Steps of an hour, with as many that were there before; one takes 1 kB."""
_VARIANTS = 4
"""Pieces that are remembered of one upper body on different legs."""
_TOGETHER = 2000
"""Frames that are put on legs together."""
_SWAPPED, _TURNED = exchanged_joints(WHOLE_BODY.names), np.array([1, 1, -1, -1], np.int16)
_Upper = Callable[[Sequence[int]], Iterator[tuple[int, FramePiece]]]


@dataclass(frozen=True)
class _Variant:
    """A piece and the lead [T, 5] with which it was made, of all frames that it depends on; slack: by how much that may
    differ."""

    piece: FramePiece
    lead: Array
    slack: float

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return self.piece.size + self.lead.nbytes


@dataclass
class _Run:
    """The legs of one plan, as far as they are made. keys: of its pieces; lead: [T, 5] of all frames; states: those
    before some pieces."""

    keys: list[Hashable]
    variants: list[_Variant]
    lead: Array
    states: dict[int, Follower] = field(default_factory=dict)
    before: _Run | None = None
    """The run that this one was like at first, until its pieces are made."""

    def shared(self, keys: Sequence[Hashable]) -> int:
        """How many pieces are the same from the start."""
        return next((at for at, (ours, other) in enumerate(zip(self.keys, keys, strict=False)) if ours != other),
                    min(len(self.keys), len(keys)))

    def cut(self, count: int) -> _Run:
        """A run that goes on after `count` pieces."""
        return _Run(self.keys[:count], self.variants[:count], self.lead.copy(),
                    {at: state for at, state in self.states.items() if at <= count}, replace(self, before=None))


@dataclass(frozen=True)
class _Asked:
    """The pieces that are asked for. blocks: all that they depend on; steps: the numbers of frames, rising from 0,
    between which legs step in the whole motion."""

    layout: PieceLayout
    blocks: Sequence[PosedBlock]
    steps: Sequence[int]

    def span(self, at: int) -> tuple[int, int]:
        """The first frame that a piece depends on, and the one after the last."""
        first, last = self.layout.needed(at)
        if not self.layout.groups:
            return first, last
        groups = [self.layout.frames(group) for group in self.layout.pinned_by(at)]
        return min([first, *(one[0] for one in groups)]), max([last, *(one[1] for one in groups)])

    def steps_of(self, first: int, last: int) -> tuple[tuple[int, int], ...]:
        """The steps with frames from `first` to `last` - 1: their own first frames, and those after their last."""
        begin = bisect_right(self.steps, first) - 1
        end = begin + 1
        while end < len(self.steps) and self.steps[end] < last:
            end += 1
        return tuple(zip(self.steps[begin:end], self.steps[begin + 1:end + 1], strict=True)) if first < last else ()

    def keys(self, count: int) -> list[Hashable]:
        """Everything that the first pieces depend on but for the lead."""
        return [(self.layout.key(at, self.blocks), self.steps_of(*self.span(at))) for at in range(count)]

    def following(self, end: int) -> int:
        """The piece after the last one on whose frames those before `end` depend."""
        if not self.layout.groups and not self.layout.ahead:
            return end
        last = max(self.span(at)[1] for at in range(end)) if self.layout.groups else self.layout.edges[end] + 1
        return max(end, bisect_left(self.layout.edges, min(last, self.layout.count)))


class StandingPieces:
    """Makes the pieces of the motions of one performer on legs. Its methods are those of `FramePieces`."""

    def __init__(self, bundle: Bundle, speaker: int, options: InferenceOptions, page: PageFrames) -> None:
        """See `FramePieces`; the seed of the options is used, too."""
        self._stance = Stance(int(options.seed), float(options.fps))
        self._upper = FramePieces(bundle, speaker, replace(options, mirror=False), page, self._stance)
        self._mirrored, self._page = options.mirrored, page
        self._known = Recent[list[_Variant]]()
        self._courses: dict[tuple[int, int], Course] = {}
        self._joined: OrderedDict[Hashable, Course] = OrderedDict()
        self._steps_of: tuple[PieceLayout, Sequence[int]] | None = None
        self._runs: list[_Run] = []  # the most recently used comes last

    def pieces(self, times: Array, blocks: Sequence[PosedBlock], duration: float, order: Sequence[int],
               plan: GesturePlan | None = None, keys: Sequence[Hashable] | None = None
               ) -> Iterator[tuple[int, FramePiece]]:
        """As `FramePieces.pieces`; all pieces before the last of the order are made."""
        if not len(order):
            return
        asked, count = self._asked(times, blocks, duration, plan), max(order) + 1
        wanted = asked.keys(count) if keys is None else keys[:count]
        run = self._begun(wanted, asked.layout.count)
        if len(run.keys) < count:
            self._extend(run, wanted, asked, partial(self._upper.pieces, times, blocks, duration))
        for at in order:
            yield at, run.variants[at].piece

    def keys(self, times: Array, blocks: Sequence[PosedBlock], duration: float, plan: GesturePlan | None = None
             ) -> list[Hashable]:
        """[N] everything that each piece depends on, but for the body before it."""
        return self._asked(times, blocks, duration, plan).keys(len(times))

    def knows(self, key: Hashable) -> bool:
        """Whether a piece is remembered that depends on this, after any body."""
        return key in self._known

    def reach(self, times: Array, duration: float, plan: GesturePlan | None = None) -> list[int]:
        """[N] the last block on whose poses each piece depends."""
        reach, asked = self._upper.reach(times, duration, plan), self._asked(times, (), duration, plan)
        if not asked.layout.groups and not asked.layout.ahead:
            return reach
        return [max(reach[at:asked.following(at + 1)]) for at in range(len(reach))]

    def stretch(self, times: Array, blocks: Sequence[PosedBlock], duration: float, span: tuple[int, int]
                ) -> tuple[int, Motion]:
        """A draft: the number of the first frame, and the frames, of the blocks of a span (first, last + 1), without
        pins, on legs that begin there."""
        layout = self._upper.layout(times, duration, None)
        first, body = layout.edges[span[0]], self._upper.body(layout, range(*span), blocks)
        follower = Follower(self._stance.seed, self._upper.fps)
        follower.begin(first / self._upper.fps)
        course, signals = self._stance.course(first, first + len(body)), self._stance.signals(resized(body, WHOLE_BODY))
        stands = self._on_legs(body, course, follower.step(signals, course, self._stance.scale))
        return self._upper.as_shown(stands, layout, span)

    def _asked(self, times: Array, blocks: Sequence[PosedBlock], duration: float, plan: GesturePlan | None) -> _Asked:
        layout = self._upper.layout(times, duration, plan)
        if self._steps_of is None or self._steps_of[0] is not layout:
            steps = KnotPath(np.zeros(1), self._upper.fps, self._upper.smoothing).steps(times, layout.count)
            self._steps_of = layout, sorted({0, *steps})
            self._known.least = max(self._known.least, LEAST * layout.size)
        return _Asked(layout, blocks, self._steps_of[1])

    # ------------------------------------------------------------------------------------------------------- runs

    def _begun(self, keys: Sequence[Hashable], frames: int) -> _Run:
        """A run of pieces with these keys, as far as it is known."""
        known = max((run for run in self._runs if len(run.lead) == frames), key=lambda run: run.shared(keys),
                    default=None)
        if known is None:
            run = _Run([], [], np.zeros((frames, 5)), {0: Follower(self._stance.seed, self._upper.fps)})
        elif (shared := known.shared(keys)) in (len(keys), len(known.keys)):  # known, or it goes on
            self._runs.remove(known)
            run = known
        else:
            run = known.cut(shared)
        self._runs = [*self._runs[1 - RUNS:], run]
        return run

    def _extend(self, run: _Run, keys: Sequence[Hashable], asked: _Asked, upper: _Upper) -> None:
        """Make the pieces that a run lacks of those with these keys."""
        begin, end = len(run.keys), len(keys)
        # An error may have ended the making of others.
        run.states = {at: state for at, state in run.states.items() if at <= begin}
        start = max(at for at in run.states if at <= begin)
        bodies = dict(upper(range(start, asked.following(end))))
        self._follow(run, asked, bodies, end)
        found, late = _alike(run, keys, asked.layout), list[int]()
        for at in range(begin, end):
            if at in found:
                continue
            lead = run.lead[slice(*asked.span(at))]
            near = next((one for one in reversed(self._known.use(keys[at]) or ())
                         if np.abs(one.lead - lead).max(initial=0.0) <= one.slack), None)
            if near is None:
                late.append(at)
            else:
                found[at] = near
        for some in _groups(late, asked.layout):
            for at, made in zip(some, self._made(run, asked, bodies, some), strict=True):
                found[at] = self._remember(keys[at], made)
        run.before = None
        run.keys[begin:], run.variants[begin:] = keys[begin:], [found[at] for at in range(begin, end)]

    def _follow(self, run: _Run, asked: _Asked, bodies: Mapping[int, FramePiece], end: int) -> None:
        """Make the lead in the frames of successive pieces. end: the piece after the last one that will be made."""
        edges, numbers = asked.layout.edges, sorted(bodies)
        state = run.states[numbers[0]].fork()
        for first in range(numbers[0], numbers[-1] + 1, _MARK):
            last = min(first + _MARK, numbers[-1] + 1)
            rows = edges[first], edges[last]
            if rows[0] < rows[1]:
                ends = [step - rows[0] for step in asked.steps if rows[0] < step <= rows[1]]
                run.lead[slice(*rows)] = state.step(joined([_signals(bodies[at]) for at in range(first, last)]),
                                                    self._course(asked, rows), self._stance.scale, ends)
            if last <= end:
                run.states[last] = state.fork()

    def _course(self, asked: _Asked, rows: tuple[int, int]) -> Course:
        """What is decided for frames (first, last + 1)."""
        steps = asked.steps_of(*rows)
        if (rows, steps) not in self._joined:
            self._joined[rows, steps] = course_of([
                (self._step(step), slice(max(rows[0], step[0]) - step[0], min(rows[1], step[1]) - step[0]))
                for step in steps])
        self._joined.move_to_end((rows, steps))
        while len(self._joined) > max(_COURSES, asked.layout.size) // 10:
            self._joined.popitem(last=False)
        return self._joined[rows, steps]

    def _step(self, step: tuple[int, int]) -> Course:
        """What is decided for the frames (first, last + 1) of a step."""
        if step not in self._courses:
            while len(self._courses) > _COURSES:
                del self._courses[next(iter(self._courses))]
            self._courses[step] = self._stance.course(*step)
        return self._courses[step]

    # -------------------------------------------------------------------------------------------------- the pieces

    def _remember(self, key: Hashable, made: _Variant) -> _Variant:
        """The variant from now on, with the number of another one whose frames are the same."""
        others = self._known.pop(key) or []
        same = next((one.piece for one in others if _same(one.piece, made.piece)), None)
        made = made if same is None else replace(made, piece=same)
        variants = [*others[1 - _VARIANTS:], made]
        self._known.put(key, variants, sum(one.size for one in variants))
        return made

    def _made(self, run: _Run, asked: _Asked, bodies: Mapping[int, FramePiece], numbers: Sequence[int]
              ) -> Iterator[_Variant]:
        """Pieces of a run, made now."""
        layout = asked.layout
        frames = [layout.needed(at) for at in numbers]
        lead = np.concatenate([run.lead[slice(*one)] for one in frames])
        turns, root = np.zeros((0, len(LEGGED), 4)), np.zeros((0, 3))
        if len(lead):
            course = course_of([(self._course(asked, one), slice(None)) for one in frames if one[0] < one[1]])
            before = np.concatenate([_turns(layout, bodies, at) for at in numbers])
            turns, root = self._stance.stood(before, course, lead)
        turns, begin, pinned = rotation.continuous(turns), 0, dict[int, Array]()
        for at, (first, last) in zip(numbers, frames, strict=True):
            rows = slice(begin, begin + last - first)
            begin = rows.stop
            own = run.lead[slice(*asked.span(at))].copy()
            if layout.groups and layout.pinned_by(at):
                yield _Variant(self._with_pins(run, asked, at, pinned), own, 0.0)
                continue
            shown = layout.shown[at], layout.shown[at + 1]
            legs, places = self._page.turns(turns[rows], first, shown), self._page.places(root[rows], first, shown)
            ends = turns[rows][[0, layout.frames(at)[1] - first - 1] if first < last else []]
            slack = float(_slack(legs, places, self._page.steps).min(initial=np.inf))
            yield _Variant(self._piece(bodies[at], self._page.rounded(legs), ends, places.astype("<f4")), own, slack)

    def _piece(self, body: FramePiece, steps: NDArray[np.int16], ends: Array, root: NDArray[np.float32]) -> FramePiece:
        """A piece with the rotations of the joints that legs turn: [T, 10, 4] as steps, and [2, 10, 4] at its ends."""
        rotations, outer = _whole(body.rotations, self._page.steps), _whole(body.ends, 1.0)
        rotations[:, LEGGED], outer[:, LEGGED] = steps, ends
        if self._mirrored:
            rotations, outer = rotations[:, _SWAPPED] * _TURNED, outer[:, _SWAPPED] * _TURNED
            root = root * np.array([-1.0, 1.0, 1.0], np.float32)
        return FramePiece(body.first, body.last, next(self._page.numbers), rotations, outer, root)

    def _with_pins(self, run: _Run, asked: _Asked, at: int, known: dict[int, Array]) -> FramePiece:
        """A piece under pins. known: [T, J, 4] rotations of groups of pins."""
        from gesticulator.body.pins import with_group

        layout = asked.layout
        first, last = layout.needed(at)
        body = self._body(run, asked, at)
        turns = body.rotations.copy()
        for number in layout.pinned_by(at):
            group = layout.groups[number - layout.size]
            if number not in known:
                known[number] = with_group(self._body(run, asked, number), group).rotations
            low, high = max(first, group.first), min(last, group.last)
            rows, part = slice(low - first, high - first), known[number][low - group.first:high - group.first]
            # On the side of the frames around them.
            turns[rows] = np.where(np.sum(part * turns[rows], axis=-1, keepdims=True) < 0.0, -part, part)
        shown = layout.shown[at], layout.shown[at + 1]
        return FramePiece(*shown, next(self._page.numbers), self._page.rounded(self._page.turns(turns, first, shown)),
                          turns[[0, layout.frames(at)[1] - first - 1]],
                          self._page.places(body.root_positions, first, shown).astype("<f4"))

    def _body(self, run: _Run, asked: _Asked, number: int) -> Motion:
        """The frames that a piece needs, or of a group of pins, without pins."""
        frames = asked.layout.needed(number)
        body = self._upper.body(asked.layout, range(number, number + 1), asked.blocks)
        return self._on_legs(body, self._course(asked, frames), run.lead[slice(*frames)])

    def _on_legs(self, body: Motion, course: Course, lead: Array) -> Motion:
        """An upper body on legs with a lead [T, 5] of the hips."""
        body = resized(body, WHOLE_BODY)
        rotations = body.rotations.copy()
        rotations[:, LEGGED], root = self._stance.stood(rotations[:, LEGGED[:2]], course, lead)
        made = on_legs(body, rotations, root, WHOLE_BODY, rotations[:0])
        return mirrored_motion(made) if self._mirrored else made


def _alike(run: _Run, keys: Sequence[Hashable], layout: PieceLayout) -> dict[int, _Variant]:
    """The pieces of the run before that stay as they are."""
    if run.before is None or layout.groups:
        return {}
    begin, old = len(run.keys), run.before
    same = [at for at in range(begin, min(len(old.keys), len(keys))) if old.keys[at] == keys[at]]
    some = [at for at in same if len(old.variants[at].lead)]
    if not some:
        return {}
    there = np.concatenate([old.variants[at].lead for at in some])
    here = np.concatenate([run.lead[slice(*layout.needed(at))] for at in some])
    starts = np.cumsum([0, *(len(old.variants[at].lead) for at in some[:-1])])
    apart = np.maximum.reduceat(np.abs(here - there).max(axis=1), starts).tolist()
    return {at: old.variants[at] for at, far in zip(some, apart, strict=True) if far <= old.variants[at].slack}


def _signals(piece: FramePiece) -> Signals:
    """What legs follow of a piece without legs."""
    assert piece.signals is not None
    return piece.signals


def _turns(layout: PieceLayout, bodies: Mapping[int, FramePiece], at: int) -> Array:
    """[T, 2, 4] the rotations of hips and spine in the frames that a piece needs."""
    turns, (first, last) = _signals(bodies[at]).turns, layout.needed(at)
    after = at
    while len(turns) < last - first:
        after += 1
        turns = np.concatenate([turns, _signals(bodies[after]).turns[:last - first - len(turns)]])
    return turns


def _whole(rotations: Any, one: float) -> Any:
    """[T, 54, 4] rotations of the whole body: those of a smaller one, [T, J, 4], and others that turn nothing, of which
    w is `one`."""
    whole = np.zeros((len(rotations), len(WHOLE_BODY), 4), rotations.dtype)
    whole[..., 0] = one
    whole[:, :rotations.shape[1]] = rotations
    return whole


def _same(one: FramePiece, other: FramePiece) -> bool:
    return np.array_equal(one.rotations, other.rotations) and np.array_equal(_root(one), _root(other))


def _root(piece: FramePiece) -> NDArray[np.float32]:
    assert piece.root is not None
    return piece.root


def _slack(turns: Array, root: Array, steps: int) -> Array:
    """[T] by how much the lead may differ so that all numbers of rotations [T, J, 4] and the root [T, 3] stay as they
    are when they are rounded to steps, and to single precision."""
    scaled, single = turns * steps, root.astype(np.float32)
    away = 0.5 - np.abs(scaled - np.round(scaled)).max(axis=(1, 2), initial=0.0)
    gaps = np.spacing(np.nextafter(np.abs(single), np.float32(0.0))) / 2.0 - np.abs(root - single)
    return np.maximum(np.minimum(away / steps / STEEPEST, gaps.min(axis=1) / STEEPEST_ROOT), 0.0)


def _groups(numbers: Sequence[int], layout: PieceLayout) -> Iterator[list[int]]:
    """Pieces that are made together."""
    some, frames = list[int](), 0
    for at in numbers:
        first, last = layout.frames(at)
        if some and frames + last - first > _TOGETHER:
            yield some
            some, frames = [], 0
        some.append(at)
        frames += last - first
    if some:
        yield some
