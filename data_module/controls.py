"""Style editing: controls of the hands, and their measurement (RG 7.2.1, the C_i of Eq. 20 and 21).

Three features, each averaged over a sliding window of four seconds: the height of the right hand, the speed of both
hands and their distance from the body's axis. They are measured in the character's facing frame, in the time of the
recording, because normalising a block changes speeds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_module.errors import InputError
from data_module.motion import skeletons
from data_module.motion.kinematics import positions_of
from data_module.types import Array, Blocks, Motion

__all__ = ["Controls", "Curve", "Levels", "measure"]

FEATURES = ("height", "speed", "radius")
"""Right hand over the hips (m), mean speed of both hands (m/s), mean horizontal distance of both hands from the
vertical axis through the root (m)."""
LEVELS = ("low", "mid", "high")
QUANTILES = (0.15, 0.5, 0.85)
WINDOW = 4.0
"""Seconds (RG 7.2.1)."""

_HANDS = ("RightHand", "LeftHand")
# Spread below which a feature counts as constant, in its unit.
_LEAST_SPREAD = 1e-3


def per_frame(motion: Motion) -> Array:
    """The three `FEATURES` of a motion with the hands of the character, frame by frame, [T, 3]. The speed at a frame is
    the mean over the two adjacent intervals (one at the ends), so that it is neither delayed nor, like a central
    difference, too small where a hand reverses. A single frame has speed 0."""
    positions = positions_of(skeletons.facing(motion))  # the root is at the origin
    right, left = (positions[:, motion.skeleton.index(name)] for name in _HANDS)
    out = np.zeros((len(motion), len(FEATURES)))
    out[:, 0] = right[:, 1]
    for hand in (right, left):
        if len(motion) > 1:
            step = np.linalg.norm(np.diff(hand, axis=0), axis=-1) * motion.fps
            # A quarter: the mean of two intervals and of two hands.
            out[:, 1] += 0.25 * (np.append(step, step[-1]) + np.insert(step, 0, step[0]))
        out[:, 2] += 0.5 * np.linalg.norm(hand[:, [0, 2]], axis=-1)
    return out


def measure(motion: Motion, window: float = WINDOW) -> Array:
    """The features [T, 3] at the motion's own rate, averaged over `window` seconds about each frame (RG 7.2.1). The
    window is centred; at the ends it is cut off, not padded. `InputError` for a window that is negative."""
    if not 0 <= window < math.inf:
        raise InputError("window", f"is {window} s", f"give 0 or more seconds; the paper has {WINDOW:g}")
    return _averaged(per_frame(motion), round(window * motion.fps / 2))


def _averaged(values: Array, half: int) -> Array:
    # Differences of cumulative sums: one pass, whatever the length of the window.
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    at = np.arange(len(values))
    first, last = np.maximum(at - half, 0), np.minimum(at + half + 1, len(values))
    return (sums[last] - sums[first]) / (last - first)[:, None]


def at_knots(values: Array, fps: float, blocks: Blocks) -> Array:
    """Features [T, D], frame t at t / fps seconds, at the K frames of every block, [N, K, D]: the C_i of Eq. 20. Linear
    between frames; beyond the last frame its values are held."""
    times = np.arange(len(values)) / fps
    sampled = np.stack([np.interp(blocks.knot_times, times, column) for column in values.T], axis=-1)
    return sampled.reshape(len(blocks), blocks.frames, -1)


@dataclass(frozen=True)
class Levels:
    """Statistics of the training data. table: [3 features, 3 levels] the 15, 50 and 85 % quantiles; mean, spread: [3].
    All in the features' own units."""

    table: Array
    mean: Array
    spread: Array

    def __post_init__(self) -> None:
        shapes = self.table.shape, self.mean.shape, self.spread.shape
        if shapes != ((len(FEATURES), len(LEVELS)), (len(FEATURES),), (len(FEATURES),)):
            raise ValueError(f"levels of shapes {shapes}, not [3, 3], [3], [3]")
        if not all(np.isfinite(part).all() for part in (self.table, self.mean, self.spread)):
            raise ValueError("levels must be finite")
        if (np.diff(self.table, axis=1) < 0).any() or (self.spread <= 0).any():
            raise ValueError("levels must not fall from low to high, and spreads must be positive")

    @classmethod
    def fit(cls, values: Array) -> Levels:
        """From the measured features [n, 3] of the training split. A feature that never changes gets a spread of 1, so
        that standardising it stays harmless."""
        if values.ndim != 2 or values.shape[1] != len(FEATURES) or len(values) == 0:
            raise ValueError(f"levels are fitted on [n, 3] values, not {values.shape}")
        # Quantiles for the three levels, which are steps of what occurs; moments to standardise the input.
        spread = values.std(axis=0)
        return cls(np.quantile(values, QUANTILES, axis=0).T, values.mean(axis=0),
                   np.where(spread > _LEAST_SPREAD, spread, 1.0))

    def value(self, feature: str, level: str) -> float:
        """The value of "low", "mid" or "high" for a feature, in its unit; KeyError for another name."""
        if feature not in FEATURES or level not in LEVELS:
            raise KeyError(f"{feature}, {level}")
        return float(self.table[FEATURES.index(feature), LEVELS.index(level)])

    def to_dict(self) -> dict[str, Array]:
        return {"table": self.table, "mean": self.mean, "spread": self.spread}

    @classmethod
    def from_dict(cls, arrays: Mapping[str, ArrayLike]) -> Levels:
        table, mean, spread = (np.asarray(arrays[key], dtype=np.float64) for key in ("table", "mean", "spread"))
        return cls(table, mean, spread)


@dataclass(frozen=True)
class Curve:
    """A value that changes over time. times: seconds, strictly rising; values: in the feature's unit."""

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.times) != len(self.values) or not self.times:
            raise ValueError(f"{len(self.times)} times for {len(self.values)} values")
        if not np.isfinite([*self.times, *self.values]).all() or (np.diff(self.times) <= 0).any():
            raise ValueError("a curve needs finite values at strictly rising times")

    def at(self, times: Array) -> Array:
        """Linear between its points, constant before the first and after the last: [T] for times [T]."""
        return np.interp(times, self.times, self.values)


@dataclass(frozen=True)
class Controls:
    """The target of each feature: None for no target, a number for a constant one, a `Curve` for a varying one."""

    height: float | Curve | None = None
    speed: float | Curve | None = None
    radius: float | Curve | None = None

    def __post_init__(self) -> None:
        for name, value in zip(FEATURES, self._targets, strict=True):
            if isinstance(value, int | float) and not math.isfinite(value):
                raise ValueError(f"{name} must be finite, not {value}")

    @property
    def _targets(self) -> tuple[float | Curve | None, ...]:
        return self.height, self.speed, self.radius

    def at(self, times: Array) -> tuple[Array, NDArray[np.bool_]]:
        """At times [T]: the targets [T, 3] (0 for a free feature), and which features have one, [3]."""
        out = np.zeros((len(times), len(FEATURES)))
        for index, value in enumerate(self._targets):
            if value is not None:
                out[:, index] = value.at(times) if isinstance(value, Curve) else value
        return out, np.array([value is not None for value in self._targets])
