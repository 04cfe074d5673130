"""A head with a face for the default skeleton in files: a mesh with blend shapes in ARKit's names, fixed to the head.

The shapes are those of ARKit that a plain face can show; `weights` gives the values of all 52, which other meshes in
the same scene may use.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from gesticulator.face.motion import FaceMotion
from gesticulator.face.mouth import mouth_outline
from gesticulator.face.shapes import ARKIT, arkit

JOINT = "Head"
_CENTRE, _RADII = np.array([0.0, 0.092, 0.016]), np.array([0.077, 0.118, 0.094])
"""The skull, an ellipsoid above the joint of the head, metres."""
_MOUTH_Y, _EYE_X, _EYE_Y, _BROW_Y = 0.043, 0.0295, 0.1, 0.1225
_EYE, _ABOVE, _BELOW, _IRIS, _PUPIL = 0.0145, 0.0095, 0.0075, 0.0066, 0.003
_BEFORE = 0.0016
"""Metres before the skull at which the features lie; each layer over another one is as far before it."""
_COLUMNS = 17
_LOOK = 0.0065
"""Metres that an iris moves at a full look."""
_CHIN = 0.013
_Shape = Callable[[Array], Array]
"""Points [n, 2] of a feature -> where a shape moves them."""
_FULL = {"jawOpen": 0.65, "mouthPucker": 0.65, "mouthStretch": 0.4, "mouthSmile": 0.7, "mouthFrown": 0.6,
         "mouthPress": 0.45, "mouthRollLower": 0.55, "mouthFunnel": 0.45}
"""The weight in `arkit` of the fullest mouth of its kind."""
SKIN, LIP, INSIDE, TOOTH, WHITE, DARK, HAIR = (
    (0.72, 0.49, 0.32), (0.45, 0.14, 0.11), (0.07, 0.014, 0.016), (0.9, 0.86, 0.78), (0.93, 0.9, 0.86),
    (0.035, 0.022, 0.014), (0.07, 0.042, 0.033))
"""Colours, linear red, green and blue."""


@dataclass
class FaceMesh:
    """V vertices in the frame of the head's joint: positions [V, 3] in metres, colours [V, 3], linear; triangles
    [F, 3]; shapes: ARKit's name -> [V, 3] by which a weight of 1 moves the vertices."""

    positions: Array = field(default_factory=lambda: np.zeros((0, 3)))
    colours: Array = field(default_factory=lambda: np.zeros((0, 3)))
    triangles: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    shapes: dict[str, Array] = field(default_factory=dict)

    def add(self, points: Array, triangles: NDArray[np.int64], colour: tuple[float, float, float],
            moved: Mapping[str, Array]) -> None:
        """Add a part; moved: name of a shape -> where its points [n, 3] are then."""
        count = len(self.positions)
        self.triangles = np.concatenate([self.triangles, triangles + count])
        self.positions = np.concatenate([self.positions, points])
        self.colours = np.concatenate([self.colours, np.tile(colour, (len(points), 1))])
        for name in {*self.shapes, *moved}:
            before = self.shapes.get(name, np.zeros((count, 3)))
            self.shapes[name] = np.concatenate([before, moved.get(name, points) - points])

    @property
    def normals(self) -> Array:
        """[V, 3] unit normals, out of the head."""
        away = self.positions - _CENTRE
        out = away / _RADII ** 2
        return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


def face_mesh() -> FaceMesh:
    """The head and its features."""
    mesh = FaceMesh()
    _skull(mesh)
    _mouth(mesh)
    for side in (1.0, -1.0):
        _eye(mesh, side)
    mesh.shapes = {name: mesh.shapes[name] for name in ARKIT if name in mesh.shapes}
    return mesh


def weights(face: FaceMotion) -> Array:
    """[T, 52] weights of ARKit's shapes, in their order."""
    curves = arkit(face)
    if face.lips_only:
        curves = {name: np.zeros_like(curve) if name.startswith(("eye", "brow")) else curve
                  for name, curve in curves.items()}
    return np.stack([curves[name] for name in ARKIT], axis=1)


def _on_skin(points: Array, layer: int) -> Array:
    """[n, 3] places on the front of the skull for points [n, 2], to the left and up."""
    u, v = (points[:, 0] - _CENTRE[0]) / _RADII[0], (points[:, 1] - _CENTRE[1]) / _RADII[1]
    deep = _CENTRE[2] + _RADII[2] * np.sqrt(np.maximum(1.0 - u * u - v * v, 0.0))
    return np.column_stack([points, deep + layer * _BEFORE])


def _band(count: int) -> NDArray[np.int64]:
    """Triangles between two rows of `count` points, the upper one first; they face ahead with x to the left."""
    a = np.arange(count - 1)
    return np.concatenate([np.column_stack([a, a + count, a + 1]), np.column_stack([a + 1, a + count, a + count + 1])])


def _patch(mesh: FaceMesh, outline: Array, layer: int, colour: tuple[float, float, float],
           moved: Mapping[str, Array]) -> None:
    """A band between two rows of points. outline: [2 n, 2]; moved: shape -> the same points then."""
    mesh.add(_on_skin(outline, layer), _band(len(outline) // 2), colour,
             {name: _on_skin(points, layer) for name, points in moved.items()})


def _up(points: Array, height: float) -> Array:
    """Points [n, 2], higher."""
    return np.asarray(points + np.array([0.0, height]))


def _skull(mesh: FaceMesh) -> None:
    unit, triangles = _sphere(18, np.pi)
    points = _CENTRE + _RADII * unit
    # The chin: everything below the lower lip of the widest mouth drops with the jaw.
    low = np.clip((_MOUTH_Y - 0.025 - points[:, 1]) / 0.03, 0.0, 1.0) * np.clip(0.5 + 2.0 * unit[:, 2], 0.0, 1.0)
    dropped = points - low[:, None] * [0.0, _CHIN / _FULL["jawOpen"], 0.0]
    mesh.add(points, triangles, SKIN, {"jawOpen": dropped})
    dome, triangles = _sphere(8, np.pi / 2)
    lean = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(0.5), np.sin(0.5)], [0.0, -np.sin(0.5), np.cos(0.5)]])
    mesh.add(_CENTRE + 1.055 * _RADII * (dome @ lean.T), triangles, HAIR, {})  # its edge is higher in front


def _sphere(rows: int, down: float) -> tuple[Array, NDArray[np.int64]]:
    """[n, 3] points of a unit sphere from its top to `down` radians from there, and triangles that face outwards."""
    around = 28
    up, turn = np.meshgrid(np.pi / 2 - np.linspace(0.0, down, rows), np.linspace(0, 2 * np.pi, around), indexing="ij")
    unit = np.stack([np.cos(up) * np.sin(turn), np.sin(up), np.cos(up) * np.cos(turn)], axis=-1).reshape(-1, 3)
    row, column = (part.ravel() for part in np.meshgrid(np.arange(rows - 1), np.arange(around - 1), indexing="ij"))
    a = row * around + column
    return unit, np.concatenate([np.column_stack([a, a + around, a + 1]),
                                 np.column_stack([a + 1, a + around, a + around + 1])])


def _mouth(mesh: FaceMesh) -> None:
    def curves(**parts: float) -> Array:
        open_, wide, press, bite, smile = (np.array([parts.get(name, 0.0)]) for name in (
            "open_", "wide", "press", "bite", "smile"))
        table = mouth_outline(open_, wide, press, bite, smile, _COLUMNS)[0]
        if not {"open_", "bite"} & set(parts):
            table[:, 3] = table[:, 2]  # no teeth between lips that meet
        return table

    rest = curves()
    fullest = {"jawOpen": {"open_": 1.0}, "mouthPucker": {"wide": -0.9}, "mouthFunnel": {"wide": -0.5},
               "mouthStretch": {"wide": 0.45}, "mouthSmile": {"smile": 1.0}, "mouthFrown": {"smile": -1.0},
               "mouthPress": {"press": 1.0}, "mouthRollLower": {"bite": 1.0}}
    moved: dict[str, Array] = {}
    share = np.clip(0.5 + rest[:, :1] / 0.01, 0.0, 1.0)  # how far a point is of the left side
    for name, parts in fullest.items():
        away = (curves(**parts) - rest) / _FULL[name]
        if name in ("mouthStretch", "mouthSmile", "mouthFrown", "mouthPress"):
            moved |= {f"{name}Left": rest + share * away, f"{name}Right": rest + (1.0 - share) * away}
        else:
            moved[name] = rest + away

    def rows(table: Array, first: int, second: int) -> Array:
        return np.concatenate([np.column_stack([table[:, 0], _MOUTH_Y + table[:, row]]) for row in (first, second)])

    for first, second, layer, colour in ((2, 4, 1, INSIDE), (2, 3, 2, TOOTH), (1, 2, 3, LIP), (4, 5, 3, LIP)):
        _patch(mesh, rows(rest, first, second), layer, colour,
               {name: rows(table, first, second) for name, table in moved.items()})


def _eye(mesh: FaceMesh, side: float) -> None:
    name, t = "Left" if side > 0 else "Right", np.linspace(-1.0, 1.0, _COLUMNS)
    middle = np.array([side * _EYE_X, _EYE_Y])
    bump = np.maximum(1.0 - t ** 2, 0.0) ** 0.6
    top, bottom = (np.column_stack([_EYE * t, height * bump]) + middle for height in (_ABOVE, -_BELOW))
    _patch(mesh, np.concatenate([top, bottom]), 1, WHITE, {})
    angle = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    fan = np.column_stack([np.zeros(24, np.int64), np.arange(1, 25), np.roll(np.arange(1, 25), -1)])
    looks = {f"eyeLookOut{name}": [side, 0.0], f"eyeLookIn{name}": [-side, 0.0], f"eyeLookUp{name}": [0.0, 1.0],
             f"eyeLookDown{name}": [0.0, -1.0]}
    for radius, layer, colour in ((_IRIS, 2, tuple(3.0 * part for part in DARK)), (_PUPIL, 3, DARK)):
        disc = np.concatenate([[[0.0, 0.0]], radius * np.column_stack([np.cos(angle), np.sin(angle)])]) + middle
        mesh.add(_on_skin(disc, layer), fan, (colour[0], colour[1], colour[2]),
                 {look: _on_skin(disc + _LOOK * np.array(way), layer) for look, way in looks.items()})
    above = _up(top, 0.0045)
    lid, shut = np.concatenate([above, top]), np.concatenate([above, _up(bottom, -0.001)])
    _patch(mesh, lid, 4, SKIN, {f"eyeBlink{name}": shut})
    lash = np.concatenate([_up(top, 0.0006), _up(top, -0.0010)])
    _patch(mesh, lash, 5, DARK, {f"eyeBlink{name}": np.concatenate([_up(bottom, 0.0004), _up(bottom, -0.0012)])})
    line = np.column_stack([side * _EYE_X + _EYE * t, _BROW_Y + 0.0032 * (1.0 - t ** 2)])
    brow = np.concatenate([_up(line, 0.0026), _up(line, -0.0026)])
    inner = np.tile(np.clip(0.5 - side * t, 0.0, 1.0), 2)[:, None] * [0.0, 1.0]  # how far a point is of the inner end
    outer = [0.0, 1.0] - inner
    _patch(mesh, brow, 2, HAIR, {"browInnerUp": brow + 0.016 * inner, f"browOuterUp{name}": brow + 0.016 * outer,
                                 f"browDown{name}": brow - 0.008 * inner - 0.003 * outer})
