"""Names for lexemes, derived from the movements that they decode to.

A lexeme is a number in a codebook; a person needs to know what the hands do in it. Each lexeme is decoded from the pose
at the start of its nearest training block, and named by rule: which hand moves (more than `MOVES`), the directions in
which it moves most (up, down, out, in, forward, back), how far, or that it beats (there and back again). Lexemes with
the same name are numbered. The same bundle gives the same names. Names describe form, not meaning: no lexeme is a
wave; gestures with a meaning are procedural (`gesticulator.directing.named_gestures`).
"""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from data_module.motion.kinematics import positions_of
from data_module.types import Array, Motion
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.plan.plan import LexemeName

MOVES, FAR = 0.05, 0.18
"""Path of a hand that counts as moving, and displacement that counts as far, metres."""
BEATS = 2.2
"""Ratio of path to displacement from which a movement counts as going there and back."""
_LEANS = 0.6
"""A direction is named if its share of the displacement is at least this part of the greatest share."""
LIFTED = 0.12
"""Height above the hips from which a hand counts as up, metres."""


@dataclass(frozen=True)
class HandWays:
    """Movements of the hands in S lexemes, the right hand first. motion: of all of them, one after the other, of equal
    length; ways: [S, 2, 3] displacement from start to end, metres outwards from the body's middle, up and forward;
    paths: [S, 2] length of the path, metres; heights: [S, 2] metres above the hips at the end."""

    motion: Motion
    ways: Array
    paths: Array
    heights: Array


def hand_ways(bundle: Bundle) -> HandWays | None:
    """Movements of the hands in every lexeme; None if lexemes cannot be decoded one by one (RACER's codes)."""
    lexicon: Any = bundle.runners["lexicon"]
    if not hasattr(lexicon, "shown"):
        return None
    blocks = lexicon.shown()
    # Movements need a start: that of the nearest training block.
    if hasattr(lexicon, "examples"):
        blocks = np.concatenate([lexicon.examples[:, -1:], blocks], axis=1)
    statistics = bundle.statistics
    poses = blocks.astype(np.float64) * statistics.deviation + statistics.mean_pose.mean(axis=0)
    motion = representation_of(bundle.config).motion(poses.reshape(-1, poses.shape[-1]), 1.0)
    names = motion.skeleton.names
    places = positions_of(motion).reshape(len(bundle.vectors), -1, len(names), 3)
    hands = places[:, :, [names.index(side + "Hand") for side in ("Right", "Left")]] - places[:, :, :1]
    # Outwards is to the right for the right hand.
    hands = hands * np.array([[-1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    paths = np.linalg.norm(np.diff(hands, axis=1), axis=-1).sum(axis=1)
    return HandWays(motion, hands[:, -1] - hands[:, 0], paths, hands[:, -1, :, 1])


def lexeme_names(bundle: Bundle) -> tuple[LexemeName, ...]:
    """A name for each lexeme of a bundle, all different."""
    silent, hands = set(bundle.silent.tolist()), hand_ways(bundle)
    # Numbered in the order of the codebook, so that a bundle gives the same names everywhere.
    count: Counter[str] = Counter()
    out = []
    for number in range(len(bundle.vectors)):
        name = f"lexeme {number}" if hands is None else "rest" if number in silent else _described(
            hands.ways[number], hands.paths[number], hands.heights[number])
        count[name] += 1
        out.append(LexemeName(number, name if count[name] == 1 else f"{name} {count[name]}", number in silent))
    return tuple(out)


def _described(ways: Array, paths: Array, heights: Array) -> str:
    """The movement of both hands in words. ways: [2, 3]; paths, heights: [2]; see `HandWays`."""
    moves = paths > MOVES
    if not moves.any():
        return "hold, hands " + ("up" if heights.min() > LIFTED else "down" if heights.max() <= LIFTED else "apart")
    right, left = (_way(way, float(path)) for way, path in zip(ways, paths, strict=True))
    if moves.all():
        return f"both hands {right}" if right == left else f"right hand {right}, left hand {left}"
    return f"right hand {right}" if moves[0] else f"left hand {left}"


def _way(way: Array, path: float) -> str:
    length = float(np.linalg.norm(way))
    if path > BEATS * max(length, 1e-6):
        return "beat"
    names = (("in", "out"), ("down", "up"), ("back", "forward"))
    # The largest direction first; a second one is named where it is nearly as large.
    order = [int(axis) for axis in np.argsort(-np.abs(way), kind="stable")]
    directions = [names[axis][int(way[axis] > 0)] for axis in order if abs(way[axis]) >= _LEANS * abs(way[order[0]])]
    return ("far " if length > FAR else "") + " and ".join(directions[:2])
