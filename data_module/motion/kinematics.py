"""Forward kinematics, from local rotations to joint positions, and transitions between motions (minimum jerk,
inertialisation)."""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from data_module.motion import rotation
from data_module.types import Array, Motion, Skeleton

__all__ = ["fade_weights", "global_rotations", "joint_positions", "local_rotations", "minimum_jerk", "positions_of",
           "resample"]


def global_rotations(skeleton: Skeleton, rotations: Array) -> Array:
    """Local [..., J, 4] to world rotations [..., J, 4]."""
    return chained(skeleton.parents, rotations)


def chained(parents: Sequence[int], rotations: Array) -> Array:
    """As `global_rotations`, for any tree with parents before children, -1 for the root."""
    world = rotations.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            world[..., joint, :] = rotation.multiply(world[..., parent, :], rotations[..., joint, :])
    return world


def local_rotations(skeleton: Skeleton, world: Array) -> Array:
    """The inverse of `global_rotations`."""
    local = world.copy()
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            local[..., joint, :] = rotation.multiply(rotation.conjugate(world[..., parent, :]), world[..., joint, :])
    return local


def copied_rotations(motion: Motion, sources: Mapping[str, tuple[str, ...]], parents: Mapping[str, str | None]
                     ) -> dict[str, Array]:
    """Local rotations [T, 4] of another tree of joints with the same rest pose, by copying world rotations. sources:
    joint of that tree -> the joints of the motion whose world rotation it copies (halfway between two), parents first.
    parents: joint of that tree -> its parent, None for the root."""
    world = global_rotations(motion.skeleton, motion.rotations)
    turned: dict[str, Array] = {}
    local: dict[str, Array] = {}
    for joint, names in sources.items():
        first, last = (world[:, motion.skeleton.index(name)] for name in (names[0], names[-1]))
        # The normalised sum of two quaternions on one half sphere is the rotation half-way between them.
        turned[joint] = rotation.normalise(first + np.where(np.sum(first * last, -1, keepdims=True) < 0, -last, last))
        relative, parent = turned[joint], parents[joint]
        if parent is not None:
            relative = rotation.multiply(rotation.conjugate(turned[parent]), relative)
        local[joint] = rotation.continuous(rotation.normalise(relative))
    return local


def joint_positions(skeleton: Skeleton, rotations: Array, root_positions: Array | None = None) -> Array:
    """Positions [..., J, 3] in metres for local rotations [..., J, 4]; the root is at the origin by default."""
    world = global_rotations(skeleton, rotations)
    positions = np.zeros((*rotations.shape[:-1], 3))
    if root_positions is not None:
        positions[..., 0, :] = root_positions
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            bone = rotation.rotate(world[..., parent, :], skeleton.offsets[joint])
            positions[..., joint, :] = positions[..., parent, :] + bone
    return positions


def positions_of_some(motion: Motion, joints: Sequence[int]) -> Array:
    """As `positions_of` for these joints only, [T, len(joints), 3]; computes only the chains from the root to them."""
    return places_of_some(motion.skeleton, motion.rotations, joints, motion.root_positions)


def places_of_some(skeleton: Skeleton, rotations: Array, joints: Sequence[int], root: Array | None = None) -> Array:
    """As `positions_of_some` for local rotations [T, J, 4]; root: [T, 3] its places, by default the origin."""
    parents, offsets = skeleton.parents, skeleton.offsets
    order = with_ancestors(parents, tuple(joints))
    # Matrices: for few frames they take a third of the time of quaternions.
    local = rotation.to_matrix(rotations[:, order]).swapaxes(0, 1)
    turns: dict[int, Array] = {}
    places = {order[0]: np.zeros((len(rotations), 3)) if root is None else root}
    above = {parents[joint] for joint in order}
    for turn, joint in zip(local, order, strict=True):
        parent = parents[joint]
        if parent >= 0:
            places[joint] = places[parent] + turns[parent] @ offsets[joint]
        if joint in above:
            turns[joint] = turn if parent < 0 else turns[parent] @ turn
    return np.array([places[joint] for joint in joints]).swapaxes(0, 1)


@lru_cache(maxsize=64)
def with_ancestors(parents: tuple[int, ...], joints: tuple[int, ...]) -> tuple[int, ...]:
    """These joints and those above them in the tree, rising."""
    needed: set[int] = set()
    for joint in joints:
        while joint >= 0:
            needed.add(joint)
            joint = parents[joint]
    return tuple(sorted(needed))


def chains(skeleton: Skeleton, ends: Sequence[int]) -> tuple[Skeleton, list[int]]:
    """The skeleton of these joints and their ancestors, and its joint indices in the full one, rising."""
    joints = list(with_ancestors(skeleton.parents, tuple(ends)))
    parents = tuple(joints.index(skeleton.parents[joint]) if joint else -1 for joint in joints)
    return Skeleton(tuple(skeleton.names[joint] for joint in joints), parents, skeleton.offsets[joints]), joints


def positions_of(motion: Motion) -> Array:
    """Joint positions of a motion, [T, J, 3] metres."""
    return joint_positions(motion.skeleton, motion.rotations, motion.root_positions)


def resample(motion: Motion, fps: float) -> Motion:
    """The same motion at another frame rate: spherical interpolation of rotations, linear of the root."""
    if fps == motion.fps:
        return motion
    # No frame after the last one of the source: its motion is not extrapolated.
    count = max(1, int(np.floor((len(motion) - 1) * fps / motion.fps + 1e-9)) + 1)
    where = np.arange(count, dtype=np.float64) * motion.fps / fps
    root = np.stack([np.interp(where, np.arange(len(motion)), column) for column in motion.root_positions.T], axis=-1)
    return Motion(motion.skeleton, rotation.interpolate(motion.rotations, where), root, fps, motion.absent,
                  motion.filled)


def minimum_jerk(s: Array) -> Array:
    """The minimum-jerk step s^3 (10 - 15 s + 6 s^2) from 0 to 1, for s within [0, 1]."""
    return s ** 3 * (10.0 - 15.0 * s + 6.0 * s * s)


def fade_weights(s: Array) -> tuple[Array, Array, Array]:
    """The quintic by which what remains of an old motion fades over s from 0 to 1: the factors, shaped like s, on its
    position, its velocity and its acceleration (time in units of the fade). With s3 for the cube of s:

        1 - 10 s3 + 15 s4 - 6 s5,   s - 6 s3 + 8 s4 - 3 s5,   (s2 - 3 s3 + 3 s4 - s5) / 2

    Each begins with its own derivative at 1 and the two others at 0, and ends with all three at 0.
    """
    s2, s3, s4, s5 = s ** 2, s ** 3, s ** 4, s ** 5
    return (1.0 - 10.0 * s3 + 15.0 * s4 - 6.0 * s5, s - 6.0 * s3 + 8.0 * s4 - 3.0 * s5,
            0.5 * (s2 - 3.0 * s3 + 3.0 * s4 - s5))
