"""Knobs on the finished poses: how large gestures are, and which hand makes them.

Everything here is a function of one pose and of the time it is shown at, so that a stream gets the frames of a file.
What needs the past (rest, lexemes) is directed while blocks are drawn (`gesticulator.plans.editing`).

**Intensity** i scales every arm about its mean pose m by the square root g of i: 0.71 at 0.5, 1.22 at 1.5. It is no
plain factor, since hands that go half as far again in the same time would be faster than people's. An arm that hangs
is left hanging: with r the resting pose, the pose x is told by how far it is lifted, s, and by what lies beside, p,

    x = r + s (m - r) + p,    s = <x - r, m - r> / |m - r|^2

and becomes, with w(s) = s^2 (3 - 2 s) of s cut to 0 to 1,

    x + (g - 1) (w(s) (s - 1) (m - r) + w(s / S) p),    S = 0.3

What this moves outwards is taken back smoothly where the training data end (`Statistics.bounds`), and hands are kept
out of the trunk. Head and spine are scaled by the square root of g.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_module.motion import rotation
from data_module.motion.representation import Representation
from data_module.types import Array, Motion
from gesticulator.contacts import kept_out_of_us, our_distances, pose_of
from gesticulator.features import Statistics

EXPONENT = 0.5
"""Of intensity: chosen so that at 0.5 and 1.5 hands are as fast as people's (docs/knobs.md)."""
TRUNK = 0.5
"""Exponent of the gain of spine and head."""
OTHER_HAND = 0.45
"""Intensity of the hand that is not preferred."""
FADE, MIRROR_FADE = 0.15, 0.3
"""Seconds to both sides of a beat in which intensity and the exchange of sides change."""
SIDES = ("Left", "Right")
_FLIP = np.array([1.0, -1.0, -1.0])
"""A reflection in x = 0 keeps the x of an axis times angle and turns y and z round."""
_LIFTED = 0.3
"""Share of the lift from which on what lies beside it is scaled in full."""
_LEAST_LIFT = 0.3
"""Radians between resting and mean pose of an arm below which it counts as always lifted."""


def levels_at(edges: Array, levels: NDArray[np.floating], times: Array, fade: float,
              kept: NDArray[np.bool_] | None = None) -> Array:
    """[M] what holds at times [M], where block n [N] of edges [N + 1] holds levels[n]; between blocks of different
    levels it changes smoothly over `fade` seconds to both sides, or half of the shorter run of blocks.

    Where nothing changes within reach it is exactly the block's own. kept: [N] blocks that must not be touched: beside
    them the change takes place on the other side.
    """
    own = np.clip(np.searchsorted(edges, times, side="left") - 1, 0, len(levels) - 1)
    out = np.asarray(levels, dtype=np.float64)[own]
    changes = np.flatnonzero(np.diff(levels)) + 1
    bounds = edges[[0, *changes, len(levels)]]
    for at, before, begins, after in zip(changes, bounds[:-2], bounds[1:-1], bounds[2:], strict=True):
        reach = min(fade, (begins - before) / 2.0, (after - begins) / 2.0)
        first, last = begins - reach, begins + reach
        if kept is not None and kept[at - 1] != kept[at]:
            first, last = (begins, last) if kept[at - 1] else (first, begins)
        near = np.flatnonzero((times > first) & (times < last))
        u = (times[near] - first) / (last - first)
        out[near] = levels[at - 1] + (levels[at] - levels[at - 1]) * u * u * (3.0 - 2.0 * u)
    return out


def exchanged_joints(names: tuple[str, ...]) -> NDArray[np.int64]:
    """[J] for each joint the one on the other side."""
    other = {"Left": "Right", "Right": "Left"}
    theirs = [next((other[side] + name[len(side):] for side in SIDES if name.startswith(side)), name) for name in names]
    return np.array([names.index(name) for name in theirs])


def mirrored_motion(motion: Motion) -> Motion:
    """The motion with left and right exchanged, exactly: the mirror image of the mirror image is the motion."""
    swapped = exchanged_joints(motion.skeleton.names)
    return replace(motion, rotations=motion.rotations[:, swapped] * np.array([1.0, 1.0, -1.0, -1.0]),
                   root_positions=motion.root_positions * np.array([-1.0, 1.0, 1.0]))


@dataclass(frozen=True)
class _Part:
    """Dimensions that are scaled together. mean, rest: [D]; power: exponent of the gain; lifts: see the module."""

    columns: NDArray[np.int64]
    mean: Array
    rest: Array
    power: float

    def scaled(self, poses: Array, gains: Array) -> Array:
        """[M, D] what is added to poses [M, D]."""
        more, way = (gains ** self.power - 1.0)[:, None], self.mean - self.rest
        length = float(way @ way)
        if length <= _LEAST_LIFT ** 2 or self.power != 1.0:
            return np.asarray(more * (poses - self.mean))
        lift = ((poses - self.rest) @ way / length)[:, None]
        beside = poses - self.rest - lift * way
        return np.asarray(more * (_smooth(lift) * (lift - 1.0) * way + _smooth(lift / _LIFTED) * beside))


def _smooth(s: Array) -> Array:
    """w(s) of the module."""
    u: Array = np.clip(s, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


class Shaper:
    """The knobs of one speaker. Poses are exponential maps [M, 3 J] in radians."""

    def __init__(self, statistics: Statistics, representation: Representation, speaker: int) -> None:
        mean, rest = statistics.mean_pose[speaker], statistics.rest_pose[speaker]
        self._representation = representation
        names = representation.motion(rest[None], 1.0).skeleton.names
        self._swapped = exchanged_joints(names)
        self._low, self._high = (statistics.denormalise(bound, speaker) for bound in statistics.bounds)
        joints = {side: [j for j, name in enumerate(names) if name in
                         [side + part for part in ("Shoulder", "Arm", "ForeArm", "Hand")]] for side in SIDES}
        joints["trunk"] = [j for j, name in enumerate(names) if name.startswith(("Spine", "Neck", "Head"))]
        self._parts = []
        for part, own in joints.items():
            columns = (3 * np.array(own)[:, None] + np.arange(3)).ravel()
            self._parts.append(_Part(columns, mean[columns], rest[columns], TRUNK if part == "trunk" else 1.0))

    def scaled(self, poses: Array, intensity: Array) -> Array:
        """Poses [M, 3 J] at intensities [M, 2] of the left and the right arm; those at 1 bit for bit as they are."""
        at = np.flatnonzero((intensity != 1.0).any(axis=1))
        if not len(at):
            return poses
        own, gains = poses[at], intensity[at] ** EXPONENT
        out = own.copy()
        for part, gain in zip(self._parts, (*gains.T, gains.max(axis=1)), strict=True):
            now = own[:, part.columns]
            added = part.scaled(now, gain)
            outwards = added * (now - part.mean) > 0
            room = np.maximum(np.where(added > 0, self._high[part.columns] - now, now - self._low[part.columns]), 1e-9)
            out[:, part.columns] = now + np.where(outwards, room * np.tanh(added / room), added)
        before = self._representation.motion(own, 1.0)
        scaled = self._representation.motion(out, 1.0)
        kept = kept_out_of_us(scaled, our_distances(pose_of(before)))
        pushed = np.flatnonzero((kept.rotations != scaled.rotations).any(axis=-1).any(axis=-1))
        if len(pushed):
            turned = rotation.to_exponential_map(kept.rotations[pushed])
            was = out[pushed].reshape(turned.shape)
            moved = (kept.rotations[pushed] != scaled.rotations[pushed]).any(axis=-1, keepdims=True)
            out[pushed] = np.where(moved, nearest_turn(turned, was), was).reshape(len(pushed), -1)
        result = poses.copy()
        result[at] = out
        return result

    def mirrored(self, poses: Array, share: Array) -> Array:
        """Poses [M, 3 J], each a share [M] of the way (0 to 1) to its mirror image; at 0 and 1 exact."""
        at = np.flatnonzero(share)
        if not len(at):
            return poses
        turned = poses[at].reshape(len(at), -1, 3)[:, self._swapped] * _FLIP
        turned = turned.reshape(len(at), -1)
        result, part = poses.copy(), share[at][:, None]
        result[at] = np.where(part == 1.0, turned, poses[at] + part * (turned - poses[at]))
        return result


def nearest_turn(vectors: Array, reference: Array) -> Array:
    """Exponential maps [..., 3] as the same rotations nearest to a reference [..., 3]: with full turns added."""
    return rotation.unroll(np.stack([reference, vectors]))[1]
