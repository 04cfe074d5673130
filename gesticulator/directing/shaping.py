"""Knobs on the finished poses: how large gestures are, and which hand makes them.

Everything here is a function of the poses up to now and of their times, so that a stream gets the frames of a file.
What needs the lexemes or rest is directed while blocks are drawn (`gesticulator.directing.editing`).

**Intensity** i makes strokes larger or smaller and leaves alone what is slow: hands that go half as far again in the
same time would be faster than people's everywhere, and people who gesture larger are no faster in between. With S what
large strokes brought an arm's pose x, and F what small movements did (`gesticulator.directing.strokes`), it becomes

    x + h ((a - 1) S + (b - 1) F)        a = 1 + 0.8 (i - 1), b = 1                     for i >= 1
                                         a = 1 - 0.5 (1 - i), b = 1 - 0.8 (1 - i)       for 0.5 <= i < 1

h falls from 1 to 0 as the arm is let down, so who hangs is left hanging: with r the resting and m the mean pose, the
arm is lifted by s = <x - r, m - r> / |m - r|^2, and h is a smooth step of s from 0.1 to 0.7. Below 0.5 the arms and
fingers of i = 0.5 are brought to the resting pose, where they are at 0: r + 2 i (x - r).

What this moves outwards is taken back smoothly where the training data end (`Statistics.bounds`), and hands are kept
out of the trunk. Head and spine are scaled about their mean pose.

**Both hands**: each arm takes over a share of the other's strokes, mirrored and a little later, and leaves out as much
of its own: x + e (M S'(t - lag) - 0.9 S), with S' of the other arm, M the mirror and e = `ECHO`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.motion import rotation
from data_module.motion.representation import Representation
from data_module.types import Array
from gesticulator.body.mirror import SIDES, exchanged_joints
from gesticulator.bundle.features import Statistics
from gesticulator.characters.contacts import kept_out_of_us, our_distances, pose_of
from gesticulator.directing.strokes import FINE, LARGE, StrokeMemory, smooth_step

STRONGER, WEAKER, FINER = 0.8, 0.5, 0.8
"""What a step of intensity adds to strokes above 1, and takes of strokes and of small movements below it: chosen so
that from 0.5 to 1.5 all figures stay within those of people (docs/knobs.md)."""
RESTING = 0.5
"""Intensity below which the arms are brought towards the resting pose: smaller strokes are smaller than people's."""
TRUNK, TRUNK_LEAST = 0.25, 0.2
"""Head and spine: exponent of their gain above 1, and what is left of their movement at 0, where she is still alive."""
OTHER_HAND = 0.45
"""Intensity of the hand that is not preferred."""
ECHO, OWN, LAG = 0.4, 0.9, 0.1
"""Of the other hand's strokes that a hand takes over; share of it that its own lose; seconds that it comes later. With
these, both hands are as fast as before, and their speeds are as alike as people's (correlation 0.7 of at most 0.83)."""
FADE, MIRROR_FADE, REST_FADE = 0.15, 0.3, 0.6
"""Seconds to both sides of a beat in which intensity, the exchange of sides, and the way to rest of an intensity below
0.5 change: a hand half a metre from rest goes there at 0.6 m/s."""
_FLIP = np.array([1.0, -1.0, -1.0])
"""A reflection in x = 0 keeps the x of an axis times angle and turns y and z round."""
_HANGS, _LIFTED = 0.1, 0.7
"""Lift of an arm, in that of the mean pose, up to which it hangs, and from which on it is up."""


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
        # A time on the beat belongs to the block before; where the change ends on the beat it is over there.
        near = np.flatnonzero((times > first) & ((times < last) | (times == begins)))
        u = (times[near] - first) / (last - first)
        out[near] = levels[at - 1] + (levels[at] - levels[at - 1]) * u * u * (3.0 - 2.0 * u)
    return out


def eased_levels(edges: Array, levels: NDArray[np.floating], fade: float, kept: NDArray[np.bool_]) -> Array:
    """[N] levels of blocks in which a run of equal ones that is shorter than 2 x fade is brought nearer to the run
    beside it that is most like it, as much as it is shorter: what cannot be reached in its time is not asked for.

    edges: [N + 1] seconds; kept: [N] blocks that stay as they are.
    """
    out = np.array(levels, dtype=np.float64)
    begins = [0, *(np.flatnonzero(np.diff(levels)) + 1), len(levels)]
    for before, at, stop, after in zip([-1, *begins[:-2]], begins[:-1], begins[1:], [*begins[2:], -1], strict=True):
        beside = ([levels[at - 1]] if before >= 0 else []) + ([levels[stop]] if after >= 0 else [])
        if beside:
            nearest = min(beside, key=lambda level, own=levels[at]: abs(level - own))  # type: ignore[misc]
            short = 1.0 - min((edges[stop] - edges[at]) / (2.0 * fade), 1.0)
            out[at:stop] += np.where(kept[at:stop], 0.0, short * (nearest - levels[at]))
    return out


@dataclass(frozen=True)
class AskedSizes:
    """What is asked at M times. intensity: [M, 2] of the left and the right arm; left: [M, 2] share of the pose that is
    left of the way from rest (`left_by` the intensity, where that does not change); both: [M] 0 to 1, how much each
    hand takes over of the other's strokes."""

    intensity: Array
    left: Array
    both: Array

    @property
    def changed(self) -> NDArray[np.int64]:
        """[n] at which anything is asked at all."""
        return np.flatnonzero((self.intensity != 1.0).any(axis=1) | (self.left != 1.0).any(axis=1) | (self.both != 0.0))


def left_by(intensity: NDArray[np.floating]) -> Array:
    """2 i of the module, at most 1."""
    return np.minimum(intensity / RESTING, 1.0)


class _ScaledArm:
    """One arm from the collar bone to the wrist, and its fingers."""

    def __init__(self, columns: NDArray[np.int64], fingers: NDArray[np.int64], mean: Array, rest: Array) -> None:
        self.columns, self.fingers = columns, fingers
        self.mean, self.rest, self.resting_fingers = mean[columns], rest[columns], rest[fingers]
        self.large, self.fine = StrokeMemory(columns, LARGE), StrokeMemory(columns, FINE)

    def lifted(self, poses: Array) -> Array:
        """[M, 1] h of the module, of poses [M, D]."""
        way = self.mean - self.rest
        lift = (poses - self.rest) @ way / max(float(way @ way), 1e-9)
        return smooth_step((lift - _HANGS) / (_LIFTED - _HANGS))[:, None]


class Shaper:
    """The knobs of one speaker. Poses are exponential maps [M, 3 J] in radians; `shaped` is given all of them, in the
    order of their times."""

    def __init__(self, statistics: Statistics, representation: Representation, speaker: int) -> None:
        mean, rest = statistics.mean_pose[speaker], statistics.rest_pose[speaker]
        self._representation = representation
        names = representation.motion(rest[None], 1.0).skeleton.names
        self._swapped = exchanged_joints(names)
        self._low, self._high = (statistics.denormalise(bound, speaker) for bound in statistics.bounds)
        self._arms = []
        for side in SIDES:
            arm = [side + part for part in ("Shoulder", "Arm", "ForeArm", "Hand")]
            fingers = [j for j, name in enumerate(names) if name.startswith(side + "Hand") and name not in arm]
            joints = [names.index(name) for name in arm if name in names]
            self._arms.append(_ScaledArm(_columns(joints), _columns(fingers), mean, rest))
        self._mirror = np.tile(_FLIP, len(self._arms[0].columns) // 3)
        self._trunk = _columns([j for j, name in enumerate(names) if name.startswith(("Spine", "Neck", "Head"))])
        self._mean = mean

    def shaped(self, poses: Array, times: Array, sizes: AskedSizes) -> Array:
        """The next poses [M, 3 J] at rising seconds [M], at these sizes; where nothing is asked, bit for bit as they
        are. Where the times go back, what came later is forgotten."""
        for arm in self._arms:
            arm.large.push(times, poses)
            arm.fine.push(times, poses)
        at = sizes.changed
        if not len(at):
            return poses
        own, out = poses[at], poses[at].copy()
        intensity, both = sizes.intensity[at], sizes.both[at, None]
        strokes = [arm.large.at(times[at]) for arm in self._arms]
        added = [np.zeros_like(one) for one in strokes]
        if both.any():
            added = [ECHO * both * (other.large.at(times[at] - LAG) * self._mirror - OWN * one)
                     for one, other in zip(strokes, self._arms[::-1], strict=True)]
        for side, (arm, stroke, echo) in enumerate(zip(self._arms, strokes, added, strict=True)):
            asked, left = intensity[:, side, None], sizes.left[at, side, None]
            now, some = own[:, arm.columns], np.maximum(asked, RESTING) - 1.0
            large = (stroke + echo) * some * np.where(some > 0.0, STRONGER, WEAKER)
            fine = arm.fine.at(times[at]) * np.minimum(some, 0.0) * FINER
            changed = self._within(now, echo + arm.lifted(now) * (large + fine), arm.columns)
            out[:, arm.columns] = _towards(arm.rest, changed, left)
            out[:, arm.fingers] = _towards(arm.resting_fingers, own[:, arm.fingers], left)
        most = intensity.max(axis=1, keepdims=True)
        gain = np.where(most > 1.0, np.maximum(most, 1.0) ** TRUNK, TRUNK_LEAST + (1.0 - TRUNK_LEAST) * most)
        trunk = own[:, self._trunk]
        out[:, self._trunk] = self._within(trunk, (gain - 1.0) * (trunk - self._mean[self._trunk]), self._trunk)
        result = poses.copy()
        result[at] = self._outside(own, out)
        return result

    def _within(self, now: Array, added: Array, columns: NDArray[np.int64]) -> Array:
        """Poses [M, D] with what is added to them, taken back smoothly where that leads out of the data."""
        outwards = added * (now - self._mean[columns]) > 0
        room = np.maximum(np.where(added > 0, self._high[columns] - now, now - self._low[columns]), 1e-9)
        return now + np.where(outwards, room * np.tanh(added / room), added)

    def _outside(self, own: Array, out: Array) -> Array:
        """Poses [M, 3 J] with the hands as far outside the trunk as they were in the poses `own`."""
        before = self._representation.motion(own, 1.0)
        scaled = self._representation.motion(out, 1.0)
        kept = kept_out_of_us(scaled, our_distances(pose_of(before)))
        pushed = np.flatnonzero((kept.rotations != scaled.rotations).any(axis=-1).any(axis=-1))
        if len(pushed):
            turned = rotation.to_exponential_map(kept.rotations[pushed])
            was = out[pushed].reshape(turned.shape)
            moved = (kept.rotations[pushed] != scaled.rotations[pushed]).any(axis=-1, keepdims=True)
            out[pushed] = np.where(moved, nearest_turn(turned, was), was).reshape(len(pushed), -1)
        return out

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


def _columns(joints: list[int]) -> NDArray[np.int64]:
    """[3 n] of a pose, those of some joints."""
    return (3 * np.array(joints, dtype=np.int64)[:, None] + np.arange(3)).ravel()


def _towards(rest: Array, poses: Array, left: Array) -> Array:
    """Poses [M, D] with a share `left` [M, 1] of their way from a pose [D]; at 1 bit for bit as they are."""
    return np.where(left == 1.0, poses, rest + left * (poses - rest))


def nearest_turn(vectors: Array, reference: Array) -> Array:
    """Exponential maps [..., 3] as the same rotations nearest to a reference [..., 3]: with full turns added."""
    return rotation.unroll(np.stack([reference, vectors]))[1]
