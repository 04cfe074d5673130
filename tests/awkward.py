"""Figures of boxes in GLB files, with what real files have besides a body: for tests of what is made of them.

Unlike `tests/rigs.py` nothing is drawn at random but the axes of the bones. A figure faces +Z in its own space, with
its left at +X; nodes above it and names are given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.gltf_reader import save, with_arrays

SIDES = ("Left", "Right")
WIDTHS = {"Hips": 0.14, "Spine": 0.14, "Head": 0.09, "UpLeg": 0.08, "Leg": 0.06}
"""Half widths of boxes, metres; of others 0.04, of fingers 0.009."""
_POSES = {"T": 0.0, "A": -45.0, "down": -80.0}


@dataclass
class Figure:
    """A figure 1.75 m high. places: key -> [3] metres in the bind pose; parents: key -> key.

    names: key -> name in the file. above: (name, rotation, scale) of nodes over the hips, the outermost first. widths:
    half width of the boxes of extra bones; 0 for none.
    """

    places: dict[str, np.ndarray]
    parents: dict[str, str | None]
    names: Callable[[str], str] = lambda key: key
    above: Sequence[tuple[str, Rotation, float]] = ()
    widths: dict[str, float] = field(default_factory=dict)

    def add(self, key: str, parent: str | None, place: Sequence[float], width: float = 0.04) -> None:
        """A bone at a place, metres."""
        self.places[key], self.parents[key], self.widths[key] = np.array(place, dtype=float), parent, width

    def without(self, *ends: str) -> Figure:
        """The figure without the bones whose keys end so."""
        for key in [key for key in self.places if key.endswith(ends)]:
            del self.places[key], self.parents[key]
        return self

    def turned(self, turn: Rotation) -> Figure:
        """The figure, turned in its space."""
        self.places = {key: turn.apply(place) for key, place in self.places.items()}
        return self

    def beside(self, key: str, parent: str, offset: Sequence[float], width: float = 0.04) -> None:
        """A bone beside its parent, which is no part of the body."""
        self.add(key, parent, self.places[parent] + offset, width)


def figure(names: Callable[[str], str] = lambda key: key, pose: str = "T", fingers: Sequence[str] = (),
           toes: bool = True) -> Figure:
    """A body with three joints of the spine and one of the neck; fingers of three joints each."""
    out = Figure({}, {}, names)
    out.add("Hips", None, (0.0, 0.95, 0.0), 0.14)
    for key, above, y in (("Spine", "Hips", 1.05), ("Spine1", "Spine", 1.18), ("Spine2", "Spine1", 1.32),
                          ("Neck", "Spine2", 1.48), ("Head", "Neck", 1.58)):
        out.add(key, above, (0.0, y, -0.01), WIDTHS.get(key[:5].rstrip("12"), 0.05))
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        turn = Rotation.from_euler("Z", _POSES[pose] * sign, degrees=True)
        shoulder = np.array([0.17 * sign, 1.42, 0.0])

        def arm(x: float, y: float = 0.0, z: float = 0.0, turn: Rotation = turn, sign: float = sign,
                start: np.ndarray = shoulder) -> np.ndarray:
            return np.asarray(start + turn.apply([x * sign, y, z]))

        out.add(side + "Shoulder", "Spine2", (0.04 * sign, 1.43, 0.0))
        out.add(side + "Arm", side + "Shoulder", shoulder)
        out.add(side + "ForeArm", side + "Arm", arm(0.28, 0.0, -0.005))
        out.add(side + "Hand", side + "ForeArm", arm(0.53), 0.03)
        for place, finger in enumerate(fingers):
            above = side + "Hand"
            for joint in range(3):
                key = f"{side}Hand{finger}{joint + 1}"
                out.add(key, above, arm(0.56 + 0.02 * joint, -0.01, 0.03 + 0.02 * joint) if finger == "Thumb"
                        else arm(0.62 + 0.035 * joint, 0.0, 0.05 - 0.02 * place), 0.009)
                above = key
        out.add(side + "UpLeg", "Hips", (0.1 * sign, 0.91, 0.0), 0.08)
        out.add(side + "Leg", side + "UpLeg", (0.1 * sign, 0.5, 0.01), 0.06)
        out.add(side + "Foot", side + "Leg", (0.1 * sign, 0.09, -0.02))
        if toes:
            out.add(side + "ToeBase", side + "Foot", (0.1 * sign, 0.02, 0.11))
    return out


def write(path: Path, body: Figure) -> Path:
    """Write a figure as GLB with a skin, its bones' axes turned at random. Returns `path`."""
    keys = list(body.places)
    axes = dict(zip(keys, Rotation.random(len(keys), random_state=3).as_matrix(), strict=True))
    nodes: list[dict[str, Any]] = []
    for name, turn, scale in body.above:
        nodes.append({"name": name, "rotation": turn.as_quat().tolist(), "scale": [scale] * 3})
        if len(nodes) > 1:
            nodes[-2]["children"] = [len(nodes) - 1]
    first = len(nodes)
    for key in keys:
        parent = body.parents[key]
        turn, place = (axes[parent], body.places[parent]) if parent else (np.eye(3), np.zeros(3))
        nodes.append({"name": body.names(key), "translation": (turn.T @ (body.places[key] - place)).tolist(),
                      "rotation": Rotation.from_matrix(turn.T @ axes[key]).as_quat().tolist()})
        holder = first + keys.index(parent) if parent else first - 1
        if holder >= 0:
            nodes[holder].setdefault("children", []).append(len(nodes) - 1)
    points, joints, corners = _boxes(body, keys)
    inverse = np.tile(np.eye(4), (len(keys), 1, 1))
    for place, key in enumerate(keys):
        inverse[place, :3, :3], inverse[place, :3, 3] = axes[key].T, -axes[key].T @ body.places[key]
    slots, weights = np.zeros((len(points), 4), "<u2"), np.zeros((len(points), 4), "<f4")
    slots[:, 0], weights[:, 0] = joints, 1.0
    document = {
        "asset": {"version": "2.0"}, "nodes": [*nodes, {"name": "Body", "mesh": 0, "skin": 0}],
        "scene": 0, "scenes": [{"nodes": [0, len(nodes)]}],
        "skins": [{"joints": list(range(first, first + len(keys))), "inverseBindMatrices": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1, "JOINTS_0": 2, "WEIGHTS_0": 3}, "indices": 4}]}]}
    return save(path, *with_arrays(document, [(inverse.swapaxes(1, 2).reshape(-1, 16).astype("<f4"), "MAT4"),
                                              (points, "VEC3"), (slots, "VEC4"), (weights, "VEC4"),
                                              (corners, "SCALAR")]))


def _boxes(body: Figure, keys: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points [V, 3], the bone of each and corners of triangles: a box along each bone, to its first child."""
    points: list[np.ndarray] = []
    joints: list[int] = []
    corners: list[int] = []
    for key in keys:
        width, start = body.widths[key], body.places[key]
        if not width:
            continue
        below = [child for child in keys if body.parents[child] == key]
        parent = body.parents[key]
        end = body.places[below[0]] if below else start + 0.5 * (start - body.places[parent or key])
        end = start + np.array([0.0, 0.2, 0.0]) if key == "Head" else end
        way = (end - start) / np.linalg.norm(end - start)
        x = np.cross(way, [0.1, 0.2, 1.0]) / np.linalg.norm(np.cross(way, [0.1, 0.2, 1.0]))
        y, at = np.cross(way, x), len(points)
        points += [place + width * corner for place in (start, end) for corner in (x + y, x - y, -x - y, y - x)]
        joints += [keys.index(key)] * 8
        corners += [at, at + 2, at + 1, at, at + 3, at + 2, at + 4, at + 5, at + 6, at + 4, at + 6, at + 7]
        for one, other in ((0, 1), (1, 2), (2, 3), (3, 0)):
            corners += [at + one, at + other, at + 4 + one, at + other, at + 4 + other, at + 4 + one]
    return np.array(points, "<f4"), np.array(joints), np.array(corners, "<u2")
