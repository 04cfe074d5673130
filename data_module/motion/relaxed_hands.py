"""Synthetic fingers for motion recorded without: hand shapes that go with what the arm does.

A hanging hand is half closed, the little finger most (the cascade). A raised hand is a mixture of shapes,

    h(t) = sum_k w_k(t) h_k,    w = softmax(s / T),

with scores s_k(t) that rise with what the hand does: the palm turned up cups, a fast hand opens, a chop is flat, a hand
held still pinches, an arm that is stretched out points, arms spread wide spread the fingers. A slow wave for each shape
and hand (a mood) is added, so that like movements do not always get the same shape. The fingers follow one after the
other, the little finger last, and none is ever quite still. All of it is continuous in the movement: another frame rate
or a tiny change moves the fingers by as little. It is a function of the arm's motion alone, so the same motion always
gets the same fingers.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.skeletons import FINGER_JOINTS, FINGERS
from data_module.types import Array, Motion, Skeleton

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
_RAISED = tuple(_SHAPES)[1:]
# Of each, how far the fingers are apart, 1 for an open hand.
_APART = {"hanging": 0.3, "relaxed": 0.5, "open": 1.0, "cup": 0.6, "fist": 0.1, "point": 0.3, "pinch": 0.5,
          "spread": 1.9}
# Temperature of the mixture: the lower, the purer the shapes.
_SHARP = 0.32
# Amplitude of the moods, and the period of the first shape's in seconds with what each shape adds.
_MOOD, _PERIODS = 0.9, (4.7, 1.31)
# Speed of a fast hand and downward speed of a chop, m/s.
_FAST, _CHOP = 0.7, 0.6
# From where to where an arm counts as stretched (wrist from shoulder, as a share of the arm) and a hand as far out to
# the side (metres).
_STRETCHED, _SIDE = (0.82, 0.97), (0.35, 0.55)
# Share by which the bend is reduced in a fast hand.
_SPEED_OPENS = 0.22
# Height over the hips at which a hand counts as half raised, and the scale of the transition, metres; a hanging hand is
# 4 cm below them.
_LIFTED, _LIFT_WIDTH = 0.12, 0.05
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


def _hand_motion(motion: Motion, side: str) -> HandMotion:
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
    hand = _hand_motion(motion, side)
    weights = _mixture(hand, np.arange(len(motion)) / motion.fps, side)
    bends = np.einsum("tk,kfj->tfj", weights, np.array(list(_SHAPES.values()), dtype=np.float64))
    spread = weights @ np.array(list(_APART.values()))
    # The thumb stays: it does not open with the speed of the hand.
    bends[:, 1:] *= (1.0 - _SPEED_OPENS * np.tanh(hand.speed / _FAST))[:, None, None]
    return np.concatenate([bends, np.repeat(spread[:, None, None], len(FINGERS), axis=1)], axis=2)


def _mixture(hand: HandMotion, times: Array, side: str) -> Array:
    """[T, shapes] weights of the shapes, in their order; they sum to 1. times: [T] seconds."""
    scores = _scores(hand) + np.stack([_mood(k, times, side) for k in range(len(_RAISED))], axis=1)
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
    return np.stack([scores[name] + np.zeros_like(fast) for name in _RAISED], axis=1)


def _mood(shape: int, times: Array, side: str) -> Array:
    """[T] a slow wave; no two shapes or hands have it at one time."""
    # Different periods for shapes and hands, so that combinations do not repeat within a performance.
    period = (_PERIODS[0] + _PERIODS[1] * shape) * (1.17 if side == "Left" else 1.0)
    phase = 0.38 * shape + 0.27 * (side == "Left")
    return _MOOD * np.sin(2.0 * np.pi * (times / period + phase))


def _ramp(values: Array, low: float, high: float) -> Array:
    return np.clip((values - low) / (high - low), 0.0, 1.0)


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
