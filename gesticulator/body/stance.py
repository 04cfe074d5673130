"""Stance: legs, standing or seated, for a performance generated from the hips up.

The motion of a person who stands and talks: weight moves from one leg to the other every few seconds, the hips over the
bearing leg, that side of the pelvis higher, the other knee bent; now and then the free foot is set down elsewhere. All
of it is a function of the seed, the time and the generated hips up to that time, so stream and file are identical.

The weight w is that of the idle motion (`life.weight_shifts`), which rolls the hips a little, combined with the
low-passed roll r of the generated hips:

    u = (w + (r - habit of r) / r0) / u0        g(u) = u / sqrt(1 + u^2), between -1 (right leg) and 1 (left leg)

The hips travel sideways by A g, and roll and turn with g instead of their habitual roll; the spine compensates, so that
the upper body keeps its place in the room. The hips move back a little when the chest comes forward, and are as high as
both legs reach with bent knees: a soft minimum, since a fully stretched knee snaps. Feet are placed and legs follow by
inverse kinematics, so a planted foot does not slide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.motion import rotation
from data_module.motion.skeletons import LEG_JOINTS, WHOLE_BODY, resized
from data_module.motion.standing_legs import bent_leg, leg_lengths
from data_module.types import Array, Motion, Skeleton
from gesticulator.body.life import breath, eased, noise, normal, uniform, weight_shifts

__all__ = ["Stance", "seated", "with_legs"]

SIDES = (("Left", 1.0), ("Right", -1.0))
"""Each foot, and the sign of its side (the character's left is +X)."""

_LEG = 0.825
"""Distance from hip to ankle of the character that the lengths below are for, metres; others are scaled."""
_SOLE = 0.020
"""Height of the joint in the ball of the foot above the floor, metres."""
_FOOT_OUT, _FOOT_BACK, _TOES_OUT = 0.008, 0.030, 9.0
"""Resting place of a foot: metres outside its hip socket and behind it (the body's weight is ahead of the ankles), and
degrees that the toes point outwards."""
_SPREAD = (0.016, 0.026, 4.0)
"""Standard deviation of foot placements about it: metres sideways and ahead, degrees."""
_BENT = 0.997
"""Largest used share of a leg's length: the knee is then bent by 9 degrees."""
_SOFT = 0.004
"""Width of the soft minimum between the legs' heights, metres."""

_TRAVEL, _FAR = 0.068, 0.085
"""Largest sideways travel of the hips, metres: by weight alone, and in total."""
_LEANS = 0.045
"""Largest travel of the hips ahead or back, metres."""
_ROLL_UNIT = 3.5
"""Generated roll, degrees, equivalent to one unit of weight of the idle motion."""
_BOTH = 0.65
"""Units of weight on a leg below which both bear weight: people mostly stand on one leg or the other."""
_ROLLED, _TURNED = 2.2, 2.6
"""Degrees of roll and yaw with all weight on one leg: the free side drops and comes ahead."""
_BALANCE = 0.25
"""Metres that the hips move opposite to each metre that the chest moves forward or sideways."""
_FOLLOWS = 0.22
"""Time constant of the three-stage low-pass by which weight follows the generated body, seconds: slower than
gestures."""
_HABIT = 2.0
"""Time constant of the three-stage low-pass by which a lasting roll becomes habitual, taken by the spine, seconds."""
_QUICK = 0.5
"""Share of faster roll taken by the spine: planted legs do not let the hips rock, and knees would shake."""
_PITCHED_BACK = 0.006
"""Metres that the hips move back for each degree that the idle motion tilts them forward."""
_SWAY = ((0.0045, 1.9), (0.0016, 0.8), (0.0060, 2.2), (0.0016, 0.9))
"""Postural sway: metres and step in seconds of the noise, two sideways and two ahead."""
_BREATH_DIPS = 0.0012
"""Metres that the hips sink on exhaling."""

_STEPS = 0.45
"""Share of the foot-freeing weight shifts that are followed by a step."""
_FREE = 0.45
"""Units of weight on the other leg at which a foot is free, see `life.weight_shifts`."""
_STEP_AFTER, _STEP_LASTS = 1.35, 0.68
"""Seconds from the start of the shift to the start of the step, and duration of the step."""
_STEP_NEEDS = 4.4
"""Least time to the next shift for a step to be made, seconds."""
_INSIDE, _OVER_IN, _OVER_OUT = 0.022, 1.5, 2.2
"""Position of the hips during a step: metres inside of the standing ankle, and seconds to move there and back."""
_NEAR, _WIDE = 0.030, 0.085
"""Least and greatest distance of a step, metres."""
_LIFT, _HEEL = 0.028, 17.0
"""Lift of the ball of the foot in metres, and rise of the heel before it in degrees."""
_LIFTED, _LANDED, _HEEL_DOWN = 0.20, 0.95, 0.85
"""Shares of a step at which the ball leaves the floor, is back, and the heel is level again."""
_TRIES = 8

_SEAT_SPREAD, _SEAT_TOES = 7.0, 12.0
"""Degrees that the thighs and feet of a seated character point outwards."""

_CHANNEL = 1 << 10
"""First random channel, distinct from those of idle motion and phrases."""
_STEP_CHANNEL, _PLACE_CHANNEL, _SWAY_CHANNEL = _CHANNEL, _CHANNEL + 1, _CHANNEL + 8
_UP, _AHEAD = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_TRUNK = ("Spine", "Spine1", "Spine2", "Spine3")


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
    rotations[:, 0], rotations[:, WHOLE_BODY.index("Spine")] = _counter_turned(body, still)
    root = np.zeros((len(body), 3))
    _, shin = leg_lengths(skeleton, "Left")
    root[:, 1] = _ankle_height(skeleton) + shin - skeleton.offsets[skeleton.index("LeftUpLeg")][1]
    level = _about(np.array([1.0, 0.0, 0.0]), -90.0)
    for side, sign in SIDES:
        knees, toes = _about(_UP, sign * _SEAT_SPREAD), _about(_UP, sign * _SEAT_TOES)
        world = [np.tile(turn, (len(body), 1)) for turn in (rotation.multiply(knees, level), toes, toes, toes)]
        _hang(rotations, still, side, world)
    return _on_legs(body, rotations, root, skeleton, rotations[:0])


# ---------------------------------------------------------------------------------------------------- the feet

@dataclass(frozen=True)
class FootPath:
    """A foot over time. ankles: [T, 3] metres; yaw, heel: [T] radians of the toes to the character's left, and of the
    heel raised over the ball; middle: [T, 2] metres along X and Z, the foot's place as the hips follow it."""

    ankles: Array
    yaw: Array
    heel: Array
    middle: Array


class Steps:
    """Placement of the feet over time, a function of seed and time."""

    def __init__(self, seed: int, scale: float, socket: float, foot: Array) -> None:
        """scale: of all lengths; socket: metres from the middle to a hip socket; foot: [3] metres from the ankle to the
        ball of a foot whose toes point ahead."""
        self.seed, self.scale, self.socket, self.foot = seed, scale, socket, foot
        self._weight = weight_shifts(seed)
        self._next_shift = 0
        self._placed = [[(-1, self._places(foot, -1)[0])] for foot in range(len(SIDES))]

    def begins(self, shift: int) -> float:
        """Start of the step after a weight shift, seconds."""
        return float(self._weight.begins(np.array([shift]))[0]) + _STEP_AFTER

    def over(self, times: Array) -> tuple[Array, Array]:
        """[T] how far the hips are over one leg, 0 to 1, and [T] over which (the sign of its side)."""
        self._extend(float(times.max()))
        held, side = np.zeros(len(times)), np.zeros(len(times))
        for foot, (_, sign) in enumerate(SIDES):
            for shift, _ in self._placed[foot][1:]:
                begin = self.begins(shift)
                early, late = begin + 0.1 - _OVER_IN, begin + _STEP_LASTS + _OVER_OUT
                near = slice(*np.searchsorted(times, [early, late]))
                way = eased((times[near] - early) / _OVER_IN) - eased((times[near] - late + _OVER_OUT) / _OVER_OUT)
                held[near], side[near] = way, -sign
        return held, side

    def path(self, foot: int, times: Array) -> FootPath:
        """Foot 0 (left) or 1 (right) at rising `times` [T], seconds."""
        self._extend(float(times.max()))
        placed = self._placed[foot]
        ball = np.tile(placed[0][1], (len(times), 1))  # along X and Z, yaw
        slow, lift, heel = ball.copy(), np.zeros(len(times)), np.zeros(len(times))
        for (_, before), (shift, after) in zip(placed[:-1], placed[1:], strict=True):
            begin = self.begins(shift)
            s = (times - begin) / _STEP_LASTS
            flight = (s - _LIFTED) / (_LANDED - _LIFTED)
            ball += eased(flight)[:, None] * (after - before)
            slow += eased((times - begin) / (_STEP_LASTS + _OVER_OUT))[:, None] * (after - before)
            lift += _bump(flight)
            heel += _bump(s / _HEEL_DOWN)
        yaw, heel = np.radians(ball[:, 2]), np.radians(_HEEL) * heel
        turn = rotation.multiply(_abouts(_UP, yaw), _abouts(np.array([1.0, 0.0, 0.0]), heel))
        flat = np.stack([ball[:, 0], _SOLE * self.scale + _LIFT * self.scale * lift, ball[:, 1]], -1)
        # The ball is placed; the ankle is behind and above it, higher with the heel raised.
        return FootPath(flat - rotation.rotate(turn, self.foot), yaw, heel,
                        slow[:, :2] - rotation.rotate(_abouts(_UP, np.radians(slow[:, 2])), self.foot)[:, [0, 2]])

    def forget(self, before: float) -> None:
        """Drop steps completed before this time in seconds, so that memory stays bounded."""
        for placed in self._placed:
            while len(placed) > 1 and self.begins(placed[1][0]) + _STEP_LASTS + _OVER_OUT < before:
                del placed[0]

    def _extend(self, until: float) -> None:
        """Generate the steps that begin by `until` seconds."""
        style = self._weight.style
        while (self._next_shift - style.jitter) * style.every <= until + _STEP_NEEDS:
            shift, self._next_shift = self._next_shift, self._next_shift + 1
            begin, following = self._weight.begins(np.array([shift, shift + 1]))
            weight = float(self._weight.posture(shift)[0])
            chance = float(uniform(self.seed, _STEP_CHANNEL, np.array([shift]))[0])
            if abs(weight) < _FREE or following - begin < _STEP_NEEDS or begin < 1.0 or chance > _STEPS:
                continue
            foot = 1 if weight > 0 else 0
            before = self._placed[foot][-1][1]
            tries = self._places(foot, shift)
            away = np.linalg.norm((tries - before)[:, :2], axis=1) / self.scale
            fits = np.flatnonzero((away >= _NEAR) & (away <= _WIDE))
            if len(fits):
                self._placed[foot].append((shift, tries[fits[0]]))

    def _places(self, foot: int, number: int) -> Array:
        """[_TRIES, 3] candidate places of the ball of a foot: metres along X and Z, and degrees of yaw."""
        sign = SIDES[foot][1]
        where = (2 * (number + 1) + foot) * _TRIES + np.arange(_TRIES)
        offsets = np.clip(normal(self.seed, _PLACE_CHANNEL, where[:, None] * 3 + np.arange(3)), -2.0, 2.0) * _SPREAD
        yaw = sign * (_TOES_OUT + offsets[:, 2])
        ankle = np.stack([sign * (self.socket + self.scale * (_FOOT_OUT + offsets[:, 0])), np.zeros(_TRIES),
                          self.scale * (offsets[:, 1] - _FOOT_BACK)], axis=-1)
        ball = ankle + rotation.rotate(_abouts(_UP, np.radians(yaw)), self.foot)
        return np.stack([ball[:, 0], ball[:, 2], yaw], axis=-1)


def _bump(share: Array) -> Array:
    """0 to 1 and back with continuous acceleration: 64 s^3 (1 - s)^3."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(64.0 * (s * (1.0 - s)) ** 3)


# ---------------------------------------------------------------------------------------------------- the body

class _LowPass:
    """Causal low-pass: three one-pole filters with a time constant in seconds."""

    def __init__(self, seconds: float, fps: float) -> None:
        self._share = 1.0 - math.exp(-1.0 / (fps * seconds))
        self._states: list[Array] | None = None

    def __call__(self, values: Array) -> Array:
        """[T, D] the filtered next values [T, D]; the state starts at the first value."""
        from scipy.signal import lfilter

        if self._states is None:
            self._states = [(1.0 - self._share) * values[:1]] * 3
        for number, state in enumerate(self._states):
            values, self._states[number] = lfilter([self._share], [1.0, self._share - 1.0], values, axis=0, zi=state)
        return values


class Stance:
    """Legs for one performance in pieces: `step` takes frames as they come."""

    def __init__(self, seed: int, fps: float, skeleton: Skeleton = WHOLE_BODY) -> None:
        if skeleton.names != WHOLE_BODY.names:
            raise ValueError(f"the legs' skeleton has {len(skeleton)} joints, not those of the whole body")
        self.skeleton, self.seed, self.fps = skeleton, seed, fps
        self.scale = sum(leg_lengths(skeleton, "Left")) / _LEG
        self._weight = weight_shifts(seed)
        socket, ball = (skeleton.offsets[skeleton.index("Left" + part)] for part in ("UpLeg", "ToeBase"))
        self.steps = Steps(seed, self.scale, abs(float(socket[0])), np.array([0.0, ball[1], ball[2]]))
        self._body, self._habit = _LowPass(_FOLLOWS, fps), _LowPass(_HABIT, fps)
        self._frames = 0
        self._last = np.zeros((0, len(WHOLE_BODY), 4))

    def step(self, motion: Motion) -> Motion:
        """The next frames [T] of the body with legs, see `with_legs`."""
        body = resized(motion, WHOLE_BODY)
        times = (self._frames + np.arange(len(body))) / self.fps
        self._frames += len(body)
        self.steps.forget(float(times[0]) - 1.0)
        rotations = body.rotations.copy()
        left = rotation.rotate(body.rotations[:, 0], np.array([1.0, 0.0, 0.0]))
        roll = np.degrees(np.arcsin(np.clip(left[:, 1], -1.0, 1.0)))
        slow = self._body(np.column_stack([roll, self._chest(body)]))
        habit = self._habit(slow[:, :1])[:, 0]
        weight = self._weight.at(times)
        feet = [self.steps.path(foot, times) for foot in range(len(SIDES))]
        u = (weight[:, 0] + (slow[:, 0] - habit) / _ROLL_UNIT) / _BOTH
        held, side = self.steps.over(times)
        g = (1.0 - held) * u / np.sqrt(1.0 + u * u) + held * side
        rolled = _ROLLED * g - habit - _QUICK * (roll - slow[:, 0])
        turn = rotation.from_exponential_map(np.radians(np.stack([0.0 * g, _TURNED * g, rolled], -1)))
        hips = rotation.multiply(turn, body.rotations[:, 0])
        rotations[:, 0], rotations[:, WHOLE_BODY.index("Spine")] = _counter_turned(body, hips)
        root = self._hips(times, feet, g, weight[:, 1], slow[:, 1:])
        self._stand(rotations, root, hips, feet, times)
        motion = _on_legs(body, rotations, root, self.skeleton, self._last)
        self._last = motion.rotations[-1:]
        return motion

    def _chest(self, body: Motion) -> Array:
        """[T, 2] displacement of the chest from its rest over the hips along X and Z, in metres of the reference
        character."""
        world, place, rest = body.rotations[:, 0], np.zeros((len(body), 3)), np.zeros(3)
        for name in _TRUNK:
            joint = WHOLE_BODY.index(name)
            place = place + rotation.rotate(world, self.skeleton.offsets[joint])
            rest = rest + self.skeleton.offsets[joint]
            world = rotation.multiply(world, body.rotations[:, joint])
        return (place - rest)[:, [0, 2]] / self.scale

    def _hips(self, times: Array, feet: Sequence[FootPath], g: Array, pitch: Array, lean: Array) -> Array:
        """[T, 3] position of the hips, without height. pitch: [T] degrees; lean: [T, 2] of the chest."""
        held, side = self.steps.over(times)
        sizes, seconds = np.array(_SWAY).T
        sway = noise(self.seed, _SWAY_CHANNEL + np.arange(len(_SWAY)), times, seconds) * sizes
        across, ahead = sway[:, :2].sum(axis=1), sway[:, 2:].sum(axis=1)
        both = (feet[0].middle + feet[1].middle) / 2.0
        both[:, 0] += self.scale * _within(_TRAVEL * g + across - _BALANCE * lean[:, 0], _FAR)
        one = np.where(side[:, None] > 0, feet[0].middle, feet[1].middle)
        one[:, 0] += self.scale * (across - _INSIDE * side)
        root = np.zeros((len(times), 3))
        root[:, [0, 2]] = both + held[:, None] * (one - both)
        leans = ahead - _PITCHED_BACK * pitch - _BALANCE * lean[:, 1]
        root[:, 2] += self.scale * (_FOOT_BACK + _within(leans, _LEANS))
        return root

    def _stand(self, rotations: Array, root: Array, hips: Array, feet: Sequence[FootPath], times: Array) -> None:
        """Set the hips' height and the legs' rotations."""
        sockets, reaches = [], []
        for (side, _), foot in zip(SIDES, feet, strict=True):
            socket = rotation.rotate(hips, self.skeleton.offsets[self.skeleton.index(side + "UpLeg")])
            level = np.sum((root + socket - foot.ankles)[:, [0, 2]] ** 2, axis=-1)
            longest = _BENT * sum(leg_lengths(self.skeleton, side))
            reaches.append(foot.ankles[:, 1] + np.sqrt(np.maximum(longest**2 - level, 0.0)) - socket[:, 1])
            sockets.append(socket)
        soft = _SOFT * self.scale
        root[:, 1] = -soft * np.logaddexp(-reaches[0] / soft, -reaches[1] / soft)
        root[:, 1] -= self.scale * _BREATH_DIPS * (1.0 - breath(self.seed, times)) / 2.0
        for (side, _), foot, socket in zip(SIDES, feet, sockets, strict=True):
            toes = _abouts(_UP, foot.yaw)
            thigh, shin = bent_leg(foot.ankles - root - socket, rotation.rotate(toes, _AHEAD),
                                   leg_lengths(self.skeleton, side))
            raised = rotation.multiply(toes, _abouts(np.array([1.0, 0.0, 0.0]), foot.heel))
            _hang(rotations, hips, side, [thigh, shin, raised, toes])


def _within(values: Array, most: float) -> Array:
    """Values compressed smoothly into -most to most, nearly unchanged below half of it."""
    return np.asarray(most * np.tanh(values / most))


def _about(axis: Array, degrees: float) -> Array:
    """[4] the rotation about an axis by an angle in degrees."""
    return _abouts(axis, np.radians(np.array([degrees])))[0]


def _abouts(axis: Array, angles: Array) -> Array:
    """[T, 4] rotations about an axis by angles [T] in radians."""
    return np.concatenate([np.cos(angles / 2.0)[:, None], np.sin(angles / 2.0)[:, None] * axis], axis=-1)


def _counter_turned(body: Motion, hips: Array) -> tuple[Array, Array]:
    """The given hips [T, 4], and rotations of the spine [T, 4] that keep the upper body unchanged in the world."""
    spine = rotation.multiply(body.rotations[:, 0], body.rotations[:, WHOLE_BODY.index("Spine")])
    return hips, rotation.multiply(rotation.conjugate(hips), spine)


def _hang(rotations: Array, hips: Array, side: str, world: Sequence[Array]) -> None:
    """Set a leg's local rotations from world rotations [T, 4] of thigh, shin, foot and toes, under hips [T, 4]."""
    above = hips
    for part, turn in zip(("UpLeg", "Leg", "Foot", "ToeBase"), world, strict=True):
        rotations[:, WHOLE_BODY.index(side + part)] = rotation.multiply(rotation.conjugate(above), turn)
        above = turn


def _ankle_height(skeleton: Skeleton) -> float:
    """Height of the ankle of a flat foot above the floor, metres."""
    scale = sum(leg_lengths(skeleton, "Left")) / _LEG
    return scale * _SOLE - float(skeleton.offsets[skeleton.index("LeftToeBase")][1])


def _on_legs(body: Motion, rotations: Array, root: Array, skeleton: Skeleton, before: Array) -> Motion:
    """The body with these rotations and root positions; its legs are marked as filled in. before: [0 or 1, J, 4] the
    previous frame, for continuous quaternion signs."""
    filled = {*body.filled, *LEG_JOINTS}
    rotations = rotation.continuous(np.concatenate([before, rotations]))[len(before):]
    return replace(body, skeleton=skeleton, rotations=rotations, root_positions=root,
                   absent=tuple(name for name in body.absent if name not in LEG_JOINTS),
                   filled=tuple(name for name in WHOLE_BODY.names if name in filled))

