"""Retargeting: the motion of our character on the skeleton of any other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_module.types import Array
from gesticulator.characters.rig import Character


@dataclass(frozen=True)
class CharacterMotion:
    """A motion of a character's own nodes, ready for a file in her own units and axes.

    character: N nodes.
    rotations: [T, N, 4] local rotations of all nodes, unit quaternions, w first, continuous over time; nodes that
        nothing moves stand as they do at rest.
    translations: [T, 3] local translation of the node `hips`, in the character's units and in its parent's frame;
        None where it stays as at rest.
    fps: frames per second; frame t is the pose at t / fps seconds.
    joints: our joint (a name of `data_module.motion.skeletons.WHOLE_BODY`) -> node.
    moved: the nodes whose rotations are written (an animation need not hold the others), in rising order.
    unit: metres per unit of the character's lengths, as they stand in its world (after scaled nodes).
    """

    character: Character
    rotations: Array
    translations: Array | None
    fps: float
    joints: Mapping[str, int]
    moved: tuple[int, ...]
    unit: float

    def __post_init__(self) -> None:
        frames = len(self.rotations)
        if self.rotations.shape != (frames, len(self.character), 4) or not frames:
            raise ValueError(f"rotations {self.rotations.shape} do not fit {len(self.character)} nodes")
        if self.translations is not None and self.translations.shape != (frames, 3):
            raise ValueError(f"translations {self.translations.shape} do not fit {frames} frames")
        if not np.isfinite(self.rotations).all() or not (self.fps > 0):
            raise ValueError("rotations must be finite and fps positive")

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def hips(self) -> int:
        """The node that carries the body."""
        return self.joints["Hips"]

    def world_matrices(self) -> Array:
        """[T, N, 4, 4] the nodes' world matrices, in the file's units and axes."""
        moved = {} if self.translations is None else {self.hips: self.translations}
        return self.character.world_matrices(self.rotations, moved)
