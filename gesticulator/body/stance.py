"""Stance: legs, standing or seated, for a performance generated from the hips up.

A person who stands and talks bears on one leg, the hips over it, that side of the pelvis higher, the other knee bent;
changes legs from time to time; turns the hips with the trunk; moves them against quick leans; gives in the knees under
strokes and dips of the trunk; and now and then sets the free foot down elsewhere. All of it is a function of the seed,
the time and the generated motion up to that time, so stream and file are identical.

The weight w of `weight.LegWeight` is combined with the low-passed roll r of the generated hips:

    u = (w + (r - habit of r) / r0) / u0        g(u) = u / sqrt(1 + u^2), between -1 (right leg) and 1 (left leg)

The hips travel sideways by A g, roll and turn with g instead of their habitual roll, and take a share of the yaw of the
chest; the spine compensates, so that everything from the chest up keeps its rotation in the room. They are as high as
both legs reach with soft knees (a soft minimum, since a fully stretched knee snaps), less what the knees give. Feet are
placed (`feet.Steps`) and legs follow by inverse kinematics, so a planted foot does not slide. docs/legs.md
compares the result with people.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from data_module.motion import rotation
from data_module.motion.skeletons import LEG_JOINTS, WHOLE_BODY, resized
from data_module.motion.standing_legs import bent_leg, leg_lengths
from data_module.types import Array, Motion, Skeleton
from gesticulator.body.feet import FOOT_BACK, SIDES, SOLE, UP, FootPath, Steps, abouts
from gesticulator.body.life import breath, noise, weight_shifts
from gesticulator.body.weight import LegWeight

__all__ = ["Stance", "seated", "with_legs"]

_LEG = 0.825
"""Distance from hip to ankle of the character that the lengths below are for, metres; others are scaled."""
_BENT = 0.9988
"""Largest used share of a leg's length: the knee is then bent by 6 degrees."""
_SOFT = 0.004
"""Width of the soft minimum between the legs' heights, metres."""

_TRAVEL, _FAR = 0.043, 0.085
"""Largest sideways travel of the hips, metres: by weight alone, and in total."""
_LEANS = 0.045
"""Largest travel of the hips ahead or back, metres."""
_ROLL_UNIT = 3.5
"""Generated roll, degrees, equivalent to one unit of weight."""
_BOTH = 0.65
"""Units of weight on a leg below which both bear weight: people mostly stand on one leg or the other."""
_ROLLED, _TURNED = 4.0, 0.8
"""Degrees of roll and yaw with all weight on one leg: the free side drops and comes ahead."""
_YAWS, _FARTHEST_YAW = 0.55, 20.0
"""Share of the chest's yaw that the hips take, and degrees at most."""
_COUNTERS = (0.25, 0.30)
"""Metres that the hips move opposite to each metre that the chest quickly moves sideways and ahead."""
_WITH_LEAN = (0.30, -0.10)
"""Metres that the hips move for each metre of a slow lean: sideways with it, ahead against it, for balance."""
_FOLLOWS, _QUICKLY, _SLOWLY = 0.22, 0.06, 0.8
"""Time constants of three-stage low-passes, seconds: weight follows the roll; hips turn and move with the chest; what
counts as a lean and not a movement."""
_HABIT = 2.0
"""Time constant of the three-stage low-pass by which a lasting roll becomes habitual, taken by the spine, seconds."""
_QUICK = 0.5
"""Share of faster roll taken by the spine: planted legs do not let the hips rock, and knees would shake."""
_PITCHED_BACK = 0.006
"""Metres that the hips move back for each degree that the idle motion tilts them forward."""

_SWAY = ((0.0045, 1.9), (0.0030, 0.7), (0.0060, 2.2), (0.0030, 0.8))
"""Postural sway: metres and step in seconds of the noise, two sideways and two ahead."""
_STIRS = ((0.0050, 1.0), (0.0080, 1.0))
"""What moving arms add to it, at full activity: sideways and ahead."""
_ROLLS = (0.7, 1.6)
"""Noise of the pelvis' roll: degrees, and step in seconds."""
_GIVES = (0.0007, 0.0016, 1.1)
"""Noise of the give of the knees: metres at rest, what full activity adds, and step in seconds."""
_GIVEN, _SOFTLY = 0.0005, 0.0007
"""Metres that the knees give at rest, and width of the soft bound that keeps the give above 0."""
_DIPS = 0.20
"""Metres that the hips sink for each metre by which the chest quickly sinks over them."""
_STROKE, _STROKE_ENERGY = 0.0060, 0.8
"""Metres that the knees give at most under strokes, and the mean square speed of the hands, (m/s)^2, for half of it."""
_ACTIVE = 0.08
"""Mean square speed of the hands, (m/s)^2, at which the body is half as active as it gets."""
_BREATH_DIPS = 0.0008
"""Metres that the hips sink on exhaling."""
_INSIDE = 0.022
"""Metres inside of the standing ankle at which the hips are during a step."""

_SEAT_SPREAD, _SEAT_TOES = 7.0, 12.0
"""Degrees that the thighs and feet of a seated character point outwards."""

_SWAY_CHANNEL = (1 << 10) + 8
_NOISE_STEPS = np.array([seconds for _, seconds in (*_SWAY, *_STIRS, _ROLLS)] + [_GIVES[2]])
_AHEAD, _LEFTWARD = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
_TRUNK = np.array([[WHOLE_BODY.index(name)] for name in ("Spine", "Spine1", "Spine2", "Spine3")])
_ARMS, _LEGS = (np.array([[WHOLE_BODY.index(side + part) for side, _ in SIDES] for part in parts]) for parts in (
    ("Shoulder", "Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot", "ToeBase")))
LEGGED = [0, int(_TRUNK[0, 0]), *_LEGS.ravel().tolist()]
"""The joints of the whole body that legs turn: the hips, the lowest one of the spine, and the legs'."""
_PLACES = np.arange(2, len(LEGGED)).reshape(_LEGS.shape)
"""The legs' joints among those."""
_COARSE, _MOVING_LITTLE = 0.5, 0.02
"""Seconds between two times, and speed of the chest in m/s, with which a rough beginning is gone on to."""


def with_legs(motion: Motion, seed: int, skeleton: Skeleton = WHOLE_BODY) -> Motion:
    """The motion on standing legs: travel and small turns of the hips and all leg joints are synthesised.

    motion: on the default skeleton in any of its sizes, facing +Z as generated; the rotation of the hips is used, the
    path of the root is not. seed: the same as for the performance, so that legs and idle motion agree. skeleton: with
    the joint names of `WHOLE_BODY` and leg bones that hang straight down; all lengths scale with its legs. The floor is
    Y = 0. Every joint from the chest up keeps its world rotation.
    """
    return Stance(seed, motion.fps, skeleton).step(motion)


def seated(motion: Motion, skeleton: Skeleton = WHOLE_BODY) -> Motion:
    """The motion on seated legs: thighs level, shins vertical, feet flat on the floor, hips still.

    See `with_legs` for the input. The spine takes the rotation of the hips, so the upper body keeps its pose.
    """
    body = resized(motion, WHOLE_BODY)
    rotations = body.rotations.copy()
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(body), 1))
    rotations[:, 0], rotations[:, WHOLE_BODY.index("Spine")] = _counter_turned(body.rotations[:, LEGGED[:2]], still)
    root = np.zeros((len(body), 3))
    _, shin = leg_lengths(skeleton, "Left")
    root[:, 1] = _ankle_height(skeleton) + shin - skeleton.offsets[skeleton.index("LeftUpLeg")][1]
    level = _about(_LEFTWARD, -90.0)
    knees, toes = (np.stack([_about(UP, sign * out) for _, sign in SIDES]) for out in (_SEAT_SPREAD, _SEAT_TOES))
    _hang(rotations, still, [np.tile(turn, (len(body), 1, 1)) for turn in (
        rotation.multiply(knees, level), toes, toes, toes)], _LEGS)
    return on_legs(body, rotations, root, skeleton, rotations[:0])


# ---------------------------------------------------------------------------------------------------- the body

class _LowPass:
    """Causal low-pass: three one-pole filters with a time constant in seconds."""

    def __init__(self, seconds: float, fps: float) -> None:
        self._share = 1.0 - math.exp(-1.0 / (fps * seconds))
        self._states: list[Array] | None = None

    def fork(self) -> _LowPass:
        """A copy that continues independently."""
        twin = copy.copy(self)
        twin._states = None if self._states is None else list(self._states)
        return twin

    def __call__(self, values: Array) -> Array:
        """[T, D] the filtered next values [T, D]; the state starts at the first value."""
        from scipy.signal import lfilter

        if self._states is None:
            self._states = [(1.0 - self._share) * values[:1]] * 3
        for number, state in enumerate(self._states):
            values, self._states[number] = lfilter([self._share], [1.0, self._share - 1.0], values, axis=0, zi=state)
        return values


@dataclass(frozen=True)
class _Drives:
    """What the generated body does, frame by frame, in metres of the reference character and degrees.

    roll: [T] of the hips; slow_roll, habit: [T] that the weight follows, and that is habitual; yaw: [T] of the chest;
    quick, lean: [T, 3] of the chest over the hips; speed: [T] m/s of the chest; energy: [T] of the hands, (m/s)^2;
    active: [T] 0 to 1."""

    roll: Array
    slow_roll: Array
    habit: Array
    yaw: Array
    quick: Array
    lean: Array
    speed: Array
    energy: Array
    active: Array


@dataclass(frozen=True)
class Signals:
    """What is followed of the generated body. roll, yaw: [T] degrees of the hips and of the chest; places: [T, 3, 3]
    displacements from their rest over the hips of the chest and both hands, in metres of the reference character;
    turns: [T, 2, 4] rotations of the hips and of the lowest joint of the spine."""

    roll: Array
    yaw: Array
    places: Array
    turns: Array

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return self.roll.nbytes + self.yaw.nbytes + self.places.nbytes + self.turns.nbytes

    def part(self, rows: slice) -> Signals:
        """Those of some of the frames."""
        return Signals(self.roll[rows], self.yaw[rows], self.places[rows], self.turns[rows])


def joined(parts: Sequence[Signals]) -> Signals:
    """The signals of successive frames."""
    return Signals(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Signals)))


class _Drive:
    """Follows the generated body in pieces."""

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self._roll, self._habit = _LowPass(_FOLLOWS, fps), _LowPass(_HABIT, fps)
        self._quick, self._slow = _LowPass(_QUICKLY, fps), _LowPass(_SLOWLY, fps)
        self._last: Array | None = None

    def fork(self) -> _Drive:
        """A copy that continues independently."""
        twin = copy.copy(self)
        twin._roll, twin._habit, twin._quick, twin._slow = (
            one.fork() for one in (self._roll, self._habit, self._quick, self._slow))
        return twin

    def step(self, signals: Signals) -> _Drives:
        roll, yaw, places = signals.roll, signals.yaw, signals.places
        slow = self._roll(roll[:, None])
        moves = np.diff(places, axis=0, prepend=places[:1] if self._last is None else self._last) * self._fps
        self._last = places[-1:]
        squares = np.sum(moves**2, axis=-1)
        smooth = self._quick(np.column_stack([yaw, places[:, 0], np.sqrt(squares[:, 0]), squares[:, 1:].mean(axis=1)]))
        lean = self._slow(np.column_stack([smooth[:, 1:4], smooth[:, 5]]))
        return _Drives(roll, slow[:, 0], self._habit(slow)[:, 0], smooth[:, 0], smooth[:, 1:4] - lean[:, :3],
                       lean[:, :3], smooth[:, 4], smooth[:, 5], lean[:, 3] / (lean[:, 3] + _ACTIVE))


@dataclass(frozen=True)
class Course:
    """What seed and time decide for T frames. times: [T] seconds; random: [T, 8] noise; feet: left and right; held,
    side: [T] see `Steps.over`; pitch: [T] degrees of the idle hips; breath: [T]"""

    times: Array
    random: Array
    feet: tuple[FootPath, FootPath]
    held: Array
    side: Array
    pitch: Array
    breath: Array


def course_of(parts: Sequence[tuple[Course, slice]]) -> Course:
    """The course of frames that are parts of others, one after the other."""
    def put(values: Sequence[Array]) -> Array:
        return np.concatenate([value[rows] for value, (_, rows) in zip(values, parts, strict=True)])

    courses = [course for course, _ in parts]
    feet = [FootPath(*(put([getattr(course.feet[foot], one.name) for course in courses]) for one in fields(FootPath)))
            for foot in range(len(SIDES))]
    rest = {one.name: put([getattr(course, one.name) for course in courses]) for one in fields(Course)
            if one.name != "feet"}
    return Course(feet=(feet[0], feet[1]), **rest)


class Follower:
    """How the legs of one performance follow its body: all of their state, but for the signs of quaternions."""

    def __init__(self, seed: int, fps: float) -> None:
        self._weight, self._drive = LegWeight(seed), _Drive(fps)

    def fork(self) -> Follower:
        """A copy that continues independently."""
        twin = copy.copy(self)
        twin._weight, twin._drive = self._weight.fork(), self._drive.fork()
        return twin

    def step(self, signals: Signals, course: Course, scale: float, ends: Sequence[int] | None = None) -> Array:
        """[T, 5] the lead of the hips in the next frames: degrees by which they are rolled and yawed, their place along
        X and Z, and by how much the knees give, metres. ends: see `LegWeight.step`."""
        drives, times = self._drive.step(signals), course.times
        u = (self._weight.step(times, drives.speed, ends) + (drives.slow_roll - drives.habit) / _ROLL_UNIT) / _BOTH
        g = (1.0 - course.held) * u / np.sqrt(1.0 + u * u) + course.held * course.side
        rolled = _ROLLED * g + _ROLLS[0] * course.random[:, 6] - drives.habit - _QUICK * (
            drives.roll - drives.slow_roll)
        yawed = _TURNED * g + _within(_YAWS * drives.yaw, _FARTHEST_YAW)
        return np.column_stack([rolled, yawed, _travelled(course, g, drives, scale), _given(course, drives, scale)])

    def begin(self, until: float) -> None:
        """Begin at a time in seconds, roughly: as if the body had hardly moved until then."""
        times = np.arange(0.0, until, _COARSE)
        if len(times):
            self._weight.step(times, np.full(len(times), _MOVING_LITTLE))


def _travelled(course: Course, g: Array, drives: _Drives, scale: float) -> Array:
    """[T, 2] position of the hips along X and Z. g: see the module."""
    feet, held, side = course.feet, course.held, course.side
    sway = course.random[:, :6] * np.array([size for size, _ in (*_SWAY, *_STIRS)])
    sway[:, 4:] *= drives.active[:, None]
    across, ahead = sway[:, [0, 1, 4]].sum(axis=1), sway[:, [2, 3, 5]].sum(axis=1)
    leans = np.array(_WITH_LEAN) * drives.lean[:, [0, 2]] - np.array(_COUNTERS) * drives.quick[:, [0, 2]]
    both = (feet[0].middle + feet[1].middle) / 2.0
    both[:, 0] += scale * _within(_TRAVEL * g + across + leans[:, 0], _FAR)
    one = np.where(side[:, None] > 0, feet[0].middle, feet[1].middle)
    one[:, 0] += scale * (across - _INSIDE * side)
    way = both + held[:, None] * (one - both)
    way[:, 1] += scale * (FOOT_BACK + _within(ahead + leans[:, 1] - _PITCHED_BACK * course.pitch, _LEANS))
    return way


def _given(course: Course, drives: _Drives, scale: float) -> Array:
    """[T] metres, above 0, by which the knees give more than they must."""
    strokes = _STROKE * drives.energy / (drives.energy + _STROKE_ENERGY)
    give = _GIVEN + (_GIVES[0] + _GIVES[1] * drives.active) * course.random[:, 7] + strokes - _DIPS * drives.quick[:, 1]
    breathed = _BREATH_DIPS * (1.0 - course.breath) / 2.0
    return scale * (_SOFTLY * np.logaddexp(0.0, give / _SOFTLY) + breathed)


class Stance:
    """Legs for one performance in pieces: `step` takes frames as they come."""

    def __init__(self, seed: int, fps: float, skeleton: Skeleton = WHOLE_BODY) -> None:
        if skeleton.names != WHOLE_BODY.names:
            raise ValueError(f"the legs' skeleton has {len(skeleton)} joints, not those of the whole body")
        self.skeleton, self.seed, self.fps = skeleton, seed, fps
        self.scale = sum(leg_lengths(skeleton, "Left")) / _LEG
        socket, ball = (skeleton.offsets[skeleton.index("Left" + part)] for part in ("UpLeg", "ToeBase"))
        self.steps = Steps(seed, self.scale, abs(float(socket[0])), np.array([0.0, ball[1], ball[2]]))
        self._pitch = weight_shifts(seed)
        lengths = np.array([leg_lengths(skeleton, side) for side, _ in SIDES])
        self._lengths = lengths[:, :1], lengths[:, 1:]
        self._follower = Follower(seed, fps)
        self._frames = 0
        self._last = np.zeros((0, len(WHOLE_BODY), 4))

    def fork(self) -> Stance:
        """A copy that continues independently."""
        return copy.deepcopy(self, {id(self.skeleton): self.skeleton})

    def step(self, motion: Motion) -> Motion:
        """The next frames [T] of the body with legs, see `with_legs`."""
        body = resized(motion, WHOLE_BODY)
        first, self._frames = self._frames, self._frames + len(body)
        self.steps.forget(first / self.fps - 1.0)
        course, signals = self.course(first, self._frames), self.signals(body)
        turns, root = self.stood(signals.turns, course, self._follower.step(signals, course, self.scale))
        rotations = body.rotations.copy()
        rotations[:, LEGGED] = turns
        motion = on_legs(body, rotations, root, self.skeleton, self._last)
        self._last = motion.rotations[-1:]
        return motion

    def course(self, first: int, last: int) -> Course:
        """What is decided for the frames `first` to `last` - 1 of a step; of the past, what was not forgotten."""
        times = (first + np.arange(last - first)) / self.fps
        steps = self.steps.since(float(times[0]) - 1.0, float(times[-1]))
        random = noise(self.seed, _SWAY_CHANNEL + np.arange(len(_NOISE_STEPS)), times, _NOISE_STEPS)
        held, side = steps.over(times)
        return Course(times, random, (steps.path(0, times), steps.path(1, times)), held, side,
                      self._pitch.at(times)[:, 1], breath(self.seed, times))

    def signals(self, body: Motion) -> Signals:
        """What is followed of a body on the skeleton of the whole body."""
        left = rotation.rotate(body.rotations[:, 0], _LEFTWARD)
        roll = np.degrees(np.arcsin(np.clip(left[:, 1], -1.0, 1.0)))
        places, chest = self._places(body)
        left = rotation.rotate(chest, _LEFTWARD)
        yaw = np.degrees(np.arctan2(-left[:, 2], left[:, 0]))
        return Signals(roll, yaw, places, body.rotations[:, LEGGED[:2]])

    def _places(self, body: Motion) -> tuple[Array, Array]:
        """[T, 3, 3] the places of `Signals`, and [T, 4] the chest's rotation."""
        chest, place = self._along(body, body.rotations[:, :1], _TRUNK)
        hands = place + self._along(body, chest, _ARMS)[1]
        rest = self.skeleton.offsets[_TRUNK].sum(axis=(0, 1))
        return np.concatenate([place - rest, hands], axis=1) / self.scale, chest[:, 0]

    def _along(self, body: Motion, world: Array, chains: NDArray[np.int64]) -> tuple[Array, Array]:
        """[T, C, 4] the rotations and [T, C, 3] the places of the last joints of chains [M, C] of joints, under a joint
        with the rotation `world` [T, 1, 4] and from the place of that."""
        place = np.zeros((len(body), 1, 3))
        for joints in chains:
            place = place + rotation.rotate(world, self.skeleton.offsets[joints])
            world = rotation.multiply(world, body.rotations[:, joints])
        return world, place

    def stood(self, turns: Array, course: Course, lead: Array) -> tuple[Array, Array]:
        """[T, 10, 4] rotations of the joints `LEGGED`, and [T, 3] positions of the root. turns: [T, 2, 4] rotations of
        the hips and of the lowest joint of the spine; lead: [T, 5] of the hips, see `Follower.step`."""
        rolled, yawed = lead[:, 0], lead[:, 1]
        turn = rotation.from_exponential_map(np.radians(np.stack([0.0 * rolled, yawed, rolled], -1)))
        hips = rotation.multiply(turn, turns[:, 0])
        out, root = np.empty((len(turns), len(LEGGED), 4)), np.zeros((len(turns), 3))
        out[:, 0], out[:, 1] = _counter_turned(turns, hips)
        root[:, [0, 2]] = lead[:, 2:4]
        self._stand(out, root, hips, course.feet, lead[:, 4])
        return out, root

    def _stand(self, turns: Array, root: Array, hips: Array, feet: Sequence[FootPath], give: Array) -> None:
        """Set the hips' height and the legs' rotations in those of `LEGGED`."""
        ankles = np.stack([foot.ankles for foot in feet], axis=1)
        socket = rotation.rotate(hips[:, None], self.skeleton.offsets[_LEGS[0]])
        longest = _BENT * (self._lengths[0] + self._lengths[1])[:, 0]
        level = np.sum((root[:, None] + socket - ankles)[..., [0, 2]] ** 2, axis=-1)
        reach = ankles[..., 1] + np.sqrt(np.maximum(longest**2 - level, 0.0)) - socket[..., 1]
        soft = _SOFT * self.scale
        root[:, 1] = -soft * np.logaddexp(*(-reach / soft).T) - give
        toes = abouts(UP, np.stack([foot.yaw for foot in feet], axis=1))
        thigh, shin = bent_leg(ankles - root[:, None] - socket, rotation.rotate(toes, _AHEAD), self._lengths)
        raised = rotation.multiply(toes, abouts(_LEFTWARD, np.stack([foot.heel for foot in feet], axis=1)))
        _hang(turns, hips, [thigh, shin, raised, toes], _PLACES)


def _within(values: Array, most: float) -> Array:
    """Values compressed smoothly into -most to most, nearly unchanged below half of it."""
    return np.asarray(most * np.tanh(values / most))


def _about(axis: Array, degrees: float) -> Array:
    """[4] the rotation about an axis by an angle in degrees."""
    return abouts(axis, np.radians(np.array([degrees])))[0]


def _counter_turned(turns: Array, hips: Array) -> tuple[Array, Array]:
    """The given hips [T, 4], and rotations of the spine [T, 4] that keep the upper body unchanged in the world. turns:
    [T, 2, 4] of hips and spine before."""
    spine = rotation.multiply(turns[:, 0], turns[:, 1])
    return hips, rotation.multiply(rotation.conjugate(hips), spine)


def _hang(rotations: Array, hips: Array, world: Sequence[Array], places: NDArray[np.int64]) -> None:
    """Set the local rotations of both legs, which are at `places` [4, 2], from world rotations [T, 2, 4] of thighs,
    shins, feet and toes, under hips [T, 4]."""
    above = hips[:, None]
    for joints, turn in zip(places, world, strict=True):
        rotations[:, joints] = rotation.multiply(rotation.conjugate(above), turn)
        above = turn


def _ankle_height(skeleton: Skeleton) -> float:
    """Height of the ankle of a flat foot above the floor, metres."""
    scale = sum(leg_lengths(skeleton, "Left")) / _LEG
    return scale * SOLE - float(skeleton.offsets[skeleton.index("LeftToeBase")][1])


def on_legs(body: Motion, rotations: Array, root: Array, skeleton: Skeleton, before: Array) -> Motion:
    """The body with these rotations and root positions; its legs are marked as filled in. before: [0 or 1, J, 4] the
    previous frame, for continuous quaternion signs."""
    filled = {*body.filled, *LEG_JOINTS}
    rotations = rotation.continuous(np.concatenate([before, rotations]))[len(before):]
    return replace(body, skeleton=skeleton, rotations=rotations, root_positions=root,
                   absent=tuple(name for name in body.absent if name not in LEG_JOINTS),
                   filled=tuple(name for name in WHOLE_BODY.names if name in filled))

