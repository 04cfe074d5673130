"""Names for lexemes, read off the movements that they decode to.

A lexeme is a number in a codebook; what a person can choose by is what the hands do in it. Each lexeme is decoded from
the pose that its nearest training block began with, and named by rule: which hand moves (more than `MOVES`), where to
(up, down, out, in, forward, back, by the greatest parts of the way), how far, or that it beats (there and back again).
Two lexemes of one name are numbered. The same bundle gives the same names. They tell form, never meaning: no lexeme
is a wave, and for meanings there are gestures made by formula (`gesticulator.directing.named_gestures`).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.motion.kinematics import positions_of
from data_module.types import Array
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.plan.plan import LexemeName
from lexicon.movement import MovementLexicon

MOVES, FAR = 0.05, 0.18
"""Metres of a hand's way from which it counts as moving, and as going far."""
BEATS = 2.2
"""A hand whose path is this many times as long as the way from its start to its end goes there and back."""
_LEANS = 0.6
"""Share of the greatest part of a way from which another part is told, too."""
_LIFTED = 0.12
"""Metres over the hips from which a hand is up."""
BIAS = 2.5
"""Nats by which a lexeme of one hand alone is preferred, or passed over, for handedness."""
_SIDES = ("Right", "Left")


@dataclass(frozen=True)
class HandWays:
    """What the hands do in S lexemes. ways: [S, 2, 3] metres from start to end, the right hand first: outwards from the
    body's middle, up, forward; paths: [S, 2] metres along the way; heights: [S, 2] metres over the hips, at the end."""

    ways: Array
    paths: Array
    heights: Array


@torch.no_grad()
def hand_ways(bundle: Bundle) -> HandWays | None:
    """Of every lexeme, decoded; None where a lexeme alone cannot be (RACER's codes are decoded together)."""
    lexicon: Any = bundle.lexicon
    if not hasattr(lexicon, "shown"):
        return None
    blocks = lexicon.shown()
    if isinstance(lexicon, MovementLexicon):  # it begins where the training block nearest to it began
        blocks = torch.cat([lexicon.examples[:, -1:], blocks], dim=1)
    statistics = bundle.statistics
    poses = blocks.double().cpu().numpy() * statistics.deviation + statistics.mean_pose.mean(axis=0)
    motion = representation_of(bundle.config).motion(poses.reshape(-1, poses.shape[-1]), 1.0)
    names = motion.skeleton.names
    places = positions_of(motion).reshape(*poses.shape[:2], len(names), 3)
    hands = places[:, :, [names.index(side + "Hand") for side in _SIDES]] - places[:, :, :1]
    hands = hands * np.array([[-1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])  # outwards is to the right for the right hand
    return HandWays(hands[:, -1] - hands[:, 0], np.linalg.norm(np.diff(hands, axis=1), axis=-1).sum(axis=1),
                    hands[:, -1, :, 1])


def lexeme_names(bundle: Bundle) -> tuple[LexemeName, ...]:
    """A name for each lexeme of a bundle, all different."""
    silent, ways = set(bundle.silent.tolist()), hand_ways(bundle)
    plain = [f"lexeme {number}" for number in range(len(bundle.vectors))]
    if ways is not None:
        plain = [described(ways.ways[n], ways.paths[n], ways.heights[n], n in silent) for n in range(len(plain))]
    seen: Counter[str] = Counter()
    out = []
    for number, name in enumerate(plain):
        seen[name] += 1
        out.append(LexemeName(number, name if seen[name] == 1 else f"{name} {seen[name]}", number in silent))
    return tuple(out)


def described(ways: Array, paths: Array, heights: Array, silent: bool) -> str:
    """What two hands do, in words. ways: [2, 3]; paths, heights: [2]; see `HandWays`."""
    moves = [float(path) > MOVES for path in paths]
    if silent:
        return "rest"
    if not any(moves):
        return "hold, hands " + ("up" if heights.min() > _LIFTED else "down" if heights.max() <= _LIFTED else "apart")
    told = [_way(ways[side], float(paths[side])) for side in (0, 1)]
    if all(moves):
        return f"both hands {told[0]}" if told[0] == told[1] else f"right hand {told[0]}, left hand {told[1]}"
    return f"right hand {told[0]}" if moves[0] else f"left hand {told[1]}"


def _way(way: Array, path: float) -> str:
    length = float(np.linalg.norm(way))
    if path > BEATS * max(length, 1e-6):
        return "beat"
    names = (("in", "out"), ("down", "up"), ("back", "forward"))
    order = [int(axis) for axis in np.argsort(-np.abs(way), kind="stable")]
    told = [names[axis][int(way[axis] > 0)] for axis in order if abs(way[axis]) >= _LEANS * abs(way[order[0]])]
    return ("far " if length > FAR else "") + " and ".join(told[:2])


def handed_bias(bundle: Bundle, hand: str) -> NDArray[np.float64] | None:
    """[S] nats to add to an interpreter's scores, so that it prefers lexemes of the left, the right or both hands."""
    ways = hand_ways(bundle)
    if ways is None:
        return None
    total = ways.paths.sum(axis=1)
    right = (ways.paths[:, 0] - ways.paths[:, 1]) / np.maximum(total, 1e-9)
    sided = {"right": right, "left": -right, "both": 1.0 - 2.0 * np.abs(right)}[hand]
    # A lexeme in which nothing moves is no hand's.
    bias: NDArray[np.float64] = BIAS * sided * np.clip(total / MOVES - 1.0, 0.0, 1.0)
    return bias
