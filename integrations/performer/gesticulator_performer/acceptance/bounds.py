"""The bounds that a corpus of gestures must keep: of its talks, its seams and its stillness.

Theory: a figure for the eye (`eval.metrics.eye`) is one value of a talk. Pooled over the talks of parts A and B it is
their mean, each talk counted by its seconds, or for a rule that holds "everywhere" (seams, freezes) the worst talk.
A bound holds where the pooled value lies in it; a value is never rounded first. Part C and
the readings are shown, not judged.

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
from eval.acceptance.bounds import Bound, Verdict, at_least, at_most
from eval.metrics import EYE_METRICS, eye
from eval.metrics.eye import trunk
from eval.metrics.eye.body import HZ, CommonBody
from eval.stats import Interval

POOLED = ("motion", "talk")
"""The parts whose talks are judged together: A and B."""
MEAN, WORST = "mean", "worst"
SEAM, FREEZE = "seam", "freeze"
_FEWEST_SEAMS = 3
# Second differences that touch the two frames on either side of a seam.
_BESIDE = range(-2, 2)


_TITLES = {SEAM: "acceleration at seams over elsewhere, worst talk",
           FREEZE: "longest freeze outside marked rest, worst talk, s"}


@dataclass(frozen=True)
class TalkClaim:
    """A claim about talks. figure: its key in `MeasuredTalk.figures`; how: `MEAN` of the talks, or
    `WORST`, their most."""

    figure: str
    bound: Bound
    how: str = MEAN

    def judge(self, value: Interval, decided: bool = True) -> Verdict:
        """The verdict on a value, with the figure's title and unit."""
        metric = EYE_METRICS.get(self.figure)
        title = _TITLES[self.figure] if metric is None else metric.heading
        return Verdict(title, self.bound, value, 2 if metric is None else metric.digits, decided=decided)


CLAIMS: tuple[TalkClaim, ...] = (
    TalkClaim("eye_hand_height_correlation", Bound(0.25, 0.55)), TalkClaim("eye_one_handed", Bound(25.0, 37.0)),
    TalkClaim("eye_one_hanging", Bound(20.0, 32.0)), TalkClaim("eye_head", Bound(11.0, 16.0)),
    TalkClaim("eye_chest", Bound(4.0, 9.0)), TalkClaim("eye_stroke_amplitude", at_least(24.0)),
    TalkClaim(SEAM, at_most(1.35), WORST),
    TalkClaim("eye_hand_in_torso", at_most(1.0)), TalkClaim("eye_elbow_in_torso", at_most(1.0)),
    TalkClaim("eye_head_yaw", at_most(25.0)), TalkClaim(FREEZE, at_most(1.0), WORST))


@dataclass(frozen=True)
class MeasuredTalk:
    """A recording's figures: those of `eye`, and `SEAM` and `FREEZE`; NaN where undefined. seconds: its length;
    source: its performer."""

    name: str
    part: str
    seconds: float
    figures: Mapping[str, float]
    source: str = ""


@dataclass(frozen=True)
class TalksVerdict:
    """The verdict on a claim about the pooled talks, and on each part alone; least, most: of the pooled talks."""

    figure: str
    pooled: Verdict
    parts: Mapping[str, Verdict]
    least: float
    most: float

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        bound, value = self.pooled.bound, self.pooled.value
        return {"name": self.pooled.figure, "figure": self.figure, "value": value.mean, "low": bound.low,
                "high": bound.high, "holds": self.pooled.holds, "interval": [value.low, value.high],
                "talks": [self.least, self.most], "parts": {name: own.value.mean for name, own in self.parts.items()}}


def measure(recording: Recording, body: CommonBody) -> MeasuredTalk:
    """Every figure of a recording with its own voice."""
    truth = recording.truth or Truth()
    heard = eye.hear(recording.speech)
    found = eye.of_body(body, heard)
    found[SEAM] = seam(body, truth)
    found[FREEZE] = freeze(body, [(mark.start, mark.end) for mark in truth.marks if mark.what == REST])
    info = recording.info
    return MeasuredTalk(info.name, info.part, body.duration, found, info.speaker)


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


def judge(talks: Sequence[MeasuredTalk], claims: Sequence[TalkClaim] = CLAIMS) -> list[TalksVerdict]:
    """Every claim over the talks of `POOLED`, and of every part that is there."""
    pooled = [talk for talk in talks if talk.part in POOLED]
    parts = {name: [talk for talk in talks if talk.part == name] for name in dict.fromkeys(t.part for t in talks)}
    out = []
    for claim in claims:
        values = np.array([talk.figures[claim.figure] for talk in pooled])
        values = values[np.isfinite(values)]
        by_part = {name: _of(claim, own) for name, own in parts.items()}
        out.append(TalksVerdict(claim.figure, _of(claim, pooled), by_part,
                                float(values.min(initial=math.inf)), float(values.max(initial=-math.inf))))
    return out


def _of(claim: TalkClaim, talks: Sequence[MeasuredTalk]) -> Verdict:
    """The verdict on some talks; undecided where none has the figure."""
    values = np.array([talk.figures[claim.figure] for talk in talks], dtype=np.float64)
    known = values[np.isfinite(values)]
    if not len(known):
        return claim.judge(Interval.undefined(), decided=False)
    return claim.judge(stats.mean_interval(values, [talk.seconds for talk in talks]) if claim.how == MEAN else
                       Interval.exact(float(known.max()), len(known)))
