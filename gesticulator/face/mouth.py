"""The mouth of the default figure: the outlines of its lips and teeth.

`mouth_outline` is drawn in films and is the mouth of the head in GLB and USD; `viewer/src/mouth.js` draws the same one
in pages.
"""

from __future__ import annotations

import numpy as np

from data_module.types import Array
from gesticulator.face.visemes import CLOSED, VISEMES, opening

_SMILE = 17
"""Place of the smile in `FaceMotion.values`."""
_WIDE = np.array([0.0, -0.05, 0.1, 0.05, 0.1, 0.1, -0.45, 0.25, 0.05, -0.4, 0.05, 0.3, 0.45, -0.55, -0.9])
"""[15] width of the mouth in each viseme: -1 pouts, 1 spreads."""
_HALF, _GAP, _LINE = 0.0225, 0.025, 0.0009
"""Half the width of a mouth at rest, its widest gap, and the gap that is left of a shut one (the line between the
lips), metres for a head of the usual size."""
_UPPER_LIP, _LOWER_LIP, _TEETH, _CORNERS = 0.0046, 0.0062, 0.0055, 0.006
"""Thickness of the lips, length of the teeth, and how far a smile lifts the corners, metres."""


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
    # A pout is narrow and full, a spread mouth wide and thin, and pressed lips are thinner still.
    half = _HALF * (1.0 + 0.32 * wide + 0.14 * np.maximum(smile, 0.0))
    full = 1.0 + 0.35 * np.maximum(-wide, 0.0) - 0.5 * press
    t = np.linspace(-1.0, 1.0, count)
    bump = np.maximum(1.0 - t * t, 0.0) ** 0.7
    # A smile lifts the corners and lowers the middle a little, so that the mouth keeps its place.
    line = smile * _CORNERS * (t * t - 0.4)
    # The jaw opens the mouth: seven tenths of the gap lie below its line.
    top = line + bump * (_LINE / 2 + 0.3 * _GAP * open_ + 0.002 * bite)
    bottom = line - bump * (_LINE / 2 + 0.7 * _GAP * open_)
    upper = top + bump * full * _UPPER_LIP * (1.0 - 0.25 * np.exp(-((t / 0.2) ** 2)))  # it dips in the middle
    lower = bottom - bump * full * _LOWER_LIP * (1.0 - 0.55 * bite)
    return np.stack([t * half, upper, top, np.maximum(bottom, top - _TEETH), bottom, lower], axis=-1)
