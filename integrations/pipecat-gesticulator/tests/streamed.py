"""Where the joints of a stream are, by quaternions of the tests' own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pipecat_gesticulator import Joint


def places_of(joints: Sequence[Joint], turns: np.ndarray, root: np.ndarray) -> np.ndarray:
    """[T, J, 3] metres, from rotations [T, J, 4], w first, and the places [T, 3] of the root."""
    worlds: list[np.ndarray] = []
    places: list[np.ndarray] = []
    for number, joint in enumerate(joints):
        if joint.parent < 0:
            worlds.append(turns[:, number])
            places.append(root)
            continue
        above = worlds[joint.parent]
        places.append(places[joint.parent] + _rotate(above, np.array(joint.offset)))
        worlds.append(_multiply(above, turns[:, number]))
    return np.stack(places, axis=1)


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    w, v, x, u = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    return np.concatenate([w * x - (v * u).sum(-1, keepdims=True), w * u + x * v + np.cross(v, u)], -1)


def _rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return v + 2 * np.cross(q[..., 1:], np.cross(q[..., 1:], v) + q[..., :1] * v)
