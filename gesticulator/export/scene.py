"""The input of every writer: motion, audio and plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from data_module.motion.skeletons import standing
from data_module.types import Motion, Speech

if TYPE_CHECKING:
    from gesticulator.characters.rig import CharacterMotion
    from gesticulator.export.clip import ClipLayout
    from gesticulator.export.nodes import NodeMotion
    from gesticulator.plan.plan import GesturePlan


@dataclass(frozen=True)
class Scene:
    """A recording with gestures, ready to be written.

    motion: on the default skeleton, as generated. speech: the audio. make_plan: computes the plan, only for writers
    that need it. character: the same motion on the user's character, if any. layout: how it is laid out for animation
    tools; None: by default.
    """

    motion: Motion
    speech: Speech
    make_plan: Callable[[], GesturePlan]
    character: CharacterMotion | None = None
    layout: ClipLayout | None = None

    @property
    def clip(self) -> ClipLayout:
        """How the motion is laid out for animation tools."""
        from gesticulator.export.clip import ClipLayout

        return self.layout or ClipLayout()

    @property
    def duration(self) -> float:
        """Duration of the audio, seconds."""
        return self.speech.duration

    @property
    def fps(self) -> float:
        """Frames per second of the motion."""
        return self.motion.fps

    @property
    def plan(self) -> GesturePlan:
        """The blocks with their gestures, the reasons for them, and the names of the lexemes."""
        return self.make_plan()

    @property
    def standing(self) -> Motion:
        """The motion on the default skeleton, standing on the floor."""
        return standing(self.motion)

    @property
    def nodes(self) -> NodeMotion:
        """The nodes to write: the user's character if there is one, else the default skeleton."""
        from gesticulator.export.nodes import of_character, of_motion

        return of_motion(self.standing) if self.character is None else of_character(self.character)
