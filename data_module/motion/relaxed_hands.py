"""Synthetic fingers for motion recorded without: hand shapes that go with what the arm does.

Which shape is `hand_shapes`' to say. A fast hand opens, the fingers follow one after the other, the little finger last,
and none is ever quite still. The result is a function of the arm's motion alone, so the same motion always gets the
same fingers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.motion import hand_shapes, kinematics, rotation, skeletons
from data_module.motion.hand_shapes import HandMotion
from data_module.motion.skeletons import FINGER_JOINTS, FINGERS
from data_module.types import Array, Motion, Skeleton

# Share by which the bend is reduced in a fast hand.
_SPEED_OPENS = 0.22
# Height over the hips at which a hand counts as half raised, and the scale of the transition, metres; a hanging hand is
# 4 cm below them.
_LIFTED, _LIFT_WIDTH = 0.12, 0.05
# Speed of a fast hand, m/s.
_FAST = 0.7
# Smoothing of the hand's height and speed, seconds, so that fingers follow the arm loosely.
_SMOOTH = 0.12
# Lag of each finger behind the previous one, from the index finger on, seconds.
_LAG = 0.035
# Sideways angle of the fingers of an open hand, towards the thumb, degrees.
_SPREAD = {"Thumb": 0.0, "Index": 5.0, "Middle": 1.0, "Ring": -3.5, "Pinky": -8.0}
# Amplitude of the fidget of a resting hand's joints in degrees, and its period in seconds.
_FIDGET, _FIDGET_SECONDS = 1.6, 5.3
# Length of the character's arm to the wrist, metres.
_ARM = 0.53
# Direction of the closed left thumb: along the palm and under it.
_THUMB_GOAL = np.array([0.75, -0.55, -0.35])
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
            shaped = _shaped(motion, side)
            for name in names:
                out[:, motion.skeleton.index(name)] = _bent(motion.skeleton, name, shaped, motion.fps)
            filled += names
    if not filled:
        return motion
    absent = tuple(name for name in motion.absent if name not in filled)
    every = {*motion.filled, *filled}
    return replace(motion, rotations=out, absent=absent,
                   filled=tuple(name for name in motion.skeleton.names if name in every))


def hand_motion(motion: Motion, side: str) -> HandMotion:
    """Height, speed, turn, stretch and side of a hand of the character, smoothed."""
    arm = skeletons.facing(skeletons.resized(motion, skeletons.CHARACTER))
    places = kinematics.positions_of(arm)
    hand, shoulder = (places[:, arm.skeleton.index(side + name)] for name in ("Hand", "Arm"))
    world = kinematics.global_rotations(arm.skeleton, arm.rotations)[:, arm.skeleton.index(side + "Hand")]
    velocity = np.gradient(hand, 1.0 / motion.fps, axis=0) if len(hand) > 1 else np.zeros_like(hand)

    def smooth(values: Array) -> Array:
        return gaussian_filter1d(values, _SMOOTH * motion.fps, mode="nearest")

    # A logistic curve and no threshold: a hand near it must not flicker between shapes.
    lifted = 1.0 / (1.0 + np.exp(-(smooth(hand[:, 1]) - _LIFTED) / _LIFT_WIDTH))
    stretched = np.linalg.norm(hand - shoulder, axis=-1) / _ARM
    return HandMotion(lifted, smooth(np.linalg.norm(velocity, axis=-1)), smooth(-velocity[:, 1]),
                      smooth(-rotation.rotate(world, _UP)[:, 1]), smooth(stretched),
                      smooth(hand[:, 0] * (1.0 if side == "Left" else -1.0)))


def _shaped(motion: Motion, side: str) -> Array:
    """[T, 5, 4] of each finger the bend of its joints in degrees, and how far it is spread (1 in an open hand)."""
    hand = hand_motion(motion, side)
    weights = hand_shapes.mixture(hand, np.arange(len(motion)) / motion.fps, side)
    bends = np.einsum("tk,kfj->tfj", weights, np.stack(list(hand_shapes.SHAPES.values())))
    spread = weights @ np.array(list(hand_shapes.SPREAD.values()))
    # The thumb stays: it does not open with the speed of the hand.
    bends[:, 1:] *= (1.0 - _SPEED_OPENS * np.tanh(hand.speed / _FAST))[:, None, None]
    return np.concatenate([bends, np.repeat(spread[:, None, None], len(FINGERS), axis=1)], axis=2)


def _bent(skeleton: Skeleton, name: str, shaped: Array, fps: float) -> Array:
    """[T, 4] the local rotations of a finger joint of a hand whose fingers are shaped [T, 5, 4]."""
    side, finger, place = name[:name.index("Hand")], name[name.index("Hand") + 4:-1], int(name[-1]) - 1
    rank = FINGERS.index(finger)
    times = np.arange(len(shaped)) / fps
    joint, spread = (np.interp(times - _LAG * max(rank - 1, 0), times, shaped[:, rank, k]) for k in (place, 3))
    # The periods of the fingers have no common multiple within minutes, and the hands are out of phase.
    phase = 2.0 * np.pi * (times / (_FIDGET_SECONDS * (1.0 + 0.13 * rank)) + 0.21 * rank + 0.37 * (side == "Left"))
    bend = np.radians(joint + _FIDGET * np.sin(phase))
    turn = bend[:, None] * _axis(skeleton, side, finger)
    if place == 0:
        # About the upward axis the fingers of the left hand turn towards the thumb by a negative angle.
        way = -1.0 if side == "Left" else 1.0
        turn = turn + (way * np.radians(_SPREAD[finger]) * spread)[:, None] * _UP
    return rotation.from_exponential_map(turn)


def _axis(skeleton: Skeleton, side: str, finger: str) -> Array:
    """[3] the axis that a finger's joints bend about, towards the palm, which faces down at rest."""
    flip = np.array([1.0 if side == "Left" else -1.0, 1.0, 1.0])
    along = skeleton.offsets[skeleton.index(f"{side}Hand{finger}2")]
    goal = _THUMB_GOAL * flip if finger == "Thumb" else -_UP
    axis = np.cross(along, goal)
    return axis / np.linalg.norm(axis)
