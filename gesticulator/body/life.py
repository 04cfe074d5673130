"""Idle motion of a body at rest: it breathes, shifts its weight, looks about, and its hands are never quite still.

A layer over the finished poses, in radians on the exponential maps, that depends only on the seed and the time: stream
and file are identical, whatever generates the gestures, and a block that is generated twice breathes alike. The
generator sees the poses without it, so idle motion never accumulates.

Four kinds of movement, all smooth and none periodic:

- noise: sum over n of g_n B((t - t_n) / step), with B the cubic B-spline and g_n standard normal: low-passed white
  noise with nothing above about 0.5 / step hertz. Used for sway and the drift of the arms.
- breathing: a sine of about 0.25 Hz whose phase wanders with noise.
- shifts: from one posture to the next, at irregular times, along 1 - (1 + a + a^2 / 2) exp(-a), a = (t - t_n) / tau:
  a quick start and a slow settling, as in eye-led head turns. Small shifts of head and upper back follow each other
  within a second, so that the head never freezes; gaze and weight shift every few seconds.
- hands, if there are fingers, open and close a little along their own bend.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from data_module.motion.kinematics import minimum_jerk, positions_of
from data_module.motion.representation import Representation
from data_module.types import Array
from gesticulator.bundle.features import Flags, Span, Statistics

HEAD = ("Neck", "Neck1", "Head")
"""The joints that turn the face without moving a hand."""
SIDES = ("Right", "Left")

_BREATHS = 0.25
"""Breaths per second: 15 a minute, as a standing adult."""
_BREATH_WANDERS, _BREATH_STEP = 0.1, 5.0
"""Phase noise of breathing: standard deviation in breaths, and its step in seconds."""
_SPLINE_SPREAD = math.sqrt(151.0 / 315.0)
"""Standard deviation over time of B-spline noise with standard normal coefficients."""
_SETTLED = 16.0
"""Time constants after which a shift counts as complete: the rest is below 1e-5 degrees."""
_TRIES = 8

_FAINT = 0.25
"""Share of the idle motion during speech, while the generator moves the body."""
_HEAD_STANDS, _HEAD_MOVES = 0.025, 0.06
"""Speeds of the generated head, m/s: full idle motion below the first, only the faint share above the second."""
_GAIN_TAU = 0.25
"""Time constant of fading idle motion in and out, seconds."""

VOICE_BITS = 48
"""The lowest bit of a voice (`sampling.loop.Keys`) in a channel, above all that channels use otherwise."""
_ALL_BITS = 0xFFFFFFFFFFFFFFFF
_STEP_OF_BITS = np.uint64(0x9E3779B97F4A7C15)


Channel = int | NDArray[np.int64]


def mixed(seed: int, channel: Channel, numbers: NDArray[np.int64]) -> NDArray[np.uint64]:
    """64 well mixed bits for each number [...] of a channel (splitmix64, Steele et al. 2014), identical on all
    machines.

    channel: one, or an array that broadcasts with the numbers.
    """
    # Arrays, unlike scalars, overflow without a warning.
    channels = np.array(channel, np.int64, ndmin=1) + 1
    key = _scrambled(np.uint64(seed & _ALL_BITS) + _STEP_OF_BITS * channels.astype(np.uint64))
    out = _scrambled(key + _STEP_OF_BITS * np.array(numbers, np.int64, ndmin=1).astype(np.uint64))
    return out if np.ndim(numbers) or np.ndim(channel) else out.reshape(())


_SHIFTS_OF_BITS = np.uint64(30), np.uint64(27), np.uint64(31)
_FACTORS_OF_BITS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def _scrambled(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    for shift, factor in zip(_SHIFTS_OF_BITS, _FACTORS_OF_BITS, strict=False):
        z = (z ^ (z >> shift)) * factor
    return z ^ (z >> _SHIFTS_OF_BITS[2])


def uniform(seed: int, channel: Channel, numbers: NDArray[np.int64]) -> Array:
    """Numbers in (0, 1) for each of `numbers` [...]."""
    return ((mixed(seed, channel, numbers) >> np.uint64(11)).astype(np.float64) + 0.5) / 2.0**53


def normal(seed: int, channel: Channel, numbers: NDArray[np.int64]) -> Array:
    """Standard normal numbers for each of `numbers` [...] (Box and Muller)."""
    pairs = np.empty((2, *np.broadcast(numbers, channel).shape), np.int64)
    # Each normal number takes two uniform ones, 2 n and 2 n + 1, so that no two share one.
    pairs[0] = 2 * np.asarray(numbers)
    pairs[1] = pairs[0] + 1
    first, second = uniform(seed, channel, pairs)
    return np.asarray(np.sqrt(-2.0 * np.log(first)) * np.cos(2.0 * np.pi * second))


def smooth_step(s: Array) -> Array:
    """3 s^2 - 2 s^3, with s clipped to 0 to 1."""
    u: Array = np.minimum(np.maximum(s, 0.0), 1.0)
    return u * u * (3.0 - 2.0 * u)


def noise(seed: int, channels: NDArray[np.int64], times: Array, steps: Array) -> Array:
    """[T, C] smooth noise of standard deviation 1 at `times` [T], one normal coefficient every `steps` [C] seconds."""
    where = np.asarray(times, dtype=np.float64)[:, None] / steps
    first = np.floor(where).astype(np.int64)
    u = where - first
    # The four cubic B-spline weights at the fraction u between two coefficients.
    weights = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]) / 6.0
    # Frames share most of their coefficients, each of which is computed once.
    least = first.min(axis=0)
    coefficients = normal(seed, channels, least + np.arange(-1, int((first - least).max(initial=0)) + 3)[:, None])
    values = coefficients[first - least + np.arange(4)[:, None, None], np.arange(len(steps))]
    return (weights * values).sum(axis=0) / _SPLINE_SPREAD


@dataclass(frozen=True)
class ShiftStyle:
    """Parameters of shifts. every: seconds between shifts; jitter: the share of it by which they come early or late, up
    to 0.5; tau: time constant, seconds; spread: [D] standard deviation of the postures in each dimension; least, most:
    distance between successive postures, in units of spread."""

    every: float
    jitter: float
    tau: float
    spread: tuple[float, ...]
    least: float
    most: float


@dataclass
class Shifts:
    """A sequence of postures [D], zero at time 0, that can be evaluated at any time and in any order."""

    seed: int
    channel: int
    style: ShiftStyle
    _postures: list[Array] = field(default_factory=list)
    """Those computed so far, each from the one before: some 20 MB in a day of the most frequent shifts."""
    _begins: list[float] = field(default_factory=list)
    """When the shifts to them begin, seconds."""

    def at(self, times: Array) -> Array:
        """[T, D] at times [T] in seconds, not negative."""
        s = self.style
        times = np.asarray(times, dtype=np.float64)
        last = max(0, math.floor(times.max() / s.every + s.jitter)) + 1
        # Shifts before `first` are complete: their sum is the posture before it.
        reach = math.ceil(_SETTLED * s.tau / s.every + 1)
        first = max(0, math.floor(times.min() / s.every) - reach)
        self._extend(last)
        a = np.maximum(times[:, None] - np.array(self._begins[first:last + 1]), 0.0) / s.tau
        done = 1.0 - (1.0 + a + a * a / 2.0) * np.exp(-a)
        postures = np.array(self._postures[first:last + 1])
        before = self._postures[first - 1] if first > 0 else np.zeros(len(s.spread))
        steps = postures - np.concatenate([before[None], postures[:-1]])
        return np.asarray(before + done @ steps)

    def begins(self, numbers: NDArray[np.int64]) -> Array:
        """Seconds at which these shifts [...] begin."""
        s = self.style
        return (numbers + s.jitter * (2.0 * uniform(self.seed, self.channel, numbers) - 1.0)) * s.every

    def posture(self, number: int) -> Array:
        """[D] the posture at the end of shift `number`."""
        self._extend(number)
        return self._postures[number]

    def _extend(self, last: int) -> None:
        """Extend the postures up to number `last`: from one spread, neither too near the one before nor too far."""
        s, width = self.style, len(self.style.spread)
        if last >= len(self._begins):
            self._begins += self.begins(np.arange(len(self._begins), last + 1)).tolist()
        for n in range(len(self._postures), last + 1):
            before = self._postures[-1] if n else np.zeros(width)
            tries = normal(self.seed, self.channel + 1, (n * _TRIES + np.arange(_TRIES))[:, None] * width
                           + np.arange(width)) * s.spread
            tries[-1] = -before  # far from most places
            apart = np.linalg.norm((tries - before) / s.spread, axis=1)
            fits = np.flatnonzero((apart >= s.least) & (apart <= s.most))
            # The first try in range; if none is, the one whose distance comes nearest to the least.
            chosen = tries[fits[0] if len(fits) else int(np.argmin(np.abs(apart - s.least)))]
            length = max(float(np.linalg.norm((chosen - before) / s.spread)), 1e-9)
            self._postures.append(before + (chosen - before) * min(max(1.0, s.least / length), s.most / length))


_HEAD_SHIFT = ShiftStyle(every=0.62, jitter=0.14, tau=0.085, spread=(1.5, 1.5), least=1.4, most=2.2)
"""Units of pitch and of roll, see `_SHIFTED`; the head shifts about every 0.6 s."""
_GAZE = ShiftStyle(every=2.9, jitter=0.35, tau=0.09, spread=(6.0, 2.5), least=0.8, most=2.5)
"""Spread in degrees of yaw and of pitch."""
_WEIGHT = ShiftStyle(every=6.5, jitter=0.35, tau=0.45, spread=(1.0, 0.7, 1.0), least=1.0, most=2.5)
"""Spread in degrees of the hips' roll, pitch and yaw, as weight moves from one leg to the other."""

_SHIFTED = {"Neck": 1.3, "Neck1": 0.6, "Spine3": 0.2, "Spine2": 0.25, "Spine1": 0.25}
"""Degrees per unit of the head's small shifts: the upper back moves too."""
LOOKED = {"Neck": 0.35, "Neck1": 0.2, "Head": 0.45}
"""Share of a gaze shift that each joint turns."""
_INHALED = {("Spine1", 0): -0.2, ("Spine2", 0): -0.4, ("Neck", 0): 0.35, ("LeftShoulder", 2): 1.0,
            ("RightShoulder", 2): -1.0}
"""Degrees at full inhalation, by joint and axis: the chest opens, the shoulders rise, the face stays level."""
_SWAYED = {("Hips", 2): (1.0, 0), ("Spine", 2): (-0.5, 0), ("Hips", 0): (1.0, 1), ("Spine", 0): (-0.5, 1),
           ("Spine1", 1): (0.8, 2)}
"""By joint and axis: share of a weight shift (and of the sway), and which of its dimensions."""
_SWAY, _SWAY_STEP = 0.35, 1.5
"""Noise added to the weight shifts: degrees, and step in seconds."""
_DRIFT = {"Arm": (1.1, 1.2), "ForeArm": (1.6, 1.0), "Hand": (1.8, 0.9)}
"""Noise on each axis of the arm joints: degrees, and step in seconds."""
_CURL, _CURL_STEP = 2.0, 1.6
"""Noise by which a hand opens and closes: degrees, and step in seconds."""
_SHIFT_CHANNEL, _GAZE_CHANNEL, _WEIGHT_CHANNEL, _BREATH_CHANNEL, _NOISE_CHANNEL = 0, 2, 4, 6, 8
_DRIFTS = [(side + part, axis, *_DRIFT[part]) for side in SIDES for part in _DRIFT for axis in range(3)]
_SWAYS, _CURLS = 3, len(SIDES)
_CHANNELS = np.append(_NOISE_CHANNEL + np.arange(_SWAYS + len(_DRIFTS) + _CURLS), _BREATH_CHANNEL)
_STEPS = np.array([_SWAY_STEP] * _SWAYS + [step for *_, step in _DRIFTS] + [_CURL_STEP] * _CURLS + [_BREATH_STEP])


def eased(share: Array) -> Array:
    """[...] 0 to 1 with zero slope at both ends: 10 s^3 - 15 s^4 + 6 s^5."""
    return np.asarray(minimum_jerk(np.clip(share, 0.0, 1.0)))


def weight_shifts(seed: int) -> Shifts:
    """Weight shifts from leg to leg: [3] degrees of the hips' roll (positive: on the left leg), pitch and yaw."""
    return Shifts(seed, _WEIGHT_CHANNEL, _WEIGHT)


def breath(seed: int, times: Array) -> Array:
    """[T] phase of breathing at `times` [T] seconds, -1 (exhaled) to 1 (inhaled)."""
    return _breathed(seed, times, noise(seed, np.array([_BREATH_CHANNEL]), times, np.array([_BREATH_STEP]))[:, 0])


def _breathed(seed: int, times: Array, wander: Array) -> Array:
    """`breath` for given phase noise [T]; exhaling takes longer than inhaling."""
    begins = float(uniform(seed, _BREATH_CHANNEL + 1, np.zeros(1, np.int64))[0])
    phase = 2.0 * np.pi * (_BREATHS * times + _BREATH_WANDERS * wander + begins)
    # Phase distortion: the rising half takes less time than the falling one.
    return np.sin(phase + 0.4 * np.sin(phase))


class Idle:
    """Idle motion of a body as a function of time: drivers (shifts, gaze, breath) mixed into the axes of joints."""

    def __init__(self, seed: int, joints: Sequence[str], rest: Array) -> None:
        """joints: names; rest: [J, 3] the resting pose as exponential maps (it tells how fingers bend)."""
        self.seed = seed
        self._shifts = Shifts(seed, _SHIFT_CHANNEL, _HEAD_SHIFT)
        self._gaze = Shifts(seed, _GAZE_CHANNEL, _GAZE)
        self._weight = weight_shifts(seed)
        self._mixing = np.radians(_mixing(list(joints), rest)).reshape(-1, 3 * len(joints))

    def __call__(self, times: Array) -> Array:
        """[T, J, 3] radians to add to the exponential maps at `times` [T], seconds from 0."""
        times = np.asarray(times, dtype=np.float64)
        # All noise in one call: it is most of the cost of a frame.
        smooth = noise(self.seed, _CHANNELS, times, _STEPS)
        sway = self._weight.at(times) + _SWAY * smooth[:, :_SWAYS]
        breathed = _breathed(self.seed, times, smooth[:, -1])
        drivers = np.concatenate([self._shifts.at(times), self._gaze.at(times), breathed[:, None], sway,
                                  smooth[:, _SWAYS:-1]], axis=1)
        return (drivers @ self._mixing).reshape(len(times), -1, 3)


def _mixing(joints: list[str], rest: Array) -> Array:
    """[M, J, 3] degrees by which each driver turns each axis."""
    # First rows of the drivers: 0 and 1 are the head's small shifts.
    gaze, breath, sway, drift = 2, 4, 5, 5 + _SWAYS
    curl = drift + len(_DRIFTS)
    rows = [(dimension, name, axis, degrees) for name, degrees in _SHIFTED.items()
            for dimension, axis in ((0, 0), (1, 2))]
    rows += [(gaze + dimension, name, axis, share) for name, share in LOOKED.items()
             for dimension, axis in ((0, 1), (1, 0))]
    rows += [(breath, name, axis, degrees) for (name, axis), degrees in _INHALED.items()]
    rows += [(sway + dimension, name, axis, share) for (name, axis), (share, dimension) in _SWAYED.items()]
    rows += [(drift + number, name, axis, degrees) for number, (name, axis, degrees, _) in enumerate(_DRIFTS)]
    out = np.zeros((curl + _CURLS, len(joints), 3))
    for driver, name, axis, degrees in rows:
        if name in joints:
            out[driver, joints.index(name), axis] += degrees
    for index, name in enumerate(joints):
        length = float(np.linalg.norm(rest[index]))
        for number, side in enumerate(SIDES):
            if name.startswith(side + "Hand") and name != side + "Hand" and length > 1e-6:
                out[curl + number, index] = _CURL * rest[index] / length  # along its own bend
    return out


# ---------------------------------------------------------------------------------------------------- over the poses

def _followed(gain: float, slope: float, targets: Sequence[float], seconds: float) -> list[tuple[float, float]]:
    """A gain and its slope after each of the frames of some seconds in which it follows a target, critically damped."""
    # Closed form of the critically damped oscillator: exact for any frame duration.
    out, fade = [], math.exp(-seconds / _GAIN_TAU)
    for target in targets:
        away = gain - target
        push = slope + away / _GAIN_TAU
        left = away + push * seconds
        gain, slope = target + left * fade, (push - left / _GAIN_TAU) * fade
        out.append((gain, slope))
    return out


class LifeLayer:
    """Adds idle motion to the poses of one performance: fully where the body rests or the head would freeze, faintly
    elsewhere. Head and body fade separately."""

    def __init__(self, seed: int, statistics: Statistics, representation: Representation, speaker: int,
                 parts: Sequence[NDArray[np.int64]]) -> None:
        """representation: of exponential maps; parts: the dimensions of the head, and those of the body."""
        pose = statistics.rest_pose[speaker]
        names = representation.motion(pose[None], 1.0).skeleton.names
        self._idle, self._parts = Idle(seed, names, pose.reshape(-1, 3)), parts
        self._scale = statistics.present / statistics.deviation
        self._head_moves = _head_moves(statistics, representation, speaker)
        self._shown = statistics.normalise(pose, speaker)
        self._gains = np.zeros((len(parts), 2))
        self.gains = np.zeros((0, len(parts), 2))
        """[K, parts, 2] gain of the idle motion in each frame of the last block, and its slope."""

    def stand_as(self, other: LifeLayer) -> None:
        """Take over pose and gains from another layer of the same speaker."""
        self._gains, self._shown = other._gains, other._shown

    def go_back(self, gains: Array, pose: Array) -> None:
        """Return to a frame already shown: its `gains` [parts, 2] and pose [D_m]."""
        self._gains, self._shown = gains, pose.astype(np.float64)

    def __call__(self, block: NDArray[np.floating], span: Span, rests: Sequence[Flags]) -> Array:
        """[K, D_m] a block of normalised poses with idle motion added; rests: [K] for each part, whether it rests."""
        times = span.times
        # In the units of the normalised poses; absent joints have none.
        life = self._idle(times).reshape(block.shape) * self._scale
        seconds = span.duration / len(times)
        steps = block - np.concatenate([self._shown[None], block[:-1]])
        # A linear map instead of forward kinematics: head angles are small, and this runs for every block.
        speed = np.linalg.norm(steps @ self._head_moves, axis=1) / seconds
        stands = np.minimum(np.maximum((_HEAD_MOVES - speed) / (_HEAD_MOVES - _HEAD_STANDS), 0.0), 1.0)
        # Full at rest or where the head stands still, whichever is more.
        wanted = _FAINT + (1.0 - _FAINT) * np.maximum(stands, np.array(rests))
        # Number by number: an array of three parts takes longer.
        followed = [_followed(gain, slope, targets, seconds) for (gain, slope), targets in zip(
            self._gains.tolist(), wanted.tolist(), strict=True)]
        self.gains = np.swapaxes(followed, 0, 1)
        self._gains = self.gains[-1]
        for part, columns in enumerate(self._parts):
            life[:, columns] *= self.gains[:, part, :1]
        self._shown = block[-1].astype(np.float64)
        return block + life


def _head_moves(statistics: Statistics, representation: Representation, speaker: int) -> Array:
    """[D_m, 3] metres that the head moves per unit of each feature, at the resting pose."""
    tiny = 1e-3
    rest = statistics.normalise(statistics.rest_pose[speaker], speaker)
    turned = np.concatenate([rest[None], rest + tiny * np.eye(len(rest))])
    motion = representation.motion(statistics.denormalise(turned, speaker), 1.0)
    at = positions_of(motion)[:, motion.skeleton.index("Head")]
    return np.asarray((at[1:] - at[:1]) / tiny)
