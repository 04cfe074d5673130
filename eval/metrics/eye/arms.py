"""Arms as people's: does an arm jump or flip, does it freeze in running speech, is the trunk alive?

Theory: of wrist and elbow seen from the shoulder, smoothed by 33 ms, acceleration and jerk; of the elbow the swivel,
its turn about the line from shoulder to wrist (only where it is 8 cm off that line, and the wrist 20 cm from the
shoulder), a second and as an arc in .2 s. Each has a limit that real people exceed in one frame of a thousand.

- jumps: events beyond a limit a minute, of both arms, where frames within .2 s are one event; flips: those by swivel or
  arc; strong jumps: beyond 1.5 times a limit. folded: percentage of the time that an elbow is bent by over 145 degrees.
- frozen arms: stretches of .6 s in which no hand or elbow reaches 5 cm/s, a minute of speech.
- lean, tilt: spread over 8 s of the chest's sideways lean and of the slope of the shoulders. still neck: percentage of
  the time in which its base is under 1 cm/s.
- left behind: of the time in which a hand exceeds .6 m/s, the percentage in which the other is raised and under .15.
- prepared, retracted: percentage of strokes before which the hand prepares for .2 s, and of units that end with a
  retraction (`data_module.motion.phases`).
- of several recordings, how far apart hands begin (`first_spread`), and whether trunks lean alike at the same second
  (`alike`), as they do where chance is keyed by time and not by what is heard.

Good (two people, two minutes and one): 4.8 and 3.8 jumps, 1.4 and 2.8 flips, 1.0 and 0 strong; none frozen or folded;
lean 1.8 and 3.3, tilt 3.8 and 5.1 degrees, 3 % still; 7 and 1 % left behind, 38 and 42 % prepared, 28 and 20 %
retracted; first places 24 cm apart; twelve clips of one person lean alike by -.02.

What fools them: slow or smoothed motion has few jumps; noise has many, and no frozen arm. Played backwards a motion
keeps most of them; with the left arm of another take it keeps all but left behind.

    >>> frozen_pose = np.ones((3, 2, 3))
    >>> first_spread(list(frozen_pose))
    0.0
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from data_module.motion.phases import Phase, phases_of, runs
from data_module.types import Array
from eval.metrics.eye.body import HZ, SIDES, CommonBody, bend
from eval.metrics.eye.hands import HANGS
from eval.metrics.eye.trunk import smoothed_speed
from gesticulator.sampling.candidates import swivel

LIMITS = {"wrist": (23.5, 469.0), "elbow": (12.5, 238.0)}
SWIVEL, ARC = 257.0, 0.111
"""m/s^2 and m/s^3, degrees a second, metres in .2 s: 99.9th percentiles of 3.9 minutes of three people who talk (a
person of GENEA 2020, one of BEAT and a take of a headset), each by these definitions."""
_STRONG, _SMOOTHING, _APART = 1.5, 2.0, 12
_OFF_LINE, _REACHES = 0.08, 0.2
FOLDED = 145.0
_FROZEN, _FREEZE = 0.05, 0.6
_PIECE, _NECK_STILL = 8.0, 0.01
_FLINGS, _HELD = 0.6, 0.15
_PREPARES = 0.2


def excess(body: CommonBody, side: str) -> tuple[Array, Array]:
    """[T] acceleration and jerk of an arm over their limits, and [T] swivel and arc of its elbow over theirs."""
    shoulder, elbow, wrist = (gaussian_filter1d(body.points[side + part], _SMOOTHING, axis=0)
                              for part in ("Arm", "ForeArm", "Hand"))
    shares = []
    for name, place in (("wrist", wrist - shoulder), ("elbow", elbow - shoulder)):
        change = np.gradient(place, 1.0 / HZ, axis=0)
        for limit in LIMITS[name]:
            change = np.gradient(change, 1.0 / HZ, axis=0)
            shares.append(np.linalg.norm(change, axis=-1) / limit)
    turns, off = swivel(shoulder, elbow, wrist)
    angle = np.concatenate([[0.0], np.cumsum(turns)])
    speed = np.degrees(np.abs(np.gradient(gaussian_filter1d(angle, 1.0), 1.0 / HZ))) / SWIVEL
    arc, k = np.zeros(len(angle)), _APART
    arc[k // 2:len(arc) - k + k // 2] = np.abs(angle[k:] - angle[:-k]) * np.minimum(off[k:], off[:-k]) / ARC
    clear = (off > _OFF_LINE) & (np.linalg.norm(wrist - shoulder, axis=-1) > _REACHES)
    return np.max(shares, axis=0), np.maximum(speed, arc) * clear


def _jumps(body: CommonBody) -> dict[str, float]:
    count = {"eye_jumps": 0, "eye_flips": 0, "eye_strong_jumps": 0}
    for side in SIDES:
        jolts, flips = excess(body, side)
        most = np.maximum(jolts, flips)
        # Bridge what is shorter than .2 s between two frames beyond a limit.
        beyond = most > 1.0
        for a, b in runs(~beyond):
            if a > 0 and b < len(beyond) and b - a <= _APART:
                beyond[a:b] = True
        for a, b in runs(beyond):
            for name, values, limit in zip(count, (most, flips, most), (1.0, 1.0, _STRONG), strict=True):
                count[name] += int(values[a:b].max() > limit)
    return {name: number * 60.0 / body.duration for name, number in count.items()}


def leans(body: CommonBody) -> Array:
    """[T, 2] degrees by which the chest leans sideways and forward over the hips."""
    chest = body.points["Chest"]
    return np.degrees(np.arctan2(chest[:, [0, 2]], chest[:, 1:2]))


def _trunk(body: CommonBody) -> dict[str, float]:
    across = body.points["LeftArm"] - body.points["RightArm"]
    lean = leans(body)[:, 0]
    tilt = np.degrees(np.arctan2(across[:, 1], np.hypot(across[:, 0], across[:, 2])))
    size = round(_PIECE * HZ)
    # A last piece of less than half the length would have too small a spread.
    starts = range(0, max(len(lean) - size // 2, 1), size)
    still = smoothed_speed(body.points["Neck"]) < _NECK_STILL
    return {"eye_lean": float(np.mean([lean[a:a + size].std() for a in starts])),
            "eye_tilt": float(np.mean([tilt[a:a + size].std() for a in starts])),
            "eye_neck_still": 100.0 * float(still.mean())}


def _strokes(body: CommonBody) -> dict[str, float]:
    strokes = prepared = units = retracted = 0
    for hand in (0, 1):
        phases = phases_of(body.hands[:, hand], HZ)
        since = np.zeros(len(body) + 1, int)  # frames of preparation up to each frame
        for a, b in runs(phases.labels == Phase.PREPARATION):
            since[b] = b - a
        strokes += len(phases.strokes)
        prepared += sum(since[stroke.first] >= _PREPARES * HZ for stroke in phases.strokes)
        units += len(phases.units)
        retracted += sum(bool((phases.labels[a:b] == Phase.RETRACTION).any()) for a, b in phases.units)
    return {"eye_prepared": 100.0 * prepared / strokes if strokes else math.nan,
            "eye_retracted": 100.0 * retracted / units if units else math.nan}


def left_behind(body: CommonBody) -> float:
    """Percentage of fast movement of one hand in which the other is raised and still; NaN without fast movement."""
    hands = body.hands - body.points["Chest"][:, None]
    speed = smoothed_speed(hands)
    fast, slow = speed.max(axis=1) > _FLINGS, speed.min(axis=1) < _HELD
    raised = np.take_along_axis(body.hands[..., 1], speed.argmin(axis=1)[:, None], axis=1)[:, 0] > HANGS
    return 100.0 * float((slow & raised)[fast].mean()) if fast.any() else math.nan


def frozen(body: CommonBody, speech: NDArray[np.bool_]) -> float:
    """Stretches of speech [T] a minute of it in which the arms are frozen; NaN for less than a second of speech."""
    if speech.sum() < HZ:
        return math.nan
    places = np.stack([body.points[side + part] for side in SIDES for part in ("Hand", "ForeArm")], axis=1)
    still = (smoothed_speed(places[:len(speech)], _SMOOTHING).max(axis=1) < _FROZEN) & speech
    return sum(b - a > _FREEZE * HZ for a, b in runs(still)) / (float(speech.sum()) / HZ / 60.0)


def first_spread(first: Sequence[Array]) -> float:
    """Mean distance of the first places [2, 3] of a hand in any two of several motions, cm; NaN for one."""
    apart = [np.linalg.norm(one - other, axis=-1).mean() for one, other in itertools.combinations(first, 2)]
    return 100.0 * float(np.mean(apart)) if apart else math.nan


def alike(tracks: Sequence[Array]) -> float:
    """Mean correlation of the `leans` [T, 2] of any two of several motions at the same second, as far as both go; NaN
    without two that last `_PIECE` seconds together."""
    long = [track for track in tracks if len(track) >= _PIECE * HZ]
    correlations = [np.corrcoef(first[:count, axis], second[:count, axis])[0, 1]
                    for first, second in itertools.combinations(long, 2) for count in [min(len(first), len(second))]
                    for axis in (0, 1)]
    return float(np.mean(correlations)) if correlations else math.nan


def figures(body: CommonBody) -> dict[str, float]:
    """Every figure of this chapter that needs no voice."""
    bent = [bend(body.points[side + "ForeArm"] - body.points[side + "Arm"],
                 body.points[side + "Hand"] - body.points[side + "ForeArm"]) for side in SIDES]
    return {**_jumps(body), **_trunk(body), **_strokes(body), "eye_left_behind": left_behind(body),
            "eye_folded": 100.0 * float((np.array(bent) > FOLDED).mean())}
