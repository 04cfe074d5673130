"""Knobs applied to the generated poses: the size of gestures, and which hand makes them.

All functions depend only on the poses so far and their times, so a stream gives the frames of a file. Knobs that affect
lexemes or rest are applied while blocks are generated (`gesticulator.editing.render`).

**Intensity** i scales strokes and leaves slow movement alone. Scaling whole poses would make hands faster than people's
everywhere, whereas people who gesture larger are not faster between strokes. With S the displacement of an arm's pose x
by large strokes, and F that by small movements (`gesticulator.directing.strokes`), the pose becomes

    x + h ((a - 1) S + (b - 1) F)        a = 1 + 0.8 (i - 1), b = 1                     for i >= 1
                                         a = 1 - 0.5 (1 - i), b = 1 - 0.8 (1 - i)       for 0.5 <= i < 1

h falls from 1 to 0 as the arm is lowered, so that a hanging arm is not moved: with r the resting pose and m the mean
pose, the lift of the arm is s = <x - r, m - r> / |m - r|^2, and h is a smooth step of s from 0.1 to 0.7. For i < 1, its
mean over the last `CALM` seconds is taken: while h changed within a stroke, it added (a - 1) S dh/dt to the speed, and
smaller gestures had faster moments than those they were made of. Below i = 0.5,
arms and fingers approach the resting pose, which they reach at 0: r + 2 i (x - r), with x as for i = 0.5.

Movement towards the bounds of the training data (`Statistics.bounds`) is limited smoothly. Head and spine are scaled
about their mean pose. Hands are kept out of the trunk afterwards (`gesticulator.contacts.default_body`).

**Both hands**: each arm takes over a share of the other arm's strokes, mirrored and a little later, in exchange for its
own: x + e (M S'(t - lag) - 0.9 S), with S' of the other arm, M the mirror image and e = `ECHO`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.motion import rotation
from data_module.motion.representation import Representation
from data_module.motion.skeletons import SIDES
from data_module.types import Array
from gesticulator.body.clips import exchanged_joints
from gesticulator.bundle.features import Statistics
from gesticulator.directing.strokes import FINE, LARGE, StrokeMemory, smooth_step

STRONGER, WEAKER, FINER = 0.8, 0.5, 0.8
"""Gain of strokes per unit of intensity above 1; loss of strokes, and of small movements, per unit below 1. With these,
all statistics stay within the range of people for intensities from 0.5 to 1.5 (docs/knobs.md)."""
RESTING = 0.5
"""Intensity below which the arms approach the resting pose: still smaller strokes would be smaller than people's."""
TRUNK, TRUNK_LEAST = 0.25, 0.2
"""Head and spine: exponent of their gain above 1, and share of their movement at 0, so that idle motion remains."""
OTHER_HAND = 0.45
"""Intensity of the hand that is not preferred."""
ECHO, LOSS, LAG = 0.4, 0.9, 0.1
"""Share of the other hand's strokes that a hand takes over; share of that by which its own strokes shrink; delay,
seconds. With these, both hands are as fast as before, and their speeds correlate as people's do (0.7, of at most 0.83).
"""
FADE, MIRROR_FADE, REST_FADE = 0.15, 0.3, 0.6
"""Seconds to both sides of a beat over which intensity, mirroring, and the approach to rest (intensity below 0.5)
change. In 0.6, a hand half a metre from rest gets there at 0.6 m/s."""
_FLIP = np.array([1.0, -1.0, -1.0])
"""A reflection in x = 0 keeps the x component of an exponential map and negates y and z."""
_HANGS, _LIFTED = 0.1, 0.7
"""Lift s (see the module) up to which an arm hangs, and from which on it is up."""
CALM = 0.8
"""Seconds over which h is averaged for smaller gestures: longer than a stroke."""


def levels_at(edges: Array, levels: NDArray[np.floating], times: Array, fade: float,
              locked: NDArray[np.bool_] | None = None) -> Array:
    """[M] level at rising times [M], where block n of edges [N + 1] has levels[n]. Between blocks of different levels
    it changes smoothly, over `fade` seconds to both sides or half of the shorter run of blocks.

    Elsewhere it is exactly the level of the block. locked: [N] blocks that must keep their level; beside them the
    change takes place on the other side alone.
    """
    block = np.clip(np.searchsorted(edges, times, side="left") - 1, 0, len(levels) - 1)
    out = np.asarray(levels, dtype=np.float64)[block]
    # Runs of equal blocks: a change may use half of the run on either side, so that two changes never overlap.
    changes = np.flatnonzero(np.diff(levels)) + 1
    bounds = edges[[0, *changes, len(levels)]]
    for at, before, begins, after in zip(changes, bounds[:-2], bounds[1:-1], bounds[2:], strict=True):
        reach = min(fade, (begins - before) / 2.0, (after - begins) / 2.0)
        first, last = begins - reach, begins + reach
        if locked is not None and locked[at - 1] != locked[at]:
            first, last = (begins, last) if locked[at - 1] else (first, begins)
        # A time on the beat belongs to the block before, but a change that ends on the beat is complete there.
        stop = int(np.searchsorted(times, last, side="left"))
        if last == begins:
            stop = int(np.searchsorted(times, begins, side="right"))
        near = slice(int(np.searchsorted(times, first, side="right")), stop)
        u = (times[near] - first) / (last - first)
        out[near] = levels[at - 1] + (levels[at] - levels[at - 1]) * u * u * (3.0 - 2.0 * u)
    return out


def eased_levels(edges: Array, levels: NDArray[np.floating], fade: float, locked: NDArray[np.bool_]) -> Array:
    """[N] levels of blocks in which runs of equal levels that are too short to fade are moved towards the more similar
    neighbouring run: by 1 - duration / (2 fade) of the difference, so that the change is not too fast.

    edges: [N + 1] seconds; locked: [N] blocks that keep their level.
    """
    out = np.array(levels, dtype=np.float64)
    begins = [0, *(np.flatnonzero(np.diff(levels)) + 1), len(levels)]
    for before, at, stop, after in zip([-1, *begins[:-2]], begins[:-1], begins[1:], [*begins[2:], -1], strict=True):
        beside = ([levels[at - 1]] if before >= 0 else []) + ([levels[stop]] if after >= 0 else [])
        if beside:
            nearest = min(beside, key=lambda level, here=levels[at]: abs(level - here))  # type: ignore[misc]
            short = 1.0 - min((edges[stop] - edges[at]) / (2.0 * fade), 1.0)
            out[at:stop] += np.where(locked[at:stop], 0.0, short * (nearest - levels[at]))
    return out


@dataclass(frozen=True)
class ShapeLevels:
    """What the knobs ask for at M times. intensity: [M, 2] of the left and the right arm; share: [M, 2] of the way from
    rest to the pose (`rest_share`); both: [M] how much each hand joins in the other's strokes, 0 to 1; mirrored: [M]
    the way to the mirror image."""

    intensity: Array
    share: Array
    both: Array
    mirrored: Array

    @property
    def changed(self) -> NDArray[np.int64]:
        """[n] indices of the times at which poses change."""
        return np.flatnonzero((self.intensity != 1.0).any(axis=1) | (self.share != 1.0).any(axis=1)
                              | (self.both != 0.0))


def rest_share(intensity: NDArray[np.floating]) -> Array:
    """The factor 2 i of the approach to rest (see the module), at most 1."""
    return np.minimum(intensity / RESTING, 1.0)


class _ScaledArm:
    """One arm from the collar bone to the wrist, and its fingers."""

    def __init__(self, columns: NDArray[np.int64], fingers: NDArray[np.int64], mean: Array, rest: Array) -> None:
        self.columns, self.fingers = columns, fingers
        self.mean, self.rest, self.resting_fingers = mean[columns], rest[columns], rest[fingers]
        self.large, self.fine = StrokeMemory(columns, LARGE), StrokeMemory(columns, FINE)

    def lifted(self, poses: Array) -> Array:
        """[M] h of the module for poses [M, D]."""
        up = self.mean - self.rest
        # Sums along rows have the same bits for any number of rows, which products of matrices have not.
        lift = ((poses - self.rest) * up).sum(axis=1) / max(float(up @ up), 1e-9)
        return smooth_step((lift - _HANGS) / (_LIFTED - _HANGS))

    def calmly_lifted(self, times: Array) -> Array:
        """[M] the mean of h over `CALM` seconds before each of the times [M] of poses that were pushed."""
        return self.large.averaged(times, CALM, self.lifted)


class Shaper:
    """Applies the knobs for one speaker. Poses are exponential maps [M, 3 J], radians; all poses of a performance must
    pass through `shaped` in the order of their times."""

    def __init__(self, statistics: Statistics, representation: Representation, speaker: int) -> None:
        mean, rest = statistics.mean_pose[speaker], statistics.rest_pose[speaker]
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

    def shaped(self, poses: Array, times: Array, levels: ShapeLevels) -> Array:
        """The next poses [M, 3 J] at rising seconds [M], scaled and mirrored. Poses without change stay the same bit
        for bit. If the times go back, later poses are forgotten."""
        for arm in self._arms:
            arm.large.push(times, poses)
            arm.fine.push(times, poses)
        result, at = poses.copy(), levels.changed
        if len(at):
            result[at] = self._scaled(poses, times, levels, at)
        at = np.flatnonzero(levels.mirrored)
        turned = result[at].reshape(len(at), len(self._swapped), 3)[:, self._swapped] * _FLIP
        result[at] = _towards(result[at], turned.reshape(len(at), poses.shape[1]), levels.mirrored[at][:, None])
        return result

    def _scaled(self, poses: Array, times: Array, scales: ShapeLevels, at: NDArray[np.int64]) -> Array:
        """The poses `at` [n] of [M, 3 J], scaled."""
        # Only the poses that change are computed; the others keep their bits, which edits of a plan rely on.
        before, out = poses[at], poses[at].copy()
        intensity, both = scales.intensity[at], scales.both[at, None]
        strokes = [arm.large.at(times[at]) for arm in self._arms]
        echoes = [np.zeros_like(stroke) for stroke in strokes]
        if both.any():
            echoes = [ECHO * both * (other.large.at(times[at] - LAG) * self._mirror - LOSS * stroke)
                      for stroke, other in zip(strokes, self._arms[::-1], strict=True)]
        for side, (arm, stroke, echo) in enumerate(zip(self._arms, strokes, echoes, strict=True)):
            pose, share = before[:, arm.columns], scales.share[at, side, None]
            # Below `RESTING` strokes shrink no further: the share below leads the arm to rest instead.
            step = np.maximum(intensity[:, side, None], RESTING) - 1.0
            large = (stroke + echo) * step * np.where(step > 0.0, STRONGER, WEAKER)
            lifted = arm.lifted(pose)[:, None]
            if (step < 0.0).any():
                large = large + arm.fine.at(times[at]) * np.minimum(step, 0.0) * FINER
                lifted = np.where(step < 0.0, arm.calmly_lifted(times[at])[:, None], lifted)
            changed = self._within(pose, echo + lifted * large, arm.columns)
            out[:, arm.columns] = _towards(arm.rest, changed, share)
            out[:, arm.fingers] = _towards(arm.resting_fingers, before[:, arm.fingers], share)
        # The trunk belongs to both arms and follows the larger gesture.
        most = intensity.max(axis=1, keepdims=True)
        gain = np.where(most > 1.0, np.maximum(most, 1.0) ** TRUNK, TRUNK_LEAST + (1.0 - TRUNK_LEAST) * most)
        trunk = before[:, self._trunk]
        out[:, self._trunk] = self._within(trunk, (gain - 1.0) * (trunk - self._mean[self._trunk]), self._trunk)
        return out

    def _within(self, poses: Array, added: Array, columns: NDArray[np.int64]) -> Array:
        """Poses [M, D] with a displacement added, limited smoothly at the bounds of the training data."""
        # Towards the mean there is always room; away from it the rest of the range is used up asymptotically.
        outwards = added * (poses - self._mean[columns]) > 0
        room = np.maximum(np.where(added > 0, self._high[columns] - poses, poses - self._low[columns]), 1e-9)
        return poses + np.where(outwards, room * np.tanh(added / room), added)


def _columns(joints: list[int]) -> NDArray[np.int64]:
    """[3 n] columns of n joints in a pose."""
    return (3 * np.array(joints, dtype=np.int64)[:, None] + np.arange(3)).ravel()


def _towards(rest: Array, poses: Array, share: Array) -> Array:
    """Poses [M, D] a share [M, 1] of the way from the pose `rest` [D]; the same bit for bit where it is 1."""
    return np.where(share == 1.0, poses, rest + share * (poses - rest))


def nearest_turn(vectors: Array, reference: Array) -> Array:
    """Exponential maps [..., 3] of the same rotations that are nearest to a reference [..., 3], by full turns."""
    return rotation.unroll(np.stack([reference, vectors]))[1]
