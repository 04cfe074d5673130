"""Gesture marks in the words of a stream: the gestures that they become, in time for the poses as they become final."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from data_module.errors import InputError
from data_module.text.marks import marked_words
from data_module.types import Word
from gesticulator.body.motion_path import LONGEST_HISTORY
from gesticulator.directing.directions import MeantCue, stroke_of_word
from gesticulator.directing.marks import SOURCE, gestures_of, warn_of_unknown
from gesticulator.directing.named_gestures import span_of_gesture
from gesticulator.plan.checks import ALLOWED_CUES, CUES_PER_SECOND
from gesticulator.plan.plan import GestureCue

LATEST = 0.6
"""Seconds that a stroke may come after its word, where the word came too late to prepare it; beyond, it is dropped."""


@dataclass(frozen=True)
class _Planned:
    """A gesture and the start of its word, seconds."""

    meant: MeantCue
    word: float


class StreamMarks:
    """The marked gestures of a stream: `take` them from words, then ask for their `cues`."""

    def __init__(self, rotations: bool) -> None:
        """rotations: whether the bundle's poses are joint rotations, which gestures need."""
        self._rotations = rotations
        self._planned: list[_Planned] = []
        self._late: tuple[str, ...] = ()
        self._known: set[str] = set()

    def take(self, words: Sequence[Word], drawn: float) -> tuple[Word, ...]:
        """The words as they are spoken, with their marks noted; a mark after the last one waits for the next call.

        drawn: seconds of motion that are final, so that a gesture can begin no earlier. `InputError` for a mark where
        the bundle's poses are no rotations, and for too many marks.
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
        self._planned = [one for one in self._planned if one.meant.time >= drawn - LONGEST_HISTORY]
        return tuple(out)

    def _plan(self, word: Word, drawn: float) -> None:
        for gesture in gestures_of(word):
            if not self._rotations:
                raise InputError("gesture marks", "need a bundle of joint rotations, and this one has joint positions",
                                 "leave them out")
            before, _ = span_of_gesture(gesture)
            spoken = stroke_of_word(word)
            time = max(spoken, drawn + before)
            again = any(one.meant.cue.gesture == gesture and one.word == word.start for one in self._planned)
            if time - spoken <= LATEST and not again:
                self._check_room(drawn)
                cue = GestureCue(gesture, time=time, source=SOURCE)
                self._planned.append(_Planned(MeantCue(cue, time), word.start))

    def _check_room(self, drawn: float) -> None:
        """`InputError` if there are more gestures than a plan of the same length may have, or too many at once: each
        costs computing time in every block around it, which other streams would wait for."""
        waiting = sum(planned.meant.time > drawn for planned in self._planned)
        if waiting >= ALLOWED_CUES or len(self._planned) >= max(ALLOWED_CUES, int(CUES_PER_SECOND * drawn)):
            raise InputError("gesture marks", f"more than {ALLOWED_CUES} wait or {CUES_PER_SECOND:g} per second came",
                             "send fewer")

    def interrupt(self, at: float) -> None:
        """Forget what begins after `at` seconds, and break off what is being made."""
        self._late = ()
        kept = [one for one in self._planned if one.meant.time - span_of_gesture(one.meant.cue.gesture)[0] < at]
        self._planned = [replace(one, meant=_broken_off(one.meant, at)) for one in kept]

    def cues(self) -> list[MeantCue]:
        """The marked gestures, in order of their words."""
        return [one.meant for one in self._planned]


def _broken_off(meant: MeantCue, at: float) -> MeantCue:
    """The gesture broken off at a time, unless it has ended by then."""
    if meant.time + span_of_gesture(meant.cue.gesture)[1] <= at:
        return meant
    return replace(meant, broken_off=at if meant.broken_off is None else min(meant.broken_off, at))
