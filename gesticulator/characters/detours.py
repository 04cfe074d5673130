"""The way of a hand around a trunk, begun so early that the hand needs no haste.

`gesticulator.characters.trunk` decides frame by frame: a hand that passes a slim waist in a tenth of a second is led
around a stout one in the same tenth, twice as fast. Here the displacements of a whole motion are spread over time: they
are smoothed, and where the hand would be nearer to the trunk than it belongs, or beyond reach, it is brought back, in
turns. These are the steps of a projected gradient descent on the integral of |d'(t)|^2 over the displacements d(t) that
keep the hand outside, stopped when d has spread by `AHEAD`. Where the hand is still faster than it would be without
correction, its path is smoothed as well, so that the haste of a moment is shared with the moments around it. The
descent begins with the displacements of each frame, which say on which side of the trunk a hand belongs. A motion that
ends where it began is smoothed as a loop; others keep the displacements at their ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from data_module.motion.skeletons import SIDES
from data_module.types import Array
from gesticulator.characters.contacts import Pose
from gesticulator.characters.inverse_kinematics import bend
from gesticulator.characters.thighs import (
    FINGERTIPS,
    Thigh,
    is_level,
    our_thighs,
    seated_thighs,
    thigh_limits,
    thigh_margins,
)
from gesticulator.characters.trunk import (
    ANGLES,
    HandLimit,
    Outline,
    TrunkAxes,
    displacement,
    outline_of,
    receding,
    trunk_axes,
    within_reach,
)

if TYPE_CHECKING:
    from gesticulator.characters.frames import Body

AHEAD = 0.2
"""Seconds before and after over which a displacement is spread (standard deviation)."""
_ARM_LENGTH = 0.53
"""Length of the default character's upper arm and forearm, metres."""
_LEAST = 1e-5
"""Metres below which a hand is not moved."""
_TURNS = 16
"""Turns of smoothing and of bringing back."""
_NEAR, _SLOW = 0.1, 0.3
"""Seconds around a frame whose fastest is the pace of the hand; metres per second below which none is hasty."""
_CLOSED = 0.01
"""Metres between the first and the last place of a hand within which a motion is taken for a loop."""
_ROUNDS = 3
"""Times in a turn that wrist, knuckles and arm are seen to, one after the other."""


@dataclass(frozen=True)
class HandPoint:
    """A wrist, knuckle or fingertip over T frames: places [T, 3] metres from the hips, without correction; margins [T]
    metres that it belongs outside of the trunk, above: [T] for each thigh, that it belongs above it."""

    places: Array
    margins: Array
    above: Sequence[Array] = ()


@dataclass(frozen=True)
class Obstacle:
    """A trunk over T frames, with thighs where the character sits. size: the length of its arm relative to ours."""

    column: TrunkAxes
    outline: Outline
    size: float
    thighs: Sequence[Thigh] = ()

    def lacking(self, point: HandPoint, push: Array) -> Array:
        """[T, 3] what is to be added to a displacement [T, 3] of a point, so that it is outside by its margins."""
        x, y, z = self.column.local(point.places + push)
        share = y / self.column.length
        gaps = np.stack([np.cos(angle) * x + np.sin(angle) * z - self.outline.support(share, np.full(len(x), angle))
                         for angle in ANGLES])
        nearest = gaps.argmax(axis=0)
        gap = gaps[nearest, np.arange(len(x))] + receding(self.outline, self.column, y, self.size)
        lack = np.maximum(point.margins - gap, 0.0)
        normal = (np.cos(ANGLES[nearest])[:, None] * self.column.axes[:, 0]
                  + np.sin(ANGLES[nearest])[:, None] * self.column.axes[:, 2])
        added = lack[:, None] * normal
        for thigh, margin in zip(self.thighs, point.above, strict=True):
            depth, up = thigh.depth(point.places + push + added)
            added = added + np.maximum(depth + margin, 0.0)[:, None] * up
        return np.asarray(added)


def keep_hands_out(turns: dict[int, Array], body: Body, ours: Pose, fps: float) -> None:
    """Bend the arms in `turns` where a hand would be nearer to the character's trunk, and to its thighs where it sits,
    than on the default character. fps: frames per second."""
    joints, bodies = body.mapping.joints, _Bodies(turns, body, ours)
    for side in SIDES:
        chain = (joints[side + "Arm"], joints[side + "ForeArm"], joints[side + "Hand"])
        arm = float(sum(np.linalg.norm(body.place({}, below) - body.place({}, above))
                        for above, below in zip(chain, chain[1:], strict=False)))
        limits, points = bodies.limits(side, turns, arm / _ARM_LENGTH)
        shoulder, wrist = body.place(turns, chain[0]), body.place(turns, chain[2])
        push = displacement(limits, wrist - shoulder, arm)
        if (np.linalg.norm(push, axis=-1) > _LEAST).any():
            push = spread(push, points, bodies.obstacle(arm / _ARM_LENGTH), (wrist - shoulder, arm), fps)
        moved = np.linalg.norm(push, axis=-1) > _LEAST
        if moved.any():
            bend(turns, body, chain, wrist + push, np.array([0.0, -1.0, -0.5]), moved)


class _Bodies:
    """Trunk and thighs of a character and of the default character over T frames."""

    def __init__(self, turns: Mapping[int, Array], body: Body, ours: Pose) -> None:
        self._body, self._ours = body, ours
        joints, chest, self._origin = body.mapping.joints, ours.turns["Spine3"], ours.places["Hips"]
        neck = body.place(turns, body.mapping.neck[0] if body.mapping.neck else joints["Head"])
        self._outline = outline_of(body)
        self._theirs, self._default = (trunk_axes(neck, chest),
                                       trunk_axes(ours.places["Neck"] - self._origin, chest))
        self._thighs, self._our_thighs = seated_thighs(body, turns), tuple[Thigh, ...]()
        if self._thighs:
            ends = [[ours.places[side + part] - self._origin for side in SIDES] for part in ("UpLeg", "Leg")]
            # A character that sits in its file may be given the motion of someone who stands.
            self._our_thighs = our_thighs(*ends) if is_level(*ends) else ()

    def obstacle(self, size: float) -> Obstacle:
        """What the hands of an arm that is `size` times as long as ours are kept out of."""
        return Obstacle(self._theirs, self._outline, size, self._thighs)

    def limits(self, side: str, turns: Mapping[int, Array], size: float) -> tuple[list[HandLimit], list[HandPoint]]:
        """Where the points of a hand belong, and the points."""
        limits, points = [], []
        for part in ("Hand", "HandMiddle1", *(FINGERTIPS if self._thighs else ())):
            if (node := self._body.mapping.joints.get(side + part)) is None:
                continue
            place, our = self._body.place(turns, node), self._ours.places[side + part] - self._origin
            margins = np.full(len(place), -np.inf)  # of fingertips, which are kept above the thighs alone
            if part not in FINGERTIPS:
                limits.append(HandLimit.of(self._default.local(our), self._theirs.local(place),
                                           (self._theirs, self._outline), size))
                margins = limits[-1].margin
            above = thigh_margins(self._thighs, self._our_thighs, our, size)
            limits.extend(thigh_limits(self._thighs, place, above))
            points.append(HandPoint(place, margins, above))
        return limits, points


def spread(push: Array, points: list[HandPoint], trunk: Obstacle, arm: tuple[Array, float], fps: float) -> Array:
    """[T, 3] displacements spread over time, of a hand that is displaced by `push` [T, 3] frame by frame.

    arm: [T, 3] the wrist from its shoulder, without correction, and the length of the arm; metres.
    """
    reached, length = arm
    width, loops = AHEAD * fps / np.sqrt(_TURNS), bool(np.linalg.norm(reached[0] - reached[-1]) < _CLOSED)
    pace = maximum_filter1d(_speeds(reached), round(2.0 * _NEAR * fps) + 1)
    for _ in range(_TURNS):
        hasty = np.clip(_speeds(reached + push) / np.maximum(pace, _SLOW / fps) - 1.0, 0.0, 1.0)
        hasty = gaussian_filter1d(maximum_filter1d(hasty, round(2.0 * AHEAD * fps) + 1), width)[:, None]
        push = _smoothed(push, width, loops) + hasty * (_smoothed(reached, width, loops) - reached)
        for _ in range(_ROUNDS):
            push = within_reach(reached + push, reached, length) - reached
            for point in points:
                push = push + trunk.lacking(point, push)
    return push


def _speeds(places: Array) -> Array:
    """[T] metres that places [T, 3] move in a frame."""
    return np.linalg.norm(np.gradient(places, axis=0), axis=-1) if len(places) > 1 else np.zeros(1)


def _smoothed(push: Array, width: float, loops: bool) -> Array:
    """[T, 3] smoothed over `width` frames (standard deviation); the ends keep their values unless it loops."""
    more = min(int(np.ceil(4.0 * width)), len(push) - 1)
    if loops or not more:
        return np.asarray(gaussian_filter1d(push, width, axis=0, mode="wrap"))
    # Continued beyond the ends by a half turn about each, whose mean is the end.
    longer = np.concatenate([2.0 * push[:1] - push[more:0:-1], push, 2.0 * push[-1:] - push[-2:-more - 2:-1]])
    return np.asarray(gaussian_filter1d(longer, width, axis=0, mode="nearest")[more:-more])
