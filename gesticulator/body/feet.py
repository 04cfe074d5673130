"""Feet of a standing body: where they are placed, and the small steps by which one that is free is set down elsewhere.

A function of the seed and the time alone. The ball of a foot is placed; the ankle is behind and above it.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from data_module.motion import rotation
from data_module.types import Array
from gesticulator.body.life import eased, normal, uniform, weight_shifts
from gesticulator.body.weight import CROSSES

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

    def since(self, before: float, until: float) -> Steps:
        """A copy that has forgotten what was complete before a time, and knows the steps that begin by `until`,
        seconds."""
        self._extend(until)
        twin = copy.copy(self)
        twin._placed = [list(placed) for placed in self._placed]
        twin.forget(before)
        return twin

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
        turn = rotation.multiply(abouts(UP, yaw), abouts(np.array([1.0, 0.0, 0.0]), heel))
        flat = np.stack([ball[:, 0], SOLE * self.scale + _LIFT * self.scale * lift, ball[:, 1]], -1)
        # The ball is placed; the ankle is behind and above it, higher with the heel raised.
        return FootPath(flat - rotation.rotate(turn, self.foot), yaw, heel,
                        slow[:, :2] - rotation.rotate(abouts(UP, np.radians(slow[:, 2])), self.foot)[:, [0, 2]])

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
            if abs(weight) < CROSSES or following - begin < _STEP_NEEDS or begin < 1.0 or chance > _STEPS:
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
                          self.scale * (offsets[:, 1] - FOOT_BACK)], axis=-1)
        ball = ankle + rotation.rotate(abouts(UP, np.radians(yaw)), self.foot)
        return np.stack([ball[:, 0], ball[:, 2], yaw], axis=-1)


def _bump(share: Array) -> Array:
    """0 to 1 and back with continuous acceleration: 64 s^3 (1 - s)^3."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(64.0 * (s * (1.0 - s)) ** 3)


def abouts(axis: Array, angles: Array) -> Array:
    """[..., 4] rotations about an axis by angles [...] in radians."""
    return np.concatenate([np.cos(angles / 2.0)[..., None], np.sin(angles / 2.0)[..., None] * axis], axis=-1)
