"""Two hands: do they move by themselves, how fast, and where do they end up?

Theory: a speaker's hands share a rhythm but not a path. With s_r, s_l the speeds of both wrists (m/s, seen from the
hips) and y_r, y_l their heights over the hips, frame by frame:

- correlation of hand speeds, corr(s_r, s_l), and of hand heights, corr(y_r, y_l); no unit. Mirrored arms are at 1.
- one-handed share: of the frames in which the faster hand exceeds 0.3 m/s, the percentage where the other has less than
  a third of its speed.
- one hand hanging: percentage of frames in which exactly one wrist is less than 6 cm above the hips; both hanging: in
  which both are.
- percentiles of hand speed (25, 50, 75, 95), over frames and both hands, m/s.
- drift: how far the mean wrist of the last 15 s lies from that of the first 15 s, both hands averaged, cm; defined from
  30 s on. A motion that is fed its own past may wander off.

Good: near what real speakers do. Two of them have speed correlations of .46 and .66, height .15 and .58, 36 and 20 %
one-handed, 23 and 24 % with one hand hanging.

What fools them:
- None hears the speech; a motion played backwards has them to the digit, but for the drift.
- Two hands that shake on their own are as free as two that gesture: 2 cm of jitter lowers the speed correlation to 0
  and the one-handed share with it, and it leaves heights as they were. Read the speeds' percentiles beside it.
- A correlation of one long clip weighs its slow postures most: one hand kept low through a talk is "independent".

    >>> both = np.stack([np.sin(np.arange(300) / 20)] * 2, axis=1)
    >>> round(correlation(both), 6)
    1.0
"""

import math

import numpy as np

from data_module.types import Array
from eval.metrics.eye.body import HZ, CommonBody

MOVES = 0.3
"""m/s: a hand that is faster moves."""
RESTS = 0.33
"""Of the faster hand's speed: below it the other one rests."""
HANGS = 0.06
"""Metres over the hips: a wrist that is lower hangs beside the body."""
PERCENTILES = (25, 50, 75, 95)
_DRIFT = 15.0
"""Seconds at both ends whose mean wrists are compared."""


def correlation(pair: Array) -> float:
    """Pearson's, of [T, 2]; NaN where either is constant."""
    # numpy would warn and give NaN as well, but not for a spread that is only rounding.
    if (pair.std(axis=0) <= 1e-9).any():
        return math.nan
    return float(np.asarray(np.corrcoef(pair.T))[0, 1])


def one_handed(speed: Array) -> float:
    """Percentage of movement that one hand makes alone, of speeds [T, 2] in m/s; NaN without movement."""
    # Which hand leads may change from frame to frame.
    fast, slow = speed.max(axis=1), speed.min(axis=1)
    moving = fast > MOVES
    return 100.0 * float((slow[moving] < RESTS * fast[moving]).mean()) if moving.any() else math.nan


def drift(hands: Array) -> float:
    """Centimetres between the mean wrists of both ends of hands [T, 2, 3]; NaN under 30 s."""
    frames = round(_DRIFT * HZ)
    if len(hands) < 2 * frames:
        return math.nan
    return 100.0 * float(np.linalg.norm(hands[:frames].mean(axis=0) - hands[-frames:].mean(axis=0), axis=-1).mean())


def figures(body: CommonBody) -> dict[str, float]:
    """Every figure of this chapter."""
    # Raw speeds between frames: the percentiles must see a jump.
    speed, height = body.hand_speed, body.hands[..., 1]
    hangs = height < HANGS
    percentiles = zip(PERCENTILES, np.percentile(speed, PERCENTILES).tolist(), strict=True)
    return {"eye_hand_speed_correlation": correlation(speed), "eye_hand_height_correlation": correlation(height),
            "eye_one_handed": one_handed(speed),
            "eye_one_hanging": 100.0 * float((hangs.sum(axis=1) == 1).mean()),
            "eye_both_hanging": 100.0 * float(hangs.all(axis=1).mean()),
            **{f"eye_speed_{percent}": value for percent, value in percentiles}, "eye_drift": drift(body.hands)}
