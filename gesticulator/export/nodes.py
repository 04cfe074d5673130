"""The input of animation writers: a tree of nodes at rest, and its motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from data_module.motion import rotation, skeletons
from data_module.types import Array, Motion, Skeleton

if TYPE_CHECKING:
    from gesticulator.characters.rig import Character, CharacterMotion


_CHUNK = 1024
"""Frames whose matrices are computed at a time, to bound memory."""


@dataclass(frozen=True)
class NodeMotion:
    """N nodes, parents before children, over T frames; frame t is the pose at t / fps seconds.

    names: N unique, non-empty names. parents: N indices, -1 for a root.
    translations: [N, 3] metres, rotations: [N, 4] (unit quaternions, w first): the local transforms at rest,
        x_parent = translation + rotation * x, Y up.
    turns: [T, N, 4] local rotations over time, replacing those at rest.
    shifts: node -> [T, 3] local translations over time, for nodes that translate.
    tips: node -> [3] the end of its bone in its frame, for nodes without a child.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    translations: Array
    rotations: Array
    turns: Array
    shifts: Mapping[int, Array]
    tips: Mapping[int, Array]
    fps: float

    def __len__(self) -> int:
        return len(self.turns)

    @property
    def times(self) -> Array:
        """[T] seconds."""
        return np.arange(len(self)) / self.fps

    def rest_matrices(self) -> Array:
        """[N, 4, 4] the nodes' world matrices at rest."""
        return self._worlds(self.rotations[None], {})[0]

    def positions(self) -> Array:
        """[T, N, 3] world positions of the nodes, metres."""
        return np.concatenate([self._worlds(self.turns[start:start + _CHUNK], {
            node: places[start:start + _CHUNK] for node, places in self.shifts.items()})[..., :3, 3]
            for start in range(0, len(self), _CHUNK)])

    def _worlds(self, turns: Array, shifts: Mapping[int, Array]) -> Array:
        local = np.zeros((*turns.shape[:-1], 4, 4))
        for axis, unit in enumerate(np.eye(3)):
            local[..., :3, axis] = rotation.rotate(turns, unit)
        local[..., :3, 3] = self.translations
        local[..., 3, 3] = 1.0
        for node, places in shifts.items():
            local[:, node, :3, 3] = places
        for node, parent in enumerate(self.parents):
            if parent >= 0:
                local[:, node] = local[:, parent] @ local[:, node]
        return local


def of_motion(motion: Motion) -> NodeMotion:
    """A motion as nodes. The rest pose is a T-pose standing on the floor, even for a seated motion: players of VRM
    animations scale the root path by the height of the hips at rest."""
    # Seated motion starts lower, which must not become the height that players scale by.
    skeleton = motion.skeleton
    rest = skeleton.offsets.copy()
    rest[0] = [0.0, skeletons.HIP_HEIGHT, 0.0]
    identity = np.zeros((len(skeleton), 4))
    identity[:, 0] = 1.0
    return NodeMotion(skeleton.names, skeleton.parents, rest, identity,
                      rotation.continuous(rotation.normalise(motion.rotations)), {0: motion.root_positions},
                      dict(skeleton.end_sites), motion.fps)


def of_character(moved: CharacterMotion) -> NodeMotion:
    """The joints of a character from the hips down the tree, in the file's axes, in metres; the hips become the root.

    Joints are the skin's nodes, the moved nodes, and nodes between them; meshes and cameras are omitted. Node scales
    are applied to the lengths below, so that nodes only rotate.
    """
    character = moved.character
    nodes = _joints_below(character, moved.hips, {*np.flatnonzero(character.skinned).tolist(), *moved.moved})
    rest, world = character.world_matrices(), moved.world_matrices()
    rest_turns, turns = (_turns(matrices[..., nodes, :, :]) for matrices in (rest, world))
    parents = [nodes.index(character.parents[node]) if node != moved.hips else -1 for node in nodes]
    # From here on metres; node scales are contained in the places.
    places = rest[nodes, :3, 3] * moved.unit
    count = len(nodes)
    offsets, local_rest, local = np.zeros((count, 3)), np.zeros((count, 4)), np.zeros((len(moved), count, 4))
    for index, parent in enumerate(parents):
        # Offsets in the rest frame of the parent, in metres, with all scales applied.
        back = rotation.conjugate(rest_turns[parent]) if parent >= 0 else np.array([1.0, 0.0, 0.0, 0.0])
        offsets[index] = rotation.rotate(back, places[index] - (places[parent] if parent >= 0 else 0.0))
        local_rest[index] = rotation.multiply(back, rest_turns[index])
        local[:, index] = turns[:, index] if parent < 0 else rotation.multiply(rotation.conjugate(turns[:, parent]),
                                                                               turns[:, index])
    tips = {nodes.index(node): rotation.rotate(rotation.conjugate(_turns(rest[node])),
                                              rest[node, :3, :3] @ tip) * moved.unit
            for node, tip in character.tips.items() if node in nodes}
    return NodeMotion(_unique([character.names[node] for node in nodes]), tuple(parents), offsets, local_rest,
                      rotation.continuous(rotation.normalise(local)),
                      {0: world[:, moved.hips, :3, 3] * moved.unit}, tips, moved.fps)


def _joints_below(character: Character, top: int, joints: set[int]) -> list[int]:
    """The node `top`, the joints below it, and the nodes between, parents first."""
    wanted = {top}
    for joint in joints:
        chain = [joint]
        while chain[-1] != top and character.parents[chain[-1]] >= 0:
            chain.append(character.parents[chain[-1]])
        if chain[-1] == top:
            wanted.update(chain)
    return sorted(wanted)


def _turns(matrices: Array) -> Array:
    """[..., 4] rotations of matrices [..., 4, 4], without their scales."""
    turns = matrices[..., :3, :3] / np.linalg.norm(matrices[..., :3, :3], axis=-2, keepdims=True)
    return rotation.from_matrix(turns)


def _unique(names: list[str]) -> tuple[str, ...]:
    """The names, with a number appended to empty or repeated ones."""
    unique: list[str] = []
    for index, name in enumerate(names):
        name = name or f"node_{index}"
        unique.append(name if name not in unique else f"{name}_{index}")
    return tuple(unique)


def with_identity_rest(motion: NodeMotion) -> Motion:
    """The motion on a skeleton with the same rest pose but identity rest rotations, as BVH requires, Y up, in metres.

    A joint's world rotation is then that from rest to its pose: W(t) W(rest)^-1.
    """
    rest = motion.rest_matrices()
    turns = motion.turns.copy()
    origin = _turns(rest)
    above = [origin[parent] if parent >= 0 else np.array([1.0, 0.0, 0.0, 0.0]) for parent in motion.parents]
    for node in range(len(motion.names)):
        # Local rotations in the rest frame of the parent joint: with W = prod L, the product telescopes.
        turns[:, node] = rotation.multiply(rotation.multiply(above[node], motion.turns[:, node]),
                                           rotation.conjugate(origin[node]))
    places = rest[:, :3, 3]
    offsets = np.array([place - places[parent] if parent >= 0 else np.zeros(3)
                        for place, parent in zip(places, motion.parents, strict=True)])
    tips = {node: rest[node, :3, :3] @ tip for node, tip in motion.tips.items()}
    root = motion.shifts.get(0, np.tile(motion.translations[0], (len(motion), 1)))
    return Motion(Skeleton(motion.names, motion.parents, offsets, tips), rotation.continuous(turns), root, motion.fps)
