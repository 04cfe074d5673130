"""Characters in BVH files, and BVH files of their motion with the same joints, channels, units and axes."""

import os
from io import StringIO
from pathlib import Path

import numpy as np

from data_module.files import write_text
from data_module.motion import bvh, rotation
from data_module.types import Array
from gesticulator.characters.rig import Character

DEFAULT_CHANNELS = ("Zrotation", "Xrotation", "Yrotation")
"""Channels of a joint that has no rotation channels in its file."""
PLACES = ("Xposition", "Yposition", "Zposition")


def read_bvh_character(path: str | os.PathLike[str]) -> Character:
    """The skeleton of a BVH file with all angles zero, in its units and axes. `InputError` if it is not BVH."""
    motion, channels = bvh.read_hierarchy(path)
    skeleton = motion.skeleton
    n = len(skeleton)
    rest = np.zeros((n, 4))
    rest[:, 0] = 1.0
    return Character(skeleton.names, skeleton.parents, skeleton.offsets, rest, np.ones((n, 3)), Path(path), "bvh",
                     np.ones(n, dtype=bool), tips=dict(skeleton.end_sites), channels=channels)


def write_character_bvh(path: str | os.PathLike[str], character: Character, rotations: Array,
                        placed: tuple[int, Array] | None, fps: float) -> None:
    """Write a motion of a BVH character atomically, with the hierarchy, channel order, units and axes of its file.

    rotations: [T, N, 4] local; placed: a node and its local translation [T, 3], None if all stay at rest; fps: frames
    per second.
    """
    channels = [_channels(character, node, placed[0] if placed else -1) for node in range(len(character))]
    lines, order = bvh.hierarchy(character.names, character.parents, character.translations, character.tips, channels)
    columns: list[Array] = []
    for node in order:
        columns += _values(character, node, channels[node], rotations[:, node],
                           placed[1] if placed and placed[0] == node else None)
    body = StringIO()
    # Adding 0.0 turns -0.0 into 0.0, so that equal motions give equal bytes.
    np.savetxt(body, np.stack(columns, axis=-1) + 0.0, fmt="%.6f")
    lines += ["MOTION", f"Frames: {len(rotations)}", f"Frame Time: {1.0 / fps:.10f}"]
    write_text(path, "\n".join(lines) + "\n" + body.getvalue())


def _channels(character: Character, node: int, placed: int) -> tuple[str, ...]:
    """The file's channels, plus those that the motion needs and the file lacks."""
    names = character.channels[node] if character.channels else ()
    turns = tuple(name for name in names if name.endswith("rotation"))
    places = tuple(name for name in names if name.endswith("position"))
    if sorted(turns) != sorted(DEFAULT_CHANNELS):
        names = (*places, *DEFAULT_CHANNELS)
    if (node == 0 or node == placed) and len(places) < 3:
        names = (*PLACES, *(name for name in names if name.endswith("rotation")))
    return names


def _values(character: Character, node: int, channels: tuple[str, ...], turns: Array, places: Array | None
            ) -> list[Array]:
    """The columns [T] of a node's channels; places None: the translation at rest."""
    order = "".join(name[0] for name in channels if name.endswith("rotation"))
    # Unwrapped: a jump by 360 degrees would be interpolated as a whole turn.
    angles = np.degrees(np.unwrap(rotation.to_euler(turns, order), axis=0))
    if places is None:
        places = np.broadcast_to(character.translations[node], (len(turns), 3))
    return [places[:, PLACES.index(name)] if name in PLACES else angles[:, order.index(name[0])] for name in channels]


def turns_of(matrices: Array) -> Array:
    """[..., 3, 3] the nearest rotations to matrices [..., 4, 4]; a mirrored one stays mirrored (determinant -1)."""
    left, _, right = np.linalg.svd(matrices[..., :3, :3])
    return np.asarray(left @ right)
