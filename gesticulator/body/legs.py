"""Legs, standing or seated, for a performance generated from the hips up.

A person who stands and talks bears on one leg, the hips over it, that side of the pelvis higher, the other knee bent;
changes legs from time to time; turns the hips with the trunk; moves them against quick leans; gives in the knees under
strokes and dips of the trunk; and now and then sets the free foot down elsewhere. All of it is a function of the seed,
the time and the generated motion up to that time, so stream and file are identical.

The weight w of `LegWeight` is combined with the low-passed roll r of the generated hips:

    u = (w + (r - habit of r) / r0) / u0        g(u) = u / sqrt(1 + u^2), between -1 (right leg) and 1 (left leg)

The hips travel sideways by A g, roll and turn with g instead of their habitual roll, and take a share of the yaw of the
chest; the spine compensates, so that everything from the chest up keeps its rotation in the room. They are as high as
both legs reach with soft knees (a soft minimum, since a fully stretched knee snaps), less what the knees give. Feet are
placed (`Steps`) and legs follow by inverse kinematics, so a planted foot does not slide. docs/legs.md
compares the result with people.

**Weight**: the idle motion rolls the hips every few seconds (`life.weight_shifts`, postures p_n at times t_n). People
stand on one leg and change legs less often than that, so the leg changes only where the roll is marked:

    s_n = sign(p_n) if |p_n| > c, else s_(n-1)         w_n = s_n (a + b min(|p_n|, p_max))

They change legs while the trunk moves, so a shift runs on a clock C(t) of its own, the integral of a rate that is low
while the trunk is still and grows with its speed:

    w(t) = w_-1 + sum over n of (w_n - w_(n-1)) f((C(t) - C(t_n)) / tau),    f(a) = 1 - (1 + a + a^2 / 2) exp(-a)

The motion decides only how fast each shift runs, so that a small change of the motion is a small change of the weight
and is forgotten with the shift.

**Feet** are placed by seed and time alone. The ball of a foot is placed; the ankle is behind and above it.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.motion import rotation
from data_module.motion.skeletons import LEG_JOINTS, WHOLE_BODY, resized
from data_module.motion.standing_legs import bent_leg, leg_lengths
from data_module.types import Array, Motion
from gesticulator.body.life import Shifts, breath, eased, noise, normal, uniform, weight_shifts
from gesticulator.contacts.lap import SEAT_SPREAD
from gesticulator.contacts.limbs import posed

__all__ = ["Stance", "seated", "with_legs"]

# ------------------------------------------------------------------------------------------------- the weight

CROSSES = 0.55
"""Roll of an idle posture in degrees above which it changes the leg that bears."""
_LEAST, _MORE, _MOST = 0.60, 0.40, 1.5
"""Weight on the bearing leg: at no roll, for each degree of it, and the largest roll that counts."""
_TAU = 0.45
"""Time constant of a shift on its clock, seconds."""
_STILL, _MOVING = 0.40, 0.04
"""Rate of the clock while the trunk is still, and speed of the chest in m/s that adds 1 to it."""
_QUICKEST = 2.0
"""Largest addition to that rate."""
_DONE = 40.0
"""Time constants after which a shift is complete to the last bit."""
_FIRST_CHANNEL = (1 << 10) + 6


class LegWeight:
    """The weight of one performance, in pieces: positive on the left leg, about -1 to 1."""

    def __init__(self, seed: int, shifts: Shifts) -> None:
        """shifts: `weight_shifts` of the seed."""
        self._shifts = shifts
        self._side = 1.0 if uniform(seed, _FIRST_CHANNEL, np.zeros(1, np.int64))[0] < 0.5 else -1.0
        self._settled = self._target = self._side * (_LEAST + _MORE)
        self._next, self._clock, self._time = 0, 0.0, 0.0
        self._running: list[tuple[float, float]] = []
        """Of every shift that began and is not complete: its start on the clock, and the change of weight."""

    def step(self, times: Array, speed: Array) -> Array:
        """[T] the weight at the next `times` [T] seconds. speed: [T] m/s of the chest over the hips, smoothed."""
        before = self._time
        # The clock of the module: slow while the trunk is still, so that a shift waits for a movement.
        rate = _STILL + _QUICKEST * np.tanh(speed / _MOVING / _QUICKEST)
        clock = np.cumsum(np.concatenate([[self._clock], rate * np.diff(times, prepend=before)]))
        self._begin(np.concatenate([[before], times]), clock)
        self._time, self._clock = float(times[-1]), float(clock[-1])
        weight = np.full(len(times), self._settled)
        running = self._running
        self._running = []
        for begin, change in running:
            start = int(np.searchsorted(clock[1:], begin, side="right"))
            a = np.maximum(clock[1 + start:] - begin, 0.0) / _TAU
            weight[start:] += change * (1.0 - (1.0 + a + a * a / 2.0) * np.exp(-a))
            # Complete to the last bit: it joins the settled weight, and no longer costs anything.
            if self._clock - begin > _DONE * _TAU:
                self._settled += change  # from the next step on
            else:
                self._running.append((begin, change))
        return weight

    def _begin(self, times: Array, clock: Array) -> None:
        """Start the shifts whose time has come."""
        while (begin := float(self._shifts.begins(np.array([self._next]))[0])) <= times[-1]:
            roll = float(self._shifts.posture(self._next)[0])
            if abs(roll) > CROSSES:
                self._side = float(np.sign(roll))
            target = self._side * (_LEAST + _MORE * min(abs(roll), _MOST))
            self._running.append((float(np.interp(begin, times, clock)), target - self._target))
            self._target, self._next = target, self._next + 1


# --------------------------------------------------------------------------------------------------- the feet

SIDES = (("Left", 1.0), ("Right", -1.0))
"""Each foot, and the sign of its side (the character's left is +X)."""
UP = np.array([0.0, 1.0, 0.0])
SOLE = 0.020
"""Height of the joint in the ball of the foot above the floor, metres."""
FOOT_BACK = 0.030
"""Metres that a foot rests behind its hip socket: the body's weight is ahead of the ankles."""

_FOOT_OUT, _TOES_OUT = 0.008, 15.0
"""Resting place of a foot: metres outside its hip socket, and degrees that the toes point outwards."""
_SPREAD = (0.016, 0.030, 4.0)
"""Standard deviation of foot placements about it: metres sideways and ahead, degrees."""
_STEPS = 0.45
"""Share of the foot-freeing weight shifts that are followed by a step."""
_STEP_AFTER, _STEP_LASTS = 1.35, 0.68
"""Seconds from the start of the shift to the start of the step, and duration of the step."""
_STEP_NEEDS = 4.4
"""Least time to the next shift for a step to be made, seconds."""
_OVER_IN, _OVER_OUT = 1.5, 2.2
"""Seconds in which the hips move over the standing foot before a step, and back after it."""
_NEAR, _WIDE = 0.030, 0.085
"""Least and greatest distance of a step, metres."""
_LIFT, _HEEL = 0.028, 17.0
"""Lift of the ball of the foot in metres, and rise of the heel before it in degrees."""
_LIFTED, _LANDED, _HEEL_DOWN = 0.20, 0.95, 0.85
"""Shares of a step at which the ball leaves the floor, is back, and the heel is level again."""
_TRIES = 8

_CHANNEL = 1 << 10
"""First random channel, distinct from those of idle motion and phrases."""
_STEP_CHANNEL, _PLACE_CHANNEL = _CHANNEL, _CHANNEL + 1


@dataclass(frozen=True)
class Feet:
    """Both feet over time. ankles: [T, 2, 3] metres; yaw, heel: [T, 2] radians of the toes to the character's left, and
    of the heel raised over the ball; middles: [T, 2, 2] metres along X and Z, their places as the hips follow them."""

    ankles: Array
    yaw: Array
    heel: Array
    middles: Array


class Steps:
    """Placement of the feet over time, a function of seed and time."""

    def __init__(self, seed: int, shifts: Shifts) -> None:
        """shifts: `weight_shifts` of the seed."""
        self.seed, self._weight = seed, shifts
        ball = WHOLE_BODY.offsets[WHOLE_BODY.index("LeftToeBase")]
        self._socket = abs(float(WHOLE_BODY.offsets[WHOLE_BODY.index("LeftUpLeg")][0]))
        self._to_ball = np.array([0.0, ball[1], ball[2]])
        self._next_shift = 0
        self._stands = [self._places(foot, -1)[0] for foot in range(len(SIDES))]
        self._lands = list(self._stands)  # after the last step that is known
        self._steps: list[tuple[float, int, Array]] = []
        """Start in seconds, foot, and the change of its place."""

    def over(self, times: Array) -> tuple[Array, Array]:
        """[T] how far the hips are over one leg, 0 to 1, and [T] over which (the sign of its side)."""
        self._extend(float(times.max()))
        held, side = np.zeros(len(times)), np.zeros(len(times))
        for begin, foot, _ in self._steps:
            # A tenth of a second into the step the foot leaves the floor: the hips are over the other one by then.
            early, late = begin + 0.1 - _OVER_IN, begin + _STEP_LASTS + _OVER_OUT
            near = slice(*np.searchsorted(times, [early, late]))
            held[near] = eased((times[near] - early) / _OVER_IN) - eased((times[near] - late + _OVER_OUT) / _OVER_OUT)
            side[near] = -SIDES[foot][1]
        return held, side

    def feet(self, times: Array) -> Feet:
        """Both feet at rising `times` [T], seconds."""
        self._extend(float(times.max()))
        ball = np.tile(self._stands, (len(times), 1, 1))  # along X and Z, yaw
        slow, lift, heel = ball.copy(), np.zeros(ball.shape[:2]), np.zeros(ball.shape[:2])
        for begin, foot, change in self._steps:
            s = (times - begin) / _STEP_LASTS
            flight = (s - _LIFTED) / (_LANDED - _LIFTED)
            ball[:, foot] += eased(flight)[:, None] * change
            slow[:, foot] += eased((times - begin) / (_STEP_LASTS + _OVER_OUT))[:, None] * change
            lift[:, foot] += _bump(flight)
            heel[:, foot] += _bump(s / _HEEL_DOWN)
        yaw, heel = np.radians(ball[..., 2]), np.radians(_HEEL) * heel
        turn = rotation.multiply(rotation.from_euler(yaw[..., None], "Y"), rotation.from_euler(heel[..., None], "X"))
        flat = np.stack([ball[..., 0], SOLE + _LIFT * lift, ball[..., 1]], -1)
        # The ball is placed; the ankle is behind and above it, higher with the heel raised.
        behind = rotation.rotate(rotation.from_euler(np.radians(slow[..., 2:]), "Y"), self._to_ball)[..., [0, 2]]
        return Feet(flat - rotation.rotate(turn, self._to_ball), yaw, heel, slow[..., :2] - behind)

    def forget(self, before: float) -> None:
        """Drop steps completed before this time in seconds, so that memory stays bounded."""
        while self._steps and self._steps[0][0] + _STEP_LASTS + _OVER_OUT < before:
            _, foot, change = self._steps.pop(0)
            self._stands[foot] = self._stands[foot] + change

    def _extend(self, until: float) -> None:
        """Generate the steps that begin by `until` seconds."""
        style = self._weight.style
        while (self._next_shift - style.jitter) * style.every <= until + _STEP_NEEDS:
            shift, self._next_shift = self._next_shift, self._next_shift + 1
            begin, following = self._weight.begins(np.array([shift, shift + 1]))
            weight = float(self._weight.posture(shift)[0])
            chance = float(uniform(self.seed, _STEP_CHANNEL, np.array([shift]))[0])
            # A step needs a foot that is freed, and time to land before the next shift.
            if abs(weight) < CROSSES or following - begin < _STEP_NEEDS or begin < 1.0 or chance > _STEPS:
                continue
            foot = 1 if weight > 0 else 0
            tries = self._places(foot, shift)
            away = np.linalg.norm((tries - self._lands[foot])[:, :2], axis=1)
            fits = np.flatnonzero((away >= _NEAR) & (away <= _WIDE))
            if len(fits):
                self._steps.append((begin + _STEP_AFTER, foot, tries[fits[0]] - self._lands[foot]))
                self._lands[foot] = tries[fits[0]]

    def _places(self, foot: int, number: int) -> Array:
        """[_TRIES, 3] candidate places of the ball of a foot: metres along X and Z, and degrees of yaw."""
        sign = SIDES[foot][1]
        where = (2 * (number + 1) + foot) * _TRIES + np.arange(_TRIES)
        offsets = np.clip(normal(self.seed, _PLACE_CHANNEL, where[:, None] * 3 + np.arange(3)), -2.0, 2.0) * _SPREAD
        yaw = sign * (_TOES_OUT + offsets[:, 2])
        ankle = np.stack([sign * (self._socket + (_FOOT_OUT + offsets[:, 0])), np.zeros(_TRIES),
                          offsets[:, 1] - FOOT_BACK], axis=-1)
        ball = ankle + rotation.rotate(rotation.from_euler(np.radians(yaw)[..., None], "Y"), self._to_ball)
        return np.stack([ball[:, 0], ball[:, 2], yaw], axis=-1)


def _bump(share: Array) -> Array:
    """0 to 1 and back with continuous acceleration: 64 s^3 (1 - s)^3."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(64.0 * (s * (1.0 - s)) ** 3)


# --------------------------------------------------------------------------------------------------- the legs

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

_SEAT_TOES = 12.0
"""Degrees that the feet of a seated character point outward."""

_SWAY_CHANNEL = (1 << 10) + 8
_NOISE_STEPS = np.array([seconds for _, seconds in (*_SWAY, *_STIRS, _ROLLS)] + [_GIVES[2]])
_AHEAD = np.array([0.0, 0.0, 1.0])
_LEGS = np.array([[WHOLE_BODY.index(side + part) for side, _ in SIDES] for part in ("UpLeg", "Leg", "Foot", "ToeBase")])
_SPINE = WHOLE_BODY.index("Spine")


def with_legs(motion: Motion, seed: int) -> Motion:
    """The motion on standing legs: travel and small turns of the hips and all leg joints are synthesised.

    motion: on the default skeleton in any of its sizes, facing +Z as generated; the rotation of the hips is used, the
    path of the root is not. seed: the same as for the performance, so that legs and idle motion agree. The floor is
    Y = 0. Every joint from the chest up keeps its world rotation.
    """
    return Stance(seed, motion.fps).step(motion)


def seated(motion: Motion) -> Motion:
    """The motion on seated legs: thighs level, shins vertical, feet flat on the floor, hips still.

    See `with_legs` for the input. The spine takes the rotation of the hips, so the upper body keeps its pose.
    """
    body = resized(motion, WHOLE_BODY)
    rotations = _with_hips(body.rotations, np.tile([1.0, 0.0, 0.0, 0.0], (len(body), 1)))
    root = np.zeros((len(body), 3))
    socket, ball = (WHOLE_BODY.offsets[WHOLE_BODY.index("Left" + part)][1] for part in ("UpLeg", "ToeBase"))
    root[:, 1] = SOLE - ball + leg_lengths(WHOLE_BODY, "Left")[1] - socket
    # Thighs level and a little apart; shins, feet and toes upright and turned out.
    level = rotation.from_euler(np.radians([[-90.0]]), "X")
    knees, toes = (rotation.from_euler(np.radians([[sign * out] for _, sign in SIDES]), "Y")
                   for out in (SEAT_SPREAD, _SEAT_TOES))
    _hang(rotations, [np.tile(turn, (len(body), 1, 1)) for turn in (rotation.multiply(knees, level), toes, toes, toes)])
    return _on_legs(body, rotations, root, rotations[:0])


# ---------------------------------------------------------------------------------------------------- the body

class _LowPass:
    """Causal low-pass: three one-pole filters with a time constant in seconds."""

    def __init__(self, seconds: float, fps: float) -> None:
        share = 1.0 - math.exp(-1.0 / (fps * seconds))
        self._sections = np.tile([share, 0.0, 0.0, 1.0, share - 1.0, 0.0], (3, 1))
        self._state: Array | None = None

    def __call__(self, values: Array) -> Array:
        """[T, D] the filtered next values [T, D]; the state starts at the first value."""
        from scipy.signal import sosfilt, sosfilt_zi

        if self._state is None:
            self._state = sosfilt_zi(self._sections)[..., None] * values[0]
        filtered, self._state = sosfilt(self._sections, values, axis=0, zi=self._state)
        return np.asarray(filtered)


@dataclass(frozen=True)
class _Drives:
    """What the generated body does, frame by frame, in metres and degrees.

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


class _Follower:
    """Follows the generated body in pieces."""

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self._roll, self._habit = _LowPass(_FOLLOWS, fps), _LowPass(_HABIT, fps)
        self._quick, self._slow = _LowPass(_QUICKLY, fps), _LowPass(_SLOWLY, fps)
        self._last: Array | None = None

    def step(self, body: Motion) -> _Drives:
        """The drives in the next frames of a body on the skeleton of the whole body."""
        pose = posed(body.skeleton, body.rotations, ("Spine3", "LeftHand", "RightHand"))
        # The first column of a turn is where the body's left points to.
        roll = np.degrees(np.arcsin(np.clip(pose.turns["Hips"][:, 1, 0], -1.0, 1.0)))
        left = pose.turns["Spine3"][..., 0]
        yaw = np.degrees(np.arctan2(-left[:, 2], left[:, 0]))
        rest = sum(WHOLE_BODY.offsets[WHOLE_BODY.index(name)] for name in ("Spine", "Spine1", "Spine2", "Spine3"))
        places = np.stack([pose.places["Spine3"] - rest, pose.places["LeftHand"], pose.places["RightHand"]], axis=1)
        slow = self._roll(roll[:, None])
        # The frame before is kept, so that pieces of any length give the same speeds.
        moves = np.diff(places, axis=0, prepend=places[:1] if self._last is None else self._last) * self._fps
        self._last = places[-1:]
        squares = np.sum(moves**2, axis=-1)
        # One filter takes all that is followed at the same pace: yaw, place and speed of the chest, speed of the hands.
        smooth = self._quick(np.column_stack([yaw, places[:, 0], np.sqrt(squares[:, 0]), squares[:, 1:].mean(axis=1)]))
        lean = self._slow(np.column_stack([smooth[:, 1:4], smooth[:, 5]]))
        return _Drives(roll, slow[:, 0], self._habit(slow)[:, 0], smooth[:, 0], smooth[:, 1:4] - lean[:, :3],
                       lean[:, :3], smooth[:, 4], smooth[:, 5], lean[:, 3] / (lean[:, 3] + _ACTIVE))


class Stance:
    """Legs for one performance in pieces: `step` takes frames as they come."""

    def __init__(self, seed: int, fps: float) -> None:
        self.seed, self.fps = seed, fps
        self._shifts = weight_shifts(seed)
        self._steps, self._weight = Steps(seed, self._shifts), LegWeight(seed, self._shifts)
        self._follower = _Follower(fps)
        self._frames = 0
        self._last = np.zeros((0, len(WHOLE_BODY), 4))

    def fork(self) -> Stance:
        """A copy that continues independently."""
        # The shifts depend on the seed alone, so copies may share what was computed of them.
        return copy.deepcopy(self, {id(self._shifts): self._shifts})

    def step(self, motion: Motion) -> Motion:
        """The next frames [T] of the body with legs, see `with_legs`."""
        body = resized(motion, WHOLE_BODY)
        times = (self._frames + np.arange(len(body))) / self.fps
        self._steps.forget(self._frames / self.fps - 1.0)
        self._frames += len(body)
        random = noise(self.seed, _SWAY_CHANNEL + np.arange(len(_NOISE_STEPS)), times, _NOISE_STEPS)
        held, side = self._steps.over(times)
        feet = self._steps.feet(times)
        drives = self._follower.step(body)
        # g as in the module's equation, but over the standing leg during a step.
        u = (self._weight.step(times, drives.speed) + (drives.slow_roll - drives.habit) / _ROLL_UNIT) / _BOTH
        g = (1.0 - held) * u / np.sqrt(1.0 + u * u) + held * side
        rolled = _ROLLED * g + _ROLLS[0] * random[:, 6] - drives.habit - _QUICK * (drives.roll - drives.slow_roll)
        yawed = _TURNED * g + _within(_YAWS * drives.yaw, _FARTHEST_YAW)
        turn = rotation.from_exponential_map(np.radians(np.stack([0.0 * rolled, yawed, rolled], -1)))
        hips = rotation.multiply(turn, body.rotations[:, 0])
        rotations = _with_hips(body.rotations, hips)
        root = np.zeros((len(body), 3))
        root[:, [0, 2]] = self._travelled(times, g, drives, random, feet, held, side)
        _stand(rotations, root, feet, self._given(times, drives, random))
        motion = _on_legs(body, rotations, root, self._last)
        self._last = motion.rotations[-1:]
        return motion

    def _travelled(self, times: Array, g: Array, drives: _Drives, random: Array, feet: Feet, held: Array, side: Array
                   ) -> Array:
        """[T, 2] position of the hips along X and Z. g: see the module; held, side: see `Steps.over`."""
        sway = random[:, :6] * np.array([size for size, _ in (*_SWAY, *_STIRS)])
        sway[:, 4:] *= drives.active[:, None]
        across, ahead = sway[:, [0, 1, 4]].sum(axis=1), sway[:, [2, 3, 5]].sum(axis=1)
        leans = np.array(_WITH_LEAN) * drives.lean[:, [0, 2]] - np.array(_COUNTERS) * drives.quick[:, [0, 2]]
        # Between the feet by the weight, or over one of them while the other steps.
        left, right = feet.middles[:, 0], feet.middles[:, 1]
        both, one = (left + right) / 2.0, np.where(side[:, None] > 0, left, right)
        both[:, 0] += _within(_TRAVEL * g + across + leans[:, 0], _FAR)
        one[:, 0] += across - _INSIDE * side
        way = both + held[:, None] * (one - both)
        pitch = self._shifts.at(times)[:, 1]
        way[:, 1] += FOOT_BACK + _within(ahead + leans[:, 1] - _PITCHED_BACK * pitch, _LEANS)
        return way

    def _given(self, times: Array, drives: _Drives, random: Array) -> Array:
        """[T] metres, above 0, by which the knees give more than they must."""
        strokes = _STROKE * drives.energy / (drives.energy + _STROKE_ENERGY)
        give = _GIVEN + (_GIVES[0] + _GIVES[1] * drives.active) * random[:, 7] + strokes - _DIPS * drives.quick[:, 1]
        breathed = _BREATH_DIPS * (1.0 - breath(self.seed, times)) / 2.0
        return np.asarray(_SOFTLY * np.logaddexp(0.0, give / _SOFTLY) + breathed)


def _stand(rotations: Array, root: Array, feet: Feet, give: Array) -> None:
    """Set the hips' height in `root` [T, 3] and the legs in `rotations` [T, J, 4]."""
    socket = rotation.rotate(rotations[:, :1], WHOLE_BODY.offsets[_LEGS[0]])
    lengths = leg_lengths(WHOLE_BODY, "Left")
    # Pythagoras: how high a leg of full length holds the hips, given how far its foot is aside.
    level = np.sum((root[:, None] + socket - feet.ankles)[..., [0, 2]] ** 2, axis=-1)
    reach = feet.ankles[..., 1] + np.sqrt(np.maximum((_BENT * sum(lengths))**2 - level, 0.0)) - socket[..., 1]
    # A soft minimum of the heights that the two legs reach.
    root[:, 1] = -_SOFT * np.logaddexp(*(-reach / _SOFT).T) - give
    toes = rotation.from_euler(feet.yaw[..., None], "Y")
    thigh, shin = bent_leg(feet.ankles - root[:, None] - socket, rotation.rotate(toes, _AHEAD), lengths)
    _hang(rotations, [thigh, shin, rotation.multiply(toes, rotation.from_euler(feet.heel[..., None], "X")), toes])


def _within(values: Array, most: float) -> Array:
    """Values compressed smoothly into -most to most, nearly unchanged below half of it."""
    return np.asarray(most * np.tanh(values / most))


def _with_hips(rotations: Array, hips: Array) -> Array:
    """A copy of the rotations [T, J, 4] with these hips [T, 4]; the spine turns back, so that the upper body stays."""
    out = rotations.copy()
    spine = rotation.multiply(rotations[:, 0], rotations[:, _SPINE])
    out[:, 0], out[:, _SPINE] = hips, rotation.multiply(rotation.conjugate(hips), spine)
    return out


def _hang(rotations: Array, world: Sequence[Array]) -> None:
    """Set both legs in `rotations` [T, J, 4] from world rotations [T, 2, 4] of thighs, shins, feet and toes."""
    above = rotations[:, :1]
    for joints, turn in zip(_LEGS, world, strict=True):
        rotations[:, joints] = rotation.multiply(rotation.conjugate(above), turn)
        above = turn


def _on_legs(body: Motion, rotations: Array, root: Array, before: Array) -> Motion:
    """The body with these rotations and root positions; its legs are marked as filled in. before: [0 or 1, J, 4] the
    previous frame, for continuous quaternion signs."""
    filled = {*body.filled, *LEG_JOINTS}
    rotations = rotation.continuous(np.concatenate([before, rotations]))[len(before):]
    return replace(body, rotations=rotations, root_positions=root,
                   absent=tuple(name for name in body.absent if name not in LEG_JOINTS),
                   filled=tuple(name for name in WHOLE_BODY.names if name in filled))
