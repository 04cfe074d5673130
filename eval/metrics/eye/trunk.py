"""Trunk and life: do the head and the chest move, does anything, and does anything run through anything?

Theory: a speaker nods, turns, leans and breathes. The spread of a rotation q_t about its mean (the largest eigenvector
of sum q q^T) is the root mean square of the rotation vectors from the mean, degrees:

- head on chest: of the head's rotation relative to the chest; chest: of the chest's, relative to the facing hips.
- hand in the torso: percentage of frames of the worse side in which a wrist lies within 11.5 cm of the line from hips
  to chest.
- fingers: percentage of time that some finger joint turns faster than 5 degrees a second; undefined without fingers.

Good: near a speaker's own (16 and 9 degrees for the head, 9 and 4 for the chest, 1 % or less in the torso).

What fools them: a trunk that sways at random has a spread, so it says nothing of nods that go with the voice. A motion
played backwards has all of them to the digit, and arms that mirror each other have the same trunk. A body that stands
apart from its hands at all times is never in its torso: a frozen pose passes that.

    >>> longest(np.array([True] * 30 + [False] + [True] * 60))
    1.0
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from data_module.motion import rotation
from data_module.motion.phases import runs
from data_module.types import Array
from eval.metrics.eye.body import HZ, SIDES, CommonBody

STILL = 0.02
"""m/s: what is slower stands still."""
SMOOTHING = 3.0
"""Frames at 60 Hz: the standard deviation of the Gaussian before speeds are taken (50 ms)."""
_HAND_RADIUS = 0.115
"""Metres from the trunk's line: half a chest's depth."""
_FINGER_MOVES = 5.0
"""Degrees a second."""


def spread(turns: Array) -> float:
    """Degrees: root mean square of rotations [T, 4] about their mean."""
    away = rotation.to_exponential_map(rotation.multiply(rotation.conjugate(rotation.mean(turns)), turns))
    return float(np.degrees(np.sqrt((away ** 2).sum(axis=-1).mean())))


def smoothed_speed(places: Array, smoothing: float = SMOOTHING) -> Array:
    """[T, ...] m/s of places [T, ..., 3] after a Gaussian of so many frames, by central differences."""
    # The places are smoothed, not the speed: a mean of speeds of noise stays above zero at rest.
    velocity = np.gradient(gaussian_filter1d(places, smoothing, axis=0), 1.0 / HZ, axis=0)
    return np.asarray(np.linalg.norm(velocity, axis=-1))


def longest(mask: NDArray[np.bool_]) -> float:
    """Seconds of the longest run of True, [T] at 60 Hz."""
    return max((stop - begin for begin, stop in runs(mask)), default=0) / HZ


def off_line(points: Array, start: Array, way: Array) -> Array:
    """[T] metres between points [T, 3] and the line from start [T, 3] along way [T, 3]."""
    # The nearest point of the segment, not of the endless line: a hand over the head is not in the torso.
    share = np.clip(((points - start) * way).sum(-1) / np.maximum((way * way).sum(-1), 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * way, axis=-1))


def figures(body: CommonBody) -> dict[str, float]:
    """Every figure of this chapter."""
    chest = body.points["Chest"]
    inside = [off_line(body.points[side + "Hand"], 0.0 * chest, chest) < _HAND_RADIUS for side in SIDES]
    out = {
        "eye_head": spread(rotation.multiply(rotation.conjugate(body.chest), body.head)),
        "eye_chest": spread(body.chest),
        "eye_hand_in_torso": max(100.0 * float(frames.mean()) for frames in inside),
    }
    if body.finger_speed is not None:
        out["eye_fingers"] = 100.0 * float((body.finger_speed > _FINGER_MOVES).mean())
    return out
