"""Head movements between utterances: nodding to another's voice, and looking away in thought.

Turns are added to the knots at playback, each a function of time that begins after the last knot already played, so the
motion never jumps. A turn is a (e((t - start) / rise) - e((t - end) / fall)) with e = `gesticulator.body.life.eased`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.silence import FRAME, STEP, LoudnessTracker, frame_levels
from data_module.types import Array, Samples
from gesticulator.body.life import LOOKED, eased, uniform

_CHANNEL = 1 << 11
"""First random channel, distinct from those of idle motion and legs."""
_NOD = ((0.0, 6.5), (0.42, 3.5))
"""The two dips of a nod: seconds after its start, and degrees down."""
_DIP, _RISE = 0.2, 0.28
"""Durations of moving down and up again, seconds."""
_BREATH = 0.3
"""Silence after which a listener nods, seconds: the end of a phrase."""
_SPOKEN = 1.2
"""Least speech of the other between two nods, seconds."""
_AWAY, _UP = 13.0, 6.0
"""Looking away in thought: degrees to a side, and up."""
_TURNS = 0.5
"""Duration of looking away, and of coming back, seconds."""
_MOST = 16
"""Most turns at a time: sound may come faster than it is played."""


@dataclass(frozen=True)
class _Turn:
    """A turn of the head and back. degrees: about X (down), Y (to the character's left) and Z; end: None while held."""

    start: float
    rise: float
    end: float | None
    fall: float
    degrees: tuple[float, float, float]

    def share(self, times: Array) -> Array:
        """[T] the share of the full turn at `times` [T]."""
        risen = eased((times - self.start) / self.rise)
        return risen if self.end is None else risen - eased((times - self.end) / self.fall)


class HeadTurns:
    """The turns of one head over time."""

    def __init__(self, seed: int, joints: Sequence[str]) -> None:
        """seed: of the side that the head turns to; joints: names of the joints of the poses."""
        self.seed = seed
        # Neck and head share a turn as they share a shift of gaze.
        self._mixing = np.zeros((3, len(joints), 3))
        for name, part in LOOKED.items():
            if name in joints:
                self._mixing[np.arange(3), joints.index(name), np.arange(3)] = math.radians(part)
        self._turns: list[_Turn] = []
        self._count = 0
        self._loudness: LoudnessTracker | None = None
        self._rest = np.zeros(0, np.float32)
        self._spoken = self._quiet = 0.0

    def __call__(self, times: Array) -> Array | None:
        """[T, 3 J] radians to add to the exponential maps at rising `times` [T] seconds; None without any turn."""
        # Turns that are over add nothing any more.
        self._turns = [turn for turn in self._turns if turn.end is None or turn.end + turn.fall > times[0]]
        if not self._turns:
            return None
        degrees = sum(turn.share(times)[:, None] * np.array(turn.degrees) for turn in self._turns)
        return np.einsum("td,dja->tja", degrees, self._mixing).reshape(len(times), -1)

    def release(self, at: float) -> None:
        """End held turns at `at` seconds, cancel later ones, and expect another voice next."""
        self._turns = [turn if turn.end is not None else replace(turn, end=max(at, turn.start + turn.rise))
                       for turn in self._turns if turn.start <= at]
        self._loudness, self._rest = None, self._rest[:0]
        self._spoken = self._quiet = 0.0

    def look_away(self, at: float) -> None:
        """Look to a side and up from `at` seconds until released."""
        self._count += 1
        side = 1.0 if uniform(self.seed, _CHANNEL, np.array([self._count]))[0] < 0.5 else -1.0
        self._turns.append(_Turn(at, _TURNS, None, _TURNS, (-_UP, _AWAY * side, 0.0)))

    @property
    def side(self) -> float:
        """Where the held turn goes to: 1 to the left, -1 to the right, 0 without one."""
        return next((math.copysign(1.0, turn.degrees[1]) for turn in reversed(self._turns)
                     if turn.end is None and turn.degrees[1]), 0.0)

    def listen(self, samples: Samples, at: float) -> None:
        """Take more of the other speaker's voice, at 16 kHz; reactions begin at `at` seconds or later."""
        if self._loudness is None:
            self._loudness = LoudnessTracker()
        sound, size, step = np.concatenate([self._rest, samples]), round(STEP * FRAME * SAMPLE_RATE), STEP * FRAME
        for start in range(0, len(sound) - size + 1, size):
            loudness = self._loudness.step(frame_levels(sound[start:start + size], SAMPLE_RATE))
            # By majority of the frames of a step: a click is not speech.
            silent = bool(loudness.silent.mean() > 0.5)
            self._quiet = self._quiet + step if silent else 0.0
            self._spoken += 0.0 if silent else step
            now = at + start / SAMPLE_RATE
            # A nod answers the end of a phrase: enough speech, then a short silence.
            if self._quiet >= _BREATH - 1e-9 and self._spoken >= _SPOKEN:
                self._spoken = 0.0
                self._turns += [_Turn(now + after, _DIP, now + after + _DIP, _RISE, (degrees, 0.0, 0.0))
                                for after, degrees in _NOD]
                del self._turns[_MOST:]
        # Samples that do not fill a step wait for the next call, so the size of packets changes nothing.
        self._rest = sound[len(sound) - len(sound) % size:]
