"""Limits that keep hands out of a trunk of any shape, and ways around it without haste.

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

Decided frame by frame, a hand that passes a slim waist in a tenth of a second would be led around a stout one in the
same tenth, twice as fast. So the displacements of a whole motion are spread over time: they are smoothed, and where the
hand would be nearer to the trunk than it belongs, or beyond reach, it is brought back, in turns. These are the steps of
a projected gradient descent on the integral of |d'(t)|^2 over the displacements d(t) that keep the hand outside,
stopped when d has spread by `AHEAD`. Where the hand is still faster than without correction, its path is smoothed as
well. A motion that ends where it began is smoothed as a loop; others keep the displacements at their ends.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from data_module.types import Array
from gesticulator.contacts.limbs import MARGIN, OURS, TrunkAxes, receding, soft

ANGLES = np.arange(36) * (2.0 * np.pi / 36)
"""Directions in which a slice is measured: between them the surface of a round one is at most 0.4 % farther out."""
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
class HandLimit:
    """Half-spaces over T frames in which a wrist or knuckle belongs. place: [T, 3] metres from the hips, without
    correction; normal: [T, 3]; lack: [T] metres by which it is outside, softened; margin: [T] metres that it belongs
    outside of the trunk."""

    place: Array
    normal: Array
    lack: Array
    margin: Array

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
class Trunk:
    """The trunk of a character over T frames. size: the length of its arm relative to ours."""

    axes: TrunkAxes
    outline: Outline
    size: float

    def limit(self, our: Array, place: Array) -> HandLimit:
        """The limit of a point of the hand at `place` [T, 3] metres from the hips; our: [3, T] left, up, ahead of the
        hips, that of the default character."""
        width, depth = OURS
        # Equation (1): the normal of the ellipse through the hand, and its distance from the tangent.
        x, z = our[0] / width ** 2, our[2] / depth ** 2
        norm = np.maximum(np.hypot(x, z), 1e-9)
        x, z = x / norm, z / norm
        slim = np.hypot(width * x, depth * z)
        gap = x * our[0] + z * our[2] - slim
        # Equation (2), with a trunk that recedes above and below.
        left, up, ahead = self.axes.local(place)
        reach = self.outline.support(up / self.axes.length, np.arctan2(z, x))
        margin = self.size * near(gap)
        lack = reach - self._receded(up) + margin - (x * left + z * ahead)
        lack = soft(lack, np.clip(reach - self.size * slim, 1e-6, _SOFT * self.size))
        return HandLimit(place, self._level(x, z), lack, margin)

    def lacking(self, limit: HandLimit, push: Array) -> Array:
        """[T, 3] what is to be added to a displacement [T, 3] of a point, so that it is outside by its margin."""
        x, y, z = self.axes.local(limit.place + push)
        share = y / self.axes.length
        # The tangent that the point is least behind is the way out.
        gaps = np.stack([np.cos(angle) * x + np.sin(angle) * z - self.outline.support(share, np.full(len(x), angle))
                         for angle in ANGLES])
        nearest = gaps.argmax(axis=0)
        lack = np.maximum(limit.margin - (gaps[nearest, np.arange(len(x))] + self._receded(y)), 0.0)
        return lack[:, None] * self._level(np.cos(ANGLES[nearest]), np.sin(ANGLES[nearest]))

    def _receded(self, along: Array) -> Array:
        return receding(along, self.outline.steps[0] * self.axes.length, self.axes.length, self.size)

    def _level(self, left: Array, ahead: Array) -> Array:
        """[T, 3] the direction with these components [T]."""
        return left[:, None] * self.axes.axes[:, 0] + ahead[:, None] * self.axes.axes[:, 2]


def spread(push: Array, limits: list[HandLimit], trunk: Trunk, arm: tuple[Array, float], fps: float) -> Array:
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
            for limit in limits:
                push = push + trunk.lacking(limit, push)
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
