"""A small library of hand shapes, and which of them a movement calls for.

A hanging hand is half closed, the little finger most (the cascade). A raised hand is a mixture of shapes,

    h(t) = sum_k w_k(t) h_k,    w = softmax(s / T),

with scores s_k(t) that rise with what the hand does: the palm turned up cups, a fast hand opens, a chop is flat, a hand
held still pinches, an arm that is stretched out points, arms spread wide spread the fingers. A slow wave for each shape
and hand (a mood) is added, so that like movements do not always get the same shape. All of it is continuous in the
movement: another frame rate or a tiny change moves the fingers by as little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_module.types import Array

FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")
# Bend of the three joints of each finger from the palm on, degrees, the thumb first.
_SHAPES: dict[str, tuple[tuple[float, float, float], ...]] = {
    "hanging": ((8, 14, 16), (11, 36, 18), (18, 46, 23), (23, 48, 23), (29, 46, 22)),
    "relaxed": ((10, 14, 12), (5, 29, 13), (13, 40, 18), (21, 47, 22), (27, 48, 22)),
    "open": ((6, 10, 6), (1, 8, 4), (4, 14, 7), (9, 21, 10), (13, 26, 12)),
    "cup": ((-2, 2, 2), (9, 21, 10), (16, 31, 14), (21, 38, 18), (24, 42, 19)),
    "fist": ((14, 24, 20), (36, 64, 36), (44, 74, 40), (50, 78, 42), (50, 76, 40)),
    "point": ((18, 28, 22), (3, 9, 6), (36, 64, 34), (44, 70, 38), (44, 68, 36)),
    "pinch": ((20, 22, 12), (33, 46, 22), (22, 38, 18), (13, 31, 15), (9, 24, 12)),
    "spread": ((-10, -2, 0), (0, 5, 3), (3, 9, 4), (6, 15, 6), (9, 20, 8)),
}
RAISED = tuple(_SHAPES)[1:]
SHAPES = {name: np.array(bends, dtype=np.float64) for name, bends in _SHAPES.items()}
"""Name -> [5, 3] degrees."""
SPREAD = {"hanging": 0.3, "relaxed": 0.5, "open": 1.0, "cup": 0.6, "fist": 0.1, "point": 0.3, "pinch": 0.5,
          "spread": 1.9}
"""Name -> how far the fingers are apart, 1 for an open hand."""
# Temperature of the mixture: the lower, the purer the shapes.
_SHARP = 0.32
# Amplitude of the moods, and the period of the first shape's in seconds with what each shape adds.
_MOOD, _PERIODS = 0.9, (4.7, 1.31)
# Speed of a fast hand and downward speed of a chop, m/s.
_FAST, _CHOP = 0.7, 0.6
# From where to where an arm counts as stretched (wrist from shoulder, as a share of the arm) and a hand as far out to
# the side (metres).
_STRETCHED, _SIDE = (0.82, 0.97), (0.35, 0.55)


@dataclass(frozen=True)
class HandMotion:
    """The course of a hand, each [T]. lifted: 0 (hangs) to 1 (raised); speed, falling: m/s; palm_up: -1 to 1;
    stretched: distance of wrist and shoulder as a share of the arm; side: metres outwards from the middle of the body.
    """

    lifted: Array
    speed: Array
    falling: Array
    palm_up: Array
    stretched: Array
    side: Array


def mixture(hand: HandMotion, times: Array, side: str) -> Array:
    """[T, shapes] weights of `SHAPES`, in their order; they sum to 1. times: [T] seconds."""
    scores = _scores(hand) + np.stack([_mood(k, times, side) for k in range(len(RAISED))], axis=1)
    # Less the largest score, so that exp cannot overflow.
    weights = np.exp((scores - scores.max(axis=1, keepdims=True)) / _SHARP)
    weights *= (hand.lifted / weights.sum(axis=1))[:, None]
    return np.concatenate([1.0 - hand.lifted[:, None], weights], axis=1)


def _scores(hand: HandMotion) -> Array:
    """[T, raised shapes]."""
    fast, up = np.tanh(hand.speed / _FAST), np.maximum(hand.palm_up, 0.0)
    chop = np.clip(hand.falling / _CHOP, 0.0, 1.0) * (1.0 - np.abs(hand.palm_up))
    stretched, side = _ramp(hand.stretched, *_STRETCHED), _ramp(hand.side, *_SIDE)
    scores = {"relaxed": 0.9 - 0.5 * fast, "open": 0.3 + 0.9 * fast + 0.4 * up + 1.2 * chop, "cup": 1.6 * up - 0.2,
              "fist": -0.2 - 0.8 * up, "point": 1.0 * stretched - 0.1 - 0.5 * up, "pinch": 0.3 - 0.9 * fast - 0.4 * up,
              "spread": 0.7 * fast + 0.8 * side - 0.4}
    return np.stack([scores[name] + np.zeros_like(fast) for name in RAISED], axis=1)


def _mood(shape: int, times: Array, side: str) -> Array:
    """[T] a slow wave; no two shapes or hands have it at one time."""
    # Different periods for shapes and hands, so that combinations do not repeat within a performance.
    period = (_PERIODS[0] + _PERIODS[1] * shape) * (1.17 if side == "Left" else 1.0)
    phase = 0.38 * shape + 0.27 * (side == "Left")
    return _MOOD * np.sin(2.0 * np.pi * (times / period + phase))


def _ramp(values: Array, low: float, high: float) -> Array:
    return np.clip((values - low) / (high - low), 0.0, 1.0)
