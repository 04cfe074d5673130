"""Fingers of the performed strokes: limited in range, smoothed, and never quite still."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.types import Array
from gesticulator_performer.takes import soft_limit
from gesticulator_performer.torso import FPS

# Soft limit of the bend of a joint against the hanging hand: bends of overlapping strokes add up.
_FARTHEST = np.radians(95.0)
# Standard deviation of the low pass, seconds: in some clips the fingers jump from frame to frame.
_SMOOTH = 0.05
# Amplitude (radians) and period (seconds) with which a finger closes and opens at rest.
_FIDGET, _SECONDS = np.radians(2.0), 5.3
# What the middle joint of each finger, the thumb first, is bent more: a relaxed hand closes towards the little finger.
_CASCADE = np.radians([0.0, -4.0, 1.0, 6.0, 10.0])
# Axes about which the fingers of the left and the right hand close.
_CLOSING = (np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]))


def living_fingers(logs: Array, side: int) -> Array:
    """Log rotations [T, F, 3] (60 fps) of one hand's finger joints, limited, smoothed and with a slow fidget. side: 0
    left, 1 right."""
    joints = np.arange(logs.shape[1])
    times = np.arange(len(logs))[:, None] / FPS
    # The three joints of a finger move in phase; the fingers and the hands do not.
    period = _SECONDS * (1.0 + 0.13 * (joints // 3))
    phase = 2.0 * np.pi * (times / period + 0.21 * (joints // 3) + 0.37 * side)
    smooth = gaussian_filter1d(soft_limit(logs, _FARTHEST), _SMOOTH * FPS, axis=0, mode="nearest")
    more = np.where(joints % 3 == 1, _CASCADE[joints // 3], 0.0)
    return smooth + (more + _FIDGET * np.sin(phase))[..., None] * _CLOSING[side]
