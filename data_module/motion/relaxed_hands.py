"""Synthetic fingers for motion recorded without: a relaxed hand that opens and closes with the motion of the arm.

A hanging hand is half closed; a raised hand opens, more while it moves fast, and closes again as it comes to rest. The
fingers follow one after the other, the little finger last and farthest. The result is a function of the arm's motion
alone, so the same motion always gets the same fingers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.skeletons import FINGER_JOINTS, FINGERS
from data_module.types import Array, Motion, Skeleton

_CLOSED = {"Thumb": (10.0, 16.0, 18.0), "Index": (22.0, 30.0, 18.0), "Middle": (28.0, 36.0, 22.0),
           "Ring": (29.0, 37.0, 22.0), "Pinky": (30.0, 35.0, 22.0)}
"""Bend of the three joints of each finger of a hanging hand, from the palm on, degrees."""
_LIFT_OPENS, _SPEED_OPENS = 0.45, 0.35
"""Shares by which the bend is reduced in a raised hand and in a fast hand."""
_LIFTED, _LIFT_WIDTH = 0.12, 0.05
"""Height over the hips at which a hand counts as half raised, and the scale of the transition, metres; a hanging hand
is 4 cm below them."""
_FAST = 0.7
"""Speed of a fast hand, m/s."""
_SMOOTH = 0.12
"""Smoothing of the hand's height and speed, seconds, so that fingers follow the arm loosely."""
_LAG = 0.035
"""Lag of each finger behind the previous one, from the index finger on, seconds."""
_SPREAD = {"Thumb": 0.0, "Index": 5.0, "Middle": 1.0, "Ring": -3.5, "Pinky": -8.0}
"""Sideways angle of the fingers of an open hand, towards the thumb, degrees."""
_FIDGET, _FIDGET_SECONDS = 0.06, 5.3
"""Amplitude of the fidget of a resting hand, as a share of the bend, and its period in seconds."""
_THUMB_GOAL = np.array([0.75, -0.55, -0.35])
"""Direction of the closed left thumb: along the palm and under it."""
_UP = np.array([0.0, 1.0, 0.0])


def with_relaxed_hands(motion: Motion) -> Motion:
    """Fill the absent finger joints of a motion: they move from `absent` to `filled`. motion: on `FINGERED` or
    `WHOLE_BODY`. A hand with any recorded finger is not changed; without absent fingers the motion itself is
    returned."""
    out = motion.rotations
    filled: list[str] = []
    for side in ("Left", "Right"):
        names = [name for name in FINGER_JOINTS if name.startswith(side)]
        if all(name in motion.absent for name in names):
            out = out.copy() if not filled else out
            opened = openness(motion, side)
            for name in names:
                out[:, motion.skeleton.index(name)] = _bent(motion.skeleton, name, opened, motion.fps)
            filled += names
    if not filled:
        return motion
    absent = tuple(name for name in motion.absent if name not in filled)
    every = {*motion.filled, *filled}
    return replace(motion, rotations=out, absent=absent,
                   filled=tuple(name for name in motion.skeleton.names if name in every))


def openness(motion: Motion, side: str) -> Array:
    """[T] from 0 (a hanging hand) to `_LIFT_OPENS` + `_SPEED_OPENS` (a raised, fast hand)."""
    arm = skeletons.resized(motion, skeletons.CHARACTER)
    places = kinematics.positions_of(skeletons.facing(arm))
    hand = places[:, arm.skeleton.index(side + "Hand")]
    if len(hand) < 2:
        speed = np.zeros(len(hand))
    else:
        speed = np.linalg.norm(np.gradient(hand, 1.0 / motion.fps, axis=0), axis=-1)
    width = _SMOOTH * motion.fps
    speed = gaussian_filter1d(speed, width, mode="nearest")
    height = gaussian_filter1d(hand[:, 1], width, mode="nearest")
    lifted = 1.0 / (1.0 + np.exp(-(height - _LIFTED) / _LIFT_WIDTH))
    return _LIFT_OPENS * lifted + _SPEED_OPENS * np.tanh(speed / _FAST)


def _bent(skeleton: Skeleton, name: str, opened: Array, fps: float) -> Array:
    """[T, 4] the local rotations of a finger joint for the openness [T]."""
    side, finger, place = name[:name.index("Hand")], name[name.index("Hand") + 4:-1], int(name[-1]) - 1
    rank = FINGERS.index(finger)
    times = np.arange(len(opened)) / fps
    late = np.interp(times - _LAG * max(rank - 1, 0), times, opened)
    # The periods of the fingers have no common multiple within minutes, and the hands are out of phase.
    phase = 2.0 * np.pi * (times / (_FIDGET_SECONDS * (1.0 + 0.13 * rank)) + 0.21 * rank + 0.37 * (side == "Left"))
    bend = np.radians(_CLOSED[finger][place]) * (1.0 - late + _FIDGET * np.sin(phase))
    turn = bend[:, None] * _axis(skeleton, side, finger)
    if place == 0:
        # About the upward axis the fingers of the left hand turn towards the thumb by a negative angle.
        way = -1.0 if side == "Left" else 1.0
        turn = turn + (way * np.radians(_SPREAD[finger]) * (0.3 + late))[:, None] * _UP
    return rotation.from_exponential_map(turn)


def _axis(skeleton: Skeleton, side: str, finger: str) -> Array:
    """[3] the axis that a finger's joints bend about, towards the palm, which faces down at rest."""
    flip = np.array([1.0 if side == "Left" else -1.0, 1.0, 1.0])
    along = skeleton.offsets[skeleton.index(f"{side}Hand{finger}2")]
    goal = _THUMB_GOAL * flip if finger == "Thumb" else -_UP
    axis = np.cross(along, goal)
    return axis / np.linalg.norm(axis)
