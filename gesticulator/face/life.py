"""Lids, brows and eyes over time: 50 steps a second, each a function of the seed, the time and what is heard so far.

- Blinks: on average 17 a minute in speech (Bentivoglio et al. 1997 counted 26 in conversation and 17 at rest), at
  irregular intervals, and more likely where a phrase ends (Cummins 2012). A lid shuts in 80 ms and opens in 160 ms.
- Brows rise on the beats that the hands gesture on, where the blocks say so.
- Gaze: who begins to speak looks away while planning and back at the end of the phrase (Kendon 1967); a listener looks
  at the other; a thinker up and aside. The eyes move within 60 ms, long before the head, and hold their target while
  the head moves.
"""

import math
from collections import deque

import numpy as np

from data_module.types import Array
from gesticulator.body.life import eased, uniform

RATE = 50
"""Steps per second."""
_CHANNEL = 1 << 12
"""First random channel, distinct from those of idle motion, legs and head turns."""
_BLINK, _PHRASE, _SIDE, _GLANCE, _BROW = range(5)
_SHUTS, _OPENS = 0.08, 0.16
"""Seconds in which a lid shuts and opens."""
_BLINK_CELL, _BLINK_SHARE = 2.9, 0.8
"""One chance of a blink in every so many seconds, anywhere in them, and its probability: 17 a minute."""
_BLINKS_APART = 0.7
"""Least seconds between two blinks."""
_PHRASE_END, _PHRASE_BLINK = 0.3, 0.6
"""Silence that ends a phrase, seconds, and the probability of a blink there."""
_RISES, _FALLS = 0.14, 0.45
"""Seconds in which the brows rise and fall."""
_AFTER = 0.06
"""Seconds from a beat to the start of its brow raise: by then the block of a stream is known, too."""
_RAISED = 0.35
"""Share of the accents on which brows rise: about one in three."""
_SACCADE = 0.06
"""Duration of a gaze shift, seconds."""
_AWAY_CELL = 3.1
"""One chance of looking away in every so many seconds of speech."""
_AWAY, _AWAY_AT_START = 0.35, 0.65
"""Probability of looking away in such a time, and at the start of a phrase after a pause."""
_AWAY_LASTS = (0.5, 1.4)
"""Shortest and longest look away, seconds."""
_ASIDE, _DOWN, _UP = (8.0, 16.0), (-9.0, 2.0), (7.0, 12.0)
"""Degrees to a side and up when looking away in speech and (up) in thought."""
_DART = 1.2
"""Degrees of the small movements of fixating eyes, a new one every `_DART_CELL` seconds."""
_DART_CELL = 0.8


class FaceLife:
    """The steps of one face. They are computed in order; each may depend on earlier ones and on the arguments alone."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._step = 0
        # Only the last two blinks are kept: a lid is open again before a third could begin.
        self._blinks: list[float] = []
        # A face starts in a long silence, so that its first words count as the start of a phrase.
        self._quiet, self._spoken = 10.0, 0.0
        self._away_until, self._target = -1.0, np.zeros(2)
        self._from, self._to, self._moved = np.zeros(2), np.zeros(2), -1.0
        self._accents: deque[float] = deque()
        self._was = ""

    @property
    def time(self) -> float:
        """Media time of the next step, seconds."""
        return self._step / RATE

    def accent(self, time: float) -> None:
        """A beat on which the hands gesture, at media time `time`; some of them raise the brows."""
        if self._random(_BROW, round(time * 1000)) < _RAISED:
            self._accents.append(time + _AFTER)

    def step(self, state: str, silent: float) -> tuple[float, float, float, float]:
        """Blink (0 to 1), brows (-1 to 1), and gaze (to the left and up, radians, relative to the other's face). state:
        "speaking", "listening", "idle", or "thinking" with " left" or " right" where the head turns to; silent: weight
        of silence at this step, 0 to 1."""
        now = self.time
        # Lids and gaze both react to the end of a phrase, so speech is counted first.
        ended = self._hear(state, silent > 0.5)
        self._maybe_blink(now, ended)
        self._look(now, state, ended)
        self._step += 1
        gaze = self._gaze(now)
        return self._lids(now), self._brows(now), float(gaze[0]), float(gaze[1])

    # ------------------------------------------------------------------------------------------------ internals

    def _random(self, channel: int, number: int) -> float:
        return float(uniform(self._seed, _CHANNEL + channel, np.array([number]))[0])

    def _hear(self, state: str, silent: bool) -> bool:
        """Count speech and silence; True where a phrase has just ended."""
        before = self._quiet
        if state != "speaking" or silent:
            self._quiet += 1 / RATE
        else:
            self._spoken, self._quiet = (0.0 if before >= _PHRASE_END else self._spoken) + 1 / RATE, 0.0
        return before < _PHRASE_END <= self._quiet and self._spoken > 0.4

    def _maybe_blink(self, now: float, ended: bool) -> None:
        # One random time in each cell, keyed by the number of the cell: irregular, and yet the same for a file and a
        # stream, and from whatever step one looks.
        cell = math.floor(now / _BLINK_CELL)
        at = (cell + self._random(_BLINK, 2 * cell)) * _BLINK_CELL
        due = at <= now < at + 1 / RATE and self._random(_BLINK, 2 * cell + 1) < _BLINK_SHARE
        phrase = ended and self._random(_PHRASE, self._step) < _PHRASE_BLINK
        if (due or phrase) and (not self._blinks or now - self._blinks[-1] >= _BLINKS_APART):
            self._blinks.append(now)
            del self._blinks[:-2]

    def _lids(self, now: float) -> float:
        shut = 0.0
        for start in self._blinks:
            closing = eased(np.array([(now - start) / _SHUTS]))[0]
            opening = eased(np.array([(now - start - _SHUTS) / _OPENS]))[0]
            shut = max(shut, float(closing - opening))
        return shut

    def _brows(self, now: float) -> float:
        while self._accents and self._accents[0] + _RISES + _FALLS < now:
            self._accents.popleft()
        raised = 0.0
        for start in self._accents:
            if start > now:
                break
            shape = eased(np.array([(now - start) / _RISES]))[0]
            shape -= eased(np.array([(now - start - _RISES) / _FALLS]))[0]
            raised = max(raised, float(shape))
        return raised

    def _look(self, now: float, state: str, ended: bool) -> None:
        """Choose the target of the eyes."""
        if state.startswith("thinking"):
            if self._was != state:
                self._aim(now, _UP, {"left": 1.0, "right": -1.0}.get(state.partition(" ")[2], 0.0))
        elif state != "speaking" or ended:
            self._away_until = -1.0
            self._shift(now, np.zeros(2))
        elif now >= self._away_until:
            cell = math.floor(now / _AWAY_CELL)
            begins = self._quiet == 0.0 and abs(self._spoken - 1 / RATE) < 1e-9
            chance = begins and self._random(_GLANCE, self._step) < _AWAY_AT_START
            at = (cell + 0.2 + 0.6 * self._random(_GLANCE, -2 * cell - 1)) * _AWAY_CELL
            spontaneous = at <= now < at + 1 / RATE and self._random(_GLANCE, -2 * cell - 2) < _AWAY
            if chance or (spontaneous and self._quiet == 0.0):
                short, long = _AWAY_LASTS
                self._away_until = now + short + (long - short) * self._random(_GLANCE, self._step + (1 << 40))
                self._aim(now, _DOWN)
            else:
                self._shift(now, np.zeros(2))
        self._was = state

    def _aim(self, now: float, up: tuple[float, float], side: float = 0.0) -> None:
        """Look aside, to a side or to either."""
        # Three random numbers for each shift, keyed by its step: side, distance aside and height.
        number = 3 * self._step
        side = side or (1.0 if self._random(_SIDE, number) < 0.5 else -1.0)
        aside = _ASIDE[0] + (_ASIDE[1] - _ASIDE[0]) * self._random(_SIDE, number + 1)
        height = up[0] + (up[1] - up[0]) * self._random(_SIDE, number + 2)
        self._shift(now, np.radians([side * aside, height]))

    def _shift(self, now: float, target: Array) -> None:
        if not np.array_equal(target, self._target):
            self._from, self._to, self._moved, self._target = self._gaze_shift(now), target, now, target

    def _gaze_shift(self, now: float) -> Array:
        share = float(eased(np.array([(now - self._moved) / _SACCADE]))[0]) if self._moved >= 0 else 1.0
        return np.asarray(self._from + (self._to - self._from) * share)

    def _gaze(self, now: float) -> Array:
        """The shift and the small darts of fixating eyes."""
        # The eyes of a person who fixates never stand: they jump by about a degree around the target.
        cell = math.floor(now / _DART_CELL)
        share = float(eased(np.array([(now - cell * _DART_CELL) / _SACCADE]))[0])
        before, after = (np.array([self._random(_SIDE, -2 * c - 2), self._random(_SIDE, -2 * c - 3)])
                         for c in (cell - 1, cell))
        dart = np.radians(_DART) * (2 * (before + (after - before) * share) - 1)
        return np.asarray(self._gaze_shift(now) + dart)
