"""Rendering of one recording's plans while they are edited; each edit costs only the blocks that it changes.

A page has a motion and its plan, a *rendering* with a number. It sends what it changed in the plan, and gets the frames
that changed, and what was decided in the plan. An answer is a sequence of messages: the length of a header (4 bytes,
little-endian), the header as JSON, and as many bytes as its `bytes` says.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.controls import FEATURES
from data_module.errors import InputError, one_line
from data_module.motion.skeletons import resized, standing
from gesticulator.body.frame_pieces import FramePiece, FramePieces, SignedPieces, signed
from gesticulator.body.mirror import mirrored_motion
from gesticulator.body.page_frames import PageFrames
from gesticulator.body.stance import WHOLE_BODY, seated
from gesticulator.body.standing_pieces import StandingPieces
from gesticulator.bundle.features import representation_of
from gesticulator.directing.directions import check_plan_of, planned
from gesticulator.directing.editing import PlayedBlock
from gesticulator.directing.record import fingerprinted, named, rendered_plan
from gesticulator.directing.shaped_blocks import ShapedBlock, ShapedBlocks
from gesticulator.export.html import QUATERNION_STEPS, describe_shape, page_fps, root_path, shown
from gesticulator.options import InferenceOptions
from gesticulator.performance import Performance
from gesticulator.plan.plain import to_plain
from gesticulator.plan.plan import Block, GesturePlan, sound_hash
from gesticulator.plan.plan_file import plan_from
from gesticulator.serve.page_server import AbandonedError, UnknownRenderingError

if TYPE_CHECKING:
    from data_module.types import Array, Blocks, Motion
    from gesticulator.bundle.bundle import Bundle
    from gesticulator.directing.editing import PlanRenderer
    from gesticulator.pipeline import Gesticulator
    from gesticulator.sampling.loop import BlockMotion

MOST_DRAWINGS = 4
"""First generations in memory: for the takes of a page, and for plans that were opened from files since."""
MOST_RENDERINGS, LEAST_RENDERINGS, RENDERED = 64, 8, 512 << 20
"""Renderings in memory that a page may build on; how few are left where the frames of all take more bytes than the
third number. Their frames are shared where they are equal. A page whose rendering is forgotten sends its whole plan."""
_PIECE = 20
"""Frames of a piece of a motion that is always made as a whole."""
REPORTS = 24
"""Blocks between two reports of progress: about a second."""
FIRST_SHOWN = 24
"""Pieces outside of the visible stretch from which on that stretch is sent first: they take a tenth of a second."""
MANY = 120
"""Blocks that knobs have changed from which on their poses are computed with the frames of their stretch; fewer are
computed first, a tenth of a second, and most prove to be as they were."""
STRETCH = 60
"""Pieces of a stretch that is sent as soon as it is made, after the visible one: about 20 s of motion, which take a
quarter of a second."""


@dataclass(frozen=True)
class KnownMotion:
    """A motion that a page has. plain: its plan, as the page has it; shape: what the page knows of the motion apart
    from its numbers; root: the path of the root."""

    number: int
    plain: Mapping[str, Any]
    shape: Mapping[str, Any]
    pieces: SignedPieces
    root: bytes
    size: int = 0
    """Bytes of its pieces that the motion before it did not have."""


@dataclass(frozen=True)
class _Maker:
    """What makes the frames of the plans of one first generation. pieces: by the options that they depend on."""

    renderer: PlanRenderer
    shaped: ShapedBlocks
    pieces: dict[tuple[Any, ...], FramePieces | StandingPieces]


@dataclass(frozen=True)
class _Asked:
    """plan, plain: the plan that the page asked for, and as plain values; have: the rendering that the page has; view:
    the visible stretch, seconds; abandoned: whether the page has asked for something else; done: takes the rendered
    plan; sent: by block, the pieces that were sent to the page last; rough: the frames (first, last + 1) of which it
    was sent others before."""

    plan: GesturePlan
    plain: Mapping[str, Any]
    have: KnownMotion | None
    view: tuple[float, float]
    abandoned: Callable[[], bool]
    done: Callable[[GesturePlan], None]
    sent: dict[int, FramePiece] = field(default_factory=dict)
    rough: list[tuple[int, int]] = field(default_factory=list)

    def check(self) -> None:
        """`AbandonedError` if the answer is not wanted any more."""
        if self.abandoned():
            raise AbandonedError

    def on_block(self, done: int, total: int) -> None:
        """`check` (`OnBlock`)."""
        self.check()

    @property
    def has_legs(self) -> bool:
        """Whether the page has a motion on standing legs."""
        return self.have is not None and _legs_of(self.have.plain) == "standing"

    @cached_property
    def _known(self) -> dict[tuple[int, int], int]:
        """The numbers of the pieces that the page had at first."""
        return {} if self.have is None else {(piece.first, piece.last): piece.number
                                             for piece in self.have.pieces.pieces}

    def differs(self, piece: FramePiece) -> bool:
        """Whether the page may have other frames than those of a piece, apart from signs."""
        known = self._known.get((piece.first, piece.last)) == piece.number
        return piece.last > piece.first and not (known and not self._was_rough(piece))

    def _was_rough(self, piece: FramePiece) -> bool:
        return any(first < piece.last and piece.first < last for first, last in self.rough)

    def lacking(self, pieces: SignedPieces, have: KnownMotion | None) -> list[int]:
        """The pieces that a page which began with the motion `have` lacks at the end of the answer."""
        rough = {at for at, piece in enumerate(pieces.pieces) if self.rough and self._was_rough(piece)}
        wanted = sorted({*pieces.changed(None if have is None else have.pieces), *rough})
        sent = {at: piece.number for at, piece in self.sent.items()}
        return [at for at in wanted if sent.get(at) != pieces.pieces[at].number or (pieces.signs[at] < 0).any()]

    def now_rough(self) -> None:
        """What was sent is not what will be there."""
        ends = sorted((piece.first, piece.last) for piece in self.sent.values())
        for first, last in ends:
            if self.rough and self.rough[-1][1] == first:
                self.rough[-1] = self.rough[-1][0], last
            else:
                self.rough.append((first, last))
        self.sent.clear()


def _noted(playing: Iterator[PlayedBlock], played: list[PlayedBlock]) -> Iterator[PlayedBlock]:
    """The same blocks. played: receives them."""
    for block in playing:
        played.append(block)
        yield block


def _performed(performing: Generator[tuple[Blocks, Sequence[BlockMotion]], None, Performance], renderer: PlanRenderer,
               asked: _Asked, made: list[Performance]) -> Iterator[PlayedBlock]:
    """The blocks of a performance as they are drawn, as far as they are cut as those of the plan that was asked for.
    made: receives the performance."""
    edges = np.array([0.0, *(block.end for block in asked.plan.blocks)])
    try:
        while True:
            cut, blocks = next(performing)
            asked.check()
            if np.array_equal(cut.edges, edges):
                yield renderer.plays(blocks[-1])
    except StopIteration as ended:
        made.append(ended.value)


class LivePlans:
    """Renders plans of the recording of performances. Not thread-safe."""

    def __init__(self, system: Gesticulator, *performances: Performance) -> None:
        """performances: one or more of the recording; the sound and words of the first are used, and the first
        generations that they kept (`Gesticulator.keeps_drawings`)."""
        first = performances[0]
        self._system, self._speech, self._name = system, first.speech, first.sound_name
        self._sound = sound_hash(first.speech)
        self._makers: list[tuple[tuple[Any, ...], _Maker]] = []  # the most recently used comes last
        self._drawings = [(_identity(one.decided), one.drawing) for one in performances if one.drawing is not None]
        self._renderings: OrderedDict[int, KnownMotion] = OrderedDict()
        self.on_edit: Callable[[Mapping[str, Any], GesturePlan], None] = lambda request, plan: None
        """Called with the request and the rendered plan after each answer."""
        self._count = 0
        self._numbers = itertools.count()

    @property
    def speakers(self) -> tuple[str, ...]:
        """The names of the performers."""
        return self._system.speakers

    def render(self, plan: GesturePlan) -> Performance:
        """Render a plan; `InputError` with the line if it is invalid or of another recording."""
        options = planned(InferenceOptions(plan=plan))
        performance = self._system.render(self._speech, options, self._maker(options).renderer)
        return performance.labelled(self._name, plan.notes)

    def performance(self, plain: Mapping[str, Any]) -> Performance:
        """The performance of a plan in plain values; `InputError` as in `render`."""
        return self.render(plan_from(plain))

    def opened(self, performance: Performance, plain: Mapping[str, Any]) -> int:
        """The number of the rendering that a page begins with. plain: its plan, as the page has it."""
        plan = performance.plan()
        options = planned(InferenceOptions(plan=plan))
        scene = performance.scene()
        motion = shown(scene)
        shape, root = describe_shape(motion, scene.duration), root_path(motion)
        if not self._in_pieces(options):
            return self._kept(plain, shape, whole_motion(motion), root).number
        maker = self._maker(options)
        assert options.plan is not None
        played, cut = maker.renderer.played(options.plan), maker.renderer.cut(options.plan)
        posed = list(maker.shaped.blocks(played, cut, self._shaping(options, cut.edges)))
        times, frames = cut.knot_times.reshape(len(cut), -1), self._frames(maker, options)
        if isinstance(frames, FramePieces):
            pieces = frames.learn(times, posed, float(cut.edges[-1]), scene.standing.rotations,
                                  options.plan)
        else:
            made = frames.pieces(times, posed, float(cut.edges[-1]), range(len(cut)), options.plan)
            pieces = signed([piece for _, piece in made])
        return self._kept(plain, shape, pieces, root).number

    def answer(self, request: Mapping[str, Any], abandoned: Callable[[], bool] = lambda: False) -> Iterator[bytes]:
        """The messages that answer a page.

        request: `have`, the number of the rendering that the page has, or null; `plan`, the plan, or `changes` of the
        plan of that rendering (`plan_with`); `view`, the visible stretch, seconds. abandoned: asked now and then; ends
        the rendering with `AbandonedError`. `InputError` for an invalid plan or unknown rendering.
        """
        have = self._renderings.get(request["have"]) if request.get("have") is not None else None
        if "plan" in request:
            plain = request["plan"]
        elif have is None:
            raise UnknownRenderingError("the page", "has a motion that is not known here any more",
                                        "send the whole plan")
        else:
            plain = plan_with(have.plain, request["changes"])
        plan = plan_from(plain)
        options = planned(InferenceOptions(plan=plan))
        assert options.plan is not None
        check_plan_of(self._system.bundle, options.plan, self._sound)
        asked = _Asked(plan, plain, have, _view(request), abandoned, lambda made: self.on_edit(request, made))
        parts = self._messages(options, asked)
        # What is wrong with a plan may be found after parts of the answer were sent.
        begun = False
        try:
            for part in parts:
                yield part
                begun = True
        except InputError as error:
            if not begun:
                raise
            yield message({"kind": "failed", "ranges": [], "error": one_line(error)})

    def _chosen_anew(self, options: InferenceOptions, asked: _Asked) -> Generator[bytes, None, GesturePlan]:
        """The plan of the options with the lexemes that its interpreter chooses. Locked blocks, and the size and side
        of the others, stay where the beats are those that were found. Yields a draft of the visible stretch, and then
        the frames as they are drawn, without what is locked."""
        plan, before = asked.plan, {(block.start, block.end): block for block in asked.plan.blocks}
        free = planned(InferenceOptions(plan=replace(plan, blocks=tuple(
            [block if block.locked else replace(block, lexeme=None) for block in plan.blocks]))))
        maker, made = self._new_maker(free), list[Performance]()
        yield from self._drafted(maker, free, asked)
        performing = self._system.performing(self._speech, replace(
            options, plan=None, cues=(), interpreter=plan.interpreter, variation=plan.variation, temperature=None,
            beta=None, gain=0.0, legs=False, seated=False))
        yield from self._as_drawn(maker, free, asked, _performed(performing, maker.renderer, asked, made))
        chosen = made[0].plan()
        # What was sent is not what will be there, where blocks are locked.
        asked.now_rough()
        settings = {**plan.made_by["settings"], **{
            name: value for name, value in chosen.made_by["settings"].items() if name in ("temperature", "beta")}}
        if "beta" not in chosen.made_by["settings"]:
            settings.pop("beta", None)

        def kept(block: Block) -> Block:
            old = before.get((block.start, block.end))
            if old is None or old.locked:
                return old or block
            return replace(block, intensity=old.intensity, mirror=old.mirror)

        decided = replace(chosen, made_by={**plan.made_by, "settings": settings}, sound=plan.sound, knobs=plan.knobs,
                          blocks=tuple([kept(block) for block in chosen.blocks]), cues=plan.cues,
                          meanings=plan.meanings, pins=plan.pins, curves=plan.curves, notes=plan.notes,
                          alignment=plan.alignment)
        if made[0].drawing is not None:
            self._drawings = [*self._drawings, (_identity(decided), made[0].drawing)][-MOST_DRAWINGS:]
        return decided

    def _messages(self, options: InferenceOptions, asked: _Asked) -> Iterator[bytes]:
        if asked.have is not None and _another_interpreter(asked.plain, asked.have.plain):
            decided = yield from self._chosen_anew(options, asked)
            options = planned(InferenceOptions(plan=decided))
        plan = options.plan
        assert plan is not None
        maker = self._maker(options)
        played: list[PlayedBlock] = []
        if self._system.bundle.system.BLOCKS:
            yield from self._drafted(maker, options, asked)
            played = yield from self._as_drawn(maker, options, asked, maker.renderer.playing(plan, asked.on_block))
        if self._in_pieces(options):
            made = self._decided(options, played)
            pieces = yield from self._pieces(maker, options, played, asked)
            shape, root = self._shape(options)
            root = _root_of(pieces.pieces) if _is_standing(options) else root
        else:
            asked.check()
            performance = self.render(plan)
            scene = performance.scene()
            made, motion = performance.plan(), shown(scene)
            pieces, shape, root = whole_motion(motion), describe_shape(motion, scene.duration), root_path(motion)
        have = asked.have if asked.have is not None and asked.have.shape == shape else None
        changes = changes_of(made, asked.plan)
        plain = plan_with(asked.plain, changes)
        rendering = self._kept(plain, shape, pieces, root)
        ranges, data = frames_of(pieces, asked.lacking(pieces, have))
        asked.done(made)
        rooted = have is not None and have.root == root
        yield message({"kind": "done", "rendering": rendering.number, "shape": None if have else shape,
                       "changes": changes, "ranges": ranges, "root": 0 if rooted else len(root)},
                      data + (b"" if rooted else root))

    def _shape(self, options: InferenceOptions) -> tuple[dict[str, Any], bytes]:
        """What a page knows of a motion that is made in pieces, and the path of its root."""
        representation, page = representation_of(self._system.bundle.config), self._page_frames(options)
        frames = page.count(max(1, round(self._speech.duration * page.made)))
        rest = self._system.bundle.statistics.rest_pose[self._system.speaker_index(options.speaker)]
        body = representation.motion(rest[None], page.fps)
        body = standing(seated(body) if options.seated else body)
        body = resized(body, WHOLE_BODY) if _is_standing(options) else body
        body = mirrored_motion(body) if options.mirrored else body
        shape = {**describe_shape(body, self._speech.duration), "frames": frames}
        return shape, root_path(body)

    def _drafted(self, maker: _Maker, options: InferenceOptions, asked: _Asked) -> Iterator[bytes]:
        """A draft of the visible stretch, where the recording has to be drawn, or put on its legs, from its start."""
        plan, renderer = options.plan, maker.renderer
        assert plan is not None
        stands = _is_standing(options) and not asked.has_legs
        drawn = renderer.knows(plan)
        if (drawn and not stands) or not (self._in_pieces(options) if stands else self._streams(options, asked)):
            return
        if drawn:
            found = renderer.played(plan), _seen(plan, asked.view)
        else:
            others = [renderer, *(known.renderer for _, known in reversed(self._makers))]
            found = next(filter(None, (renderer.draft(plan, asked.view, other) for other in others)), ([], (0, 0)))
        played, seen = found
        if seen[0] < seen[1]:
            cut = renderer.cut(plan)
            posed = list(maker.shaped.blocks(played, cut, self._shaping(options, cut.edges)))
            yield self._draft(maker, options, asked, posed, seen)

    def _draft(self, maker: _Maker, options: InferenceOptions, asked: _Asked, posed: Sequence[ShapedBlock],
               seen: tuple[int, int]) -> bytes:
        """The message with a draft of the blocks of a span."""
        assert options.plan is not None
        cut = maker.renderer.cut(options.plan)
        times, frames = cut.knot_times.reshape(len(cut), -1), self._frames(maker, options)
        first, body = frames.stretch(times, posed, float(cut.edges[-1]), seen)
        asked.rough.append((first, first + len(body)))
        header: dict[str, Any] = {"kind": "frames", "ranges": [asked.rough[-1]], "share": 0.0}
        data = np.round(body.rotations * QUATERNION_STEPS).astype("<i2").tobytes()
        if not _is_standing(options):
            return message(header, data)
        roots = body.root_positions.astype("<f4").tobytes()
        if not asked.has_legs:
            header["shape"] = self._shape(options)[0]
        return message({**header, "roots": len(roots)}, data + roots)

    def _as_drawn(self, maker: _Maker, options: InferenceOptions, asked: _Asked, playing: Iterator[PlayedBlock]
                  ) -> Generator[bytes, None, list[PlayedBlock]]:
        """All blocks of `playing`; where the recording has to be drawn, yields the frames as far as they are drawn, or
        how far it is where a page cannot take them yet."""
        plan, played = options.plan, list[PlayedBlock]()
        assert plan is not None
        if maker.renderer.knows(plan):
            return list(playing)
        cut, count, streams = maker.renderer.cut(plan), len(plan.blocks), self._streams(options, asked)
        times, duration = cut.knot_times.reshape(len(cut), -1), float(cut.edges[-1])
        frames, posed, ready = self._frames(maker, options), list[ShapedBlock](), 0
        reach = frames.reach(times, duration, plan) if streams else []
        for block in maker.shaped.blocks(_noted(playing, played), cut, self._shaping(options, cut.edges)):
            posed.append(block)
            if len(posed) % REPORTS or len(posed) == count:
                continue
            pieces: list[tuple[int, FramePiece]] = []
            if streams:
                end = next(at for at in range(ready, count) if reach[at] >= len(posed))
                pieces = [(at, piece) for at, piece in frames.pieces(times, posed, duration, range(ready, end), plan)
                          if asked.differs(piece)]
                ready = end
            asked.sent.update(pieces)
            if pieces:
                yield _unsigned([piece for _, piece in pieces], len(posed) / count)
            else:
                yield message({"kind": "progress", "ranges": [], "share": round(len(posed) / count, 3)})
        return played

    def _streams(self, options: InferenceOptions, asked: _Asked) -> bool:
        """Whether frames may be sent before the end of the answer: not where they are made as a whole, nor to a page
        that has another number of them or of joints, as after legs."""
        if not self._in_pieces(options):
            return False
        shape = self._shape(options)[0]
        return asked.have is None or asked.have.shape == shape or bool(asked.rough and _is_standing(options))

    def _pieces(self, maker: _Maker, options: InferenceOptions, played: Sequence[PlayedBlock], asked: _Asked
                ) -> Generator[bytes, None, SignedPieces]:
        """The pieces of a plan; where they take long, yields those of the visible stretch first, and then stretch by
        stretch, the nearest to it first."""
        assert options.plan is not None
        cut = maker.renderer.cut(options.plan)
        times, duration = cut.knot_times.reshape(len(cut), -1), float(cut.edges[-1])
        posed = list(maker.shaped.blocks(played, cut, self._shaping(options, cut.edges)))
        frames = self._frames(maker, options)
        fresh = [at for at, block in enumerate(posed) if not block.is_known]
        keys = frames.keys(times, posed, duration, options.plan) if len(fresh) < MANY else None
        if keys is not None:
            lacking = [at for at, key in enumerate(keys) if not frames.knows(key)]
        else:  # their poses are not computed before their turn
            lacking = sorted({near for at in fresh for near in range(max(at - 2, 0), min(at + 3, len(cut)))})
        seen = [at for at in lacking if cut.edges[at + 1] > asked.view[0] and cut.edges[at] < asked.view[1]]
        stretches = [list(range(len(cut)))]
        if len(lacking) - len(seen) >= FIRST_SHOWN and seen and self._streams(options, asked):
            if isinstance(frames, StandingPieces):  # legs come from what was before
                if not asked.rough:
                    yield self._draft(maker, options, asked, posed, (seen[0], seen[-1] + 1))
                stretches = [*_in_order(lacking), stretches[0]]
            else:
                # The last stretch is sent with the end of the answer, which has what is left to say of all of them.
                stretches = [seen, *_nearest_first(lacking, seen), stretches[0]]
        found, done = dict[int, FramePiece](), 0
        for stretch in stretches:
            for at, piece in frames.pieces(times, posed, duration, stretch, options.plan, keys):
                found[at] = piece
                if at % 8 == 0:
                    asked.check()
            if stretch is not stretches[-1]:
                fresh = [at for at in stretch if asked.differs(found[at])]
                asked.sent.update((at, found[at]) for at in fresh)
                done += len(stretch)
                if fresh:
                    yield _unsigned([found[at] for at in fresh], done / len(lacking))
                asked.check()
        return signed([found[at] for at in range(len(cut))])

    def _decided(self, options: InferenceOptions, played: Sequence[PlayedBlock]) -> GesturePlan:
        """The plan of the options with what was decided in its blocks."""
        plan = options.plan
        assert plan is not None
        cast = self._system.cast(options, self._system.reads_words_of(self._speech))
        origin = self._system.origin(self._speech, options, cast, plan.meanings)
        made = rendered_plan(plan, self._speech, [one.block for one in played], origin)
        made = replace(made, notes=plan.notes, sound=replace(made.sound, name=self._name))
        return named(fingerprinted(made, self._speech), self._system.lexeme_names())

    def _shaping(self, options: InferenceOptions, edges: Array) -> Any:
        assert options.plan is not None
        speaker = self._system.speaker_index(options.speaker)
        return self._system.shaping(self._speech, options, speaker, edges, options.plan.meanings)

    def _in_pieces(self, options: InferenceOptions) -> bool:
        """Whether frames are made in pieces."""
        bundle = self._system.bundle
        return bundle.system.BLOCKS and representation_of(bundle.config).name == "rotations"

    def _page_frames(self, options: InferenceOptions) -> PageFrames:
        """How the page has the frames of a motion."""
        made = float(options.fps)
        return PageFrames(made, page_fps(self._speech.duration, made), QUATERNION_STEPS, self._numbers)

    def _kept(self, plain: Mapping[str, Any], shape: Mapping[str, Any], pieces: SignedPieces, root: bytes
              ) -> KnownMotion:
        self._count += 1
        known = self._renderings.get(self._count - 1)
        before = {piece.number for piece in known.pieces.pieces} if known else set()
        size = sum(piece.size for piece in pieces.pieces if piece.number not in before)
        made = self._renderings[self._count] = KnownMotion(self._count, plain, shape, pieces, root, size)
        while len(self._renderings) > MOST_RENDERINGS or (
                len(self._renderings) > LEAST_RENDERINGS
                and sum(one.size for one in self._renderings.values()) > RENDERED):
            self._renderings.popitem(last=False)
        return made

    def _maker(self, options: InferenceOptions) -> _Maker:
        """What renders the plan of the options."""
        plan = options.plan
        assert plan is not None
        key = _identity(plan)
        at = next((at for at, (known, _) in enumerate(self._makers) if known == key), None)
        entry = (key, self._new_maker(options)) if at is None else self._makers.pop(at)
        while len(self._makers) >= MOST_DRAWINGS:
            # Those that were abandoned go first.
            del self._makers[next((at for at, (_, one) in enumerate(self._makers) if not one.renderer.is_drawn), 0)]
        self._makers.append(entry)
        return entry[1]

    def _new_maker(self, options: InferenceOptions) -> _Maker:
        plan, bundle = options.plan, self._system.bundle
        assert plan is not None
        drawing = next((drawing for known, drawing in self._drawings if known == _identity(plan)), None)
        for _, known in self._makers:
            drawing = drawing or known.renderer.speech_of(plan)
        renderer = self._system.plan_renderer(self._speech, options, drawing)
        speaker, count = self._system.speaker_index(options.speaker), len(plan.drawn.lexemes)
        return _Maker(renderer, ShapedBlocks(bundle.statistics, speaker, count), {})

    def _frames(self, maker: _Maker, options: InferenceOptions) -> FramePieces | StandingPieces:
        key = options.fps, options.seated, options.mirrored, options.seed if _is_standing(options) else None
        if key not in maker.pieces:
            speaker = self._system.speaker_index(options.speaker)
            kind = StandingPieces if _is_standing(options) else FramePieces
            maker.pieces[key] = kind(self._system.bundle, speaker, options, self._page_frames(options))
        return maker.pieces[key]


def levels_of(bundle: Bundle) -> dict[str, list[float]] | None:
    """Feature of the hands -> its low, middle and high value, in its unit; None if they cannot be controlled."""
    levels = bundle.levels
    return None if levels is None else {name: [round(float(value), 3) for value in row]
                                        for name, row in zip(FEATURES, levels.table, strict=True)}


def _identity(plan: GesturePlan) -> tuple[Any, ...]:
    """Everything that identifies a first generation. Equal parts of the plans that a page sends are the same objects,
    so comparing the tuples is fast."""
    controls = tuple([curve for curve in plan.curves if curve.knob in FEATURES])
    settings = plan.made_by.get("settings")
    if isinstance(settings, dict) and "legs" in settings:  # they are added to what was generated
        made_by = {**plan.made_by, "settings": {name: value for name, value in settings.items() if name != "legs"}}
        return made_by, *_identity(replace(plan, made_by=made_by))[1:]
    return plan.made_by, plan.seed, plan.variation, plan.speaker, plan.interpreter, plan.drawn, plan.words, controls


def directions_of(system: Gesticulator) -> dict[str, list[str]]:
    """What the page offers as directions of the whole take: the names of performers and interpreters."""
    return {"speakers": list(system.speakers), "interpreters": list(system.interpreters)}


def _is_standing(options: InferenceOptions) -> bool:
    """Whether the motion is on standing legs."""
    return options.legs and not options.seated


def _legs_of(plain: Mapping[str, Any]) -> Any:
    """The legs of a plan in plain values; None without legs."""
    settings = plain.get("made_by", {}).get("settings")
    return settings.get("legs") if isinstance(settings, dict) else None


def _another_interpreter(plain: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
    """Whether a plan wants another interpreter to choose the lexemes that were chosen in the plan before it; not where
    it has been there already, as after undo."""
    return plain.get("interpreter") != before.get("interpreter") and plain.get("drawn") == before.get("drawn")


def _seen(plan: GesturePlan, view: tuple[float, float]) -> tuple[int, int]:
    """The blocks of a plan in a stretch (seconds): the first, and the one after the last."""
    return (bisect_right(plan.blocks, view[0], key=lambda block: block.end),
            bisect_left(plan.blocks, view[1], key=lambda block: block.start))


def _view(request: Mapping[str, Any]) -> tuple[float, float]:
    view = request.get("view")
    if isinstance(view, list) and len(view) == 2 and all(isinstance(time, int | float) for time in view):
        return float(view[0]), float(view[1])
    return 0.0, 0.0


# -------------------------------------------------------------------------------------------------------- messages

def message(header: Mapping[str, Any], data: bytes = b"") -> bytes:
    """A message of an answer."""
    text = json.dumps({**header, "bytes": len(data)}, allow_nan=False).encode()
    return len(text).to_bytes(4, "little") + text + data


def frames_of(pieces: SignedPieces, wanted: Sequence[int]) -> tuple[list[tuple[int, int]], bytes]:
    """The frames of the wanted pieces: ranges (first, last + 1), and [T, J, 4] int16."""
    ranges: list[tuple[int, int]] = []
    for at in wanted:
        piece = pieces.pieces[at]
        if ranges and ranges[-1][1] == piece.first:
            ranges[-1] = ranges[-1][0], piece.last
        else:
            ranges.append((piece.first, piece.last))
    return ranges, b"".join(pieces.rotations(at).astype("<i2").tobytes() for at in wanted)


def _unsigned(pieces: Sequence[FramePiece], share: float) -> bytes:
    """The message with frames of pieces whose signs are not known yet. share: of the frames to be sent, so far."""
    ranges, data = frames_of(SignedPieces(0, pieces, np.ones((len(pieces), pieces[0].ends.shape[1]), np.int16)),
                             range(len(pieces)))
    header, roots = {"kind": "frames", "ranges": ranges, "share": round(share, 3)}, _root_of(pieces)
    return message({**header, "roots": len(roots)} if roots else header, data + roots)


def _root_of(pieces: Sequence[FramePiece]) -> bytes:
    """float32 [T, 3] the positions of the root in some pieces, where it moves."""
    return b"".join(piece.root.tobytes() for piece in pieces if piece.root is not None)


def _in_order(lacking: Sequence[int]) -> list[list[int]]:
    """The pieces that are lacking, in order, in stretches of neighbours."""
    return [list(lacking[at:at + STRETCH]) for at in range(0, len(lacking), STRETCH)]


def _nearest_first(lacking: Sequence[int], seen: Sequence[int]) -> list[list[int]]:
    """The pieces that are lacking, but for those of the visible stretch, in stretches of neighbours, by their distance
    from it. What comes next in time is as near as half of the distance before it: playing reaches it."""
    after = [at for at in lacking if at > seen[-1]]
    before = [at for at in lacking if at < seen[0]]
    stretches = [after[at:at + STRETCH] for at in range(0, len(after), STRETCH)]
    stretches += [before[max(at - STRETCH, 0):at] for at in range(len(before), 0, -STRETCH)]

    def distance(stretch: list[int]) -> int:
        return stretch[0] - seen[-1] if stretch[0] > seen[-1] else 2 * (seen[0] - stretch[-1])

    return sorted(stretches, key=distance)


def whole_motion(motion: Motion) -> SignedPieces:
    """A motion in pieces, whose numbers are those of their content."""
    rotations = np.round(motion.rotations * QUATERNION_STEPS).astype("<i2")
    pieces = []
    for first in range(0, len(rotations), _PIECE):
        part = rotations[first:first + _PIECE]
        number = int.from_bytes(hashlib.blake2b(part.tobytes(), digest_size=8).digest(), "little")
        pieces.append(FramePiece(first, first + len(part), number, part, part[[0, -1]].astype(np.float64)))
    return SignedPieces(len(rotations), pieces, np.ones((len(pieces), rotations.shape[1]), np.int16))


# ------------------------------------------------------------------------------------------------- changes of plans

def plan_with(plain: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A plan in plain values with changes: `blocks`, a list of [first, last + 1, new blocks] from the last to the first
    of them, and `parts`, other members by name, null to leave one out. `InputError` for invalid ones."""
    try:
        blocks = list(plain["blocks"])
        for first, last, new in changes.get("blocks", ()):
            if not 0 <= first <= last <= len(blocks) or not isinstance(new, list):
                raise ValueError
            blocks[first:last] = new
        made = {**plain, **changes.get("parts", {}), "blocks": blocks}
    except (ValueError, TypeError, KeyError, AttributeError):
        raise InputError("the changes", "do not fit the plan", "load the page again") from None
    return {name: value for name, value in made.items() if value is not None}


def changes_of(made: GesturePlan, plan: GesturePlan) -> dict[str, Any]:
    """The changes (`plan_with`) that lead from a plan to another one."""
    rows: list[tuple[int, int, list[Any]]] = []
    if len(made.blocks) != len(plan.blocks):
        rows.append((0, len(plan.blocks), [to_plain(block) for block in made.blocks]))
    else:
        for at, (new, old) in enumerate(zip(made.blocks, plan.blocks, strict=True)):
            if new is not old and new != old:
                rows.append((at, at + 1, [to_plain(new)]))
    before, after = plan.to_dict(), made.to_dict()
    parts = {name: value for name, value in after.items() if name != "blocks" and before.get(name) != value}
    return {"blocks": rows[::-1], "parts": {**parts, **{name: None for name in before if name not in after}}}
