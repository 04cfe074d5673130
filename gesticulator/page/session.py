"""Rendering of one recording's plans while they are edited on a page.

A page has a motion and its plan, a *rendering* with a number. After each edit it sends the whole plan, that number and
the revision of the plan that it started from, and gets the plan with what was decided in it, and the frames that differ
from those that it has (`server.message`). Where the recording is generated again, messages with the share that is done
come before that.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from data_module.controls import FEATURES
from data_module.motion import kinematics
from data_module.motion.skeletons import standing
from gesticulator.bundle.features import representation_of
from gesticulator.directing.directions import check_plan_of, planned
from gesticulator.editing.frames import EditedFrames, FrameRenderer
from gesticulator.export.html import QUATERNION_STEPS, describe_shape, page_fps, root_path
from gesticulator.options import InferenceOptions
from gesticulator.page.edits import Edits
from gesticulator.page.server import AbandonedError, message
from gesticulator.performance import Performance
from gesticulator.plan.plan import GesturePlan, fingerprinted, named, sound_hash
from gesticulator.plan.plan_file import plan_from

if TYPE_CHECKING:
    from data_module.types import Motion
    from gesticulator.bundle.bundle import Bundle
    from gesticulator.editing.render import PlanRenderer
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.sampling.loop import GeneratedMotion

MOST_GENERATIONS = 4
"""First generations in memory: of the page, and of plans that were opened from files since."""
MOST_RENDERINGS = 8
"""Renderings in memory that a page may have, and that undo finds: ten minutes at 60 frames a second take 14 MB each."""
MOST_FRAMES = 2
"""Renderings whose frames the next one may share: ten minutes take 60 MB each. Two, so that undo shares
those before the last edit."""
REPORTS = 12
"""Blocks between two reports of progress: about half a second."""


@dataclass(frozen=True)
class Rendering:
    """A motion that a page may have. plan: as it was sent, and as it was rendered; shape: the description of the motion
    apart from its numbers; frames: [T, J, 4] rotations in whole steps; root: its path, as bytes."""

    number: int
    sent: GesturePlan
    plan: GesturePlan
    shape: Mapping[str, Any]
    frames: NDArray[np.int16]
    root: bytes


class EditSession:
    """Renders plans of the recording of a performance. Not thread-safe."""

    def __init__(self, gesticulator: Gesticulator, first: Performance, edits: Edits | None = None) -> None:
        """first: whose sound and words are used, and its generation, if it has one (`Gesticulator.keeps_generations`).
        edits: the owner of the plan, by default one without a file."""
        self._gesticulator, self._speech, self._name = gesticulator, first.speech, first.decided.sound.name
        self._sound = sound_hash(first.speech)
        self._first = _identity(first.decided), first.generation
        self._renderers: OrderedDict[str, PlanRenderer] = OrderedDict()
        self._renderings: OrderedDict[int, Rendering] = OrderedDict()
        self._frames: OrderedDict[int, tuple[Hashable, EditedFrames]] = OrderedDict()
        self._count = 0
        self.edits = edits or Edits()

    def perform(self, plan: GesturePlan) -> Performance:
        """The performance of a plan; `InputError` with the line if it is invalid or of another recording."""
        options = planned(InferenceOptions(plan=plan))
        performance = self._gesticulator.render(self._speech, options, self._renderer(options))
        return performance.labelled(self._name, plan.notes)

    def opened(self, performance: Performance) -> int:
        """The number of the rendering that a page begins with."""
        rendering = self._whole(performance, plan_from(performance.plan().to_dict()))
        options = planned(InferenceOptions(plan=rendering.sent))
        # The first edit then computes a window of frames and not the whole take.
        if self._renders_parts and options.plan is not None and not options.plan.pins:
            generated = self._renderer(options).render(options.plan)
            self._share(rendering, options, self._framed(options, generated, None, performance.motion))
        self.edits.plan = rendering.plan
        return rendering.number

    def answer(self, request: Mapping[str, Any], abandoned: Callable[[], bool] = lambda: False,
               report: Callable[[bytes], object] = lambda message: None) -> bytes:
        """The message that answers a page.

        request: `plan`; `have`, the number of the rendering that the page has, or null; `revision`, that the plan
        started from, without which it is a try, and not taken; `page`, its name; `both`, whether the plan that is
        replaced is kept as a file. abandoned: called now and then, ends the rendering with `AbandonedError`; what was
        generated until then is remembered. report: takes messages of progress. `InputError` for an invalid plan,
        `StaleError` for one that does not know of another page's edits.
        """
        base, page = request.get("revision"), str(request.get("page", ""))
        if isinstance(base, int):
            self.edits.check(base, page)
        have = self._renderings.get(request["have"]) if isinstance(request.get("have"), int) else None

        def on_block(done: int, total: int) -> None:
            if abandoned():
                raise AbandonedError
            if done % REPORTS == 0 and done < total:
                report(message({"kind": "progress", "share": round(done / total, 3)}))

        rendering = self.render(plan_from(request["plan"]), have, on_block)
        if isinstance(base, int):
            if request.get("both"):
                self.edits.copy()
            self.edits.take(rendering.plan, page)
        return _answer(rendering, have, self.edits.head())

    def render(self, plan: GesturePlan, have: Rendering | None = None,
               on_block: Callable[[int, int], None] | None = None) -> Rendering:
        """The rendering of a plan, which shares what it can with the one that the page has. on_block: see
        `PlanRenderer.render`."""
        # Undo sends a plan that was sent or answered before, and most often the last but one.
        known = next((rendering for rendering in reversed(self._renderings.values())
                      if plan in (rendering.sent, rendering.plan)), None)
        if known is not None:
            self._renderings.move_to_end(known.number)
            return known
        options = planned(InferenceOptions(plan=plan))
        assert options.plan is not None
        check_plan_of(self._gesticulator.bundle, options.plan, self._sound)
        if not self._renders_parts:
            return self._whole(self.perform(plan), plan)
        generated = self._renderer(options).render(options.plan, on_block)
        # The frames of the page's rendering, or else the latest ones: whatever differs is computed again.
        shared = self._frames.get(-1 if have is None else have.number) or next(reversed(self._frames.values()), None)
        before = shared[1] if shared is not None and shared[0] == self._framing(options) else None
        frames = self._framed(options, generated, before)
        rendering = self._kept(plan, self._decided(options, generated), frames.motion)
        self._share(rendering, options, frames)
        return rendering

    @property
    def _renders_parts(self) -> bool:
        """Whether the bundle samples block by block, and poses give frames one by one."""
        bundle = self._gesticulator.bundle
        return bundle.system.BLOCKS and representation_of(bundle.config).name == "rotations"

    def _framed(self, options: InferenceOptions, generated: GeneratedMotion, before: EditedFrames | None,
                motion: Motion | None = None) -> EditedFrames:
        """The frames of a generation; see `FrameRenderer.render`."""
        bundle, speaker = self._gesticulator.bundle, self._gesticulator.resolver.speaker(options.speaker)
        shaping = self._gesticulator.assembler(self._speech, options).shaping(generated.cut.edges)
        assert options.plan is not None
        return FrameRenderer(bundle, speaker, options).render(generated, shaping, options.plan, before, motion)

    def _framing(self, options: InferenceOptions) -> Hashable:
        """The options on which frames depend, apart from their poses (`MotionPath`)."""
        return options.speaker, options.fps, options.legs, options.seated, options.mirrored, options.seed

    def _share(self, rendering: Rendering, options: InferenceOptions, frames: EditedFrames) -> None:
        """Let the next renderings share the frames of one."""
        self._frames[rendering.number] = self._framing(options), frames
        _trim(self._frames, MOST_FRAMES)

    def _whole(self, performance: Performance, sent: GesturePlan) -> Rendering:
        """The rendering of a whole performance."""
        return self._kept(sent, performance.plan(), performance.motion)

    def _kept(self, sent: GesturePlan, plan: GesturePlan, motion: Motion) -> Rendering:
        """The rendering of a motion, from now on in memory."""
        # A page plays fewer frames of a long recording, to be loaded in time.
        whole = standing(motion)
        page = kinematics.resample(whole, page_fps(self._speech.duration, whole.fps))
        # Numbers are never used twice: a page that was left open may send one of a rendering that is forgotten.
        self._count += 1
        rendering = Rendering(self._count, sent, plan, describe_shape(page, self._speech.duration),
                              np.round(page.rotations * QUATERNION_STEPS).astype("<i2"), root_path(page))
        self._renderings[self._count] = rendering
        _trim(self._renderings, MOST_RENDERINGS)
        return rendering

    def _decided(self, options: InferenceOptions, generated: GeneratedMotion) -> GesturePlan:
        """The plan of the options with what was decided in its blocks."""
        plan, gesticulator = options.plan, self._gesticulator
        assert plan is not None
        rendered = gesticulator.assembler(self._speech, options).plan(generated)
        rendered = replace(rendered, notes=plan.notes, sound=replace(rendered.sound, name=self._name))
        return named(fingerprinted(rendered, self._speech), gesticulator.lexeme_names())

    def _renderer(self, options: InferenceOptions) -> PlanRenderer:
        """The renderer of the first generation of the options' plan."""
        plan = options.plan
        assert plan is not None
        # Edits share a renderer, and with it all blocks that were sampled before.
        key = _identity(plan)
        if key in self._renderers:
            self._renderers.move_to_end(key)
        else:
            generation = self._first[1] if key == self._first[0] else None
            self._renderers[key] = self._gesticulator.plan_renderer(self._speech, options, generation)
            _trim(self._renderers, MOST_GENERATIONS)
        return self._renderers[key]


def _trim(cache: OrderedDict[Any, Any], most: int) -> None:
    """Forget the oldest entries."""
    while len(cache) > most:
        cache.popitem(last=False)


def levels_of(bundle: Bundle) -> dict[str, list[float]] | None:
    """Feature of the hands -> its low, middle and high value, in its unit; None if they cannot be controlled."""
    levels = bundle.levels
    return None if levels is None else {name: [round(float(value), 3) for value in row]
                                        for name, row in zip(FEATURES, levels.table, strict=True)}


def _answer(rendering: Rendering, have: Rendering | None, head: Mapping[str, Any]) -> bytes:
    """The message with a rendering for a page that has another one, or none: the header `rendering` (its number),
    `shape` (null for the same one), `plan`, `range` of the frames (first, last + 1) and `root`, the bytes of the root's
    path after those of the frames; and what pages are told of the edits (`Edits.head`)."""
    # Another number of frames or joints is another motion, which is sent as a whole.
    alike = have is not None and have.shape == rendering.shape
    first, last = 0, len(rendering.frames)
    if alike and have is not None:
        # In whole steps of the numbers that are sent, so that nothing is sent that looks the same.
        differs = np.flatnonzero((rendering.frames != have.frames).any(axis=(1, 2)))
        first, last = (int(differs[0]), int(differs[-1]) + 1) if len(differs) else (0, 0)
    root = b"" if alike and have is not None and have.root == rendering.root else rendering.root
    return message({"kind": "done", "rendering": rendering.number, "shape": None if alike else rendering.shape,
                    "plan": rendering.plan.to_dict(), "range": [first, last], "root": len(root), **head},
                   rendering.frames[first:last].tobytes() + root)


def _identity(plan: GesturePlan) -> str:
    """Everything that identifies a first generation. Legs are added to what was generated."""
    # Curves of the hands steer the sampling; those of knobs are applied to its poses, and share a generation.
    controls = [curve for curve in plan.curves if curve.knob in FEATURES]
    generated_by = {name: value for name, value in plan.made_by.items() if name != "settings"}
    settings = {name: value for name, value in plan.made_by.get("settings", {}).items() if name != "legs"}
    return repr((generated_by, settings, plan.seed, plan.variation, plan.speaker, plan.interpreter, plan.drawn,
                 plan.words, controls))
