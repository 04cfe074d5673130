"""Which of several drawn blocks is kept: of those that show the lexeme the one most in time, that joins on smoothly and
is nearest to what is asked of the hands.

- Not thrown: a candidate in which a hand gets faster than people's hands do counts only where all do. The corpus has
  leaps, one frame in a thousand, and what learns from it draws one now and then.
- In time: the hands' braking b(t) = max(0, -ds/dt), where s is the summed speed of both, lies near the onsets of the
  block's sound. The figure is sum b w / (sum b + b0), where w(t) is a Gaussian of the time to the nearest onset, and b0
  keeps what hardly moves from counting.
- Without a seam: the hands' acceleration at the start over that within the block, at most 2, so that whoever hardly
  moves is not thrown out for it.
- As asked: how far height, speed and radius of the hands (`data_module.controls`) over the block are from what is
  asked, in spreads of training.

Onsets are those that beats are placed at (`data_module.speech.onsets`), which is neither of the two detectors that
judge timing (`eval.metrics.eye`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module import controls
from data_module.motion.kinematics import chains, positions_of_some
from data_module.motion.rotation import from_exponential_map
from data_module.types import Array, Motion
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock, representation_of

if TYPE_CHECKING:
    from gesticulator.bundle.config import SelectionConfig

_NEAR = 0.05
"""Seconds: the deviation of w. Half of what the measures of timing forgive."""
_STILL = 3.0
"""Summed braking (m/s^2 over a block's frames) of hands that hardly move: b0."""
FASTEST = 3.5
"""m/s: the hands of the real takes stay under 3.1 in 99 of 100 seconds."""
_SEAM = 0.02
"""Seconds at the start of a block in which braking does not count: a jolt at the seam is no beat."""
_BEFORE = 4
"""Frames before a block that its first speeds are told from."""
_ASKED_RANK = 4
"""Lexemes that may be nearer to a candidate than the one to play, where something is asked of the hands: it is among
the best five."""


class CandidateChooser:
    """Weighs a block's candidates for one speaker."""

    def __init__(self, bundle: Bundle, speaker: int) -> None:
        self._settings: SelectionConfig = bundle.config.selection
        self._statistics, self._speaker = bundle.statistics, speaker
        self._representation = representation_of(bundle.config)
        skeleton = self._representation.motion(self._statistics.rest_pose[speaker][None], 1.0).skeleton
        self._joints = [skeleton.index(side + "Hand") for side in ("Right", "Left")]
        # Rotations are of each joint by itself, and a quarter of them moves the hands.
        self._arms = chains(skeleton, self._joints) if self._representation.name == "rotations" else None

    def choose(self, speech: SpeechBlock, past: Array, blocks: Array, nearer: NDArray[np.int64],
               asked: Array | None = None) -> int:
        """The candidate to keep; of equals the first.

        past: [P, D_m] features as they were shown, up to the block's start; blocks: [C, K, D_m] the candidates; nearer:
        [C] how many lexemes are nearer to each than the one to play; asked: [K, 2 F] rows of the control, or None.
        """
        if len(blocks) == 1:
            return 0
        hands, times = self._moved(speech, past, blocks)
        likely = not_thrown(hands, times)
        most = int(nearer[likely].min())
        if asked is not None and self._settings.as_asked:
            most = max(most, _ASKED_RANK)
        allowed = likely[nearer[likely] <= most]
        timed = bool(self._settings.timing) and len(speech.onsets) > 0
        if len(allowed) == 1 or not (timed or self._settings.seam or asked is not None):
            return int(allowed[nearer[allowed].argmin()])
        hands = hands[allowed]
        worth = -1e-3 * nearer[allowed].astype(np.float64)  # of equals the one that shows the lexeme best
        if timed:
            worth += self._settings.timing * in_time(hands, times, speech.start, speech.onsets)
        if self._settings.seam:
            worth -= self._settings.seam * jolt(hands, times)
        if asked is not None:
            worth -= self._settings.as_asked * self._away(hands, times, asked)
        return int(allowed[worth.argmax()])

    def throws(self, speech: SpeechBlock, past: Array, blocks: Array) -> bool:
        """Whether a hand gets faster than `FASTEST` in every candidate; shapes as in `choose`."""
        return bool((fastest(*self._moved(speech, past, blocks)) > FASTEST).all())

    def _moved(self, speech: SpeechBlock, past: Array, blocks: Array) -> tuple[Array, Array]:
        """Hands [C, T, 2, 3] metres of the last frames before a block and of its candidates, at times [T]."""
        frames = np.concatenate([np.repeat(past[None, -_BEFORE:], len(blocks), axis=0), blocks], axis=1)
        return self._hands(frames), self._times(speech, blocks.shape[1])

    def _hands(self, frames: Array) -> Array:
        """[C, T, 2, 3] metres, the right hand first, of features [C, T, D_m]."""
        poses = self._statistics.denormalise(frames.reshape(-1, frames.shape[-1]), self._speaker)
        if self._arms is None:
            places = positions_of_some(self._representation.motion(poses, 1.0), self._joints)
        else:
            skeleton, joints = self._arms
            rotations = from_exponential_map(poses.reshape(len(poses), -1, 3)[:, joints])
            places = positions_of_some(Motion(skeleton, rotations, np.zeros((len(poses), 3)), 1.0),
                                       [joints.index(hand) for hand in self._joints])
        return places.reshape(*frames.shape[:2], 2, 3)

    @staticmethod
    def _times(speech: SpeechBlock, frames: int) -> Array:
        """[T] seconds of the frames before a block and of its own."""
        before, own, _ = speech.durations
        steps = np.arange(1, frames + 1) / frames
        return np.concatenate([speech.start - before / frames * np.arange(_BEFORE - 1, -1, -1),
                               speech.start + own * steps])

    def _away(self, hands: Array, times: Array, asked: Array) -> Array:
        """[C] spreads between what each block [C, T, 2, 3] does and what is asked, over the features asked for."""
        own, width = hands[:, _BEFORE:], len(controls.FEATURES)
        steps = np.linalg.norm(np.diff(hands[:, _BEFORE - 1:], axis=1), axis=-1).mean(-1)
        done = np.stack([own[:, :, 0, 1].mean(1), steps.sum(1) / (times[-1] - times[_BEFORE - 1]),
                         np.linalg.norm(own[..., [0, 2]], axis=-1).mean((1, 2))], axis=-1)
        levels = self._statistics.levels
        if levels is None:
            return np.zeros(len(hands))
        wanted, given = asked[:, :width].mean(0), asked[:, width:].mean(0)
        return np.asarray((np.abs((done - levels.mean) / levels.spread - wanted) * given).sum(-1))


def fastest(hands: Array, times: Array) -> Array:
    """[C] m/s, the greatest speed of a hand in each block.

    hands: [C, T, 2, 3] metres at times [T] seconds, the frames before the block and its own.
    """
    speed = np.linalg.norm(np.diff(hands[:, _BEFORE - 1:], axis=1), axis=-1) / np.diff(times[_BEFORE - 1:])[:, None]
    return np.asarray(speed.max((1, 2)))


def not_thrown(hands: Array, times: Array) -> NDArray[np.int64]:
    """The candidates whose hands stay under `FASTEST`, or else the slowest one; see `fastest`."""
    speeds = fastest(hands, times)
    slow = np.flatnonzero(speeds <= FASTEST)
    return slow if len(slow) else np.array([speeds.argmin()])


def in_time(hands: Array, times: Array, start: float, onsets: Array) -> Array:
    """[C] from 0 to 1: what share of the hands' braking lies near onsets [n], seconds, from `start` on.

    hands: [C, T, 2, 3] metres at times [T] seconds, some frames before `start` and all after it.
    """
    seconds = np.diff(times)
    speed = np.linalg.norm(np.diff(hands, axis=1), axis=-1).sum(-1) / seconds
    between = 0.5 * (times[1:] + times[:-1])
    braking = np.maximum(-np.diff(speed, axis=1) / np.diff(between), 0.0)
    counts = times[1:-1] > start + _SEAM
    away = np.abs(times[1:-1, None] - np.asarray(onsets)).min(axis=1)
    near = np.exp(-0.5 * (away / _NEAR) ** 2)
    braking, near = braking[:, counts], near[counts]
    return np.asarray((braking * near).sum(1) / (braking.sum(1) + _STILL))


def jolt(hands: Array, times: Array) -> Array:
    """[C] the hands' acceleration at the start of each block over the mean within it, at most 2.

    hands: [C, T, 2, 3] metres at times [T] seconds, the frames before the block and its own.
    """
    velocity = np.diff(hands, axis=1) / np.diff(times)[:, None, None]
    between = 0.5 * (times[2:] - times[:-2])
    acceleration = np.linalg.norm(np.diff(velocity, axis=1) / between[:, None, None], axis=-1).sum(-1)
    at, inside = acceleration[:, _BEFORE - 2], acceleration[:, _BEFORE - 1:]
    return np.asarray(np.minimum(at / (inside.mean(1) + 1.0), 2.0))
