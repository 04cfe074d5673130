"""From sampled blocks to frames at a fixed rate: knots, smoothing, joints, and legs if requested.

File and stream both go through `MotionPath` block by block, so both get the same numbers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.blocks import KnotPath, half_of, smooth
from data_module.types import Array, Motion
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.contacts.default_body import cleared, cleared_poses
from gesticulator.options import InferenceOptions

if TYPE_CHECKING:
    from gesticulator.body.legs import Stance

HISTORY, LONGEST_HISTORY = 60.0, 600.0
"""Seconds of generated motion that can be taken back: by default, and at most (a long answer delivered at once and
played over minutes). A second takes 25 kB."""


SMOOTHED = 0.07
"""Deviation of the Gaussian by which corrections of the path are smoothed, seconds."""


class ClearedPath(KnotPath):
    """A path whose hands are out of the body. A correction sets in with a kink, so it is smoothed over time, unless the
    path is prompt; what is left is for the one who takes the frames to correct. cleared: of poses [T, D]."""

    def __init__(self, first: Array, fps: float, smooth_over: float, cleared: Callable[[Array], Array],
                 prompt: bool = False) -> None:
        super().__init__(first, fps, smooth_over, prompt)
        self._cleared, self._wide = cleared, half_of(fps, SMOOTHED)
        self.free = False
        """Whether the frames returned last, and those near them, were clear of the body as they came."""

    @property
    def reach(self) -> float:
        return super().reach + (0.0 if self.prompt else self._wide / self.fps)

    def _frames(self, numbers: NDArray[np.int64], count: int | None = None) -> Array:
        self.free = False
        if self.prompt or not len(numbers) or count == 1:
            return super()._frames(numbers, count)
        frames = super()._frames(np.arange(numbers[0] - self._wide, numbers[-1] + self._wide + 1), count)
        cleared = self._cleared(frames)
        self.free = cleared is frames
        if not self.free:
            frames = frames + smooth(cleared - frames, self.fps, SMOOTHED)
        return np.asarray(frames[self._wide:len(frames) - self._wide])


class MotionPath:
    """Turns successive normalised blocks of one performer into motion (RG 4.2.2, 7.1.2)."""

    def __init__(self, bundle: Bundle, speaker: int, options: InferenceOptions,
                 shaping: Callable[[Array, Array], Array] | None = None) -> None:
        """options: fps, legs, seated, seed and mirror are used; shaping: a function of poses [K, D_m] at seconds [K]
        that applies the style knobs."""
        self._shaping, self._mirrored = shaping, options.mirrored
        self._statistics, self._speaker, self._options = bundle.statistics, speaker, options
        self._representation = representation_of(bundle.config)
        first: Array = bundle.statistics.rest_pose[speaker]
        # Nobody saw what was before: a body that can begin elsewhere than at rest begins in its first knot.
        self._unseen = bundle.config.rests_by_phrase
        self._free = partial(cleared_poses, sits=options.seated)
        path = partial(ClearedPath, cleared=self._free) if self._unseen else KnotPath
        self._path = partial(path, fps=float(options.fps), smooth_over=bundle.config.motion.smoothing)
        self._knots = self._path(first)
        # Joint positions give rotations only as a whole: their frames wait for the end.
        self._whole: list[Array] | None = None if bundle.config.motion.representation == "rotations" else []
        self._last: Array | None = None
        self._stance: Stance | None = None
        self.skeleton = self._representation.motion(first[None], float(options.fps)).skeleton
        if options.legs or options.seated:
            from gesticulator.body.legs import WHOLE_BODY, Stance

            self.skeleton = WHOLE_BODY
            self._stance = None if options.seated else Stance(int(options.seed), float(options.fps))
        self._stances: deque[tuple[int, Stance]] = deque()
        self.history = HISTORY
        """Seconds that can be taken back."""

    @property
    def next(self) -> int:
        return self._knots.next

    @property
    def fps(self) -> float:
        return self._knots.fps

    @property
    def prompt(self) -> bool:
        """Whether frames up to the newest knot are final, see `KnotPath`; may be set between blocks."""
        return self._knots.prompt

    @prompt.setter
    def prompt(self, on: bool) -> None:
        self._knots.prompt = on

    @property
    def reach(self) -> float:
        """Seconds after a frame within which later frames affect it (smoothing)."""
        return self._knots.reach

    def push(self, times: Array, features: NDArray[np.floating], until: int | None = None) -> Motion | None:
        """Add knots: features [K, D_m] at rising times [K] seconds; returns the frames now final, or None. Frames from
        number `until` on are held back.

        With joint positions all frames come at the end, because rotations are computed from the whole motion.
        """
        return self.push_poses(times, self._poses(times, features), until)

    def push_poses(self, times: Array, poses: Array, until: int | None = None) -> Motion | None:
        """`push` of poses [K, D_m] that are not normalised and have the knobs and gestures applied."""
        if self._unseen and len(poses):
            self._knots, self._unseen = self._path(self._free(poses[:1])[0], prompt=self.prompt), False
        frames = self._knots.push(times, self._cleared(poses), until)
        if self._whole is None:
            return self._motion(frames)
        self._whole.append(frames)
        return None

    def finish(self, duration: float) -> Motion | None:
        """The remaining frames of a motion of `duration` seconds."""
        return self._motion(np.concatenate([*(self._whole or ()), self._knots.finish(duration)]))

    def rewind(self, times: Array, features: NDArray[np.floating], first: int) -> None:
        """Go back to frame `first`, see `KnotPath.rewind`; features [M, D_m] at times [M] of the remembered past."""
        self.rewind_poses(times, self._poses(times, features), first)
        if self._stance is not None:
            while len(self._stances) > 1 and self._stances[-1][0] > first:
                self._stances.pop()
            number, self._stance = self._stances[-1]
            self._stances[-1] = number, self._stance.fork()
            if number < first:
                self._stance.step(self._representation.motion(self._knots.frames(number, first), self._knots.fps))

    def rewind_poses(self, times: Array, poses: Array, first: int) -> None:
        """`rewind` with poses [M, D_m] as in `push_poses`; the legs stay as they are."""
        self._knots.rewind(times, self._cleared(poses), first)
        self._last, self._unseen = None, False

    @property
    def has_legs(self) -> bool:
        """Whether the motion is on standing legs, which depend on everything before."""
        return self._stance is not None

    def _poses(self, times: Array, features: NDArray[np.floating]) -> Array:
        poses = self._statistics.denormalise(features.astype(np.float64), self._speaker)
        if not len(poses):
            return poses
        return poses if self._shaping is None else self._shaping(poses, times)

    def _cleared(self, poses: Array) -> Array:
        """Knots [K, D_m] with the hands out of the body, if their path does not see to it."""
        return poses if self._whole is not None or not len(poses) or isinstance(self._knots, ClearedPath) else \
            self._free(poses)
    def _motion(self, frames: Array) -> Motion | None:
        if len(frames) == 0:
            return None
        motion = self._moved(frames)
        if not self._mirrored:
            return motion
        from gesticulator.body.clips import mirrored_motion

        return mirrored_motion(motion)

    def _moved(self, frames: Array) -> Motion:
        # Interpolated frames between two clear knots may pass through the body, so frames are cleared, too.
        body = self._representation.motion(frames, self._knots.fps)
        if self._whole is None and not (isinstance(self._knots, ClearedPath) and self._knots.free):
            body = cleared(body, self._options.seated)
        if self._stance is not None:
            first = self._knots.next - len(frames)
            # The legs before these frames, to return to: a stream that is interrupted takes frames back.
            self._stances.append((first, self._stance.fork()))
            while (first - self._stances[0][0]) / self._knots.fps > self.history and len(self._stances) > 1:
                self._stances.popleft()
            return self._stance.step(body)
        if self._options.seated:
            from gesticulator.body.legs import seated

            body = seated(body)
        # A quaternion and its negative are the same rotation; take the one nearer to the frame before.
        if self._last is not None:
            turned = np.where(np.sum(body.rotations[0] * self._last, axis=-1) < 0, -1.0, 1.0)
            body = replace(body, rotations=body.rotations * turned[:, None])
        self._last = body.rotations[-1]
        return body
