"""Frames of an edited plan: those around the change are computed again, the others are taken from the last rendering.

A frame depends on the poses at the knots around it, a pose on the strokes of the last `REMEMBERED` seconds where knobs
scale them, and legs on everything before, so that frames on legs are all computed again. The poses are compared knot by
knot with those of the last rendering; the first and the last knot that differ bound what is computed. The result is
that of the whole plan, bit for bit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, Motion
from gesticulator.body.motion_path import MotionPath
from gesticulator.body.pins import pinned
from gesticulator.bundle.bundle import Bundle
from gesticulator.directing.cues import TimedCue
from gesticulator.directing.shaping import CALM, Shaping
from gesticulator.directing.strokes import REMEMBERED
from gesticulator.options import InferenceOptions
from gesticulator.plan.plan import GesturePlan
from gesticulator.sampling.loop import GeneratedMotion

_MEMORY = REMEMBERED + CALM
"""Seconds of strokes on which the size of a pose depends, with what the lift of an arm is averaged over."""
_MARGIN = 6
"""Knots before a window of frames, more than the slope of the path needs."""
_UNSCALED = (1.0, 1.0, 0.0)
"""What is asked for at a knot where no knob is set."""
_TOGETHER = 64
"""Blocks whose frames are computed at once, for bounded memory."""


@dataclass(frozen=True)
class EditedFrames:
    """The frames of a rendered plan, with what they were computed from. inputs: [M, D_m + 4] seconds of the
    knots, the generated poses, normalised, and what the knobs ask for; gestures: the named ones; poses: [M, D_m] with
    knobs and gestures applied. unpinned, motion: without and with the pins of the plan."""

    inputs: Array
    gestures: tuple[TimedCue, ...]
    poses: Array
    unpinned: Motion
    motion: Motion


@dataclass(frozen=True)
class FrameRenderer:
    """Computes the frames of plans of one performer with the same rate, legs and side (`InferenceOptions`)."""

    bundle: Bundle
    speaker: int
    options: InferenceOptions

    def render(self, generated: GeneratedMotion, shaping: Shaping | None, plan: GesturePlan,
               before: EditedFrames | None, motion: Motion | None = None) -> EditedFrames:
        """The frames of a plan's blocks. before: those of another plan of the same recording and renderer; motion: of
        a plan without pins, if it is known."""
        times = generated.cut.knot_times.ravel()
        features = generated.motion.reshape(len(times), -1)
        asked, gestures = np.tile(_UNSCALED, (len(times), 1)), tuple[TimedCue, ...]()
        if shaping is not None:
            levels, gestures = shaping.levels(times), tuple(shaping.named(times))
            asked = np.column_stack([levels.intensity, levels.share, levels.mirrored])
        # What is asked stands beside the poses, so that a knob that changes over time counts as a change of the poses.
        inputs = np.column_stack([times, features, asked])
        poses = self._poses(features, inputs, gestures, shaping, before)
        knots = generated.cut.knot_times.size // len(generated.cut)
        if motion is None:
            motion = self._frames(times, poses, knots, float(generated.cut.edges[-1]), before)
        return EditedFrames(inputs, gestures, poses, motion, pinned(motion, plan) if plan.pins else motion)

    def _poses(self, features: NDArray[np.float32], inputs: Array, gestures: tuple[TimedCue, ...],
               shaping: Shaping | None, before: EditedFrames | None) -> Array:
        """[M, D_m] poses with knobs and gestures."""
        times = inputs[:, 0]

        def plain(first: int, last: int) -> Array:
            return self.bundle.statistics.denormalise(features[first:last].astype(np.float64), self.speaker)

        if before is None:
            return plain(0, len(times)) if shaping is None else shaping(plain(0, len(times)), times)
        first, last = changed_rows(before.inputs, inputs)
        # A named gesture that came, went or moved changes the poses of its whole span.
        for cue in {*gestures} ^ {*before.gestures}:
            first = min(first, int(np.searchsorted(times, cue.span[0])))
            last = max(last, int(np.searchsorted(times, cue.span[1], side="right")))
        last = max(first, last)
        if shaping is None:
            window = plain(first, last)
        else:
            # Later strokes remember what has changed, and these depend on those before.
            last = int(np.searchsorted(times, times[min(last, len(times) - 1)] + _MEMORY, side="right"))
            begin = max(int(np.searchsorted(times, times[min(first, len(times) - 1)] - _MEMORY)) - 2, 0)
            window = shaping(plain(begin, last), times[begin:last])[first - begin:]
        return np.concatenate([before.poses[:first], window, before.poses[len(before.poses) - len(times) + last:]])

    def _frames(self, times: Array, poses: Array, knots: int, duration: float, before: EditedFrames | None) -> Motion:
        """The motion without pins. knots: of a block."""
        path = MotionPath(self.bundle, self.speaker, self.options)
        if before is None:
            return self._whole(path, times, poses, knots, duration)
        first, last = changed_rows(*(np.column_stack(rows) for rows in (
            (before.inputs[:, 0], before.poses), (times, poses))))
        if first >= last and len(times) == len(before.inputs):
            return before.unpinned
        if path.has_legs:  # they depend on everything before
            return self._whole(path, times, poses, knots, duration)
        count, half = max(1, round(duration * path.fps)), round(path.reach * path.fps)
        begin = 0
        if first >= 2:
            begin = min(math.ceil(times[first - 2] * path.fps - 1e-9), round(times[first - 1] * path.fps)) - half
        # The last frames are smoothed with what the path holds at the end, so a window near the end begins before them.
        begin = max(min(begin, count - 2 * half - 3), 0)
        low = int(np.searchsorted(times, (begin - half) / path.fps)) - _MARGIN
        if low <= 0:
            begin = low = 0
        else:
            # The knots up to the last one before the window; what follows is pushed.
            known = max(int(np.searchsorted(times, begin / path.fps)), low + 2)
            path.rewind_poses(times[low:known], poses[low:known], begin)
            low = known
        stop = count
        # The slope at a knot needs the next one, and the smoothing half a kernel more.
        if last + 1 < len(times):
            stop = min(math.ceil(times[last + 1] * path.fps) + half + 1, count)
        if stop >= count - 2 * half - 3:
            parts, stop = [path.push_poses(times[low:], poses[low:]), path.finish(duration)], count
        else:
            high = int(np.searchsorted(times, (stop + half + 1) / path.fps)) + _MARGIN
            parts = [path.push_poses(times[low:high], poses[low:high])]
            if path.next < stop:
                parts, stop = [*parts, path.push_poses(times[high:], poses[high:]), path.finish(duration)], count
        return spliced(before.unpinned, _joined(parts), begin, stop)

    def _whole(self, path: MotionPath, times: Array, poses: Array, knots: int, duration: float) -> Motion:
        # On legs block by block, as in a file and in a stream: the bits of a shift of the weight depend on where its
        # steps end.
        step = knots if path.has_legs else _TOGETHER * knots
        parts = [path.push_poses(times[at:at + step], poses[at:at + step]) for at in range(0, len(times), step)]
        return _joined([*parts, path.finish(duration)])


def changed_rows(before: Array, now: Array) -> tuple[int, int]:
    """The rows (first, last + 1) of `now` [M, D] that differ from those of `before` [L, D], whose first rows are equal
    to the first ones and whose last rows to the last ones; first = last if rows were only left out."""
    # From both ends: between the first and the last difference there may be more or fewer rows than before.
    count = min(len(before), len(now))
    differs = np.flatnonzero((before[:count] != now[:count]).any(axis=1))
    first = int(differs[0]) if len(differs) else count
    differs = np.flatnonzero((before[len(before) - count:] != now[len(now) - count:]).any(axis=1))
    last = len(now) - count + int(differs[-1]) + 1 if len(differs) else len(now) - count
    return first, max(first, last)


def spliced(before: Motion, window: Motion, begin: int, stop: int) -> Motion:
    """A motion with the frames `begin` to `stop` - 1 of another one. A quaternion and its negative are the same
    rotation; each joint has the sign nearer to that of the frame before, in the window and after it."""
    turns, tail = window.rotations[:stop - begin], before.rotations[stop:]
    if begin > 0:
        turns = turns * _signs(before.rotations[begin - 1], turns[0])
    if len(tail):
        signs = _signs(turns[-1], tail[0])
        tail = tail if (signs > 0.0).all() else tail * signs
    return replace(before, rotations=np.concatenate([before.rotations[:begin], turns, tail]),
                   root_positions=np.concatenate([before.root_positions[:begin], window.root_positions[:stop - begin],
                                                  before.root_positions[stop:]]))


def _signs(one: Array, other: Array) -> Array:
    """[J, 1] 1.0 where quaternions [J, 4] are on the same side, else -1.0."""
    return np.where(np.sum(one * other, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)


def _joined(parts: Sequence[Motion | None]) -> Motion:
    """Successive parts of one motion, of which some may be missing."""
    given = [part for part in parts if part is not None]
    return replace(given[0], rotations=np.concatenate([part.rotations for part in given]),
                   root_positions=np.concatenate([part.root_positions for part in given]))
