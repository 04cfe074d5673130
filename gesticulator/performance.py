"""A performance: what can be asked of it, what it is, and how it is written to a file.

Nothing heavy is imported before it is needed, so that the command line checks its numbers against the same ranges
before numpy and torch are loaded.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gesticulator.export.writers import check_output, write

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_module.types import Array, Blocks, Motion, Speech
    from gesticulator.characters.mapping import RigMapping
    from gesticulator.characters.rig import Character, CharacterMotion
    from gesticulator.export.scene import Scene
    from gesticulator.options import InferenceOptions
    from gesticulator.plan.plan import GesturePlan, LexemeName

__all__ = ["Performance"]


# The blocks must end where the sound ends; a cut on the frame grid may miss it by less than this.
_END_TOLERANCE = 0.05


@dataclass(frozen=True)
class Performance:
    """Gesture for one recording: the speech, the plan of what is gestured in it, and the motion.

    motion: on the character of 16, 46 or, with legs, 54 joints, at any frame rate. speech: the sound. blocks: N blocks
    that tile it. lexemes: [N] the lexeme that was played. codes: [N, d_z] style codes. decided: the plan, without the
    names of lexemes (`plan` gives them).
    """

    motion: Motion
    speech: Speech
    blocks: Blocks
    lexemes: NDArray[np.int64]
    codes: NDArray[np.float32]
    decided: GesturePlan
    options: InferenceOptions | None = None
    """The options of the performance, with nothing left to the bundle."""
    names: Callable[[], tuple[LexemeName, ...]] | None = None
    """Gives the names of the lexemes, worked out on the first call."""
    character: CharacterMotion | None = None
    """The same motion on a character of the user's, shown by .bvh, .glb, .fbx, .usda, .usdc, .csv, .parquet."""

    def __post_init__(self) -> None:
        import numpy as np

        n = len(self.blocks)
        if self.lexemes.shape != (n,) or len(self.codes) != n or len(self.decided.blocks) != n:
            raise ValueError(f"{self.lexemes.shape} lexemes, {len(self.codes)} codes and {len(self.decided.blocks)} "
                             f"planned blocks do not fit {n} blocks")
        scores = self.scores
        if self.best.ndim != 2 or self.best.shape[1] == 0 or not np.isfinite(scores).all():
            raise ValueError("each block needs as many alternatives as the others, with finite scores")
        if (np.diff(scores, axis=1) > 0).any():
            raise ValueError("scores must fall: the best candidate first")
        if self.blocks.edges[0] != 0 or abs(self.blocks.edges[-1] - self.speech.duration) > _END_TOLERANCE:
            raise ValueError(f"blocks from {self.blocks.edges[0]} to {self.blocks.edges[-1]} s do not tile "
                             f"{self.speech.duration} s of sound")

    @property
    def best(self) -> NDArray[np.int64]:
        """[N, M] the best lexemes of each block, best first. The one that was played need not be the first: it may
        have been sampled, or asked for."""
        return self._alternatives("lexeme", int)

    @property
    def scores(self) -> NDArray[np.float64]:
        """[N, M] the interpreter's scores of `best`, falling along M."""
        return self._alternatives("score", float)

    @property
    def score_is(self) -> str:
        """The scores are natural logarithms of probabilities ("log-probability"), or "Q value": RACER's Q-network ranks
        lexemes by it. It is no expected return: the conservative loss lowers it where the data have few examples
        (RACER Eq. 11)."""
        return self.decided.score_is

    @property
    def gate(self) -> NDArray[np.float64]:
        """[N] the gate's probability of a gesture, NaN where there is no gate."""
        import numpy as np

        return np.array([np.nan if block.gate is None else block.gate for block in self.decided.blocks])

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks for the user, a line each."""
        return self.decided.notes

    @property
    def sound_name(self) -> str:
        """The name of the sound's file; empty for samples."""
        return self.decided.sound.name

    def labelled(self, sound_name: str, notes: tuple[str, ...] = ()) -> Performance:
        """The performance with the name of the sound's file, and with remarks for the user."""
        # A file's name may hold bytes that are no text.
        name = sound_name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
        return replace(self, decided=replace(self.decided, notes=notes, sound=replace(self.decided.sound, name=name)))

    def _alternatives(self, member: str, kind: type) -> NDArray[Any]:
        import numpy as np

        rows = [[getattr(one, member) for one in block.alternatives] for block in self.decided.blocks]
        return np.array(rows, dtype=kind)

    def __repr__(self) -> str:
        by = ", ".join(name for name in (self.decided.speaker, self.decided.interpreter) if name)
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
        """The plan with the names of lexemes: it can be edited and rendered again (`InferenceOptions.plan`)."""
        from gesticulator.directing.record import named

        return named(self.decided, () if self.names is None else self.names())

    def explain(self) -> dict[str, Any]:
        """Why each block got its gesture, ready for JSON: `plan` in plain values (docs/plan.md)."""
        return self.plan().to_dict()
