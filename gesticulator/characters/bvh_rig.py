"""Characters in BVH files, and motion written onto them in the file's own joints, channels, units and axes."""

from __future__ import annotations

import os
from io import StringIO
from pathlib import Path

import numpy as np

from data_module.files import write_text
from data_module.motion import bvh, rotation
from data_module.types import Array
from gesticulator.characters import shape
from gesticulator.characters.rig import Character

DEFAULT_CHANNELS = ("Zrotation", "Xrotation", "Yrotation")
"""What is written for a joint of a character whose file is no BVH, or that has no channels of rotation in it."""
PLACES = ("Xposition", "Yposition", "Zposition")


def read_bvh_character(path: str | os.PathLike[str]) -> Character:
    """The skeleton of a BVH file, in its own units and axes.

    Its rest pose is that of all angles zero, as the format means it. Where that is no pose of a body (some tools write
    every offset along one axis, and the body stands only by the angles of the first frame), the first frame is taken
    as the pose to align with (`Character.bind`). `InputError` where the file is no BVH.
    """
    motion, channels = bvh.read_hierarchy(path)
    skeleton = motion.skeleton
    n = len(skeleton)
    rest = np.zeros((n, 4))
    rest[:, 0] = 1.0
    character = Character(skeleton.names, skeleton.parents, skeleton.offsets, rest, np.ones((n, 3)), Path(path), "bvh",
                          np.ones(n, dtype=bool), tips=dict(skeleton.end_sites), channels=channels)
    if _is_a_line(character.world_matrices()[:, :3, 3]):
        bind = character.world_matrices(motion.rotations[0], {0: motion.root_positions[0]})
        if not _is_a_line(bind[:, :3, 3]):
            character = Character(**{**vars(character), "bind": bind})
    return character


def _is_a_line(places: Array) -> bool:
    """Whether a body is narrower than a twentieth of its length in all but one direction."""
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(spread[1] < 0.05 * spread[0])


def write_character_bvh(path: str | os.PathLike[str], character: Character, rotations: Array,
                        placed: tuple[int, Array] | None, fps: float) -> None:
    """Write a motion of a character's own nodes as BVH, whole or not at all; `read_bvh_character` is the inverse.

    A BVH character keeps her hierarchy, order of channels, units and axes. Of another character the joints of the skin
    are written (with the nodes that join them), in a rest pose without rotations: each joint's world rotation is
    written relative to that of the bind pose, so the offsets show the bind pose.

    rotations: [T, N, 4] local; placed: a node and its local translation [T, 3]; fps: frames per second.
    """
    if character.kind != "bvh":
        character, rotations, placed = plain_skeleton(character, rotations, placed)
    frames, n = len(rotations), len(character)
    below: list[list[int]] = [[] for _ in range(n)]
    for node, parent in enumerate(character.parents):
        if parent >= 0:
            below[parent].append(node)
    channels = [_channels(character, node, placed[0] if placed else -1) for node in range(n)]
    lines, order = ["HIERARCHY"], list[int]()
    _describe(character, 0, below, channels, lines, order)
    columns: list[Array] = []
    for node in order:
        columns += _values(character, node, channels[node], rotations[:, node],
                           placed[1] if placed and placed[0] == node else None)
    body = StringIO()
    np.savetxt(body, np.stack(columns, axis=-1) + 0.0, fmt="%.6f")
    lines += ["MOTION", f"Frames: {frames}", f"Frame Time: {1.0 / fps:.10f}"]
    write_text(path, "\n".join(lines) + "\n" + body.getvalue())


def _channels(character: Character, node: int, placed: int) -> tuple[str, ...]:
    """The file's own channels, with those that the motion needs and the file lacks."""
    own = character.channels[node] if character.channels else ()
    turns = tuple(name for name in own if name.endswith("rotation"))
    places = tuple(name for name in own if name.endswith("position"))
    if sorted(turns) != sorted(DEFAULT_CHANNELS):
        own = (*places, *DEFAULT_CHANNELS)
    if (node == 0 or node == placed) and len(places) < 3:
        own = (*PLACES, *(name for name in own if name.endswith("rotation")))
    return own


def _values(character: Character, node: int, channels: tuple[str, ...], turns: Array, places: Array | None
            ) -> list[Array]:
    """The columns [T] of a node's channels; a place that the motion does not tell is that at rest."""
    order = "".join(name[0] for name in channels if name.endswith("rotation"))
    angles = np.degrees(np.unwrap(rotation.to_euler(turns, order), axis=0))
    still = np.broadcast_to(character.translations[node], (len(turns), 3))
    there = still if places is None else places
    return [there[:, PLACES.index(name)] if name in PLACES else angles[:, order.index(name[0])] for name in channels]


def _describe(character: Character, node: int, below: list[list[int]], channels: list[tuple[str, ...]],
              lines: list[str], order: list[int]) -> None:
    """The hierarchy as text, and the order in which its joints stand; without recursion, for trees of any depth."""
    todo: list[tuple[int, int, bool]] = [(node, 0, False)]
    while todo:
        at, depth, done = todo.pop()
        pad = "  " * depth
        if done:
            lines.append(pad + "}")
            continue
        order.append(at)
        offset = np.zeros(3) if depth == 0 and character.kind != "bvh" else character.translations[at]
        lines += [f"{pad}{'JOINT' if depth else 'ROOT'} {character.names[at]}", pad + "{",
                  f"{pad}  OFFSET {_triple(offset)}",
                  f"{pad}  CHANNELS {len(channels[at])} {' '.join(channels[at])}"]
        if not below[at] or at in character.tips:
            tip = character.tips.get(at, np.zeros(3))
            lines += [f"{pad}  End Site", pad + "  {", f"{pad}    OFFSET {_triple(tip)}", pad + "  }"]
        todo.append((at, depth, True))
        todo += [(child, depth + 1, False) for child in reversed(below[at])]


def _triple(values: Array) -> str:
    return " ".join(f"{value:.6f}" for value in np.asarray(values) + 0.0)


def plain_skeleton(character: Character, rotations: Array, placed: tuple[int, Array] | None
                   ) -> tuple[Character, Array, tuple[int, Array] | None]:
    """The joints of a character's skin as a skeleton whose rest is its bind pose without any rotation, in centimetres
    of its world, and the same motion on it.

    World rotation there = world rotation here * (world rotation in the bind pose) inverse.
    """
    kept = _kept(character, placed[0] if placed else -1)
    bind = shape.bind_matrices(character)
    scale = 100.0 * (character.unit or 1.0)
    names = _distinct_names([character.names[node] for node in kept])
    parents = [kept.index(character.parents[node]) if character.parents[node] in kept else -1 for node in kept]
    straight = _quaternions(turns_of(bind))
    world = _world_rotations(character, rotations)
    turned = np.stack([rotation.multiply(world[node], rotation.conjugate(straight[node])) for node in kept], axis=1)
    local = turned.copy()
    for place, parent in enumerate(parents):
        if parent >= 0:
            local[:, place] = rotation.multiply(rotation.conjugate(turned[:, parent]), turned[:, place])
    # Offsets from the transforms that the motion is played with: what the pose bends, it does not stretch.
    rest = character.world_matrices()
    offsets = np.zeros((len(kept), 3))
    for place, (node, parent) in enumerate(zip(kept, parents, strict=True)):
        above = rest[kept[parent]] if parent >= 0 else np.eye(4)
        way = rest[node, :3, 3] - above[:3, 3]
        if parent >= 0:
            turn = rotation.multiply(straight[kept[parent]], rotation.conjugate(_quaternions(turns_of(above))))
            way = rotation.rotate(turn, way)
        offsets[place] = scale * way
    root = np.broadcast_to(offsets[0], (len(rotations), 3))
    if placed is not None:
        matrices = [character.parents[placed[0]]]
        above = rest[matrices[0]] if matrices[0] >= 0 else np.eye(4)
        root = scale * (placed[1] @ above[:3, :3].T + above[:3, 3])
    n = len(kept)
    identity = np.zeros((n, 4))
    identity[:, 0] = 1.0
    plain = Character(names, tuple(parents), offsets, identity, np.ones((n, 3)), character.path, "plain",
                      np.ones(n, dtype=bool), unit=0.01)
    return plain, rotation.continuous(local), (0, root)


def _kept(character: Character, root: int) -> list[int]:
    """The nodes of the skin under `root` (the first joint where none is told), and those that join them to it."""
    if root < 0:
        root = int(np.flatnonzero(character.skinned)[0])
    wanted = {root}
    under = [False] * len(character)
    under[root] = True
    for node, parent in enumerate(character.parents):
        under[node] = under[node] or (parent >= 0 and under[parent])
    for node in np.flatnonzero(character.skinned):
        above = int(node)
        while under[above] and above not in wanted:
            wanted.add(above)
            above = character.parents[above]
    return sorted(wanted)


def _distinct_names(names: list[str]) -> tuple[str, ...]:
    """Names without blanks, each once: BVH knows no quotes, and two joints of one name are one joint to many tools."""
    out: list[str] = []
    for name in names:
        plain = "_".join(name.split()) or "node"
        number, unique = 1, plain
        while unique in out:
            number += 1
            unique = f"{plain}_{number}"
        out.append(unique)
    return tuple(out)


def turns_of(matrices: Array) -> Array:
    """[..., 3, 3] the rotations of matrices [..., 4, 4] without their scale: the nearest, by singular values."""
    left, _, right = np.linalg.svd(matrices[..., :3, :3])
    left[..., :, 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    return left @ right


def _quaternions(turns: Array) -> Array:
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    return flat.reshape(*turns.shape[:-2], 4)


def _world_rotations(character: Character, rotations: Array) -> Array:
    """[N] of [T, 4] world rotations."""
    world = np.empty((len(character), len(rotations), 4))
    for node, parent in enumerate(character.parents):
        own = rotations[:, node]
        world[node] = own if parent < 0 else rotation.multiply(world[parent], own)
    return world
