"""What a head does between utterances: it nods to another's voice, tilts now and then, looks away in thought.

Turns are laid over the knots that are shown, each a function of time that begins after the last knot that was shown: so
whatever comes next, nothing jumps. A turn is a (e((t - start) / rise) - e((t - end) / fall)), where e(s) = 10 s^3
- 15 s^4 + 6 s^5 is still at both ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.silence import FRAME, STEP, LoudnessTracker, frame_levels
from data_module.types import Array, Samples
from gesticulator.body.life import LOOKED, uniform

_CHANNEL = 1 << 11
"""The first of the random channels, apart from those of the idle life and of the legs."""
_NOD = ((0.0, 6.5), (0.42, 3.5))
"""A nod's two dips: seconds after its begin, and degrees down."""
_DIP, _RISE = 0.2, 0.28
"""Seconds in which the head goes down and comes up again."""
_BREATH = 0.3
"""Seconds of silence after which a listener nods: the end of a phrase."""
_SPOKEN = 1.2
"""Seconds of the other's speech since the last nod without which there is none."""
_TILT, _TILT_EVERY, _TILT_HOLDS = 4.0, 5.5, 2.4
"""Degrees to a side, seconds of listening from one to the next, and seconds that it holds."""
_AWAY, _UP = 13.0, 6.0
"""Degrees that a thinker looks to a side, and up."""
_TURNS = 0.5
"""Seconds in which the head tilts or looks away, and comes back."""
_MOST = 16
"""Turns that are under way at once, at most."""


@dataclass(frozen=True)
class _Turn:
    """A turn of the head and back. degrees: about X (down), Y (to her left) and Z; end: None while it holds."""

    start: float
    rise: float
    end: float | None
    fall: float
    degrees: tuple[float, float, float]

    def share(self, times: Array) -> Array:
        """[T] of the whole turn at `times` [T]."""
        risen = _eased((times - self.start) / self.rise)
        return risen if self.end is None else risen - _eased((times - self.end) / self.fall)


def _eased(share: Array) -> Array:
    s = np.clip(share, 0.0, 1.0)
    way: Array = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    return way


class HeadTurns:
    """Turns of one head, in the order of time."""

    def __init__(self, seed: int, joints: Sequence[str]) -> None:
        """seed: of where she looks; joints: names of those that the poses turn."""
        self.seed = seed
        self._mixing = np.zeros((3, len(joints), 3))
        for name, part in LOOKED.items():
            if name in joints:
                self._mixing[np.arange(3), joints.index(name), np.arange(3)] = math.radians(part)
        self._turns: list[_Turn] = []
        self._made = 0
        self._loudness: LoudnessTracker | None = None
        self._left = np.zeros(0, np.float32)
        self._spoken = self._quiet = self._listened = 0.0

    def __call__(self, times: Array) -> Array | None:
        """[T, 3 J] radians to add to the exponential maps at rising `times` [T] seconds; None for nothing."""
        self._turns = [one for one in self._turns if one.end is None or one.end + one.fall > times[0]]
        if not self._turns:
            return None
        degrees = sum(one.share(times)[:, None] * np.array(one.degrees) for one in self._turns)
        turned: Array = np.einsum("td,dja->tja", degrees, self._mixing).reshape(len(times), -1)
        return turned

    def release(self, at: float) -> None:
        """What holds is given up from `at` seconds on; so is what has not begun. The next voice is another."""
        self._turns = [one if one.end is not None else replace(one, end=max(at, one.start + one.rise))
                       for one in self._turns if one.start <= at]
        self._loudness, self._left = None, self._left[:0]
        self._spoken = self._quiet = self._listened = 0.0

    def look_away(self, at: float) -> None:
        """Look to a side and up from `at` seconds on, until released."""
        self._add(_Turn(at, _TURNS, None, _TURNS, (-_UP, _AWAY * self._side(), 0.0)))

    def listen(self, samples: Samples, at: float) -> None:
        """Some more of another's voice, at 16 kHz; what she does to it begins at `at` seconds or later."""
        if self._loudness is None:
            self._loudness = LoudnessTracker()
        sound, size, step = np.concatenate([self._left, samples]), round(STEP * FRAME * SAMPLE_RATE), STEP * FRAME
        for start in range(0, len(sound) - size + 1, size):
            heard = self._loudness.step(frame_levels(sound[start:start + size], SAMPLE_RATE))
            silent = bool(heard.silent.mean() > 0.5)
            self._listened += step
            self._quiet = self._quiet + step if silent else 0.0
            self._spoken += 0.0 if silent else step
            now = at + start / SAMPLE_RATE
            if self._quiet >= _BREATH - 1e-9 and self._spoken >= _SPOKEN:
                self._spoken = 0.0
                for after, degrees in _NOD:
                    self._add(_Turn(now + after, _DIP, now + after + _DIP, _RISE, (degrees, 0.0, 0.0)))
            if self._listened >= _TILT_EVERY:
                self._listened = 0.0
                self._add(_Turn(now, _TURNS, now + _TURNS + _TILT_HOLDS, _TURNS, (0.0, 0.0, _TILT * self._side())))
        self._left = sound[len(sound) - len(sound) % size:]

    def _side(self) -> float:
        self._made += 1
        return 1.0 if uniform(self.seed, _CHANNEL, np.array([self._made]))[0] < 0.5 else -1.0

    def _add(self, turn: _Turn) -> None:
        if len(self._turns) < _MOST:
            self._turns.append(turn)
