"""Expressions of a face at a cue or a mark: a smile or raised brows for a moment, or a mood that lasts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_module.types import Array
from gesticulator.body.life import eased

_MOOD_CHANGES = 0.6
"""Seconds in which a mood gives way to the next."""
_AGAIN = 0.05
"""Seconds within which the same expression is the same cue, sent twice."""


@dataclass(frozen=True)
class _Expression:
    """An expression. mood: of the mouth, -1 to 1, or None for the mood of the settings; brows: -1 to 1, added; lasts:
    seconds at full strength, infinite for a mood; rises, falls: seconds."""

    mood: float | None = None
    brows: float = 0.0
    lasts: float = np.inf
    rises: float = _MOOD_CHANGES
    falls: float = 0.0


_EXPRESSIONS = {
    "happy": _Expression(0.7), "sad": _Expression(-0.7), "neutral": _Expression(),
    # Spontaneous smiles last 0.7 to 4 s (Ekman and Friesen 1982).
    "smile": _Expression(0.9, 0.0, 1.4, 0.4, 0.7),
    "frown": _Expression(-0.2, -1.0, 0.8, 0.25, 0.4),
    "raise brows": _Expression(None, 1.0, 0.4, 0.18, 0.35)}
"""How the names of `plan.gestures.EXPRESSIONS` look."""


class FaceCues:
    """The expressions of one face, by their times."""

    def __init__(self) -> None:
        self._cues: list[tuple[float, str]] = []
        self._lasting: set[tuple[float, str]] = set()

    def add(self, time: float, name: str, lasting: bool = False) -> None:
        """An expression of `EXPRESSIONS` from media time `time` on; KeyError for another name. lasting: an interruption
        leaves it."""
        _EXPRESSIONS[name]
        if lasting:
            self._lasting.add((time, name))
        if not any(other == name and abs(at - time) < _AGAIN for at, other in self._cues):
            self._cues = sorted([*self._cues, (time, name)])

    def interrupt(self, at: float) -> None:
        """Forget what begins at `at` seconds or later, but for what is lasting."""
        self._cues = [cue for cue in self._cues if cue[0] < at or cue in self._lasting]

    def forget(self, oldest: float) -> None:
        """Forget what no longer shows at `oldest` seconds: past moments, and moods before the last."""
        moods = [time for time, name in self._cues if np.isinf(_EXPRESSIONS[name].lasts)
                 and time + _MOOD_CHANGES <= oldest]
        last = max(moods, default=-np.inf)
        self._cues = [(time, name) for time, name in self._cues
                      if (time >= last if np.isinf(_EXPRESSIONS[name].lasts) else _end(time, name) > oldest)]

    def __call__(self, times: Array, mood: Array) -> tuple[Array, Array]:
        """[T] the mood, -1 to 1, and [T] what is added to the brows, at media times [T]. mood: of the settings."""
        now, brows = mood, np.zeros(len(times))
        # Moods first: a smile passes over whichever lasts.
        for time, name in sorted(self._cues, key=lambda cue: np.isfinite(_EXPRESSIONS[cue[1]].lasts)):
            one = _EXPRESSIONS[name]
            share = eased((times - time) / one.rises)
            if np.isfinite(one.lasts):
                share = share - eased((times - time - one.rises - one.lasts) / one.falls)
            if one.mood is not None:
                now = now + (one.mood - now) * share
            elif np.isinf(one.lasts):
                now = now + (mood - now) * share
            brows = brows + one.brows * share
        return np.asarray(now), np.asarray(brows)


def _end(time: float, name: str) -> float:
    one = _EXPRESSIONS[name]
    return time + one.rises + one.lasts + one.falls
