"""A performance: what can be asked of it, what it is, and how it is written to a file.

Nothing heavy is imported before it is needed, so that the command line checks its numbers against the same ranges
before numpy and torch are loaded.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gesticulator.export.writers import check_output, write

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_module.types import Array, Blocks, Motion, Speech
    from gesticulator.characters.mapping import RigMapping
    from gesticulator.characters.rig import Character, CharacterMotion
    from gesticulator.drawing.rollout import LexemeWorth
    from gesticulator.export.scene import Scene
    from gesticulator.options import InferenceOptions
    from gesticulator.plan.plan import GesturePlan, LexemeName

__all__ = ["Performance"]


# The blocks must end where the sound ends; a cut on the frame grid may miss it by less than this.
_END_TOLERANCE = 0.05


# ---------------------------------------------------------------------------------------------------- the result


@dataclass(frozen=True)
class Performance:
    """Gesture for one recording.

    motion: on the character of 16, 46 or, with legs, 54 joints, at any frame rate. speech: the sound. blocks: N blocks
    that tile it. lexemes: [N] the lexeme that was played. best: [N, M] the M best lexemes, best first; scores: [N, M]
    what the interpreter thought of them, falling along M. M is `BEST`, or the size of the lexicon where that is
    smaller. The played lexeme need not be the first of `best` (it may have been drawn, or asked for). codes: [N, d_z]
    style codes. gate: [N] how likely a gesture was on each block, NaN where the gate was not asked. notes: what the
    user should know, a line each.
    """

    motion: Motion
    speech: Speech
    blocks: Blocks
    lexemes: NDArray[np.int64]
    best: NDArray[np.int64]
    scores: NDArray[np.float64]
    codes: NDArray[np.float32] | None = None
    gate: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    score_is: str = "log-probability"
    """What the scores are: natural logarithms of probabilities, or "Q value". A Q value is what RACER's Q-network gives
    a lexeme. It ranks lexemes, and is no expected return: the conservative loss pushes it down where the data have few
    examples (RACER Eq. 11), so its size is not that of any sum of rewards."""
    weighed: LexemeWorth | None = None
    """Of the interpreter "advantage": what the candidates are worth."""
    character: CharacterMotion | None = None
    """The same motion on a character of the user's, shown by .bvh, .glb, .fbx, .usda, .usdc, .csv, .parquet."""
    made_by: Mapping[str, Any] = field(default_factory=dict)
    """What made it, in plain values: the version, the bundle, and the settings that were asked for or chosen."""
    options: InferenceOptions | None = None
    """What was asked, with nothing left to the bundle."""
    names: Callable[[], tuple[LexemeName, ...]] | None = None
    """The names of the lexemes, worked out when they are asked for."""
    sound_name: str = ""
    """The file of the sound."""

    def __post_init__(self) -> None:
        import numpy as np

        n = len(self.blocks)
        if self.lexemes.shape != (n,) or self.best.ndim != 2 or len(self.best) != n or self.best.shape[1] == 0:
            raise ValueError(f"lexemes {self.lexemes.shape} and best {self.best.shape} do not fit {n} blocks")
        if self.scores.shape != self.best.shape or not np.isfinite(self.scores).all():
            raise ValueError(f"scores must be finite and shaped as best, {self.best.shape}")
        if (np.diff(self.scores, axis=1) > 0).any():
            raise ValueError("scores must fall: the best candidate first")
        if self.weighed is not None and self.weighed.prior.shape != (n, self.best.shape[1] + 1):
            raise ValueError(f"the worth of lexemes {self.weighed.prior.shape} does not fit best {self.best.shape}")
        if self.blocks.edges[0] != 0 or abs(self.blocks.edges[-1] - self.speech.duration) > _END_TOLERANCE:
            raise ValueError(f"blocks from {self.blocks.edges[0]} to {self.blocks.edges[-1]} s do not tile "
                             f"{self.speech.duration} s of sound")

    def __repr__(self) -> str:
        settings = self.made_by.get("settings", {})
        by = ", ".join(str(settings[name]) for name in ("speaker", "interpreter") if settings.get(name))
        return (f"<Performance of {self.sound_name or 'samples'}: {self.duration:.1f} s, {len(self.blocks)} blocks, "
                f"{len(self.motion)} frames of {len(self.joints)} joints at {self.fps:g} fps"
                + (f", by {by}>" if by else ">"))

    def _repr_html_(self) -> str:
        """The figure and its sound, for a notebook: the preview page in a frame."""
        from html import escape

        from gesticulator.export.html import page

        return (f'<iframe srcdoc="{escape(page({"take": self.scene()}, self.sound_name or "take"))}" width="100%" '
                'height="480" style="border: 0"></iframe>')

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
        """[T, J, 3] where the joints are, metres: Y up, facing +Z, the floor at 0, as in the files that are written."""
        from data_module.motion.kinematics import positions_of
        from data_module.motion.skeletons import standing

        return positions_of(standing(self.motion))

    def save(self, path: str | os.PathLike[str], *, unit: str = "cm") -> Path:
        """Write it, whole or not at all, in the format of the suffix (`WRITERS`): .bvh, .glb, .fbx and so on the
        motion, .html a page that plays it, .json its plan.

        unit: "cm" or "m", the unit of length of a BVH file; all other formats are in metres, or tell their unit.
        Folders that are missing are made. `InputError` for an unknown suffix, or where what its writer needs is not
        installed; OSError where the disk refuses.
        """
        check_output(path, unit)  # before a folder is made
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        return write(path, self.scene(), unit=unit)

    def scene(self) -> Scene:
        """What writers are given: the motion, the sound, the plan, and the character."""
        from gesticulator.export.scene import Scene

        return Scene(self.motion, self.speech, self.plan, self.character)

    def on(self, character: Character | str | os.PathLike[str],
           mapping: RigMapping | str | os.PathLike[str] | None = None, *, contacts: bool = True) -> Performance:
        """The performance with its motion on a character as well (`gesticulator.characters.retarget`), which `save`
        then writes.

        character: a file (.bvh, .glb, .gltf, .vrm, .fbx), or what `read_character` gives. mapping: a file as
        `save_mapping` writes it, where her joints are not found. contacts: keep hands out of her trunk.
        `InputError` where she cannot be read, or her joints can only be guessed.
        """
        from gesticulator.characters.retarget import retarget

        return replace(self, character=retarget(self.motion, character, mapping, contacts=contacts))

    def plan(self) -> GesturePlan:
        """What was decided, as a plan that can be edited and rendered again (`InferenceOptions.plan`)."""
        from gesticulator.directing.record import plan_of

        return plan_of(self)

    def explain(self) -> dict[str, Any]:
        """Why each block got its gesture, ready for JSON: `plan` in plain values (docs/plan.md)."""
        return self.plan().to_dict()


# ---------------------------------------------------------------------------------------------------- its files


