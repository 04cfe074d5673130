"""How a body stands: knees, weight, hips and feet, in the spans of a motion in which both feet stay where they are.

A span lasts 4 s or more; in it both ankles are slower than 8 cm/s and both hips are not lower than nine tenths of the
leg's length over them, so steps, walks and stools do not count. Places of the motion's own joints are measured, Y up;
sideways is the mean direction of the line through both hip sockets, and lengths are those of a leg of 82.5 cm. Several
spans give their mean, weighted by duration. A knee's bend is the angle between thigh and shin: a skeleton whose bones
are not straight at rest has some degrees of it always.

"Quick" is what remains of a path smoothed over 0.1 s after its mean over 1 s is taken off (about 0.2 to 2 Hz).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks, welch

from data_module.motion import kinematics
from data_module.motion.skeletons import find_table
from data_module.types import Array, Motion
from eval.stats import runs
from eval.table import Column

__all__ = ["FIGURES", "PEOPLE", "StandingSpan", "bands", "figures", "knee_bend", "outside", "spans_of"]

SHORTEST = 4.0
"""Seconds of a span at least."""
_STANDS, _UPRIGHT = 0.08, 0.9
"""m/s of an ankle that stands, and least height of a hip over its ankle in leg lengths."""
_LEG = 0.825
"""Metres from hip to ankle to which lengths are scaled."""
_SHIFT, _STAYS, _SLOW = 0.02, 2.0, 0.4
"""A weight shift: metres that the hips go sideways, seconds that they then stay within as much, and seconds of
smoothing."""
_FAST, _BEFORE, _AFTER = 1.0, (0.6, 0.2), (0.15, 0.5)
"""Strokes: m/s of a hand over the hips at least, and seconds before and after the peak whose heights are compared."""
_FREQUENCIES = (0.08, 3.0)
"""Hertz between which the frequency of sway is looked for."""

FIGURES: Mapping[str, Column] = {
    "straight": Column("straighter knee", "degrees", 1), "bent": Column("other knee", "degrees", 1),
    "knees": Column("knee movement, sd", "degrees", 1), "sinks": Column("hips up and down, quick, sd", "mm", 1),
    "strokes": Column("hips sink after fast strokes", "mm", 1), "speed": Column("hips' speed, median", "cm/s", 1),
    "sway": Column("sway sideways, sd", "cm", 1), "rate": Column("its mean frequency", "Hz", 2),
    "drop": Column("pelvis lower over the bent knee", "degrees", 1),
    "over": Column("hips towards the straighter leg", "cm", 1), "shifts": Column("weight shifts", "a minute", 1),
    "turns": Column("hips with shoulders, yaw", "r", 2), "turned": Column("the same, gain", "", 2),
    "aside": Column("hips with quick leans sideways", "r", 2), "ahead": Column("hips with quick leans ahead", "r", 2),
    "width": Column("ankles apart", "cm", 1), "stagger": Column("one ahead of the other", "cm", 1),
    "toes": Column("toes outwards", "degrees", 1),
}
PEOPLE: Mapping[str, tuple[float, float]] = {
    "straight": (1.3, 14.7), "bent": (16.6, 24.1), "knees": (0.5, 4.0), "sinks": (0.13, 2.64),
    "strokes": (-3.6, 3.0), "speed": (0.45, 3.63), "sway": (0.12, 1.74), "rate": (0.15, 0.42),
    "drop": (0.9, 5.1), "over": (-0.8, 3.4), "shifts": (1.5, 6.5), "turns": (0.18, 0.99), "turned": (0.06, 0.88),
    "aside": (-0.58, 0.60), "ahead": (-0.69, 0.50), "width": (16.8, 25.2), "stagger": (0.2, 6.4), "toes": (14.0, 15.9),
}
"""The band of each figure (see `bands`) over 11 minutes in which eight people stand, talk, listen and wait: two of
Microsoft Rocketbox (five sixths of the time, and alone in telling toes), five of CMU and one of SmartBody's PNGestures.
`probe stance --people` measures it."""


@dataclass(frozen=True)
class StandingSpan:
    """Places in a span. fps: frames a second; places: joint name -> [T, 3] metres of a leg of 82.5 cm."""

    fps: float
    places: Mapping[str, Array]

    @property
    def seconds(self) -> float:
        return len(self.places["Hips"]) / self.fps

    def figures(self) -> dict[str, float]:
        """Every one of `FIGURES`; NaN where there is nothing to measure. "shifts" is their number."""
        return {**self._legs(), **self._hips(), **self._coupling(), **self._feet()}

    def _legs(self) -> dict[str, float]:
        left, right = (knee_bend(*(self.places[side + part] for part in ("UpLeg", "Leg", "Foot")))
                       for side in ("Left", "Right"))
        bearing = math.copysign(1.0, right.mean() - left.mean())
        line = self.places["LeftUpLeg"] - self.places["RightUpLeg"]
        roll = np.degrees(np.arcsin(line[:, 1] / np.linalg.norm(line, axis=-1)))
        return {"straight": float(np.minimum(left, right).mean()), "bent": float(np.maximum(left, right).mean()),
                "knees": float((_detrended(left, self.fps).std() + _detrended(right, self.fps).std()) / 2.0),
                "drop": bearing * float(roll.mean()), "over": bearing * 100.0 * float(self._across.mean())}

    def _hips(self) -> dict[str, float]:
        hips = self.places["Hips"]
        speed = np.linalg.norm(np.diff(hips, axis=0), axis=-1) * self.fps
        at, power = welch(self._across, self.fps, nperseg=min(len(hips), round(10.0 * self.fps)))
        power = power * ((at > _FREQUENCIES[0]) & (at < _FREQUENCIES[1]))
        return {"sinks": 1000.0 * float(self._quick(hips[:, 1]).std()), "strokes": self._sinking(),
                "speed": 100.0 * float(np.median(speed)),
                "sway": 100.0 * float(_detrended(self._across, self.fps).std()),
                "rate": float(at @ power / power.sum()) if power.sum() > 1e-12 else math.nan,
                "shifts": float(self._shifts())}

    def _coupling(self) -> dict[str, float]:
        shoulders, sockets = (self.places["Left" + part] - self.places["Right" + part] for part in ("Arm", "UpLeg"))
        yaws = [np.degrees(np.unwrap(np.arctan2(line @ self._forward, line @ self._sideways)))
                for line in (shoulders, sockets)]
        chest = (self.places["LeftArm"] + self.places["RightArm"]) / 2.0 - self.places["Hips"]
        hips = self.places["Hips"] - self._middle
        return {"turns": _correlation(*yaws), "turned": _gain(*yaws),
                "aside": _correlation(*(self._quick(path @ self._sideways) for path in (chest, hips))),
                "ahead": _correlation(*(self._quick(path @ self._forward) for path in (chest, hips)))}

    def _feet(self) -> dict[str, float]:
        way = (self.places["LeftFoot"] - self.places["RightFoot"]).mean(axis=0)
        toes = [sign * math.degrees(math.atan2(foot @ self._sideways, foot @ self._forward))
                for side, sign in (("Left", 1.0), ("Right", -1.0)) if side + "ToeBase" in self.places
                for foot in [(self.places[side + "ToeBase"] - self.places[side + "Foot"]).mean(axis=0)]]
        return {"width": 100.0 * abs(float(way @ self._sideways)), "stagger": 100.0 * abs(float(way @ self._forward)),
                "toes": float(np.mean(toes)) if toes else math.nan}

    @property
    def _sideways(self) -> Array:
        """[3] to the character's left."""
        line = (self.places["LeftUpLeg"] - self.places["RightUpLeg"]).mean(axis=0) * [1.0, 0.0, 1.0]
        return np.asarray(line / np.linalg.norm(line))

    @property
    def _forward(self) -> Array:
        return np.cross(self._sideways, [0.0, 1.0, 0.0])

    @property
    def _middle(self) -> Array:
        """[T, 3] between the ankles."""
        return np.asarray((self.places["LeftFoot"] + self.places["RightFoot"]) / 2.0)

    @property
    def _across(self) -> Array:
        """[T] metres of the hips to the left of the middle."""
        return np.asarray((self.places["Hips"] - self._middle) @ self._sideways)

    def _quick(self, path: Array) -> Array:
        return _smooth(path, 0.1, self.fps) - _smooth(path, 1.0, self.fps)

    def _shifts(self) -> int:
        """How often the hips come to stay elsewhere."""
        path, length = _smooth(self._across, _SLOW, self.fps), round(_STAYS * self.fps)
        found, place = 0, float(np.median(path[:length]))
        for start in range(0, len(path) - length + 1, max(1, round(0.1 * self.fps))):
            window = path[start:start + length]
            if np.ptp(window) < _SHIFT and abs(float(np.median(window)) - place) > _SHIFT:
                found, place = found + 1, float(np.median(window))
        return found

    def _sinking(self) -> float:
        """Millimetres by which the hips are lower after fast strokes than before, the median; NaN without any."""
        height = _smooth(1000.0 * self.places["Hips"][:, 1], 0.05, self.fps)
        sunk = []
        for side in ("Left", "Right"):
            hand = _smooth(self.places[side + "Hand"] - self.places["Hips"], 0.05, self.fps)
            speed = np.linalg.norm(np.gradient(hand, axis=0), axis=-1) * self.fps
            for peak in find_peaks(speed, height=_FAST, distance=max(1, round(0.3 * self.fps)))[0]:
                early, late, after, end = (peak + round(seconds * self.fps)
                                           for seconds in (-_BEFORE[0], -_BEFORE[1], *_AFTER))
                if early >= 0 and end <= len(height):
                    sunk.append(height[early:late].mean() - height[after:end].mean())
        return float(np.median(sunk)) if sunk else math.nan


def spans_of(motion: Motion) -> list[StandingSpan]:
    """The spans in which a motion with legs stands, each at least `SHORTEST` long."""
    positions = kinematics.positions_of(motion)
    places = {name: positions[:, joint] for name, joint in find_table(motion.skeleton.names).items()}
    thigh, shin = (np.linalg.norm(places["Left" + one][0] - places["Left" + other][0])
                   for one, other in (("UpLeg", "Leg"), ("Leg", "Foot")))
    places = {name: path * (_LEG / (thigh + shin)) for name, path in places.items()}
    stands = np.ones(len(motion), bool)
    for side in ("Left", "Right"):
        ankle = places[side + "Foot"]
        speed = np.linalg.norm(np.gradient(_smooth(ankle, 0.1, motion.fps), axis=0), axis=-1) * motion.fps
        stands &= (speed < _STANDS) & ((places[side + "UpLeg"] - ankle)[:, 1] > _UPRIGHT * _LEG)
    return [StandingSpan(motion.fps, {name: path[a:b] for name, path in places.items()})
            for a, b in runs(stands) if b - a >= SHORTEST * motion.fps]


def figures(spans: Sequence[StandingSpan]) -> dict[str, float]:
    """The figures of spans together; NaN for what none of them has. Shifts are a minute in which one could be seen."""
    values = [span.figures() for span in spans]
    out = {key: _weighted([value[key] for value in values], [span.seconds for span in spans]) for key in FIGURES}
    seen = sum(span.seconds - 2.0 * _STAYS for span in spans) + 1e-9
    out["shifts"] = 60.0 * sum(value["shifts"] for value in values) / seen if spans else math.nan
    return out


def bands(people: Mapping[str, Sequence[StandingSpan]]) -> dict[str, tuple[float, float]]:
    """The 10th and 90th percentile of each figure over the spans of people, weighted by duration; of shifts, which a
    span is too short for, the lowest and the highest rate of a person with half a minute of spans."""
    spans = [span for of_one in people.values() for span in of_one]
    values = [span.figures() for span in spans]
    out = {key: _percentiles([value[key] for value in values], [span.seconds for span in spans]) for key in FIGURES}
    rates = [figures(of_one)["shifts"] for of_one in people.values() if sum(span.seconds for span in of_one) >= 30.0]
    out["shifts"] = (min(rates), max(rates)) if rates else (math.nan, math.nan)
    return out


def outside(key: str, value: float) -> bool:
    """Whether a figure lies outside the band of people; what is undefined does not."""
    low, high = PEOPLE[key]
    return value < low or value > high


def knee_bend(hip: Array, knee: Array, ankle: Array) -> Array:
    """[T] degrees by which a knee is bent, from the places [T, 3] of its leg's joints."""
    thigh, shin = knee - hip, ankle - knee
    cosine = np.sum(thigh * shin, -1) / (np.linalg.norm(thigh, axis=-1) * np.linalg.norm(shin, axis=-1))
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _smooth(path: Array, seconds: float, fps: float) -> Array:
    return np.asarray(gaussian_filter1d(path, seconds * fps, axis=0, mode="nearest"))


def _detrended(path: Array, fps: float) -> Array:
    return path - _smooth(path, 2.0, fps)


def _gain(of: Array, to: Array) -> float:
    """Slope of the regression of `to` on `of`; NaN where that does not move."""
    of = of - of.mean()
    return float(of @ to / (of @ of)) if of @ of > 1e-12 else math.nan


def _correlation(a: Array, b: Array) -> float:
    """Pearson's r; 0 where one of them does not move: nothing follows then."""
    a, b = a - a.mean(), b - b.mean()
    norm = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / norm if norm > 1e-12 else 0.0


def _weighted(values: Iterable[float], weights: Iterable[float]) -> float:
    known = [(value, weight) for value, weight in zip(values, weights, strict=True) if not math.isnan(value)]
    return sum(value * weight for value, weight in known) / sum(weight for _, weight in known) if known else math.nan


def _percentiles(values: Sequence[float], weights: Sequence[float]) -> tuple[float, float]:
    """The weighted 10th and 90th percentile of what is defined."""
    known = [(value, weight) for value, weight in zip(values, weights, strict=True) if not math.isnan(value)]
    if not known:
        return math.nan, math.nan
    ordered, of = (np.array(column) for column in zip(*sorted(known), strict=True))
    low, high = np.interp([0.1, 0.9], (np.cumsum(of) - of / 2.0) / of.sum(), ordered)
    return float(low), float(high)
