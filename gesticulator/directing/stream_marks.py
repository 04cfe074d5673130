"""Gesture marks in the words of a stream: each gesture is laid over the poses as they become final."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.errors import InputError
from data_module.text.marks import marked_words
from data_module.types import Array, Word
from gesticulator.body.motion_path import LONGEST_HISTORY
from gesticulator.directing.directions import stroke_of_word
from gesticulator.directing.marks import SOURCE, gestures_of, warn_of_unknown
from gesticulator.directing.named_gestures import laid_over, span_of_gesture
from gesticulator.plan.plan import GestureCue

LATEST = 0.6
"""Seconds that a stroke may come after its word, where the word came too late to prepare it; beyond, it is dropped."""
BREAKS_OFF = 0.7
"""Seconds in which a gesture is blended out that is interrupted: as long as a gesture falls."""


@dataclass(frozen=True)
class _Planned:
    """A gesture and the time of its stroke, seconds; word: start of its word; cut: when it was interrupted."""

    cue: GestureCue
    time: float
    word: float
    cut: float = math.inf


class StreamMarks:
    """The marked gestures of a stream: `take` them from words, then call with poses."""

    def __init__(self, shaping: Callable[[Array, Array], Array] | None, rotations: bool, seed: int = 0) -> None:
        """shaping: applied to the poses first; rotations: whether poses are joint rotations, which gestures need; seed:
        of the gestures' variation."""
        self._shaping, self._rotations, self._seed = shaping, rotations, seed
        self._planned: deque[_Planned] = deque()
        self._late: tuple[str, ...] = ()
        self._known: set[str] = set()

    def take(self, words: Sequence[Word], drawn: float) -> tuple[Word, ...]:
        """The words as they are spoken, with their marks noted; a mark after the last one waits for the next call.

        drawn: seconds of motion that are final, so that a gesture can begin no earlier. `InputError` for a mark where
        the bundle's poses are no rotations.
        """
        parts, late = marked_words([word.text for word in words])
        waiting, self._late = self._late, late
        out = []
        for word, (text, marks) in zip(words, parts, strict=True):
            if not text.strip():
                if not word.text.strip():
                    out.append(word)
                continue
            out.append(replace(word, text=text, marks=(*word.marks, *waiting, *marks)))
            waiting = ()
        self._late = (*waiting, *late)
        warn_of_unknown((name for word in out for name in word.marks), self._known)
        for word in out:
            self._plan(word, drawn)
        while self._planned and self._planned[0].time < drawn - LONGEST_HISTORY:
            self._planned.popleft()
        return tuple(out)

    def _plan(self, word: Word, drawn: float) -> None:
        for gesture in gestures_of(word):
            if not self._rotations:
                raise InputError("gesture marks", "need a bundle of joint rotations, and this one has joint positions",
                                 "leave them out")
            before, _ = span_of_gesture(gesture)
            spoken = stroke_of_word(word)
            time = max(spoken, drawn + before)
            again = any(one.cue.gesture == gesture and one.word == word.start for one in self._planned)
            if time - spoken <= LATEST and not again:
                self._planned.append(_Planned(GestureCue(gesture, time=time, source=SOURCE), time, word.start))

    def interrupt(self, at: float) -> None:
        """Forget what begins after `at` seconds, and blend out what is being made."""
        self._late = ()
        self._planned = deque(replace(one, cut=min(one.cut, at)) for one in self._planned
                              if one.time - span_of_gesture(one.cue.gesture)[0] < at)

    def __call__(self, poses: Array, times: Array) -> Array:
        """Poses [M, 3 J] at seconds [M], shaped and with the marked gestures laid over."""
        out = poses if self._shaping is None else self._shaping(poses, times)
        for one in self._planned:
            before, after = span_of_gesture(one.cue.gesture)
            if not len(times) or times[-1] <= one.time - before or times[0] >= min(one.time + after,
                                                                                 one.cut + BREAKS_OFF):
                continue
            laid = laid_over(out, times, [(one.cue, one.time)], self._seed)
            left = np.clip((one.cut + BREAKS_OFF - times) / BREAKS_OFF, 0.0, 1.0)
            share = (left * left * (3.0 - 2.0 * left))[:, None]
            out = np.where(share == 1.0, laid, out + share * (laid - out))
        return out
