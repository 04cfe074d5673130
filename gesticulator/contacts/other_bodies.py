"""Limits that keep hands out of a trunk of any shape and off thighs, and ways around them without haste.

The same bone directions bring hands to other places on other bodies: a hand that passes a slim waist at a hand's
breadth ends inside a stout one. There is no way out of a closed shape that is continuous everywhere: at its middle, it
turns round, and the hand jumps. The hands of the default character, however, are outside its trunk, so that they say on
which side of any trunk they belong. With a, b half the width and depth of the default trunk and (x, z) the place of its
hand across and ahead of it,

    n = (x / a^2, z / b^2) / |(x / a^2, z / b^2)|,   g = n (x, z) - |(a n_x, b n_z)|                              (1)

are the outward normal of the ellipse through the hand and the hand's distance from the tangent of the trunk. The hand
of the character at (X, Z) belongs beyond the tangent of its trunk with the same normal, at the same distance:

    n (X, Z) >= h(n) + s w(g)                                                                                     (2)

where h is the support function of a slice of its trunk (of the mesh, at the height of the hand), s the ratio of arm
lengths and w(g) a smooth minimum of g and `MARGIN`. What is lacking is added along n. The projection on a half-plane
moves no two points apart and n changes continuously with the pose, so a hand that passes the trunk is led around it
without a jump. A character with the trunk of the default one keeps its pose.
"

These limits decide frame by frame: a hand that passes a slim waist in a tenth of a second is led
around a stout one in the same tenth, twice as fast. Here the displacements of a whole motion are spread over time: they
are smoothed, and where the hand would be nearer to the trunk than it belongs, or beyond reach, it is brought back, in
turns. These are the steps of a projected gradient descent on the integral of |d'(t)|^2 over the displacements d(t) that
keep the hand outside, stopped when d has spread by `AHEAD`. Where the hand is still faster than it would be without
correction, its path is smoothed as well, so that the haste of a moment is shared with the moments around it. The
descent begins with the displacements of each frame, which say on which side of the trunk a hand belongs. A motion that
ends where it began is smoothed as a loop; others keep the displacements at their ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from data_module.types import Array
from gesticulator.contacts.limbs import MARGIN, OURS, TrunkAxes, receding, soft
from gesticulator.contacts.surfaces import ANGLES, Outline, Thigh

THICK = 0.015
"""Metres that the joints of a hand are above a thigh at least: half the thickness of a hand."""
_SOFT = 0.05
"""Metres before and after the surface over which a hand is slowed, where the trunk is wider by as much."""
_ROUNDS, _REACH = 12, 0.999
"""Rounds of projections on the limits of wrist, knuckles and arm; share of an arm's length that is used."""
AHEAD = 0.2
"""Seconds before and after over which a displacement is spread (standard deviation)."""
_TURNS = 16
"""Turns of smoothing and of bringing back."""
_NEAR, _SLOW = 0.1, 0.3
"""Seconds around a frame whose fastest is the pace of the hand; metres per second below which none is hasty."""
_CLOSED = 0.01
"""Metres between the first and the last place of a hand within which a motion is taken for a loop."""
_CORRECTIONS = 3
"""Times in a turn that wrist, knuckles and arm are seen to, one after the other."""


@dataclass(frozen=True)
class HandLimit:
    """Half-spaces over T frames in which a point of the hand belongs: normals [T, 3]; lack: [T] metres by which the
    point is outside, softened; margin: [T] metres that it belongs outside of the trunk."""

    normal: Array
    lack: Array
    margin: Array

    @staticmethod
    def of(our: Array, their: Array, trunk: tuple[TrunkAxes, Outline], size: float) -> HandLimit:
        """our, their: [3, T] left, up, ahead of the hips: the point of the default character's hand, and of the
        character's; trunk: of the character; size: its arm's length relative to ours."""
        column, outline = trunk
        width, depth = OURS
        # Equation (1): the normal of the ellipse through the hand, and its distance from the tangent.
        x, z = our[0] / width ** 2, our[2] / depth ** 2
        norm = np.maximum(np.hypot(x, z), 1e-9)
        x, z = x / norm, z / norm
        slim = np.hypot(width * x, depth * z)
        gap = x * our[0] + z * our[2] - slim
        # Equation (2), with a trunk that recedes above and below.
        reach = outline.support(their[1] / column.length, np.arctan2(z, x))
        margin = size * near(gap)
        receded = receding(their[1], outline.steps[0] * column.length, column.length, size)
        lack = reach - receded + margin - (x * their[0] + z * their[2])
        lack = soft(lack, np.clip(reach - size * slim, 1e-6, _SOFT * size))
        return HandLimit(x[:, None] * column.axes[:, 0] + z[:, None] * column.axes[:, 2], lack, margin)

    def lacking(self, push: Array) -> Array:
        """[T, 3] what is to be added to a displacement [T, 3] of the hand."""
        return np.maximum(self.lack - np.sum(push * self.normal, axis=-1), 0.0)[:, None] * self.normal


def near(gap: Array) -> Array:
    """The smaller of a distance and `MARGIN`, metres, without a kink between them; 0 inside."""
    gap = np.clip(gap, 0.0, 2.0 * MARGIN)
    return np.asarray(gap - gap ** 2 / (4.0 * MARGIN))


def displacement(limits: list[HandLimit], reached: Array, arm: float) -> Array:
    """[T, 3] the displacement that brings a hand at `reached` [T, 3] from the shoulder within all limits and the reach
    of an arm, metres: by projections on them in turn, which move no two hands apart."""
    moved = reached
    # Projections on convex sets in turn converge to a place in all of them, if there is one.
    for _ in range(_ROUNDS):
        for limit in limits:
            moved = moved + limit.lacking(moved - reached)
        moved = within_reach(moved, reached, arm)
    return moved - reached


def within_reach(moved: Array, reached: Array, arm: float) -> Array:
    """Places [T, 3] from the shoulder, brought within the reach of an arm that was at `reached` [T, 3], metres."""
    # An arm that was stretched already may stay so.
    longest = np.maximum(np.linalg.norm(reached, axis=-1), _REACH * arm)
    far = np.maximum(np.linalg.norm(moved, axis=-1), 1e-9)
    return np.asarray(moved * np.minimum(longest / far, 1.0)[:, None])


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
        # The tangent that the point is least behind is the way out.
        gaps = np.stack([np.cos(angle) * x + np.sin(angle) * z - self.outline.support(share, np.full(len(x), angle))
                         for angle in ANGLES])
        nearest = gaps.argmax(axis=0)
        receded = receding(y, self.outline.steps[0] * self.column.length, self.column.length, self.size)
        gap = gaps[nearest, np.arange(len(x))] + receded
        lack = np.maximum(point.margins - gap, 0.0)
        normal = (np.cos(ANGLES[nearest])[:, None] * self.column.axes[:, 0]
                  + np.sin(ANGLES[nearest])[:, None] * self.column.axes[:, 2])
        added = lack[:, None] * normal
        for thigh, margin in zip(self.thighs, point.above, strict=True):
            depth, up = thigh.depth(point.places + push + added)
            added = added + np.maximum(depth + margin, 0.0)[:, None] * up
        return np.asarray(added)


def spread(push: Array, points: list[HandPoint], trunk: Obstacle, arm: tuple[Array, float], fps: float) -> Array:
    """[T, 3] displacements spread over time, of a hand that is displaced by `push` [T, 3] frame by frame.

    arm: [T, 3] the wrist from its shoulder, without correction, and the length of the arm; metres.
    """
    reached, length = arm
    width, loops = AHEAD * fps / np.sqrt(_TURNS), bool(np.linalg.norm(reached[0] - reached[-1]) < _CLOSED)
    # What counts as hasty: faster than the hand is anyway around that moment.
    pace = maximum_filter1d(_speeds(reached), round(2.0 * _NEAR * fps) + 1)
    for _ in range(_TURNS):
        hasty = np.clip(_speeds(reached + push) / np.maximum(pace, _SLOW / fps) - 1.0, 0.0, 1.0)
        hasty = gaussian_filter1d(maximum_filter1d(hasty, round(2.0 * AHEAD * fps) + 1), width)[:, None]
        # One step of descent: the displacements are smoothed, and where the hand is hasty its path, too.
        push = _smoothed(push, width, loops) + hasty * (_smoothed(reached, width, loops) - reached)
        # Then back into the reach of the arm and out of the body, both more than once, as each may undo the other.
        for _ in range(_CORRECTIONS):
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
