"""What every writer of an animation is given: a tree of nodes at rest, and how it moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from data_module.motion import rotation, skeletons
from data_module.types import Array, Motion

if TYPE_CHECKING:
    from gesticulator.performance import Performance


_CHUNK = 1024
"""Frames whose matrices are held at once: an hour of them would take gigabytes."""


@dataclass(frozen=True)
class NodeMotion:
    """N nodes, parents before children, that move over T frames; frame t is the pose at t / fps seconds.

    names: N names, of which none is empty and none repeats. parents: N indices, -1 at the top.
    translations: [N, 3], rotations: [N, 4] (unit quaternions, w first), scales: [N, 3]: the local transforms at rest,
        x_parent = translation + rotation * (scale * x), Y up.
    turns: [T, N, 4] the local rotations over time, in place of those at rest.
    shifts: node -> [T, 3] local translations over time, for the nodes whose place changes.
    tips: node -> [3] the end of its bone in its own frame, where no child tells it.
    unit: metres per unit of length.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    translations: Array
    rotations: Array
    scales: Array
    turns: Array
    shifts: Mapping[int, Array]
    tips: Mapping[int, Array]
    fps: float
    unit: float = 1.0

    def __len__(self) -> int:
        return len(self.turns)

    @property
    def times(self) -> Array:
        """[T] seconds."""
        return np.arange(len(self)) / self.fps

    @property
    def duration(self) -> float:
        """Seconds: each frame lasts 1 / fps."""
        return len(self) / self.fps

    def rest_matrices(self) -> Array:
        """[N, 4, 4] the nodes' world matrices at rest."""
        return self._worlds(self.rotations[None], {})[0]

    def positions(self) -> Array:
        """[T, N, 3] where the nodes are, metres."""
        return np.concatenate([self._worlds(self.turns[start:start + _CHUNK], {
            node: places[start:start + _CHUNK] for node, places in self.shifts.items()})[..., :3, 3]
            for start in range(0, len(self), _CHUNK)]) * self.unit

    def _worlds(self, turns: Array, shifts: Mapping[int, Array]) -> Array:
        local = np.zeros((*turns.shape[:-1], 4, 4))
        for axis, unit in enumerate(np.eye(3)):
            local[..., :3, axis] = rotation.rotate(turns, unit) * self.scales[:, axis, None]
        local[..., :3, 3] = self.translations
        local[..., 3, 3] = 1.0
        for node, places in shifts.items():
            local[:, node, :3, 3] = places
        for node, parent in enumerate(self.parents):
            if parent >= 0:
                local[:, node] = local[:, parent] @ local[:, node]
        return local


def of_motion(motion: Motion) -> NodeMotion:
    """A motion as nodes. At rest the character stands in her T-pose where the motion has her on average, the root at
    its median height, so that a tool which shows the rest pose shows her on the floor."""
    skeleton = motion.skeleton
    rest = skeleton.offsets.copy()
    rest[0] = [0.0, float(np.median(motion.root_positions[:, 1])), 0.0]
    identity = np.zeros((len(skeleton), 4))
    identity[:, 0] = 1.0
    return NodeMotion(skeleton.names, skeleton.parents, rest, identity, np.ones((len(skeleton), 3)),
                      rotation.continuous(rotation.normalise(motion.rotations)), {0: motion.root_positions},
                      dict(skeleton.end_sites), motion.fps)


def shown(performance: Performance) -> Motion:
    """The motion on our own skeleton, standing on the floor."""
    return skeletons.standing(performance.motion)


def of_performance(performance: Performance) -> NodeMotion:
    """What a file of the performance shows."""
    return of_motion(shown(performance))
