"""From the generated blocks of a recording to its performance: motion, gesture plan and face."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, Blocks, Motion, Speech
from gesticulator.body.motion_path import MotionPath
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.options import InferenceOptions
from gesticulator.performance import Performance
from gesticulator.sampling.loop import GeneratedMotion, Setup
from gesticulator.setup import origin_of

if TYPE_CHECKING:
    from gesticulator.directing.lexeme_names import LexemeName
    from gesticulator.directing.record import Origin
    from gesticulator.directing.shaping import Shaping
    from gesticulator.face.motion import FaceMotion
    from gesticulator.plan.plan import GesturePlan, PlanMeaning


@dataclass(frozen=True)
class Assembler:
    """Everything about one recording that its blocks do not say. setup: resolved from the options; speech: at 16 kHz,
    with the words that were read."""

    bundle: Bundle
    speech: Speech
    options: InferenceOptions
    setup: Setup

    def performance(self, generated: GeneratedMotion, names: Callable[[], tuple[LexemeName, ...]]) -> Performance:
        """The performance. names: returns the names of the lexemes."""
        blocks = generated.blocks
        motion, plan = self.motion(generated), self.plan(generated)
        return Performance(motion, self.speech, generated.cut, np.array([block.lexeme for block in blocks], np.int64),
                           np.stack([block.code for block in blocks]), plan, self.origin.options, names,
                           rest=partial(rest_pose, self.bundle, self.setup.speaker), face=self._face(plan, motion))

    @cached_property
    def origin(self) -> Origin:
        """The provenance that the plan records."""
        return origin_of(self.bundle, self.options, self.setup, self.meanings)

    @cached_property
    def meanings(self) -> tuple[PlanMeaning, ...]:
        """The meanings of the plan, or those that the words call for."""
        if self.options.plan is not None:
            return self.options.plan.meanings
        # Named gestures are blended as joint rotations.
        if not self.speech.words or representation_of(self.bundle.config).name != "rotations":
            return ()
        from gesticulator.directing.meanings import track_of

        track = track_of(self.options, self.speech)
        if track is None:
            return ()
        track.add(self.speech.words)
        return track.meanings()

    def shaping(self, edges: Array) -> Shaping | None:
        """The changes of the generated poses in blocks with these edges [N + 1]; None for none."""
        # Without shaping poses go through untouched, which keeps the bytes of a plain performance.
        if not self.options.shaped and not self.meanings:
            return None
        from gesticulator.directing.meanings import played_meanings
        from gesticulator.directing.shaping import Shaping

        played = played_meanings(self.meanings)
        return Shaping(self.bundle, self.options, self.setup.speaker, self.speech.words or (), edges,
                       lambda until: played)

    def motion(self, generated: GeneratedMotion) -> Motion:
        """The motion, on the time of the speech."""
        motion = motion_of(self.bundle, self.setup.speaker, self.options, generated.motion, generated.cut,
                           self.shaping(generated.cut.edges))
        if self.options.plan is None or not self.options.plan.pins:
            return motion
        from gesticulator.body.pins import pinned

        return pinned(motion, self.options.plan)

    def plan(self, generated: GeneratedMotion) -> GesturePlan:
        """The plan with everything that was decided in its blocks, without names of lexemes."""
        from gesticulator.directing.record import plan_of, rendered_plan

        if self.options.plan is None:
            return plan_of(self.speech, generated.cut, generated.blocks, self.origin)
        return rendered_plan(self.options.plan, self.speech, generated.blocks, self.origin)

    def _face(self, plan: GesturePlan, motion: Motion) -> FaceMotion | None:
        """The face over the frames of the body; None if the options ask for none."""
        options, words = self.options, self.speech.words or ()
        if options.face == "off":
            return None
        from gesticulator.face.track import face_of

        # Expressions are cues of the face; those of the body were directed during generation.
        cues: list[tuple[float, str]] = []
        if options.cues:
            from gesticulator.directing.cues import expressions_at

            cues = expressions_at(options.cues, words, self.speech.duration)
        return face_of(options, self.speech.samples, plan.blocks, motion, words, cues)


def rest_pose(bundle: Bundle, speaker: int) -> Motion:
    """A speaker's resting pose, a motion of one frame."""
    return representation_of(bundle.config).motion(bundle.statistics.rest_pose[speaker][None], 1.0)


def motion_of(bundle: Bundle, speaker: int, options: InferenceOptions, features: NDArray[np.float32], blocks: Blocks,
              shaping: Shaping | None = None) -> Motion:
    """Normalised blocks [N, K, D_m], warped back onto the time of the speech and smoothed (RG 4.2.2, 7.1.2).

    shaping: applies intensity, mirroring and named gestures.
    """
    path, duration = MotionPath(bundle, speaker, options, shaping=shaping), float(blocks.edges[-1])
    count, begin = max(1, round(duration * path.fps)), 0
    # One array from the start: an hour of joined pieces would need its 300 MB of rotations twice.
    rotations, root = np.empty((count, len(path.skeleton), 4)), np.empty((count, 3))
    times = blocks.knot_times.reshape(len(blocks), -1)
    for number in range(len(blocks) + 1):
        piece = path.push(times[number], features[number]) if number < len(blocks) else path.finish(duration)
        if piece is not None:
            after = begin + len(piece)
            rotations[begin:after], root[begin:after] = piece.rotations, piece.root_positions
            begin, whole = after, piece
    return replace(whole, rotations=rotations, root_positions=root)
