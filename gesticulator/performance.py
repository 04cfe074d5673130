"""A performance, the result of inference: motion, sound and plan, and how they are saved.

Heavy modules are imported inside the functions that need them, to keep the start of the command line fast.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gesticulator.export.writers import check_output, write

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_module.types import Array, Blocks, Motion, Speech
    from gesticulator.characters.mapping import RigMapping
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.characters.rig import Character, CharacterMotion
    from gesticulator.editing.render import Generation
    from gesticulator.export.clip import ClipLayout
    from gesticulator.export.writers import Scene
    from gesticulator.face.motion import FaceMotion
    from gesticulator.options import InferenceOptions
    from gesticulator.plan.plan import GesturePlan, LexemeName

__all__ = ["Performance"]


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
    names: Callable[[], tuple[LexemeName, ...]] | None = None
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
        import numpy as np

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
        from gesticulator.export.writers import Scene

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
        from gesticulator.characters.mapping import RigMapping, load_mapping
        from gesticulator.characters.reading import read_character
        from gesticulator.characters.retarget import Retargeter
        from gesticulator.characters.rig import Character

        rig = character if isinstance(character, Character) else read_character(character)
        joints = mapping if mapping is None or isinstance(mapping, RigMapping) else load_mapping(mapping, rig)
        # A clip of the upper body must not key the legs, or it could not be laid over a walk.
        legs = self.clip is None or not self.clip.bare
        return self.moved_by(Retargeter(rig, joints, contacts=contacts, legs=legs))

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
        from gesticulator.directing.record import fingerprinted, named

        return named(fingerprinted(self.decided, self.speech), () if self.names is None else self.names())

    def explain(self) -> dict[str, Any]:
        """Why each block got its gesture: `plan` in plain values, ready for JSON (docs/plan.md)."""
        return self.plan().to_dict()
