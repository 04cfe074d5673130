"""What a corpus of gestures must be like, as bounds: of its talks, its seams and stillness, and its styles.

Theory: a figure for the eye (`eval.metrics.eye`) is one value of a talk. Pooled over the talks of parts A and B it is
their mean, each talk counted by its seconds, or for a rule that holds "everywhere" (seams, freezes) the worst talk.
A bound holds where the pooled value lies in it; a value is never rounded first. Style is judged on part C alone.

- seams: acceleration of the hands within 2 frames of a place where the motion was put together, over that elsewhere. Of
  part A that is where two stretches of real motion were joined; of the others where a stroke begins and where its hold
  ends, and "elsewhere" is the rest of the strokes, as those are movements between which the hands hold still.
- freeze: seconds for which both hands and the head stay under 2 cm/s, frames of marked rest left out.

What fools it: a mean hides talks that lie far out, so the least and the most of all talks stand beside it. A and B may
miss a bound on opposite sides and pool to the middle; so each part is printed, and marked where it misses by itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.store import Recording
from data_module.truth import JOIN, REST, Truth
from eval import stats
from eval.metrics import EYE_METRICS, eye
from eval.metrics.eye import trunk
from eval.metrics.eye.body import HZ, CommonBody
from eval.stats import Interval

POOLED = ("motion", "talk")
"""The parts whose talks are judged together: A and B."""
MEAN, WORST = "mean", "worst"
SEAM, FREEZE = "seam", "freeze"
_FEWEST_SEAMS = 3
_BESIDE = range(-2, 2)
"""Second differences that touch the two frames on either side of a seam."""


@dataclass(frozen=True)
class Bound:
    """A figure of talks with its bounds (either may be infinite). how: `MEAN` of the talks, or `WORST`, their most."""

    figure: str
    low: float
    high: float
    how: str = MEAN

    @property
    def title(self) -> str:
        """What it is, with its unit."""
        own = {SEAM: "acceleration at seams over elsewhere, worst talk",
               FREEZE: "longest freeze outside marked rest, worst talk, s"}
        return own[self.figure] if self.figure in own else EYE_METRICS[self.figure].heading

    @property
    def digits(self) -> int:
        """As many are shown."""
        return EYE_METRICS[self.figure].digits if self.figure in EYE_METRICS else 2

    def holds(self, value: float) -> bool | None:
        """None where nothing is known."""
        return self.low <= value <= self.high if math.isfinite(value) else None


BOUNDS: tuple[Bound, ...] = (
    Bound("eye_hand_height_correlation", 0.25, 0.55), Bound("eye_one_handed", 25.0, 37.0),
    Bound("eye_one_hanging", 20.0, 32.0), Bound("eye_head", 11.0, 16.0), Bound("eye_chest", 4.0, 9.0),
    Bound("eye_stroke_amplitude", 24.0, math.inf), Bound("eye_above_1", 25.0, 45.0), Bound("eye_above_2", 25.0, 45.0),
    Bound("eye_loudness", 0.1, 0.35), Bound(SEAM, -math.inf, 1.35, WORST), Bound("eye_hand_in_torso", -math.inf, 1.0),
    Bound("eye_elbow_in_torso", -math.inf, 1.0), Bound("eye_head_yaw", -math.inf, 25.0),
    Bound(FREEZE, -math.inf, 1.0, WORST))
STYLE_BOUNDS: dict[str, float] = {"amplitude": 0.6, "tempo": 0.3, "log hand speed": 0.4}
"""R2 from 8 s of sound alone, at least (`eval.style_from_sound`)."""


@dataclass(frozen=True)
class MeasuredTalk:
    """A recording's figures: those of `eye`, and `SEAM` and `FREEZE`; NaN where undefined. seconds: its length."""

    name: str
    part: str
    seconds: float
    figures: Mapping[str, float]


@dataclass(frozen=True)
class BoundVerdict:
    """A bound and what was found: pooled, and of each part; least, most: of the pooled talks."""

    bound: Bound
    value: Interval
    parts: Mapping[str, Interval]
    least: float
    most: float

    @property
    def holds(self) -> bool | None:
        """None where nothing is known."""
        return self.bound.holds(self.value.mean)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"name": self.bound.title, "figure": self.bound.figure, "value": self.value.mean, "low": self.bound.low,
                "high": self.bound.high, "holds": self.holds, "interval": [self.value.low, self.value.high],
                "talks": [self.least, self.most], "parts": {name: own.mean for name, own in self.parts.items()}}


def measure(recording: Recording, body: CommonBody) -> MeasuredTalk:
    """Every figure of a recording with its own voice."""
    truth = recording.truth or Truth()
    found = eye.of_body(body, eye.hear(recording.speech))
    found[SEAM] = seam(body, truth)
    found[FREEZE] = freeze(body, [(mark.start, mark.end) for mark in truth.marks if mark.what == REST])
    return MeasuredTalk(recording.info.name, recording.info.part, body.duration, found)


def seam(body: CommonBody, truth: Truth) -> float:
    """Acceleration where the motion was put together over that elsewhere in it; NaN for fewer than three places."""
    times = [mark.start for mark in truth.marks if mark.what == JOIN]
    times += [time for stroke in truth.strokes for time in (stroke.start, stroke.hold_end)]
    change = np.linalg.norm(np.diff(body.hands, 2, axis=0), axis=-1).max(axis=1)
    at = np.unique(np.round(np.array(times) * HZ).astype(int))
    at = at[(at > 2) & (at < len(change) - 3)]
    moving, near = np.full(len(change), not truth.strokes), np.zeros(len(change), dtype=bool)
    for stroke in truth.strokes:
        moving[round(stroke.start * HZ):round(stroke.end * HZ)] = True
    for step in _BESIDE:
        near[at + step] = True
    elsewhere = change[moving & ~near]
    if len(at) < _FEWEST_SEAMS or not len(elsewhere) or elsewhere.mean() * HZ ** 2 <= 1e-9:
        return math.nan
    return float(change[near].mean() / elsewhere.mean())


def freeze(body: CommonBody, rests: Sequence[tuple[float, float]]) -> float:
    """Seconds of the longest stretch outside `rests` in which both hands and the head stand still."""
    points = np.concatenate([body.hands, body.points["Head"][:, None]], axis=1)
    still: NDArray[np.bool_] = np.asarray((trunk.smoothed_speed(points) < trunk.STILL).all(axis=1))
    for start, end in rests:
        still[round(start * HZ):round(end * HZ)] = False
    return trunk.longest(still)


def judge(talks: Sequence[MeasuredTalk], bounds: Sequence[Bound] = BOUNDS) -> list[BoundVerdict]:
    """Every bound over the talks of `POOLED`, and of every part that is there."""
    pooled = [talk for talk in talks if talk.part in POOLED]
    parts = {name: [talk for talk in talks if talk.part == name] for name in dict.fromkeys(t.part for t in talks)}
    out = []
    for bound in bounds:
        values = np.array([talk.figures[bound.figure] for talk in pooled])
        values = values[np.isfinite(values)]
        out.append(BoundVerdict(bound, _of(bound, pooled), {name: _of(bound, own) for name, own in parts.items()},
                           float(values.min(initial=math.inf)), float(values.max(initial=-math.inf))))
    return out


def _of(bound: Bound, talks: Sequence[MeasuredTalk]) -> Interval:
    """A figure of talks as its bound wants it."""
    values = np.array([talk.figures[bound.figure] for talk in talks], dtype=np.float64)
    if bound.how == MEAN:
        return stats.mean_interval(values, [talk.seconds for talk in talks])
    known = values[np.isfinite(values)]
    return Interval.exact(float(known.max()), len(known)) if len(known) else Interval.undefined()
