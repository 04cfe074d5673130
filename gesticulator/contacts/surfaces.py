"""Trunks and thighs as slices: outlines by their support functions, and thighs as height fields.

Seen from a thigh, its surface is a height field: above the line from hip to knee, with s along it and w across, the
tangents of its slice at s (the support function h of angles a, 0 to the left and pi / 2 up) leave

    H(s, w) = min over a of (h(s, a) - w cos a) / sin a,   40 to 140 degrees,

the upper side of the slice, which falls beside it and beyond its ends with a slope of at most 1.2. A hand is moved
along the upward normal of the thigh alone: a direction out of a closed shape would turn round at its middle, and a hand
that passes through a thigh would jump. Its displacement changes at most 1.2 times as fast as the hand moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_module.types import Array

ANGLES = np.arange(36) * (2.0 * np.pi / 36)
"""Directions in which a slice is measured: between them the surface of a round one is at most 0.4 % farther out."""
OUR_RADII = (0.076, 0.056)
"""Metres around the line from hip to knee of the default character, at its ends: as pages draw them."""
FINGERTIPS = ("HandThumb3", "HandIndex3", "HandMiddle3", "HandRing3", "HandPinky3")
"""Joints of a hand that are kept out of thighs with its wrist and knuckles."""
LEVEL = 0.7
"""Cosine between thighs and straight down below which a body sits: 45 degrees."""
_UPPER = range(4, 15)
"""Directions of `ANGLES` from 40 to 140 degrees, of which the flattest tangent has a slope of 1.2."""
_STEEPEST, _ROUND = 1.2, 0.05
"""Slope beyond the ends of a thigh, and metres over which it begins."""


@dataclass(frozen=True)
class Outline:
    """The support function of a trunk: steps [H] heights along it, 0 at the hips and 1 at the neck; reach: [H, 36]
    metres from the line of the bones to the tangents with normals every 10 degrees, from left by ahead."""

    steps: Array
    reach: Array

    def support(self, share: Array, angle: Array) -> Array:
        """[T] metres to the tangent with its normal at angles [T] (0 left, pi / 2 ahead) at heights [T]."""
        # Bilinear between heights and directions; directions wrap around.
        row = np.clip(np.interp(share, self.steps, np.arange(len(self.steps))), 0.0, len(self.steps) - 1.0)
        column = np.mod(angle, 2.0 * np.pi) / (2.0 * np.pi) * len(ANGLES)
        low, first = np.floor(row).astype(int), np.floor(column).astype(int)
        high, second = np.minimum(low + 1, len(self.steps) - 1), (first + 1) % len(ANGLES)
        first = first % len(ANGLES)
        up, on = row - low, column - np.floor(column)
        return np.asarray((1.0 - up) * ((1.0 - on) * self.reach[low, first] + on * self.reach[low, second])
                          + up * ((1.0 - on) * self.reach[high, first] + on * self.reach[high, second]))


def ellipse(width: float, depth: float) -> Outline:
    """The outline of a column of constant half width and half depth, metres."""
    return Outline(np.array([0.0, 1.0]), np.tile(np.hypot(width * np.cos(ANGLES), depth * np.sin(ANGLES)), (2, 1)))


@dataclass(frozen=True)
class Thigh:
    """A thigh over T frames: hip, knee [T, 3] or [1, 3] metres from the middle of the hips; outline: its slices, steps
    from 0 at the hip to 1 at the knee, angles from its left by its upper side."""

    hip: Array
    knee: Array
    outline: Outline

    @property
    def axes(self) -> Array:
        """[T, 3, 3] rows: to its left, which is level, up, and along it."""
        along = self.knee - self.hip
        along = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
        # Level and not the bone's own left: a thigh that rolls keeps its upper side up.
        left = np.cross([0.0, 1.0, 0.0], along)
        left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
        return np.stack([left, np.cross(along, left), along], axis=-2)

    def depth(self, points: Array) -> tuple[Array, Array]:
        """[T] metres by which points [T, 3] are under the surface, negative above it, and [T, 3] the way up."""
        axes = self.axes
        across, height, along = np.moveaxis(np.einsum("tij,tj->ti", np.broadcast_to(axes, (len(points), 3, 3)),
                                                      points - self.hip), -1, 0)
        length = np.linalg.norm(self.knee - self.hip, axis=-1)
        share = along / np.maximum(length, 1e-9)
        # The height field of the module: the lowest of the tangents over this place across.
        tangents = [(self.outline.support(share, np.full(len(share), ANGLES[at])) - across * np.cos(ANGLES[at]))
                    / np.sin(ANGLES[at]) for at in _UPPER]
        # Beyond hip and knee it falls, rounded so that a hand gliding off has no kink in its path.
        beyond = np.maximum(np.maximum(-along, along - length), 0.0)
        top = np.min(tangents, axis=0) - _STEEPEST * (np.hypot(beyond, _ROUND) - _ROUND)
        return top - height, np.broadcast_to(axes[:, 1], points.shape)


def our_thighs(hips: Sequence[Array], knees: Sequence[Array]) -> tuple[Thigh, ...]:
    """Those of the default character. hips, knees: left and right [T, 3] metres from the middle of the hips."""
    return tuple(Thigh(hip, knee, tapering(*OUR_RADII)) for hip, knee in zip(hips, knees, strict=True))


def tapering(upper: float, lower: float) -> Outline:
    """The outline of a round thigh with these radii at hip and knee, metres."""
    return Outline(np.array([0.0, 1.0]), np.outer([upper, lower], np.ones(len(ANGLES))))


def is_level(hips: Sequence[Array], knees: Sequence[Array]) -> bool:
    """True if thighs with these ends [T, 3] are those of a body that sits."""
    ways = np.concatenate([np.atleast_2d(knee - hip) for hip, knee in zip(hips, knees, strict=True)])
    return bool((-ways[:, 1] < LEVEL * np.linalg.norm(ways, axis=-1)).all())
