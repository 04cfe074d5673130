"""From the generated blocks of a recording to its performance, the result of inference: motion, sound, gesture plan and
face, and how they are saved.

Modules that only some performances need are imported by the functions that need them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain, groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from data_module.controls import FEATURES, Curve
from data_module.types import Array, Blocks, Motion, Speech
from gesticulator.body.motion_path import MotionPath
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.bundle.files import lexicon_hash
from gesticulator.cli import __version__
from gesticulator.export.writers import Scene, check_output, write
from gesticulator.options import InferenceOptions, interpreter_name
from gesticulator.plan import plan as plans
from gesticulator.plan.plan import GesturePlan, PlanMeaning
from gesticulator.sampling.loop import BlockMotion, GeneratedMotion, Generation, Setup

if TYPE_CHECKING:
    from gesticulator.characters.mapping import RigMapping
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.characters.rig import Character, CharacterMotion
    from gesticulator.directing.shaping import Shaping
    from gesticulator.export.clip import ClipLayout
    from gesticulator.face.motion import FaceMotion

__all__ = ["Performance"]

_ABOVE = ("seed", "variation", "speaker", "interpreter", "activity")
"""Settings that have fields of their own in a plan."""
_SIZES = (1.0, 0.6, 1.0, 1.5)
"""The size of a unit's gestures, as an intensity, for each of the planner's sizes."""
_RUN = 16
"""Blocks whose motion is computed in one call."""


@dataclass(frozen=True, repr=False)
class Performance:
    """Gesture for one recording: the speech, its gesture plan, and the motion.

    motion: on a skeleton of 16, 46 or, with legs, 54 joints, at any frame rate. speech: the sound. blocks: N blocks
    that tile it. lexemes: [N] the lexeme played in each block. codes: [N, d_z] style codes. decided: the plan without
    the names of lexemes (`plan` adds them).
    """

    motion: Motion
    speech: Speech
    blocks: Blocks
    lexemes: NDArray[np.int64]
    codes: NDArray[np.float32]
    decided: GesturePlan
    options: InferenceOptions | None = None
    """The options of the performance, with the bundle's defaults filled in."""
    names: Callable[[], tuple[plans.LexemeName, ...]] | None = None
    """Returns the names of the lexemes."""
    retiming: str | None = None
    """What became of a plan that was moved onto this sound (`InferenceOptions.retime`)."""
    generation: Generation | None = field(default=None, compare=False)
    """The first generation, from which edits start (`Gesticulator.keeps_generations`)."""
    character: CharacterMotion | None = None
    """The same motion on a user's character, written to .bvh, .glb, .fbx, .usda, .usdc and .csv."""
    face: FaceMotion | None = None
    """The face over the same frames, where one was asked for (`InferenceOptions.face`)."""
    clip: ClipLayout | None = None
    """How files for animation tools are laid out (`as_clip`); None: by default."""
    rest: Callable[[], Motion] | None = None
    """Returns the speaker's resting pose, a motion of one frame."""

    @property
    def scores(self) -> NDArray[np.float64]:
        """[N, M] the interpreter's scores of the best lexemes of each block, falling along M."""
        return np.array([[choice.score for choice in block.alternatives] for block in self.decided.blocks])

    def labelled(self, sound_name: str, notes: tuple[str, ...] = ()) -> Performance:
        """The performance with the name of its sound file and with remarks for the user."""
        # A file name may contain bytes that are not valid UTF-8.
        name = sound_name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
        return replace(self, decided=replace(self.decided, notes=notes, sound=replace(self.decided.sound, name=name)))

    @property
    def duration(self) -> float:
        """Seconds of sound."""
        return self.speech.duration

    @property
    def fps(self) -> float:
        """Frames per second of the motion."""
        return self.motion.fps

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints, the root first, parents before children."""
        return self.motion.skeleton.names

    @property
    def rotations(self) -> Array:
        """[T, J, 4] local rotations, unit quaternions, w first; the identity is the T-pose."""
        return self.motion.rotations

    def positions(self) -> Array:
        """[T, J, 3] joint positions, metres: Y up, facing +Z, the floor at 0, as in the files that are written."""
        from data_module.motion.kinematics import positions_of
        from data_module.motion.skeletons import standing

        return positions_of(standing(self.motion))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the performance atomically, in the format of the suffix (`WRITERS`): .bvh, .glb, .fbx and so on for the
        motion, .html for a page that plays it, .json for its plan.

        Missing folders are created. `InputError` for an unknown suffix or a missing dependency of its writer; OSError
        where writing fails.
        """
        check_output(path)  # before a folder is made
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        return write(path, self.scene())

    def scene(self) -> Scene:
        """The input of writers: motion, sound, plan, character and layout."""
        motion = self.motion
        if self.clip is not None and self.clip.additive:
            from gesticulator.body.clips import added_to_rest

            motion = added_to_rest(motion, self._rest_of(motion))
        return Scene(motion, self.speech, self.plan, self.character, self.clip,
                     None if self.face is None else self.face.fitted(len(motion)))

    def as_clip(self, clip: ClipLayout) -> Performance:
        """The performance laid out as a clip for animation tools: looped, of the upper body alone. Do it before `on`;
        ValueError after. `InputError` if the motion is too short for a loop."""
        if self.character is not None and clip.changes_motion:
            raise ValueError("make the clip first, then transfer it to a character")
        motion = self.motion
        if clip.changes_motion:
            from gesticulator.body.clips import upper_alone

            motion = upper_alone(motion) if clip.bare else motion
            if clip.loop:
                from gesticulator.body.clips import looped

                motion = looped(motion)
        return replace(self, motion=motion, clip=clip)

    def _rest_of(self, motion: Motion) -> Motion:
        """The resting pose on the skeleton of a motion, of the upper body alone."""
        from data_module.motion.skeletons import resized
        from gesticulator.body.clips import upper_alone

        assert self.rest is not None
        rest = upper_alone(resized(self.rest(), motion.skeleton))
        return replace(rest, root_positions=motion.root_positions[:1])

    def on(self, character: Character | str | os.PathLike[str],
           mapping: RigMapping | str | os.PathLike[str] | None = None, *, contacts: bool = True) -> Performance:
        """The performance retargeted to a character (`gesticulator.characters.retarget`), which `save` then writes.

        character: a file (.bvh, .glb, .gltf, .vrm, .fbx), or the result of `read_character`. mapping: a file as
        written by `save_mapping`, needed where the joints are not recognised. contacts: keep the hands out of the
        character's trunk. `InputError` if the character cannot be read or its joints are ambiguous.
        """
        from gesticulator.characters.retarget import Retargeter

        # A clip of the upper body must not key the legs, or it could not be laid over a walk.
        legs = self.clip is None or not self.clip.bare
        return self.moved_by(Retargeter.of(character, mapping, contacts=contacts, legs=legs))

    def moved_by(self, retargeter: Retargeter) -> Performance:
        """The performance with the motion of a retargeter's character. Clips of the upper body need one with
        `legs=False`."""
        moved = retargeter(self.motion)
        if self.clip is not None and self.clip.bare:
            moved = replace(moved, translations=None)
        if self.clip is not None and self.clip.additive:
            moved = moved.added_to_rest(retargeter(self._rest_of(self.motion)))
        return replace(self, character=moved)

    def plan(self) -> GesturePlan:
        """The plan with the names of lexemes. It can be edited and rendered again (`InferenceOptions.plan`)."""
        return plans.named(plans.fingerprinted(self.decided, self.speech), () if self.names is None else self.names())

    def explain(self) -> dict[str, Any]:
        """Why each block got its gesture: `plan` in plain values, ready for JSON (docs/plan.md)."""
        return self.plan().to_dict()


@dataclass(frozen=True)
class Assembler:
    """Everything about one recording that its blocks do not say. setup: resolved from the options; speech: at 16 kHz,
    with the words that were read."""

    bundle: Bundle
    speech: Speech
    options: InferenceOptions
    setup: Setup

    def performance(self, generated: GeneratedMotion, names: Callable[[], tuple[plans.LexemeName, ...]]) -> Performance:
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
    # Kinematics costs as much for one block as for sixteen. Legs step block by block, as in a stream: a sum over more
    # frames differs from theirs in the last digit.
    run = 1 if path.has_legs else _RUN
    pushed = (path.push(times[i:i + run].ravel(), np.concatenate(features[i:i + run]))
              for i in range(0, len(blocks), run))
    for piece in chain(pushed, map(path.finish, (duration,))):  # finished after the last push: map is lazy
        if piece is not None:
            after = begin + len(piece)
            rotations[begin:after], root[begin:after] = piece.rotations, piece.root_positions
            begin, whole = after, piece
    return replace(whole, rotations=rotations, root_positions=root)


# ------------------------------------------------------------------------------------------------------------ the plan

@dataclass(frozen=True)
class Origin:
    """Provenance of a performance. options: with the bundle's defaults filled in; program: version and bundle, in plain
    values; settings: all that the generation depends on; score_is: the kind of scores; meanings: of the words."""

    options: InferenceOptions
    program: Mapping[str, Any]
    settings: Mapping[str, Any]
    score_is: str
    meanings: tuple[PlanMeaning, ...] = ()


def origin_of(bundle: Bundle, options: InferenceOptions, setup: Setup, meanings: tuple[PlanMeaning, ...]) -> Origin:
    """The provenance of a performance, as a plan records it: the options with everything filled in."""
    # A plan must render alike with a later version whose defaults differ.
    used = replace(options, speaker=bundle.speakers[setup.speaker],
                   interpreter=options.interpreter or bundle.interpreters[0],
                   temperature=setup.temperature,
                   activity=bundle.config.selection.activity if options.activity is None else options.activity,
                   controls=setup.controls, hand_height=None, hand_speed=None, hand_radius=None)
    program = {"gesticulator": __version__,
               "bundle": {"preset": bundle.config.name, "lexicon": lexicon_hash(bundle.vectors)}}
    return Origin(used, program, _settings(used, setup), setup.score_is, meanings)


def _settings(used: InferenceOptions, setup: Setup) -> dict[str, Any]:
    """Everything that a generation depends on, in plain values. used: options with everything filled in."""
    settings: dict[str, Any] = {
        "speaker": used.speaker, "interpreter": interpreter_name(used.interpreter or ""), "words": setup.text,
        "seed": int(used.seed), "variation": int(used.variation),
        **{key: float(getattr(used, key)) for key in ("temperature", "activity", "fps", "gain")}}
    if used.legs or used.seated:
        settings["legs"] = "seated" if used.seated else "standing"
    for feature in FEATURES:
        value = getattr(setup.controls, feature)
        if value is not None:
            settings[f"hand_{feature}"] = ({"times": list(value.times), "values": list(value.values)}
                                           if isinstance(value, Curve) else float(value))
    return settings


def plan_of(speech: Speech, cut: Blocks, blocks: Sequence[BlockMotion], origin: Origin) -> GesturePlan:
    """The plan of a first generation, still without names of lexemes (`named`). cut: the N blocks of the speech."""
    settings, decisions = origin.settings, tuple(block.block for block in blocks)
    drawn = plans.DrawnBlocks(tuple(cut.edges.tolist()), tuple(block.flag for block in decisions),
                        tuple(block.silent for block in decisions), tuple(block.lexeme for block in blocks),
                        origin.options.knobs)
    # What the plan states in fields of its own is not repeated in the settings, where an edit would contradict it.
    made_by = {**origin.program, "settings": {key: value for key, value in settings.items() if key not in _ABOVE}}
    sound = plans.PlanSound("", speech.duration, speech.sample_rate, plans.sound_hash(speech))
    return GesturePlan(
        plans.FORMAT, plans.VERSION, made_by, sound,
        int(settings["seed"]), int(settings["variation"]), str(settings["speaker"]), str(settings["interpreter"]),
        drawn, decisions, drawn.knobs, tuple(origin.options.cues), plans.words_of(speech), score_is=origin.score_is,
        units=units_of_blocks(blocks), meanings=origin.meanings)


def rendered_plan(plan: GesturePlan, speech: Speech, blocks: Sequence[BlockMotion], origin: Origin) -> GesturePlan:
    """A plan after rendering, with the models' choices in its edited blocks."""
    # The hash of the sound was compared with the plan's before rendering (`directions.check_plan_of`).
    sound = plans.PlanSound("", speech.duration, speech.sample_rate, plan.sound.sha256)
    decided = tuple(replace(
        block, lexeme=made.lexeme if block.lexeme is None else block.lexeme, gate=made.block.gate,
        alternatives=made.block.alternatives, score=made.block.score, rank=made.block.rank)
        for block, made in zip(plan.blocks, blocks, strict=True))
    return replace(plan, sound=sound, blocks=decided, units=units_of_blocks(blocks) or plan.units,
                   words=plans.words_of(speech), score_is=origin.score_is, source="plan")


def units_of_blocks(blocks: Sequence[BlockMotion]) -> tuple[plans.GestureUnit, ...]:
    """The units of a performance, in order: from one rest to the next. () without a planner."""
    groups = groupby(blocks, lambda block: block.unit is not None and bool(block.unit.phase))
    return tuple(_unit(list(group)) for moves, group in groups if moves)


def _unit(blocks: Sequence[BlockMotion]) -> plans.GestureUnit:
    from interpreters.planner_run import HANDS, PHASES

    decisions = [block.unit for block in blocks if block.unit is not None]
    phases: list[plans.GesturePhase] = []
    struck = False
    for block, decision in zip(blocks, decisions, strict=True):
        # Equal phases of neighbouring blocks are one phase; a hold is named by the stroke that it precedes or follows.
        kind = PHASES[decision.phase]
        struck = struck or kind == "stroke"
        if kind == "hold":
            kind = "post-stroke hold" if struck else "pre-stroke hold"
        start = phases.pop().start if phases and phases[-1].kind == kind else block.block.start
        phases.append(plans.GesturePhase(cast(plans.PhaseKind, kind), start, block.block.end))
    # A unit may change hands: the one that makes most of its blocks names it.
    hands = [decision.hand for decision in decisions if decision.hand]
    hand = cast(plans.Hand, HANDS[max(set(hands), key=hands.count)]) if hands else None
    sizes = [_SIZES[decision.size] for decision in decisions if decision.size]
    size = round(sum(sizes) / len(sizes), 2) if sizes else 1.0
    return plans.GestureUnit(blocks[0].block.start, blocks[-1].block.end, tuple(phases), hand, size)
