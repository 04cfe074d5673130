"""What every writer is given: how the character moves, what is heard, and the plan behind it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from data_module.motion.skeletons import standing
from data_module.types import Motion, Speech
from gesticulator.export.nodes import NodeMotion, of_character, of_motion

if TYPE_CHECKING:
    from gesticulator.characters.rig import CharacterMotion
    from gesticulator.plan.plan import GesturePlan


@dataclass(frozen=True)
class Scene:
    """A recording with gesture, ready to be written.

    motion: on the default skeleton, as it was generated. speech: the sound. make_plan: gives the plan, worked out only
    for the writers that want it. character: the same motion on a character of the user's, None for none.
    """

    motion: Motion
    speech: Speech
    make_plan: Callable[[], GesturePlan]
    character: CharacterMotion | None = None

    @property
    def duration(self) -> float:
        """Seconds of sound."""
        return self.speech.duration

    @property
    def fps(self) -> float:
        """Frames per second of the motion."""
        return self.motion.fps

    @property
    def plan(self) -> GesturePlan:
        """The blocks with their gestures, and why each was chosen; lexemes with their names."""
        return self.make_plan()

    @property
    def standing(self) -> Motion:
        """The motion on the default skeleton, standing on the floor."""
        return standing(self.motion)

    @property
    def nodes(self) -> NodeMotion:
        """What a file shows: the user's character where there is one, else the default skeleton."""
        return of_motion(self.standing) if self.character is None else of_character(self.character)
