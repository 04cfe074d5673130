"""Knobs, curves and named gestures, applied to the generated poses: size, mirror image, overlays.

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
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.motion.representation import Representation
from data_module.motion.skeletons import SIDES
from data_module.types import Array, Word
from gesticulator.body.clips import exchanged_joints
from gesticulator.body.life import smooth_step
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import Statistics, representation_of
from gesticulator.directing.cues import TimedCue, cues_at
from gesticulator.directing.lexeme_names import lexeme_names
from gesticulator.directing.strokes import FINE, LARGE, StrokeMemory
from gesticulator.options import InferenceOptions

STRONGER, WEAKER, FINER = 0.8, 0.5, 0.8
"""Gain of strokes per unit of intensity above 1; loss of strokes, and of small movements, per unit below 1. With these,
all statistics stay within the range of people for intensities from 0.5 to 1.5 (docs/knobs.md)."""
RESTING = 0.5
"""Intensity below which the arms approach the resting pose: still smaller strokes would be smaller than people's."""
TRUNK, TRUNK_LEAST = 0.25, 0.2
"""Head and spine: exponent of their gain above 1, and share of their movement at 0, so that idle motion remains."""
FADE, MIRROR_FADE, REST_FADE = 0.15, 0.3, 0.6
"""Seconds to both sides of a beat over which intensity, mirroring, and the approach to rest (intensity below 0.5)
change. In 0.6, a hand half a metre from rest gets there at 0.6 m/s."""
_FLIP = np.array([1.0, -1.0, -1.0])
"""A reflection in x = 0 keeps the x component of an exponential map and negates y and z."""
_HANGS, _LIFTED = 0.1, 0.7
"""Lift s (see the module) up to which an arm hangs, and from which on it is up."""
CALM = 0.8
"""Seconds over which h is averaged for smaller gestures: longer than a stroke."""
LONGEST_GESTURE = 4.0
"""Seconds from the start of a named gesture to its apex, or from there to its end, at most (a test measures it)."""
_BROKEN_OFF = 1.2
"""Seconds in which a gesture ends that an interruption breaks off: so long the hands take to hang."""
_TIME = attrgetter("time")


class Shaping:
    """Applies intensity, mirroring and named gestures to generated poses [M, D_m] at rising seconds [M]."""

    def __init__(self, bundle: Bundle, options: InferenceOptions, speaker: int, words: Sequence[Word], edges: Array,
                 meant: Callable[[float], Sequence[TimedCue]] | None = None) -> None:
        """edges: [N + 1] seconds of the blocks; without a plan, the start and the end (infinity for a stream) are
        enough. meant: gives the gestures that words call for, or that are marked, and that begin up to a time."""
        representation = representation_of(bundle.config)
        if representation.name != "rotations":
            raise InputError("intensity, energy, cues and plans", "need a bundle of joint rotations, and this "
                             "one has joint positions", "leave them out")
        self._edges, self._meant, self._seed = edges, meant, options.seed or 0
        self._sizes, self._mirrored, self._locked = _levels(options, len(edges) - 1)
        self._curve = None if options.plan is None else options.plan.curve("intensity")
        self._shares = eased_levels(edges, rest_share(self._sizes), REST_FADE, self._locked)
        cues = cues_at(options.cues, words, float(edges[-1]), lambda: lexeme_names(bundle))
        self._cues = [cue for cue in cues if cue.lexeme is None]
        self._shaper = Shaper(bundle.statistics, representation, speaker)

    def levels(self, times: Array) -> ShapeLevels:
        """The levels at `times` [M]."""
        edges, locked = self._edges, self._locked
        intensity = levels_at(edges, self._sizes, times, FADE, locked)
        share = levels_at(edges, self._shares, times, REST_FADE, locked)
        if self._curve is not None:
            factor = np.interp(times, self._curve.times, self._curve.values)
            # Locked blocks keep the size of the first generation, which had no curves.
            factor = 1.0 + (factor - 1.0) * levels_at(edges, 1.0 - locked, times, FADE, locked)
            intensity = np.minimum(intensity * factor, 2.0)
            share = share * rest_share(np.minimum(factor, 1.0))
        return ShapeLevels(intensity, share, levels_at(edges, self._mirrored, times, MIRROR_FADE, locked))

    def named(self, times: Array) -> list[TimedCue]:
        """The gestures that may be made within `times`, by the times of their strokes."""
        if not len(times):
            return []
        # A stroke outside of these times may still reach into them with its preparation or its hold.
        begin, end = float(times[0]) - LONGEST_GESTURE, float(times[-1]) + LONGEST_GESTURE
        called = self._meant(float(times[-1])) if self._meant else ()
        return sorted((cue for cue in (*self._cues, *called) if begin <= cue.time <= end), key=_TIME)

    def __call__(self, poses: Array, times: Array) -> Array:
        """The next poses."""
        poses = self._shaper.shaped(poses, times, self.levels(times))
        return with_gestures(poses, times, self.named(times), self._seed)


def with_gestures(poses: Array, times: Array, cues: Sequence[TimedCue], seed: int) -> Array:
    """Poses [M, D] at seconds [M] with named gestures, also those that are broken off; seed: of their variation."""
    if not cues:
        return poses
    from gesticulator.directing.named_gestures import laid_over, nearest_turn

    for cue in cues:
        if cue.broken_off is None:
            continue
        whole = laid_over(poses, times, [(cue.cue, cue.time)], seed)
        share = smooth_step((times - cue.broken_off) / _BROKEN_OFF)[:, None]
        # Between two turns of the same joint, the nearer representation: the other would whirl the arm around.
        target = nearest_turn(poses.reshape(len(poses), -1, 3), whole.reshape(len(poses), -1, 3)).reshape(poses.shape)
        poses = np.where(share == 1.0, poses, np.where(share == 0.0, whole, whole + share * (target - whole)))
    played = sorted((cue for cue in cues if cue.broken_off is None), key=_TIME)
    return laid_over(poses, times, [(cue.cue, cue.time) for cue in played], seed)


def _levels(options: InferenceOptions, count: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Of N blocks: [N] intensities; [N] 1.0 where the block is mirrored; [N] whether it is locked."""
    # Without a plan all blocks are alike, and a stream has no blocks yet.
    if options.plan is None:
        return np.full(count, options.knobs.size), np.zeros(count), np.zeros(count, bool)
    blocks, now, first = options.plan.blocks, options.plan.knobs, options.plan.drawn.knobs
    locked = np.array([block.locked for block in blocks])
    sizes = np.minimum(np.array([block.intensity for block in blocks]) * np.where(locked, first.size, now.size), 2.0)
    # Where the whole motion is mirrored at the end, the knob has been seen to already.
    whole = options.mirrored
    mirrored = [block.mirror != (not whole and (first if block.locked else now).mirror) for block in blocks]
    return sizes, np.array(mirrored, dtype=np.float64), locked


def levels_at(edges: Array, levels: NDArray[np.floating], times: Array, fade: float,
              locked: NDArray[np.bool_] | None = None) -> Array:
    """[M] level at rising times [M], where block n of edges [N + 1] has levels[n]. Between blocks of different levels
    it changes smoothly, over `fade` seconds to both sides or half of the shorter run of blocks. Elsewhere it is exactly
    the level of the block. locked: [N] blocks that keep their level; beside them the other side alone changes."""
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
    neighbouring run: by 1 - duration / (2 fade) of the difference, so that the change is not too fast. edges: [N + 1]
    seconds; locked: [N] blocks that keep their level."""
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
    """What the knobs ask for at M times. intensity: [M]; share: [M] of the way from rest to the pose (`rest_share`);
    mirrored: [M] the way to the mirror image."""

    intensity: Array
    share: Array
    mirrored: Array


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
        self._trunk = _columns([j for j, name in enumerate(names) if name.startswith(("Spine", "Neck", "Head"))])
        self._mean = mean

    def shaped(self, poses: Array, times: Array, levels: ShapeLevels) -> Array:
        """The next poses [M, 3 J] at rising seconds [M], scaled and mirrored. Poses without change stay the same bit
        for bit. If the times go back, later poses are forgotten."""
        for arm in self._arms:
            arm.large.push(times, poses)
            arm.fine.push(times, poses)
        result, at = poses.copy(), np.flatnonzero((levels.intensity != 1.0) | (levels.share != 1.0))
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
        intensity, share = scales.intensity[at, None], scales.share[at, None]
        # Below `RESTING` strokes shrink no further: the share leads the arm to rest instead.
        step = np.maximum(intensity, RESTING) - 1.0
        for arm in self._arms:
            pose = before[:, arm.columns]
            large = arm.large.at(times[at]) * step * np.where(step > 0.0, STRONGER, WEAKER)
            lifted = arm.lifted(pose)[:, None]
            if (step < 0.0).any():
                large = large + arm.fine.at(times[at]) * np.minimum(step, 0.0) * FINER
                lifted = np.where(step < 0.0, arm.large.averaged(times[at], CALM, arm.lifted)[:, None], lifted)
            changed = self._within(pose, lifted * large, arm.columns)
            out[:, arm.columns] = _towards(arm.rest, changed, share)
            out[:, arm.fingers] = _towards(arm.resting_fingers, before[:, arm.fingers], share)
        gain = np.where(intensity > 1.0, np.maximum(intensity, 1.0) ** TRUNK,
                        TRUNK_LEAST + (1.0 - TRUNK_LEAST) * intensity)
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
    # [3 n] columns of n joints in a pose.
    return (3 * np.array(joints, dtype=np.int64)[:, None] + np.arange(3)).ravel()


def _towards(rest: Array, poses: Array, share: Array) -> Array:
    """Poses [M, D] a share [M, 1] of the way from the pose `rest` [D]; the same bit for bit where it is 1."""
    return np.where(share == 1.0, poses, rest + share * (poses - rest))
