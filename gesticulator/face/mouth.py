"""The face of the figure in films: lips, teeth, eyes, lids and brows as outlines on the front of the head.

`lip_curves` is the mouth of our figure everywhere; `viewer/src/mouth.js` draws the same one in pages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from data_module.motion import kinematics, rotation, skeletons
from data_module.types import Array, Motion
from gesticulator.face.motion import FaceMotion
from gesticulator.face.visemes import CLOSED, VISEMES, opening

NUMBERS, LEFT, AHEAD = "Face", "HeadLeft", "HeadAhead"
"""Entries that a face adds to the points of a figure: [T, 20] `FaceMotion.values`, and the unit vectors [T, 3] from the
head to its left and ahead."""
_BLINK, _BROWS, _SMILE, _GAZE = 15, 16, 17, slice(18, 20)
_WIDE = np.array([0.0, -0.05, 0.1, 0.05, 0.1, 0.1, -0.45, 0.25, 0.05, -0.4, 0.05, 0.3, 0.45, -0.55, -0.9])
"""[15] width of the mouth in each viseme: -1 pouts, 1 spreads."""
_HALF, _GAP, _LINE = 0.0225, 0.025, 0.0009
"""Half the width of a mouth at rest, its widest gap, and the gap that is left of a shut one (the line between the
lips), metres for a head of the usual size."""
_UPPER_LIP, _LOWER_LIP, _TEETH, _CORNERS = 0.0046, 0.0062, 0.0055, 0.006
"""Thickness of the lips, length of the teeth, and how far a smile lifts the corners, metres."""

LIP, MOUTH, TOOTH, WHITE, IRIS, LASH = "#b3685d", "#4a1f22", "#f3eee4", "#f7f4ee", "#5a4634", "#2b211c"
_COLUMNS = 17
_LARGER = 1.5
"""Scale of the features in films, where a head is 50 pixels wide."""
_MOUTH_Y, _EYE_X, _EYE_Y, _BROW_Y = -0.045, 0.038, 0.036, 0.062
"""Places on the front of the head from its middle, metres."""
_EYE, _ABOVE, _BELOW, _IRIS = 0.018, 0.014, 0.010, 0.0092
"""Half the width of an eye, its heights above and below its middle, and the radius of an iris, metres."""
_BALL = 0.02
"""Metres that an iris moves when the eye turns by a radian."""
_SHOWS_TEETH, _BITES = 0.08, 0.3

Look = Callable[[Array], tuple[Array, Array, Array]]


class Patch(NamedTuple):
    """A filled outline: points [T, K, 3] in metres, and a colour."""

    points: Array
    colour: str


def face_points(face: FaceMotion, motion: Motion, times: Array) -> dict[str, Array]:
    """What a face adds to `figure_points` of the same motion and times."""
    frames = np.clip(np.asarray(times) * motion.fps, 0, len(motion) - 1)
    first = int(frames.min())
    near = skeletons.facing(skeletons.to_character(motion.crop(first, int(np.ceil(frames.max())) + 1)))
    turns = rotation.interpolate(near.rotations, frames - first)
    head = kinematics.global_rotations(near.skeleton, turns)[:, near.skeleton.index("Head")]
    return {NUMBERS: face.at(times), LEFT: rotation.rotate(head, np.array([1.0, 0.0, 0.0])),
            AHEAD: rotation.rotate(head, np.array([0.0, 0.0, 1.0]))}


def lip_curves(numbers: Array, count: int) -> Array:
    """[T, count, 6] `mouth_outline` of `FaceMotion.values` [T, 20]."""
    visemes = numbers[:, :len(VISEMES)]
    return mouth_outline(opening(visemes), visemes @ _WIDE, visemes[:, CLOSED], visemes[:, VISEMES.index("FF")],
                         numbers[:, _SMILE], count)


def mouth_outline(open_: Array, wide: Array, press: Array, bite: Array, smile: Array, count: int) -> Array:
    """[T, count, 6] a mouth from one corner to the other: to the left, then the heights of the upper lip's edges, the
    teeth's, and the lower lip's edges; metres from the middle of the mouth.

    Each [T]: opening, 0 to 1; width, -1 (a pout) to 1; how far the lips are pressed, 0 to 1; how far the teeth are on
    the lower lip, 0 to 1; smile, -1 to 1.
    """
    open_, wide, press, bite, smile = (part[:, None] for part in (open_, wide, press, bite, smile))
    half = _HALF * (1.0 + 0.32 * wide + 0.14 * np.maximum(smile, 0.0))
    full = 1.0 + 0.35 * np.maximum(-wide, 0.0) - 0.5 * press
    t = np.linspace(-1.0, 1.0, count)
    bump = np.maximum(1.0 - t * t, 0.0) ** 0.7
    line = smile * _CORNERS * (t * t - 0.4)
    top = line + bump * (_LINE / 2 + 0.3 * _GAP * open_ + 0.002 * bite)
    bottom = line - bump * (_LINE / 2 + 0.7 * _GAP * open_)
    upper = top + bump * full * _UPPER_LIP * (1.0 - 0.25 * np.exp(-((t / 0.2) ** 2)))  # it dips in the middle
    lower = bottom - bump * full * _LOWER_LIP * (1.0 - 0.55 * bite)
    return np.stack([t * half, upper, top, np.maximum(bottom, top - _TEETH), bottom, lower], axis=-1)


def features(now: Mapping[str, Array], look: Look, ball: tuple[Array, float], hair: str) -> tuple[Patch, ...]:
    """The features on a ball with the face, from back to front; those beyond its edge lie on it.

    ball: its centre [T, 3] and radius; hair: colour of the brows."""
    centre, radius = ball
    numbers, left, ahead = now[NUMBERS], now[LEFT], now[AHEAD]
    view = np.stack([look(centre + axis)[2] - look(centre)[2] for axis in np.eye(3)], axis=-1)
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    up = np.cross(ahead, left)

    def patch(outline: Array, colour: str) -> Patch:
        """outline: [T, K, 2] to the left and up."""
        u, v = outline[..., 0], outline[..., 1]
        deep = np.sqrt(np.maximum(radius ** 2 - u ** 2 - v ** 2, 0.0))
        away = (u[..., None] * left[:, None] + v[..., None] * up[:, None] + deep[..., None] * ahead[:, None])
        near = np.einsum("tkc,tc->tk", away, view)
        edge = away - near[..., None] * view[:, None]
        edge *= radius / np.maximum(np.linalg.norm(edge, axis=-1, keepdims=True), 1e-9)
        return Patch(centre[:, None] + np.where(near[..., None] < 0.0, edge, away), colour)

    return (*(patch(outline, colour) for outline, colour in _mouth(numbers)),
            *(patch(outline, colour) for side in (1.0, -1.0) for outline, colour in _eye(numbers, side, hair)))


def _mouth(numbers: Array) -> list[tuple[Array, str]]:
    curves = lip_curves(numbers, _COLUMNS) * _LARGER
    x = curves[..., 0]

    def between(one: Array, other: Array) -> Array:
        return np.concatenate([np.stack([x, _MOUTH_Y + one], -1), np.stack([x, _MOUTH_Y + other], -1)[:, ::-1]], axis=1)

    _, upper, top, teeth, bottom, lower = np.moveaxis(curves, -1, 0)
    visemes = numbers[:, :len(VISEMES)]
    shown = (opening(visemes) > _SHOWS_TEETH) | (visemes[:, VISEMES.index("FF")] > _BITES)
    # Teeth that are not shown lie under the edge of the upper lip, which is drawn over them.
    return [(between(top, bottom), MOUTH), (between(top, np.where(shown[:, None], teeth, top)), TOOTH),
            (between(upper, top), LIP), (between(bottom, lower), LIP)]


def _eye(numbers: Array, side: float, hair: str) -> list[tuple[Array, str]]:
    """White, iris, the edge of the lid, and brow. side: 1 left, -1 right."""
    t = np.linspace(-1.0, 1.0, _COLUMNS)
    blink, brows = numbers[:, _BLINK, None], numbers[:, _BROWS, None]

    def lids(place: Array) -> tuple[Array, Array]:
        """Heights of the lower and the upper lid at places [..., K] of -1 to 1."""
        bump = np.maximum(1.0 - place ** 2, 0.0) ** 0.6
        low = -_BELOW * bump
        return low, low + (_ABOVE + _BELOW) * bump * (1.0 - blink)

    def placed(u: Array, v: Array) -> Array:
        return np.stack([side * _EYE_X + u, _EYE_Y + v], axis=-1)

    still = np.broadcast_to(t, (len(numbers), _COLUMNS))
    low, high = lids(still)
    white = np.concatenate([placed(_EYE * still, low), placed(_EYE * still, high)[:, ::-1]], axis=1)
    angle = np.linspace(0.0, 2 * np.pi, 2 * _COLUMNS, endpoint=False)
    gaze = _BALL * numbers[:, _GAZE]
    u = np.clip(gaze[:, :1] + _IRIS * np.cos(angle), -_EYE, _EYE)
    iris = placed(u, np.clip(gaze[:, 1:] + 0.001 + _IRIS * np.sin(angle), *lids(u / _EYE)))
    wider = 1.08 * _EYE * still
    lash = np.concatenate([placed(wider, high), placed(wider, high + 0.0034)[:, ::-1]], axis=1)
    raised, drawn = np.maximum(brows, 0.0), np.maximum(-brows, 0.0)
    height = (_BROW_Y - _EYE_Y + 0.012 * raised - 0.004 * drawn + 0.006 * (1.0 - t ** 2)
              + side * t * (0.001 * raised + 0.005 * drawn))
    thick = 0.0038 * (1.0 - 0.6 * t ** 6)
    across = 0.021 * still - side * 0.004 * drawn
    brow = np.concatenate([placed(across, height - thick), placed(across, height + thick)[:, ::-1]], axis=1)
    return [(white, WHITE), (iris, IRIS), (lash, LASH), (brow, hair)]
