"""The thighs of a body that sits: hands lie on them and do not enter them.

Seen from a thigh, its surface is a height field: above the line from hip to knee, with s along it and w across, the
tangents of its slice at s (the support function h of angles a, 0 to the left and pi / 2 up) leave

    H(s, w) = min over a of (h(s, a) - w cos a) / sin a,   40 to 140 degrees,

the upper side of the slice, which falls beside it and beyond its ends with a slope of at most 1.2. A hand is moved
along the upward normal of the thigh alone: a direction out of a closed shape would turn round at its middle, and a hand
that passes through a thigh would jump. What it is moved by changes at most 1.2 times as fast as the hand moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from data_module.motion.skeletons import SIDES
from data_module.types import Array
from gesticulator.characters.trunk import (
    ANGLES,
    FEWEST,
    FEWEST_IN_SLICE,
    OUTER,
    SPARSE,
    HandLimit,
    Outline,
    near,
    scale_of,
    surface_of,
)

if TYPE_CHECKING:
    from gesticulator.characters.frames import Body

OUR_RADII = (0.076, 0.056)
"""Metres around the line from hip to knee of the default character, at its ends: as pages draw them."""
FINGERTIPS = ("HandThumb3", "HandIndex3", "HandMiddle3", "HandRing3", "HandPinky3")
"""Joints of a hand that are kept out of thighs with its wrist and knuckles."""
LEVEL = 0.7
"""Cosine between thighs and straight down below which a body sits: 45 degrees."""
THICK = 0.015
"""Metres that the joints of a hand are above a thigh at least: half the thickness of a hand."""
_UPPER = range(4, 15)
"""Directions of `ANGLES` from 40 to 140 degrees, of which the flattest tangent has a slope of 1.2."""
_STEEPEST, _ROUND = 1.2, 0.05
"""Slope beyond the ends of a thigh, and metres over which it begins."""
_STEPS = (np.arange(-1, 9) + 0.5) / 8.0
"""Slices of a thigh that is measured, 0 at the hip and 1 at the knee."""


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
        tangents = [(self.outline.support(share, np.full(len(share), ANGLES[at])) - across * np.cos(ANGLES[at]))
                    / np.sin(ANGLES[at]) for at in _UPPER]
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
    """Whether thighs with these ends [T, 3] are those of a body that sits."""
    ways = np.concatenate([np.atleast_2d(knee - hip) for hip, knee in zip(hips, knees, strict=True)])
    return bool((-ways[:, 1] < LEVEL * np.linalg.norm(ways, axis=-1)).all())


def seated_thighs(body: Body, turns: Mapping[int, Array]) -> tuple[Thigh, ...]:
    """Those of a character with these turns of its nodes; none where it does not sit."""
    joints = body.mapping.joints
    if not all(side + part in joints for side in SIDES for part in ("UpLeg", "Leg")):
        return ()
    hips, knees = ([body.place(turns, joints[side + part]) for side in SIDES] for part in ("UpLeg", "Leg"))
    if not is_level(hips, knees):
        return ()
    return tuple(Thigh(hip, knee, _measured(body, side) or tapering(*(radius * scale_of(body) for radius in OUR_RADII)))
                 for side, hip, knee in zip(SIDES, hips, knees, strict=True))


def thigh_margins(theirs: Sequence[Thigh], ours: Sequence[Thigh], places: Array, size: float) -> tuple[Array, ...]:
    """For each thigh of a character [T] metres that a point of its hand belongs above it: as far as that of the default
    character, at `places` [T, 3], but no farther than `MARGIN`, and half a hand where that does not sit (`ours` is
    empty). size: the length of its arm relative to ours."""
    if not ours:
        return tuple(np.full(len(places), size * THICK) for _ in theirs)
    return tuple(size * np.maximum(near(-thigh.depth(places)[0]), THICK) for thigh in ours)


def thigh_limits(theirs: Sequence[Thigh], places: Array, margins: Sequence[Array]) -> list[HandLimit]:
    """The half-spaces in which a point of a character's hand belongs that is at `places` [T, 3]."""
    out = []
    for thigh, margin in zip(theirs, margins, strict=True):
        depth, up = thigh.depth(places)
        out.append(HandLimit(up, depth + margin, margin))
    return out


def _measured(body: Body, side: str) -> Outline | None:
    """The outline of the vertices moved by a thigh; None if there are too few."""
    from gesticulator.characters.shape import bind_matrices

    character, joints = body.character, body.mapping.joints
    thigh = np.zeros(len(character), dtype=bool)
    thigh[joints[side + "UpLeg"]] = True
    mapped = set(joints.values())
    for node, parent in enumerate(character.parents):  # twist bones move with it
        thigh[node] |= parent >= 0 and bool(thigh[parent]) and node not in mapped
    points = character.flesh[thigh[character.flesh_nodes]] if len(character.flesh) else np.zeros((0, 3))
    if len(points) < SPARSE and len(character.flesh):
        points = np.concatenate([points, surface_of(character.skin, thigh)])
    if len(points) < FEWEST:
        return None
    hip, knee = (bind_matrices(character)[joints[side + part], :3, 3] @ body.bind_axes.T * body.unit
                 for part in ("UpLeg", "Leg"))
    length = float(np.linalg.norm(knee - hip))
    along = (knee - hip) / length
    left = np.array([1.0, 0.0, 0.0]) - along[0] * along
    left = left / np.linalg.norm(left)
    places = points @ body.bind_axes.T * body.unit - hip
    out = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1) @ np.stack([places @ left, places @ np.cross(along, left)])
    steps, rows = [], []
    for step in _STEPS:
        there = np.abs(places @ along / length - step) < 1.0 / 8.0
        if there.sum() >= FEWEST_IN_SLICE:
            steps.append(step)
            rows.append(np.percentile(out[:, there], OUTER, axis=1))
    return Outline(np.array(steps), np.array(rows)) if rows else None
