"""Parts together: does the body move as one, and does activity rise and fall?

Theory: head, trunk and hands of a speaker share their effort, and the effort comes in phrases. With the hands' speed
v (smoothed by 42 ms, m/s), the turning speed of a rotation in degrees a second, and places over the hips:

- head with hands: correlation of the turning speed of the head on the chest with the mean speed of the hands; no unit.
- head travel, chest travel: mean speed of their places, cm/s.
- fast velocity: percentage of the power of the wrists' velocity about the chest between 3 and 6 Hz (Welch).

And for `units` and `rest`, variation over 4 s: coefficient of variation of the mean hand speed of windows of 4 s.

Good: real speakers have .25 to .54, 6.9 to 9.6 and 4.5 to 5.0 cm/s, .7 to 12 %; a variation of .31 to .40.

What fools them: the head's correlation is near that of any two parts that move in speech and stop in pauses. Jitter
raises travel and the power between 3 and 6 Hz together. A motion played backwards, or mirrored, has all of them.

    >>> variation(np.repeat([1.0, 3.0], 3 * 240), np.ones(6 * 240, bool))
    0.5
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import welch

from data_module.motion import rotation
from data_module.types import Array
from eval.metrics.eye.body import HZ, SIDES, CommonBody
from eval.metrics.eye.hands import correlation
from eval.metrics.eye.trunk import smoothed_speed

SMOOTHING = 2.5
"""Frames at 60 Hz: the standard deviation of the Gaussian before a speed is taken (42 ms)."""
_TURN_SMOOTHING = 2.0
"""Frames: that of a turning speed (33 ms)."""
_BAND, _BAND_SMOOTHING = (3.0, 6.0), 2.4
"""Hertz of the band, and frames of the Gaussian before it (40 ms), which takes measurement noise away."""
WINDOW = 4.0
"""Seconds over which activity is averaged."""


def hand_speeds(body: CommonBody) -> Array:
    """[T, 2] m/s of both wrists over the hips, the right first, smoothed."""
    return smoothed_speed(body.hands, SMOOTHING)


def turning(turns: Array) -> Array:
    """[T - 1] degrees a second of rotations [T, 4], smoothed."""
    return np.asarray(gaussian_filter1d(np.degrees(rotation.angle_between(turns[:-1], turns[1:])) * HZ,
                                        _TURN_SMOOTHING))


def travel(places: Array) -> float:
    """Mean speed of places [T, 3], cm/s."""
    # Noise alone would travel: 1 mm of white noise at 60 Hz is 14 cm/s.
    smooth = gaussian_filter1d(places, SMOOTHING, axis=0)
    return 100.0 * float(np.linalg.norm(np.diff(smooth, axis=0), axis=1).mean()) * HZ


def variation(speed: Array, counts: NDArray[np.bool_]) -> float:
    """Coefficient of variation of the mean speed [T] of windows of 4 s, over the frames that count [T]; windows of
    which less than half counts are left out. NaN with fewer than three windows."""
    size = round(WINDOW * HZ)
    whole = len(speed) // size
    windows = zip(speed[:whole * size].reshape(whole, size), counts[:whole * size].reshape(whole, size), strict=True)
    means = np.array([values[mask].mean() for values, mask in windows if mask.sum() >= size // 2])
    return float(means.std() / means.mean()) if len(means) > 2 and means.mean() > 1e-9 else math.nan


def fast_share(body: CommonBody) -> float:
    """Percentage of the power of the wrists' velocity about the chest that lies between 3 and 6 Hz."""
    about = np.concatenate([body.points[side + "Hand"] - body.points["Chest"] for side in SIDES], axis=1)
    velocity = np.gradient(gaussian_filter1d(about, _BAND_SMOOTHING, axis=0), 1.0 / HZ, axis=0)
    # Windows of 256 frames: 4.3 s, which tell apart a quarter of a hertz; shorter clips are one window.
    frequencies, power = welch(velocity, HZ, nperseg=min(256, len(about)), axis=0)
    total = float(power.sum())
    # A frozen pose has no power, and no share of it.
    if total < 1e-12:
        return math.nan
    return 100.0 * float(power[(frequencies >= _BAND[0]) & (frequencies < _BAND[1])].sum()) / total


def figures(body: CommonBody) -> dict[str, float]:
    """Every figure of this chapter."""
    speed = hand_speeds(body).mean(axis=1)
    head = rotation.multiply(rotation.conjugate(body.chest), body.head)
    return {"eye_head_with_hands": correlation(np.stack([turning(head), speed[1:]], axis=1)),
            "eye_head_travel": travel(body.points["Head"]), "eye_chest_travel": travel(body.points["Chest"]),
            "eye_fast": fast_share(body)}
