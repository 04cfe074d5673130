"""How smooth is motion: jerk and acceleration of hands and joints, and are speeds as often high as a speaker's?

Theory: acceleration is the second and jerk the third derivative of a joint's place, in m/s^2 and m/s^3; each figure is
the mean length of that vector over frames and both hands. Differences of neighbouring frames stand for derivatives,
divided by dt^n, so that the unit is right at every frame rate. The distance between histograms of speed is that of the
GENEA challenges (Hellinger): with p and q the shares of frames in each bin,

    H(p, q) = sqrt(1 - sum_i sqrt(p_i q_i)),

0 for one distribution and 1 for two that share no bin. Theirs are of speed per joint, averaged over joints; here of the
hands alone, which gesture, in m/s, in bins of 0.05 m/s with all that is faster in the last.

Good: near the speaker's own jerk and acceleration, neither above nor below, and a distance near 0. What fools them:
- None hears the speech: another clip's motion has the same values, and motion played backwards has them to the digit.
- Differences amplify noise by fps^n. On one real take (BEAT) the hands' jerk is 50 m/s^3 at 15 fps and 71 at 30; with
  2 cm of jitter it is 480 and 3900. Compare at one frame rate.
- Less jerk is not better: the mean pose, held, has none.
- A histogram of few frames is far from another of the same source: about sqrt(bins in use / (8 frames)) if frames were
  independent, and neighbours are alike, so it is more. Read it above the distance of two halves of the real clips.

    >>> hellinger(np.array([1.0, 0.0]), np.array([0.0, 3.0])), hellinger(np.array([1.0, 1.0]), np.array([5.0, 5.0]))
    (1.0, 0.0)
"""

import math

import numpy as np

from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import facing
from data_module.types import Array, Motion

__all__ = ["hand_figures"]

HANDS = ("RightHand", "LeftHand")
BIN = 0.05
"""m/s: width of a bin of speeds."""
BINS = 60
"""The last of them holds all from 2.95 m/s up."""


def derivative(positions: Array, fps: float, order: int) -> Array:
    """[T - order, J] lengths of the `order`-th derivative of positions [T, J, 3], in m/s^order."""
    if len(positions) <= order:
        return np.zeros((0, positions.shape[1]))
    # Plain differences, so that the figure is that of the frames and of no filter's.
    lengths: Array = np.linalg.norm(np.diff(positions, n=order, axis=0), axis=-1) * fps ** order
    return lengths


def hand_figures(motion: Motion) -> dict[str, float]:
    """Mean speed, acceleration and jerk of both wrists; NaN where there are too few frames (order n takes n + 1)."""
    places = _hands(motion)
    every = {f"{name}_hands": derivative(places, motion.fps, order)
             for order, name in enumerate(("speed", "acceleration", "jerk"), 1)}
    return {name: float(values.mean()) if values.size else math.nan for name, values in every.items()}


def hand_speeds(motion: Motion) -> Array:
    """[T - 1, 2] m/s of both hands, seen from the facing hips."""
    return derivative(_hands(motion), motion.fps, 1)


def _hands(motion: Motion) -> Array:
    """[T, 2, 3] the wrists of a motion, seen from its own facing hips."""
    return positions_of(facing(motion))[:, [motion.skeleton.index(name) for name in HANDS]]


def speed_histogram(speeds: Array) -> Array:
    """[BINS] how many of the speeds (m/s, any shape) lie in each bin."""
    # A speed on the edge of a bin is in the upper one, also where the division is a hair too small.
    bins = np.minimum((speeds.ravel() / BIN + 1e-9).astype(int), BINS - 1)
    return np.bincount(bins, minlength=BINS).astype(np.float64)


def hellinger(first: Array, second: Array) -> float:
    """Hellinger distance between two histograms of counts or shares [n]; NaN where either is empty."""
    if first.sum() <= 0 or second.sum() <= 0:
        return math.nan
    # As the distance of roots, so that equal histograms are at 0 and not at the root of a rounding error.
    return float(np.linalg.norm(np.sqrt(first / first.sum()) - np.sqrt(second / second.sum())) / np.sqrt(2.0))
