"""What the product gives back: a motion, the sound it belongs to, and why each block got its gesture."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import standing
from data_module.types import Array, BeatFlag, Blocks, Motion, Speech

BEST = 5
"""How many candidates a block keeps."""

# The blocks must end where the sound ends; a cut on the frame grid may miss it by less than this.
_END_TOLERANCE = 0.05


@dataclass(frozen=True)
class Performance:
    """Gesture for one recording.

    motion: on the 16-joint character, at any frame rate. speech: the sound. blocks: N blocks that tile the sound.
    lexemes: [N] the lexeme that was played. best: [N, M] the M best lexemes, best first; scores: [N, M] what the
    interpreter thought of them, falling along M. M is `BEST`, or the size of the lexicon where that is smaller.
    The played lexeme need not be the first of `best` (it may have been drawn, or asked for). codes: [N, d_z] style
    codes. gate: [N] how likely a gesture was on each block, NaN where the gate was not asked. notes: what the user
    should know, a line each.
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
    made_by: Mapping[str, Any] = field(default_factory=dict)
    """What made it, in plain values: the version, the bundle, and the settings that were asked for or chosen."""

    def __post_init__(self) -> None:
        n = len(self.blocks)
        if self.lexemes.shape != (n,) or self.best.ndim != 2 or len(self.best) != n or self.best.shape[1] == 0:
            raise ValueError(f"lexemes {self.lexemes.shape} and best {self.best.shape} do not fit {n} blocks")
        if self.scores.shape != self.best.shape or not np.isfinite(self.scores).all():
            raise ValueError(f"scores must be finite and shaped as best, {self.best.shape}")
        if (np.diff(self.scores, axis=1) > 0).any():
            raise ValueError("scores must fall: the best candidate first")
        if self.blocks.edges[0] != 0 or abs(self.blocks.edges[-1] - self.speech.duration) > _END_TOLERANCE:
            raise ValueError(f"blocks from {self.blocks.edges[0]} to {self.blocks.edges[-1]} s do not tile "
                             f"{self.speech.duration} s of sound")

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
        return positions_of(standing(self.motion))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it, whole or not at all, in the format of the suffix (`gesticulator.export.WRITERS`): .bvh the motion,
        .html a page that plays it, .json its plan.

        Folders that are missing are made. `InputError` for an unknown suffix; OSError where the disk refuses.
        """
        from gesticulator.export import write, writer_for

        writer_for(path)  # before a folder is made
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        return write(path, self)

    def explain(self) -> dict[str, Any]:
        """Why each block got its gesture, ready for JSON.

        {"made_by": what made it, "notes": what the user should know, "score": what a score is,
         "blocks": [{"start", "end", "flag", "silent", "played", "lexemes": [{"id", "score"}, ... best first]}]};
        seconds;
        `flag` is the lower-case name of the `BeatFlag` that closes the block; each block starts where the last
        one ended; `played` is the lexeme that was taken, and `gate`, where the gate was asked, how likely it thought a
        gesture.
        """
        edges = self.blocks.edges.tolist()
        gates = np.full(len(self.blocks), np.nan) if self.gate is None else self.gate
        return {"made_by": dict(self.made_by), "notes": list(self.notes), "score": self.score_is, "blocks": [
            {
                "start": start,
                "end": end,
                "flag": BeatFlag(int(flag)).name.lower(),
                "silent": bool(silent),
                "played": int(played),
                **({} if np.isnan(gate) else {"gate": float(gate)}),
                "lexemes": [{"id": int(lexeme), "score": float(score)}
                            for lexeme, score in zip(best, scores, strict=True)],
            }
            for start, end, flag, silent, played, gate, best, scores in zip(
                edges[:-1], edges[1:], self.blocks.flags, self.blocks.silent, self.lexemes, gates, self.best,
                self.scores, strict=True)
        ]}
