"""A classifier that names the gesture in a motion, trained on clips of people: the stand-in for a rater without sound.

Theory: a gesture is described as notations of sign languages describe signs (Stokoe 1960): where the hands are, where
palms and fingers point, the shape of the hand, the movement, and what head and shoulders do; here at `STEPS` moments
from the start of the stroke to the end of the hold, in the frame of the chest, on a body of one size. The hand that
takes part more comes first, so that a gesture and its mirror image look alike but for four figures that tell left from
right. A hand that hangs or rests tells nothing: its figures fade to those of one place (`_GATE`). The classes are named
by linear discriminants with half-shrunk covariances, which need few clips; each clip is learned with its mirror image
and with its moments shifted a little.

What fools it: it sees no more than these figures; it must choose one of the classes that it knows; clips of one person
are alike, so that a test on other people's clips says more about a new body; features and shrinkage were chosen by the
cross-validation on people's clips, so that this one is a little optimistic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from data_module.motion import kinematics, rotation, skeletons
from data_module.types import Array, Motion
from gesticulator.body.mirror import SIDES, mirrored_motion

STEPS = 7
"""Moments of a gesture at which it is described: four of the stroke, and on to the end of the hold."""
SHIFTS = ((0.0, 0.0, 0.0), (0.07, 0.0, 0.1), (-0.07, 0.07, -0.1), (0.0, -0.07, 0.2))
"""Seconds by which begin, apex and end of a clip are shifted for training."""
_LONGEST, _STROKE = 2.0, (0.1, 0.7)
"""Seconds of a gesture that are described at most (applause may last for 20), and of its stroke."""
_RATE = 30.0
_SHAKES = (0.8, 6.0)
"""Hertz of repeated movements."""
_AROUND = 0.3
"""Seconds before and after a gesture in which repeated movements, head and shoulders are looked at."""
_GATE = (-0.36, 0.04)
"""Metres over the shoulders at which a hand takes half part, and the width of the step."""
_RESTING = np.array([0.2, -0.4, 0.2])
"""Place of a hand that takes no part, metres from the middle of the shoulders: outwards, up, ahead."""
_HANGING = -0.45
_FARTHEST = 0.6
"""Metres from the head beyond which a hand is away from it."""
_SHRINKAGE = 0.5
_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")


@dataclass(frozen=True)
class GestureSpan:
    """When a gesture is made, seconds: start of the stroke, its end, and the end of the hold."""

    begin: float
    apex: float
    end: float

    def shifted(self, by: tuple[float, float, float]) -> GestureSpan:
        """Begin, apex and end moved by seconds."""
        return GestureSpan(self.begin + by[0], self.apex + by[1], self.end + by[2])


class GestureBody:
    """A motion in which gestures are described: on a body of one size, in the frame of its chest."""

    def __init__(self, motion: Motion) -> None:
        """motion: of any upper body, with fingers or without."""
        self._body = kinematics.resample(skeletons.to_character(motion, skeleton=skeletons.FINGERED), _RATE)
        self._frame = _ChestFrame.of(self._body)
        self._hands = [_Hand.of(self._body, self._frame, side) for side in SIDES]

    def figures(self, span: GestureSpan) -> Array:
        """[F] figures of a gesture, the same number for every gesture."""
        seconds = np.arange(len(self._body)) / _RATE
        end = min(span.end, span.begin + _LONGEST)
        middle = min(max(span.apex, span.begin + _STROKE[0]), span.begin + _STROKE[1], end)
        half = STEPS // 2 + 1
        moments = [*np.linspace(span.begin, middle, half), *np.linspace(middle, end, half)[1:]]
        steps = np.clip(np.round(np.array(moments) * _RATE).astype(int), 0, len(self._body) - 1)
        near = (seconds >= span.begin - _AROUND) & (seconds <= end + _AROUND)
        first = int(self._hands[1].share(steps) > self._hands[0].share(steps))
        moved, other = self._hands[first], self._hands[1 - first]
        return np.concatenate([moved.figures(steps, near), other.figures(steps, near), _of_both(moved, other, steps),
                               moved.sided(steps), self._frame.of_head(self._body, near)])


@dataclass(frozen=True)
class _ChestFrame:
    """place: [T, 3] middle of the shoulders; turn: [T, 4] of the chest; world, points: of all joints."""

    place: Array
    turn: Array
    world: Array
    points: Array

    @classmethod
    def of(cls, body: Motion) -> _ChestFrame:
        world = kinematics.global_rotations(body.skeleton, body.rotations)
        points = kinematics.joint_positions(body.skeleton, body.rotations)
        chest = body.skeleton.index("Spine3")
        up = rotation.rotate(world[:, chest], np.array([0.0, 0.09, 0.0]))
        return cls(points[:, chest] + up, world[:, chest], world, points)

    def along(self, directions: Array) -> Array:
        """[T, 3] directions in this frame."""
        return rotation.rotate(rotation.conjugate(self.turn), directions)

    def inside(self, points: Array) -> Array:
        """[T, 3] places in this frame."""
        return self.along(points - self.place)

    def of_head(self, body: Motion, near: NDArray[np.bool_]) -> Array:
        """Head and shoulders: range, repeated movement and mean turn about each axis, and the lift of the shoulders."""
        head = self.world[:, body.skeleton.index("Head")]
        angles = rotation.to_exponential_map(rotation.multiply(rotation.conjugate(self.turn), head))[near]
        lifts = [self.inside(self.points[:, body.skeleton.index(side + "Arm")])[near, 1] for side in SIDES]
        lift = 0.5 * (lifts[0] + lifts[1])
        return np.concatenate([np.ptp(angles, axis=0), _shaken(angles), angles.mean(axis=0) - angles[0],
                               [np.ptp(lift), float(np.percentile(lift, 80)) - lift[0]]])


@dataclass(frozen=True)
class _Hand:
    """In the frame of the chest, outwards instead of left. place: of the palm's middle, palm, fingers: directions, [T,
    3]; curls: [T, 5] radians; head: [T] metres from the head; sign: 1 for the left hand."""

    place: Array
    palm: Array
    fingers: Array
    curls: Array
    head: Array
    sign: float

    @classmethod
    def of(cls, body: Motion, frame: _ChestFrame, side: str) -> _Hand:
        joint, sign = body.skeleton.index(side + "Hand"), 1.0 if side == "Left" else -1.0
        out, turn = np.array([sign, 1.0, 1.0]), frame.world[:, joint]
        along = rotation.rotate(turn, np.array([sign, 0.0, 0.0]))
        place = frame.inside(frame.points[:, joint] + 0.08 * along)
        skull = body.skeleton.index("Head")
        head = frame.points[:, skull] + rotation.rotate(frame.world[:, skull], np.array([0.0, 0.08, 0.05]))
        palm = frame.along(rotation.rotate(turn, np.array([0.0, -1.0, 0.0])))
        return cls(place * out, palm * out, frame.along(along) * out,
                   np.stack([_curl(body, side, finger) for finger in _FINGERS], axis=1),
                   np.linalg.norm(frame.inside(head) - place, axis=1), sign)

    def share(self, steps: NDArray[np.int64]) -> float:
        """How much it takes part: how high it is held, and how far it goes. It finds the hand of all one-handed clips
        of which the hand is known."""
        place = self.place[steps]
        return float(np.maximum(place[2:, 1], _HANGING).mean() + 0.7 * np.linalg.norm(np.ptp(place, axis=0)))

    def figures(self, steps: NDArray[np.int64], near: NDArray[np.bool_]) -> Array:
        """Places, directions, shape and movement."""
        way = np.diff(self.place[steps], axis=0)
        path = self.place[steps[0]:steps[-1] + 1]
        high = max(float(path[:, 1].max()) + 0.5, 0.0)
        travel = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) + 0.3 * high
        up = (1.0 / (1.0 + np.exp(-(self.place[steps, 1] - _GATE[0]) / _GATE[1])))[:, None]
        place = _RESTING + up * (self.place[steps] - _RESTING)
        palm, fingers, curls = (up * part[steps] for part in (self.palm, self.fingers, self.curls))
        return np.concatenate([
            place.ravel(), palm.ravel(), fingers.ravel(), way.sum(axis=0), _shaken(self.place[near]),
            [travel, float(np.linalg.norm(way, axis=1).max())], curls[2:].mean(axis=0), curls.std(axis=0),
            [min(float(self.head[steps].min()), _FARTHEST), float(place[:, 1].max())]])

    def sided(self, steps: NDArray[np.int64]) -> Array:
        """What tells left from right: [4]."""
        place = self.place[steps, 0] * self.sign
        return np.array([place.mean(), place[-1] - place[0], (self.fingers[steps, 0] * self.sign).mean(), self.sign])


def _of_both(moved: _Hand, other: _Hand, steps: NDArray[np.int64]) -> Array:
    """Whether each hand is raised, and where one is from the other."""
    raised = [float(np.mean(hand.place[steps, 1] > -0.35)) for hand in (moved, other)]
    first, second = (hand.place[steps] * [hand.sign, 1.0, 1.0] for hand in (moved, other))
    apart = np.linalg.norm(first - second, axis=1)
    return np.array([*raised, *apart[[0, 2, 4]], apart.min(), apart[-1] - apart[0],
                     *(moved.place[steps] - other.place[steps]).mean(axis=0)])


def _shaken(path: Array) -> Array:
    """[D] standard deviation of the repeated part of a path [T, D]."""
    if len(path) < 12:
        return np.zeros(path.shape[1])
    band = butter(2, _SHAKES, "bandpass", fs=_RATE, output="sos")
    out: Array = sosfiltfilt(band, path, axis=0, padlen=len(path) - 1).std(axis=0)
    return out


def _curl(body: Motion, side: str, finger: str) -> Array:
    """[T] turn of the joints of a finger from straight, radians."""
    joints = [body.skeleton.index(f"{side}Hand{finger}{place}") for place in (1, 2, 3)]
    out: Array = np.linalg.norm(rotation.to_exponential_map(body.rotations[:, joints]), axis=-1).sum(axis=1)
    return out


# ------------------------------------------------------------------------------------------------------ classifier

@dataclass(frozen=True)
class DescribedGesture:
    """A gesture of a class. views: [2, `SHIFTS`, F] figures of it and of its mirror image; person: who makes it; take:
    clips of one take are alike."""

    label: str
    views: Array
    person: str = ""
    take: str = ""

    @classmethod
    def of(cls, label: str, motion: Motion, span: GestureSpan, person: str = "", take: str = "") -> DescribedGesture:
        """Of a motion of any upper body."""
        bodies = [GestureBody(one) for one in (motion, mirrored_motion(motion))]
        views = np.array([[body.figures(span.shifted(by)) for by in SHIFTS] for body in bodies])
        return cls(label, views, person, take)


def mirrored_label(label: str) -> str:
    """The label of the mirror image: left and right are swapped."""
    swap = {"left": "right", "right": "left"}
    return " ".join(swap.get(part, part) for part in label.split(" "))


class GestureClassifier:
    """Names gestures. All classes are taken to be equally frequent."""

    def __init__(self, gestures: Sequence[DescribedGesture], labels: Sequence[str] | None = None) -> None:
        """Learn from gestures; labels: in place of theirs."""
        given = [one.label for one in gestures] if labels is None else labels
        figures = np.concatenate([one.views[view] for one in gestures for view in (0, 1)])
        names = [name for label in given for name in (label, mirrored_label(label)) for _ in SHIFTS]
        count = len(set(names))
        self._model = make_pipeline(StandardScaler(), LinearDiscriminantAnalysis(
            solver="lsqr", shrinkage=_SHRINKAGE, priors=np.full(count, 1.0 / count)))
        self._model.fit(figures, names)
        self.labels: tuple[str, ...] = tuple(map(str, self._model.classes_))

    def scores(self, gestures: Sequence[DescribedGesture], view: int = 0) -> Array:
        """[N, C] log probabilities. view: 1 for the mirror images."""
        scores: Array = self._model.predict_log_proba(np.array([one.views[view, 0] for one in gestures]))
        return scores


def cross_validated(gestures: Sequence[DescribedGesture], group: Callable[[DescribedGesture], str],
                    labels: Sequence[str] | None = None) -> Array:
    """[N, C] scores of each gesture by a classifier that has not seen its group; classes as of `class_names`. -inf for
    a class that no other group has. labels: learned in place of the gestures'."""
    names, given = class_names(gestures), [one.label for one in gestures] if labels is None else labels
    groups = np.array([group(one) for one in gestures])
    out = np.full((len(gestures), len(names)), -np.inf)
    for name in sorted(set(groups)):
        held = np.flatnonzero(groups == name).tolist()
        seen = np.flatnonzero(groups != name).tolist()
        model = GestureClassifier([gestures[k] for k in seen], [given[k] for k in seen])
        columns = [names.index(label) for label in model.labels]
        out[np.ix_(np.array(held), np.array(columns))] = model.scores([gestures[k] for k in held])
    return out


def class_names(gestures: Sequence[DescribedGesture]) -> list[str]:
    """The classes of gestures and of their mirror images, in order."""
    return sorted({name for one in gestures for name in (one.label, mirrored_label(one.label))})


def chosen_among(scores: Array, right: NDArray[np.int64], answers: int, seed: int = 0, draws: int = 50) -> Array:
    """[N] share of draws in which the right class scores highest among it and `answers` - 1 others, drawn at random;
    among all classes if there are no more. scores: [N, C]; right: [N] numbers of the right classes."""
    rng = np.random.default_rng(seed)
    own = scores[np.arange(len(scores)), right]
    others = np.array([np.delete(row, place) for row, place in zip(scores, right, strict=True)])
    count = min(answers - 1, others.shape[1])
    picks = rng.permuted(np.tile(np.arange(others.shape[1]), (draws, len(scores), 1)), axis=-1)[..., :count]
    best = np.take_along_axis(np.broadcast_to(others, (draws, *others.shape)), picks, axis=-1).max(axis=-1)
    out: Array = (own > best).mean(axis=0)
    return out
