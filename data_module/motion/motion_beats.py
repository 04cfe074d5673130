"""Motion beats: the times when the acting arms decelerate hardest, or stand still.

They are detected at the original frame rate and interpolated between frames: 0.1 s, the scale of synchrony, is only two
frames at 20 fps.
"""

import numpy as np
from numpy.typing import NDArray

from data_module.motion import kinematics, skeletons
from data_module.types import Array, Motion

MODES = ("A", "B")
ACTING = ("RightHand", "RightForeArm", "LeftHand", "LeftForeArm")
"""Joints whose speeds are summed (skeleton joints: the wrist and the elbow)."""
SMOOTHING = 0.05
"""Standard deviation of the Gaussian smoothing of the velocity, seconds."""
SPACING = 0.1
"""Seconds; of two closer motion beats only the stronger one counts."""

# Least depth of a minimum, in standard deviations of its curve.
_DEPTH = 0.5
# Summed speed below which the arms stand still, m/s.
_STILL = 0.1
# Least deceleration of a beat in mode A, m/s^2, for recordings in which little moves.
_GENTLE = 0.5
# Seconds before a beat in which the arms must have moved.
_BEFORE = 0.3


def acting_speed(positions: Array, fps: float) -> Array:
    """Summed speed of joints in m/s, smoothed by `SMOOTHING`, [T], from their positions [T, n, 3] in metres."""
    from scipy.ndimage import gaussian_filter1d

    if len(positions) < 2:
        return np.zeros(len(positions))
    # Smooth the velocity, not the speed: a norm is never negative, so noise in it would not average out.
    velocity = gaussian_filter1d(np.gradient(positions, 1.0 / fps, axis=0), SMOOTHING * fps, axis=0, mode="nearest")
    return np.linalg.norm(velocity, axis=-1).sum(axis=-1)


def acting_positions(motion: Motion) -> Array:
    """Positions of `ACTING` in the character's facing frame, [T, 4, 3] metres, for any upper body."""
    faced = skeletons.facing(motion)
    table = skeletons.find_table(motion.skeleton.names)
    return kinematics.positions_of(faced)[:, [table[name] for name in ACTING]]


def motion_beats(motion: Motion, mode: str = "A") -> Array:
    """Motion beats in seconds, rising, [n].

    Mode A: the strongest decelerations, minima of d/dt of `acting_speed` deeper than half its standard deviation.
    Mode B: minima of `acting_speed` itself, as deep as half its standard deviation below their surroundings. Both
    exclude stretches in which the arms hardly move, and interpolate the beat between frames by a parabola.
    """
    return beats_of_speed(acting_speed(acting_positions(motion), motion.fps), motion.fps, mode)


def beats_of_speed(speed: Array, fps: float, mode: str = "A") -> Array:
    """`motion_beats` from a summed speed [T] in m/s, for other joints than `ACTING`."""
    from scipy.ndimage import maximum_filter1d
    from scipy.signal import find_peaks

    if len(speed) < 3:
        return np.zeros(0)
    acceleration = np.gradient(speed, 1.0 / fps)
    curve = -acceleration if mode == "A" else -speed
    spacing = max(1, round(SPACING * fps))
    depth = _DEPTH * float(np.std(curve))
    limits = {"height": max(depth, _GENTLE)} if mode == "A" else {"prominence": max(depth, _STILL / 2)}
    peaks = find_peaks(curve, distance=spacing, **limits)[0]
    # A beat ends a movement: just before it the arms must have moved.
    span = max(1, round(_BEFORE * fps))
    fastest = maximum_filter1d(speed, span + 1, origin=span // 2, mode="nearest")
    return _between_frames(curve, peaks[fastest[peaks] > _STILL]) / fps


def _between_frames(curve: Array, peaks: NDArray[np.int64]) -> Array:
    """The maximum of the parabola through each peak and its two neighbours, in frames."""
    left, middle, right = curve[peaks - 1], curve[peaks], curve[peaks + 1]
    bend = left - 2.0 * middle + right
    # The vertex of the parabola; a plateau (bend 0) has none and stays.
    shift = np.where(bend < 0, 0.5 * (left - right) / np.where(bend < 0, bend, 1.0), 0.0)
    return peaks + np.clip(shift, -0.5, 0.5)
