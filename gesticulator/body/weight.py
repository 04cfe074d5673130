"""Weight: over which leg a standing body bears, and when that changes.

The idle motion rolls the hips every few seconds (`life.weight_shifts`, postures p_n at times t_n). People stand on one
leg and change legs less often than that, so the leg changes only where the roll is marked:

    s_n = sign(p_n) if |p_n| > c, else s_(n-1)         w_n = s_n (a + b min(|p_n|, p_max))

They change legs while the trunk moves, so a shift advances with the movement of the trunk. It runs on a clock of its
own, C(t), the integral of a rate that is low while the trunk is still and grows with its speed:

    w(t) = w_-1 + sum over n of (w_n - w_(n-1)) f((C(t) - C(t_n)) / tau),    f(a) = 1 - (1 + a + a^2 / 2) exp(-a)

Which shifts there are depends on the seed and the time alone. The motion decides only how fast each runs, and that
continuously, so that a small change of the motion is a small change of the weight and is forgotten with the shift.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from data_module.types import Array
from gesticulator.body.life import uniform, weight_shifts

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

    def __init__(self, seed: int) -> None:
        self._shifts = weight_shifts(seed)
        self._side = 1.0 if uniform(seed, _FIRST_CHANNEL, np.zeros(1, np.int64))[0] < 0.5 else -1.0
        self._settled = self._target = self._side * (_LEAST + _MORE)
        self._next, self._clock, self._time = 0, 0.0, 0.0
        self._running: list[tuple[float, float]] = []
        """Of every shift that began and is not complete: its start on the clock, and the change of weight."""

    def fork(self) -> LegWeight:
        """A copy that continues independently."""
        twin = copy.copy(self)
        twin._running = list(self._running)
        return twin

    def step(self, times: Array, speed: Array, ends: Sequence[int] | None = None) -> Array:
        """[T] the weight at the next `times` [T] seconds. speed: [T] m/s of the chest over the hips, smoothed; ends:
        the numbers of frames, rising, after which a step of a performance ends, where these are frames of several steps
        or of a part of one; the result is that of those steps, bit for bit."""
        before = self._time
        rate = _STILL + _QUICKEST * np.tanh(speed / _MOVING / _QUICKEST)
        clock = np.cumsum(np.concatenate([[self._clock], rate * np.diff(times, prepend=before)]))
        self._begin(np.concatenate([[before], times]), clock)
        self._time, self._clock = float(times[-1]), float(clock[-1])
        stops = np.array([len(times)] if ends is None else ends, np.int64)
        weight, parts, complete = np.full(len(times), self._settled), list[tuple[int, float, float]](), 0
        for begin, change in self._running:
            # A shift that is complete at the end of a step has settled from there on.
            late = stops[max(int(np.searchsorted(clock[stops], begin + _DONE * _TAU)) - 1, 0):]
            stop = int(next((at for at in late if clock[at] - begin > _DONE * _TAU), len(times) + 1))
            parts.append((stop, begin, change))
            if stop <= len(times):
                self._settled += change
                weight[stop:], complete = self._settled, complete + 1
        del self._running[:complete]
        for stop, begin, change in parts:
            start = int(np.searchsorted(clock[1:], begin, side="right"))
            a = np.maximum(clock[1 + start:1 + stop] - begin, 0.0) / _TAU
            weight[start:stop] += change * (1.0 - (1.0 + a + a * a / 2.0) * np.exp(-a))
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
