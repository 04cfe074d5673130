"""Shapes of the hand: names such as "fist" or "victory", and the bends of the fifteen finger joints that they mean.

A shape is a curl of each finger, from 0 (straight) to 1 (in a fist), a spread between the fingers, and three angles of
the thumb. All are of a left hand; the right hand is its mirror image.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from data_module.motion.skeletons import FINGERED, FINGERS
from data_module.types import Array

_FULL = {"Thumb": (8.0, 34.0, 40.0), "Index": (72.0, 92.0, 55.0), "Middle": (74.0, 94.0, 56.0),
         "Ring": (76.0, 94.0, 56.0), "Pinky": (76.0, 92.0, 54.0)}
"""Bends of the joints of a closed finger, from the knuckle on, degrees."""
_SIDE = {"Index": -1.0, "Middle": -0.25, "Ring": 0.4, "Pinky": 1.15}
"""Share of the spread by which a finger turns away from the middle of the hand."""
_UNDER_PALM = np.array([0.75, -0.55, -0.35])
"""Direction towards which a thumb bends."""


@dataclass(frozen=True)
class HandShape:
    """A shape. curls: of index, middle, ring and little finger, 0 to 1; spread: degrees between neighbours; thumb: its
    curl (0 to 1), degrees away from the fingers, and degrees under the palm; knuckles: share of a curl that the
    knuckles take part in (0: only the outer joints bend, as in quotes)."""

    curls: tuple[float, float, float, float] = (0.1, 0.12, 0.15, 0.17)
    spread: float = 3.0
    thumb: tuple[float, float, float] = (0.1, 5.0, 0.0)
    knuckles: float = 1.0


_FOLDED = (0.75, -8.0, 55.0)
"""A thumb across the palm."""
SHAPES: dict[str, HandShape] = {
    "relaxed": HandShape((0.2, 0.24, 0.28, 0.3)),
    "open": HandShape((0.04, 0.05, 0.07, 0.08), 5.0, (0.0, 14.0, 0.0)),
    "flat": HandShape((0.02, 0.02, 0.02, 0.03), 0.5, (0.15, -12.0, 5.0)),
    "spread": HandShape((0.0, 0.0, 0.0, 0.0), 13.0, (0.0, 30.0, 0.0)),
    "fist": HandShape((1.0, 1.0, 1.0, 1.0), 0.0, (0.8, -10.0, 60.0)),
    "point": HandShape((0.0, 1.0, 1.0, 1.0), 0.0, (0.8, -10.0, 60.0)),
    "two": HandShape((0.0, 0.0, 1.0, 1.0), 4.0, _FOLDED),
    "victory": HandShape((0.0, 0.0, 1.0, 1.0), 16.0, _FOLDED),
    "three": HandShape((0.0, 0.0, 0.0, 1.0), 9.0, _FOLDED),
    "four": HandShape((0.0, 0.0, 0.0, 0.0), 9.0, (0.9, -25.0, 75.0)),
    "thumb": HandShape((1.0, 1.0, 1.0, 1.0), 0.0, (0.0, 42.0, 0.0)),
    "phone": HandShape((1.0, 1.0, 1.0, 0.0), 6.0, (0.0, 42.0, 0.0)),
    "crossed": HandShape((0.08, 0.12, 1.0, 1.0), -11.0, _FOLDED),
    "pinch": HandShape((0.52, 0.85, 0.95, 1.0), 0.0, (0.25, -4.0, 42.0)),
    "gap": HandShape((0.42, 0.85, 0.95, 1.0), 0.0, (0.16, 8.0, 38.0)),
    "ring": HandShape((0.56, 0.2, 0.1, 0.03), 9.0, (0.28, -4.0, 44.0)),
    "zero": HandShape((0.55, 0.52, 0.52, 0.54), 0.0, (0.35, 0.0, 42.0)),
    "bunch": HandShape((0.5, 0.5, 0.52, 0.55), -3.0, (0.25, -10.0, 48.0)),
    "round": HandShape((0.34, 0.34, 0.34, 0.34), 7.0, (0.2, 24.0, 35.0)),
    "claw": HandShape((0.45, 0.45, 0.45, 0.45), 11.0, (0.3, 25.0, 25.0), 0.3),
    "cup": HandShape((0.25, 0.25, 0.27, 0.3), 0.0, (0.2, -5.0, 10.0)),
    "quotes": HandShape((0.12, 0.12, 1.0, 1.0), 8.0, _FOLDED),
    "hooked": HandShape((0.75, 0.75, 1.0, 1.0), 6.0, _FOLDED, 0.5),
    "heart": HandShape((0.5, 0.5, 0.52, 0.55), 0.0, (0.0, 10.0, 20.0)),
    "pen": HandShape((0.48, 0.6, 0.85, 0.95), 0.0, (0.3, -4.0, 40.0)),
    "snap": HandShape((0.35, 0.62, 0.9, 0.95), 0.0, (0.3, -12.0, 44.0)),
    "keys": HandShape((0.22, 0.24, 0.26, 0.28), 6.0, (0.1, 8.0, 20.0)),
}


@functools.cache
def _axes() -> dict[str, Array]:
    """Finger -> [3] axis about which a left hand's finger bends; at rest the palm faces down and the fingers left."""
    out = {}
    for finger in FINGERS:
        along = FINGERED.offsets[FINGERED.index(f"LeftHand{finger}2")]
        axis = np.cross(along, _UNDER_PALM if finger == "Thumb" else np.array([0.0, -1.0, 0.0]))
        out[finger] = axis / np.linalg.norm(axis)
    return out


@functools.cache
def finger_turns(shape: str) -> Array:
    """[15, 3] exponential maps, radians, of the joints of a left hand in a shape, in the order of `FINGERS`."""
    hand = SHAPES[shape]
    rows = []
    for finger in FINGERS:
        thumb = finger == "Thumb"
        curl = hand.thumb[0] if thumb else hand.curls[FINGERS.index(finger) - 1]
        for place, degrees in enumerate(_FULL[finger]):
            share = curl * (hand.knuckles if place == 0 else 1.0)
            turn = share * degrees * _axes()[finger]
            if place == 0:
                turn = turn + (np.array([hand.thumb[2], -hand.thumb[1], 0.0]) if thumb
                               else np.array([0.0, hand.spread * _SIDE[finger], 0.0]))
            rows.append(np.radians(turn))
    return np.array(rows)
