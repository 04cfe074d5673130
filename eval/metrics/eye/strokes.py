"""Strokes: how large are the movements, are they cut at the blocks, and do they come again?

Theory: a stroke is a movement of one hand between two minima of its speed (prominent by 0.12 m/s; of the wrist seen
from the chest, smoothed over 50 ms) whose fastest moment exceeds 0.3 m/s. Its amplitude is the distance between where
it begins and ends, cm; the figures are the median and the 90th percentile.

- seams: mean acceleration of the faster-changing hand within 2 frames of the inner block edges, over that elsewhere; no
  unit. 1 is no seam; chance edges on two real takes gave 1.26 and .98.
- repetition: for each window of 2 s (10 Hz, both wrists seen from the chest, every 0.2 s) the root mean square distance
  to the nearest window that does not overlap it, over the spread of the hands; the median. No unit; two speakers .66
  and .59. Lower is more repetitive. Undefined under about 7 s, and biased up in short clips, which have had no time to
  repeat.

Good: amplitude near a speaker's own (31 and 24 cm), seams at most 1.2.

What fools them: a mirrored copy has all of them to within the difference of the two arms. A motion played backwards has
the same sizes and repetition to the digit. White jitter of 2 cm makes many short strokes of real
ones and drowns seams. A frozen pose has no stroke (undefined), no seam, and no repetition to speak of. Edges must be
those of the system's own blocks: at other edges the seam figure is 1 by chance.

A hand that goes 30 cm there and back, once in 2 s:

    >>> path = np.zeros((240, 3))
    >>> path[:, 1] = 0.15 * np.cos(np.pi * np.arange(240) / 60)
    >>> [round(float(value), 2) for value in strokes(path)[1]]
    [1.0, 0.3]
"""

import math

import numpy as np
from scipy.signal import find_peaks

from data_module.types import Array
from eval.metrics.eye.body import HZ, CommonBody
from eval.metrics.eye.hands import MOVES
from eval.metrics.eye.trunk import smoothed_speed

_PROMINENCE = 0.12
"""m/s by which a minimum of speed must stand out."""
_BESIDE = range(-2, 2)
"""Second differences that touch the two frames on either side of an edge."""
_THIN, _WINDOW, _STEP = 6, 20, 2
"""Frames per sample of repetition (10 Hz), samples in a window (2 s) and from one to the next (0.2 s)."""
_FEWEST = 25
"""Windows from which on repetition is defined."""


def strokes(path: Array) -> Array:
    """[n, 2] seconds and metres of each stroke of one wrist's path [T, 3] at 60 Hz."""
    speed = smoothed_speed(path)
    # The first and last frame count as minima: a clip may begin or end within a stroke.
    minima = np.concatenate([[0], find_peaks(-speed, prominence=_PROMINENCE)[0], [len(path) - 1]])
    pairs = [((end - start) / HZ, float(np.linalg.norm(path[end] - path[start])))
             for start, end in zip(minima[:-1], minima[1:], strict=True) if speed[start:end].max(initial=0.0) > MOVES]
    return np.array(pairs, dtype=np.float64).reshape(-1, 2)


def seam(hands: Array, edges: Array) -> float:
    """Acceleration beside the inner edges [N + 1] (seconds) over that elsewhere, of hands [T, 2, 3]; NaN where either
    has no frame, or nothing moves."""
    # The hand that changes more: a seam in one arm must not be diluted by a still one.
    change = np.linalg.norm(np.diff(hands, 2, axis=0), axis=-1).max(axis=1)
    at = np.round(np.asarray(edges)[1:-1] * HZ).astype(int)
    at = at[(at > 2) & (at < len(change) - 3)]
    near = np.zeros(len(change), dtype=bool)
    for step in _BESIDE:
        near[at + step] = True
    # A frozen pose has no acceleration to compare with: the ratio would be one of rounding errors.
    if not near.any() or near.all() or change[~near].mean() * HZ ** 2 <= 1e-9:
        return math.nan
    return float(change[near].mean() / change[~near].mean())


def repetition(hands: Array) -> float:
    """The median distance to the nearest other window over the spread, of hands [T, 2, 3]; NaN for short or still."""
    path = hands[::_THIN].reshape(len(hands[::_THIN]), -1)
    starts = np.arange(0, len(path) - _WINDOW, _STEP)
    # Of one hand on average, as the distance below is.
    spread = float(np.sqrt(path.var(axis=0).sum() / 2.0))
    if len(starts) <= _FEWEST or spread <= 1e-6:
        return math.nan
    windows = np.stack([path[start:start + _WINDOW].ravel() for start in starts])
    nearest = np.empty(len(windows))
    for k, start in enumerate(starts):
        apart = ((windows - windows[k]) ** 2).sum(axis=1)
        # Windows that overlap share frames and are near by construction.
        apart[np.abs(starts - start) < _WINDOW] = np.inf
        nearest[k] = apart.min()
    return float(np.median(np.sqrt(nearest / (2.0 * _WINDOW))) / spread)


def figures(body: CommonBody, edges: Array | None = None) -> dict[str, float]:
    """Every figure of this chapter; edges: [N + 1] of the motion's own blocks, seconds."""
    # Seen from the chest: a step or a lean of the whole body is no stroke.
    hands = body.hands - body.points["Chest"][:, None]
    lengths = np.concatenate([strokes(hands[:, k]) for k in (0, 1)])
    out = {"eye_repetition": repetition(hands)}
    if len(lengths):
        median, large = 100.0 * np.percentile(lengths[:, 1], (50, 90))
        out |= {"eye_stroke_amplitude": float(median), "eye_stroke_amplitude_90": float(large)}
    # Three inner edges at least: fewer are too few for a mean.
    if edges is not None and len(edges) > 4:
        out["eye_seam"] = seam(body.hands, np.asarray(edges))
    return out
