"""The frames of a motion in pieces of one block each, of which only those are computed that were not known before.

Frames are the same bits as those of `MotionPath` for the whole motion: a frame depends on a few knots around it alone.
Numbers and rate are those of the page (`gesticulator.export.html`): quaternions as int16, which a long recording has at
half of the rate of the motion.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from data_module.blocks import KnotPath
from data_module.motion.skeletons import resized
from data_module.types import Array, Motion
from gesticulator.body.clearance import cleared, cleared_poses
from gesticulator.body.mirror import mirrored_motion
from gesticulator.body.page_frames import LEAST, PageFrames, Recent
from gesticulator.body.stance import WHOLE_BODY, Signals, Stance, seated
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.options import InferenceOptions
from gesticulator.plan.plan import GesturePlan

if TYPE_CHECKING:
    from gesticulator.body.pins import PinGroup

MOST_GROUPS = 200
"""Groups of pins whose frames are in memory. One of 1.2 s at 60 frames a second takes 60 kB."""
_TOGETHER = 12
"""Neighbouring pieces that are made together: that takes little longer than to make one of them."""
_MARGIN = 2
"""Knots on either side of those between which a frame lies that its slopes depend on, and one to spare."""


class PosedBlock(Protocol):
    """The poses of a block. times: [K] seconds."""

    times: Array

    @property
    def number(self) -> int:
        """The number of their content."""
        ...

    @property
    def poses(self) -> Array:
        """[K, D_m]"""
        ...


@dataclass(frozen=True)
class FramePiece:
    """Frames `first` to `last` - 1 of the page. number: of their content, but for signs; rotations: [T, J, 4] int16, w
    first; ends: [2, J, 4] the first and the last frame of the motion, before rounding, [0, J, 4] without frames; root:
    [T, 3] its positions, where it moves; signals: what legs follow of the frames of the motion."""

    first: int
    last: int
    number: int
    rotations: NDArray[np.int16]
    ends: Array
    root: NDArray[np.float32] | None = None
    signals: Signals | None = None

    @property
    def size(self) -> int:
        """Bytes in memory, but for what the objects themselves take."""
        root = 0 if self.root is None else self.root.nbytes
        return self.rotations.nbytes + self.ends.nbytes + root + (0 if self.signals is None else self.signals.size)


@dataclass(frozen=True)
class SignedPieces:
    """All pieces of a motion of `frames` frames. signs: [N, J] 1 or -1, the side of each joint's quaternions on which
    they go on from the piece before."""

    frames: int
    pieces: Sequence[FramePiece]
    signs: NDArray[np.int16]

    def rotations(self, at: int) -> NDArray[np.int16]:
        """[T, J, 4] the frames of a piece."""
        return self.pieces[at].rotations * self.signs[at][:, None]

    def changed(self, other: SignedPieces | None) -> list[int]:
        """The pieces with frames that differ from those of another motion of as many frames; all for None."""
        known = {} if other is None else {
            (piece.first, piece.last): (piece.number, signs.tobytes())
            for piece, signs in zip(other.pieces, other.signs, strict=True)}
        return [at for at, (piece, signs) in enumerate(zip(self.pieces, self.signs, strict=True))
                if piece.last > piece.first and known.get((piece.first, piece.last)) != (piece.number, signs.tobytes())]


@dataclass(frozen=True)
class PieceLayout:
    """Of N pieces, and of the frames of G groups of pins. edges: [N + 1] frames of the pieces in the motion; shown:
    [N + 1] and in the page; ahead: frames after its last one on which a piece depends; first, last: [N + G] the blocks
    whose poses a piece or group depends on; begins: [N + G] whether it depends on the beginning; count: of all frames
    of the motion; groups: [G]."""

    edges: Sequence[int]
    shown: Sequence[int]
    ahead: int
    first: Sequence[int]
    last: Sequence[int]
    begins: Sequence[bool]
    count: int
    groups: Sequence[PinGroup] = ()

    @property
    def size(self) -> int:
        """N"""
        return len(self.edges) - 1

    def frames(self, at: int) -> tuple[int, int]:
        """The first frame of a piece or group and the one after its last."""
        if at < self.size:
            return self.edges[at], self.edges[at + 1]
        group = self.groups[at - self.size]
        return group.first, group.last

    def needed(self, at: int) -> tuple[int, int]:
        """The first frame on which those of a piece in the page depend, and the one after the last; those of a
        group."""
        first, last = self.frames(at)
        return first, min(last + self.ahead, self.count) if first < last and at < self.size else last

    def pinned_by(self, at: int) -> list[int]:
        """The groups, as numbers from N on, that change frames on which a piece depends."""
        first, last = self.needed(at)
        return [self.size + number for number, group in enumerate(self.groups)
                if group.first < last and group.last > first]

    def key(self, at: int, blocks: Sequence[PosedBlock]) -> Hashable:
        """Everything that a piece depends on."""
        near = self.pinned_by(at) if self.groups else ()
        own = self._key(at, blocks)
        return (*own, tuple([self.group_key(number, blocks) for number in near])) if near else own

    def group_key(self, at: int, blocks: Sequence[PosedBlock]) -> Hashable:
        """Everything that the frames of a group of pins depend on."""
        return (*self._key(at, blocks), self.groups[at - self.size])

    def _key(self, at: int, blocks: Sequence[PosedBlock]) -> tuple[Hashable, ...]:
        first, last = self.first[at], self.last[at]
        end = self.count if last + 2 > self.size else 0
        return tuple([block.number for block in blocks[first:last + 1]]), *self.frames(at), end


class FramePieces:
    """Makes the pieces of the motions of one performer."""

    def __init__(self, bundle: Bundle, speaker: int, options: InferenceOptions, page: PageFrames,
                 stance: Stance | None = None) -> None:
        """options: fps, seated and mirror are used; stance: legs that follow the pieces."""
        self._representation = representation_of(bundle.config)
        self._first: Array = bundle.statistics.rest_pose[speaker]
        self.smoothing, self.fps = bundle.config.motion.smoothing, float(options.fps)
        self._seated, self._mirrored, self._page = options.seated, options.mirrored, page
        self._known = Recent[FramePiece]()
        self._stance = stance
        self._pinned: dict[Hashable, Array] = {}
        self._layouts: list[tuple[Array, float, GesturePlan | None, PieceLayout]] = []

    def pieces(self, times: Array, blocks: Sequence[PosedBlock], duration: float, order: Sequence[int],
               plan: GesturePlan | None = None, keys: Sequence[Hashable] | None = None
               ) -> Iterator[tuple[int, FramePiece]]:
        """The number and the piece of each of the blocks in `order`, of N blocks with knots at `times` [N, K] seconds
        and of these poses; of the first blocks alone where the pieces do not depend on others (`reach`). plan: its pins
        are applied; keys: see `keys`."""
        layout, left = self.layout(times, duration, plan), deque(order)

        def key_of(at: int) -> Hashable:
            return layout.key(at, blocks) if keys is None else keys[at]

        while left:
            at = left.popleft()
            key = key_of(at)
            if (known := self._known.use(key)) is not None:
                yield at, known
                continue
            lacking = [key]
            while left and left[0] == at + len(lacking) and len(lacking) < _TOGETHER:
                key = key_of(left[0])
                if key in self._known:
                    break
                lacking.append(key)
                left.popleft()
            # Neighbours share most of what is computed for them.
            body = self.body(layout, range(at, at + len(lacking)), blocks)
            signals = None if self._stance is None else self._stance.signals(resized(body, WHOLE_BODY))
            begin = layout.frames(at)[0]
            for number, key in enumerate(lacking, at):
                (first, last), needed = layout.frames(number), layout.needed(number)
                turns = self._pinned_turns(layout, number, blocks, body.rotations[needed[0] - begin:needed[1] - begin])
                yield number, self._remember(key, layout, number, turns,
                                             signals and signals.part(slice(first - begin, last - begin)))

    def stretch(self, times: Array, blocks: Sequence[PosedBlock], duration: float, span: tuple[int, int]
                ) -> tuple[int, Motion]:
        """The number of the first frame in the page, and the frames, of the blocks of a span (first, last + 1), without
        pins."""
        layout = self.layout(times, duration, None)
        return self.as_shown(self.body(layout, range(*span), blocks), layout, span)

    def as_shown(self, body: Motion, layout: PieceLayout, span: tuple[int, int]) -> tuple[int, Motion]:
        """The number of the first frame in the page, and the frames, of a motion of the pieces of a span (first, last +
        1)."""
        shown, begin = (layout.shown[span[0]], layout.shown[span[1]]), layout.edges[span[0]]
        return shown[0], replace(body, rotations=self._page.turns(body.rotations, begin, shown), fps=self._page.fps,
                                 root_positions=self._page.places(body.root_positions, begin, shown))

    def learn(self, times: Array, blocks: Sequence[PosedBlock], duration: float, rotations: Array,
              plan: GesturePlan | None = None) -> SignedPieces:
        """Remember the pieces of a motion that is known: [T, J, 4] rotations, w first, at its rate."""
        layout = self.layout(times, duration, plan)
        made = list[FramePiece]()
        for at in range(len(times)):
            key = layout.key(at, blocks)
            made.append(self._known.use(key) or
                        self._remember(key, layout, at, rotations[slice(*layout.needed(at))]))
        return signed(made)

    def keys(self, times: Array, blocks: Sequence[PosedBlock], duration: float, plan: GesturePlan | None = None
             ) -> list[Hashable]:
        """[N] everything that each piece depends on."""
        layout = self.layout(times, duration, plan)
        return [layout.key(at, blocks) for at in range(len(times))]

    def knows(self, key: Hashable) -> bool:
        """Whether the piece is remembered that depends on this alone."""
        return key in self._known

    def reach(self, times: Array, duration: float, plan: GesturePlan | None = None) -> list[int]:
        """[N] the last block on whose poses each piece depends."""
        layout = self.layout(times, duration, plan)
        return [max([layout.last[at], *(layout.last[group] for group in layout.pinned_by(at))])
                for at in range(len(times))]

    def layout(self, times: Array, duration: float, plan: GesturePlan | None) -> PieceLayout:
        """The layout of blocks with knots at `times`. The last ones are remembered by these very objects."""
        known = next((made for *asked, made in self._layouts if asked[0] is times and asked[1] == duration
                      and asked[2] is plan), None)
        if known is None:
            known = self._laid_out(times, duration, plan)
            self._known.least = max(self._known.least, LEAST * known.size)
            self._layouts = [*self._layouts[-1:], (times, duration, plan, known)]
        return known

    def _laid_out(self, times: Array, duration: float, plan: GesturePlan | None) -> PieceLayout:
        flat = np.concatenate([[0.0], times.ravel()])
        knots, count = times.shape[1], max(1, round(duration * self.fps))
        edges = [0, *np.minimum(np.ceil(times[:-1, -1] * self.fps - 1e-9), count).astype(int).tolist(), count]
        groups = self._groups(plan, count)
        half = round(KnotPath(self._first, self.fps, self.smoothing).reach * self.fps) + 1
        begins = np.maximum(np.array([*edges[:-1], *(group.first for group in groups)]) - half, 0) / self.fps
        ahead = self._page.ahead
        stops = (np.array([*(edge + ahead for edge in edges[1:]), *(group.last for group in groups)]) - 1
                 + half) / self.fps
        # What is mirrored at the end of the recording lies before it.
        begins = np.where(stops > (count - 1) / self.fps, np.minimum(begins, (count - 1 - 2 * half) / self.fps), begins)
        low = np.searchsorted(flat, begins, side="right") - 1 - _MARGIN
        high = np.minimum(np.searchsorted(flat, stops, side="right") + _MARGIN, len(flat))
        first, last = np.maximum(low - 1, 0) // knots, (high - 2) // knots
        return PieceLayout(tuple(edges), self._page.edges(edges), ahead, first.tolist(), last.tolist(),
                           (low <= 0).tolist(), count, groups)

    def _groups(self, plan: GesturePlan | None, count: int) -> Sequence[PinGroup]:
        if plan is None or not plan.pins:
            return ()
        from gesticulator.body.pins import pin_groups

        return pin_groups(plan, self.fps, count)

    def _remember(self, key: Hashable, layout: PieceLayout, at: int, turns: Array, signals: Signals | None = None
                  ) -> FramePiece:
        """A piece with these rotations [T, J, 4] of the frames that it needs, from now on."""
        (first, last), shown = layout.frames(at), (layout.shown[at], layout.shown[at + 1])
        ends = turns[[0, last - first - 1]] if len(turns) else turns
        made = FramePiece(*shown, next(self._page.numbers),
                          self._page.rounded(self._page.turns(turns, first, shown)), ends, signals=signals)
        self._known.put(key, made, made.size)
        return made

    def _pinned_turns(self, layout: PieceLayout, at: int, blocks: Sequence[PosedBlock], turns: Array) -> Array:
        """The rotations [T, J, 4] of a piece with those of its pins."""
        (first, last), near = layout.needed(at), layout.pinned_by(at)
        for number in near:
            group, moved = layout.groups[number - layout.size], self._with_pins(layout, number, blocks)
            low, high = max(first, group.first), min(last, group.last)
            turns = turns if number != near[0] else turns.copy()
            rows, part = slice(low - first, high - first), moved[low - group.first:high - group.first]
            # On the side of the frames around them.
            turns[rows] = np.where(np.sum(part * turns[rows], axis=-1, keepdims=True) < 0.0, -part, part)
        return turns

    def _with_pins(self, layout: PieceLayout, number: int, blocks: Sequence[PosedBlock]) -> Array:
        """[T, J, 4] rotations of the frames of a group of pins."""
        from gesticulator.body.pins import with_group

        key = layout.group_key(number, blocks)
        if key not in self._pinned:
            body = self.body(layout, range(number, number + 1), blocks)
            made = with_group(body, layout.groups[number - layout.size]).rotations
            while len(self._pinned) >= MOST_GROUPS:
                self._pinned.pop(next(iter(self._pinned)))
            self._pinned[key] = made
        return self._pinned[key]

    def body(self, layout: PieceLayout, numbers: range, blocks: Sequence[PosedBlock]) -> Motion:
        """The frames of the motion that neighbouring pieces need, or a group, without pins."""
        first = min([layout.first[at] for at in numbers])
        near, begins = blocks[first:layout.last[numbers[-1]] + 1], any(layout.begins[at] for at in numbers)
        frames = layout.frames(numbers[0])[0], max([layout.needed(at)[1] for at in numbers])
        return self._placed(self._upper_body(near, begins, frames, layout.count))

    def _upper_body(self, blocks: Sequence[PosedBlock], begins: bool, frames: tuple[int, int], count: int) -> Motion:
        """Some frames of `count`; begins: whether the blocks are the first ones."""
        times = np.concatenate([block.times for block in blocks])
        poses = cleared_poses(np.concatenate([block.poses for block in blocks]), self._representation,
                              self._seated)
        if begins:
            times, poses = np.concatenate([[0.0], times]), np.concatenate([self._first[None], poses])
        path = KnotPath(self._first, self.fps, self.smoothing)
        path.rewind(times, poses, frames[0])
        return cleared(self._representation.motion(path.frames(*frames, count), self.fps), self._seated)

    def _placed(self, body: Motion) -> Motion:
        """The body on its seat, and mirrored, where that is asked for."""
        body = seated(body) if self._seated else body
        return mirrored_motion(body) if self._mirrored else body


def signed(pieces: Sequence[FramePiece]) -> SignedPieces:
    """All pieces of a motion, in order."""
    joints = pieces[0].ends.shape[1]
    signs = np.ones((len(pieces), joints), np.int16)
    filled = [at for at, piece in enumerate(pieces) if len(piece.ends)]
    if filled:
        ends = np.stack([pieces[at].ends for at in filled])
        dots = np.sum(ends[1:, 0] * ends[:-1, 1], axis=-1)
        signs[filled] = np.cumprod(np.concatenate([np.ones((1, joints)), np.where(dots < 0, -1.0, 1.0)]), axis=0)
    return SignedPieces(pieces[-1].last, pieces, signs)
