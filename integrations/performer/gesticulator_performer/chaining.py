"""Join stretches of motion to a talk at the places where pose and velocity agree best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_module.motion.kinematics import quintic_offset
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array
from gesticulator_performer.torso import FPS

# Seconds: a difference in velocity costs as much as the difference in pose that it makes in this time.
_VELOCITY = 0.12
# Frames between the candidate places at which a stretch may be left or entered.
_STEP = 3
# A stretch is left in the last 35 % and entered in the first 40 % of its length.
_LEAVE, _ENTER = 0.35, 0.4
# Least seconds of a stretch that are played.
_LEAST = 2.0
# The next stretch is drawn at random from this many with the lowest cost.
_BEST = 3
# Seconds over which the offset at a seam fades, for close poses and for distant ones.
_FADE, _LONGEST_FADE = 0.45, 0.9
# Square root of the cost at which the longest fade is used (weighted radians).
_FAR = 3.0
# Weights of the joints in the cost of a seam.
_WEIGHTS = np.array([{"Hips": 0.7, "LeftArm": 2.0, "RightArm": 2.0, "LeftForeArm": 1.5, "RightForeArm": 1.5,
                      "LeftHand": 0.3, "RightHand": 0.3}.get(name, 1.0) for name in CHARACTER.names])


@dataclass(frozen=True)
class Chain:
    """A talk made of stretches. logs: [T, J, 3]; edges: [K + 1] seconds at which stretches begin, and the end;
    used: [K] indices of the stretches."""

    logs: Array
    edges: Array
    used: tuple[int, ...]


def chain(stretches: Sequence[Array], seconds: float, rng: np.random.Generator, recent: int = 6) -> Chain:
    """Join stretches [T, J, 3] at 60 fps until `seconds` are filled, without repeating any of the last `recent`. Each
    seam is at the two places where pose and velocity are nearest; the remaining offset fades by a quintic. ValueError
    with fewer than two stretches."""
    if len(stretches) < 2:
        raise ValueError("a chain needs two stretches at least")
    recent = min(recent, len(stretches) - 1)
    features = [_features(logs) for logs in stretches]
    now, start = int(rng.integers(len(stretches))), 3
    out = np.zeros((0, *stretches[0].shape[1:]))
    used, edges, fade = [now], [0.0], 0.0
    while True:
        leave, following, enter, cost = _next(stretches, features, used[-recent:], now, start, rng)
        out = _joined(out, stretches[now], start, leave, fade)
        if len(out) >= seconds * FPS:
            break
        edges.append(len(out) / FPS)
        used.append(following)
        now, start = following, enter
        fade = _FADE + (_LONGEST_FADE - _FADE) * min(1.0, float(np.sqrt(cost)) / _FAR)
    frames = round(seconds * FPS)
    return Chain(out[:frames], np.array([*edges, frames / FPS]), tuple(used))


def _features(logs: Array) -> Array:
    """[T, 96] weighted poses and velocities, fingers left out; the cost of a seam is the squared distance of two rows.
    """
    logs = logs[:, :len(_WEIGHTS)]
    velocity = np.gradient(logs, 1.0 / FPS, axis=0) * _VELOCITY
    both = np.concatenate([logs * _WEIGHTS[:, None], velocity * _WEIGHTS[:, None]], axis=1)
    return both.reshape(len(logs), -1)


def _next(stretches: Sequence[Array], features: Sequence[Array], recent: Sequence[int], now: int, start: int,
          rng: np.random.Generator) -> tuple[int, int, int, float]:
    """(frame at which to leave `now`, next stretch, frame at which to enter it, cost of the seam)."""
    length = len(stretches[now])
    first = min(max(start + round(_LEAST * FPS), round(length * (1.0 - _LEAVE))), length - 2)
    ends = np.arange(first, length - 1, _STEP)
    options: list[tuple[float, int, int, int]] = []
    for k, logs in enumerate(stretches):
        if k in recent:
            continue
        last = max(4, min(round(len(logs) * _ENTER), len(logs) - round(_LEAST * FPS) - 10))
        starts = np.arange(3, last, _STEP)
        gap = features[now][ends][:, None] - features[k][starts][None]
        cost = np.einsum("ijk,ijk->ij", gap, gap)
        a, b = np.unravel_index(int(cost.argmin()), cost.shape)
        options.append((float(cost[a, b]), k, int(ends[a]), int(starts[b])))
    options.sort()
    cost_of, k, leave, enter = options[int(rng.integers(min(_BEST, len(options))))]
    return leave, k, enter, cost_of


def _joined(out: Array, logs: Array, start: int, leave: int, fade: float) -> Array:
    piece = logs[start:leave + 1].copy()
    if len(out) >= 3:
        times = np.arange(len(piece)) / FPS
        offset = quintic_offset(out[-3:].reshape(3, -1), logs[start - 3:start].reshape(3, -1), times, fade, FPS)
        piece += offset.reshape(piece.shape)
    return np.concatenate([out, piece])


def seam_ratio(hands: Array, edges: Array) -> float:
    """Mean acceleration of the faster hand within two frames of the inner edges (seconds), divided by that elsewhere.
    hands: [T, 2, 3] metres at 60 fps. 1 without an inner edge."""
    acceleration = np.linalg.norm(np.diff(hands, 2, axis=0), axis=-1).max(axis=1)
    at = np.round(edges[1:-1] * FPS).astype(int)
    at = at[(at > 2) & (at < len(acceleration) - 3)]
    near = np.zeros(len(acceleration), dtype=bool)
    near[(at[:, None] + np.arange(-2, 2)).ravel()] = True
    if not near.any() or near.all():
        return 1.0
    return float(acceleration[near].mean() / max(acceleration[~near].mean(), 1e-9))
