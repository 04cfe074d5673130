"""A visible body for a bare skeleton: one spindle of eight triangles per bone.

The mesh is in the world of the rest pose, metres; each spindle is rigidly attached to its joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from gesticulator.export.nodes import NodeMotion

WIDEST = 0.14
"""Half width of a spindle as a share of its length."""
_MOST = 0.035
"""Largest half width, metres."""
_LEAST = 1e-4
"""Shorter bones are omitted, metres."""
_BELLY = 0.18
"""Position of the widest point along the bone."""
_FACES = np.array([(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 1, 4), (5, 1, 2), (5, 2, 3), (5, 3, 4), (5, 4, 1)])


@dataclass(frozen=True)
class FigureMesh:
    """V vertices, each in one triangle (flat shading): positions and normals [V, 3], and the joint of each [V]."""

    positions: Array
    normals: Array
    joints: NDArray[np.int64]


def figure(motion: NodeMotion) -> FigureMesh:
    """The mesh of all bones of a skeleton at rest; [0, 3] if no bone has a length."""
    world = motion.rest_matrices()
    bones = [(parent, world[node, :3, 3]) for node, parent in enumerate(motion.parents) if parent >= 0]
    bones += [(node, world[node, :3, :3] @ tip + world[node, :3, 3]) for node, tip in motion.tips.items()]
    corners, joints = [], []
    for joint, end in bones:
        start = world[joint, :3, 3]
        if np.linalg.norm(end - start) * motion.unit > _LEAST:
            corners.append(_spindle(start, end, _MOST / motion.unit)[_FACES])
            joints.append(joint)
    triangles = np.concatenate(corners) if corners else np.zeros((0, 3, 3))
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return FigureMesh(triangles.reshape(-1, 3), np.repeat(normals, 3, axis=0),
                      np.repeat(np.array(joints, np.int64), 3 * len(_FACES)))


def _spindle(start: Array, end: Array, most: float) -> Array:
    """[6, 3] the first point, four around the widest place, and the last."""
    way = end - start
    length = float(np.linalg.norm(way))
    along = way / length
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    up = np.cross(along, across)
    belly = start + way * _BELLY
    around = min(WIDEST * length, most) * np.array([across, up, -across, -up])
    return np.concatenate([start[None], belly + around, end[None]])
