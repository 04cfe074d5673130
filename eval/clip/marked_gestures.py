"""Named gestures in a performance: each is marked in a recording, performed by a bundle, and cut out again.

What fools it: the gesture stands where there is room for it and not where the words call for it. Who sees it without
sound cannot tell; who hears it can.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from data_module.errors import InputError
from data_module.speech.audio import load_speech
from data_module.types import Motion, Speech
from gesticulator.pipeline import Gesticulator
from gesticulator.plan.gestures import ALIASES, REPERTOIRE, near_gestures
from gesticulator.plan.plan import GestureCue

BEFORE, AFTER = 1.7, 2.9
"""Seconds of a clip before and after the apex: the longest gesture and some of what is around it."""
_APART = 5.0
"""Seconds between two gestures at least."""


@dataclass(frozen=True)
class MarkedGesture:
    """A gesture in a performance. motion: the clip; without: the same seconds of a performance without marks; apex:
    seconds from the start of the clip; recording, start: where the clip is from, seconds."""

    gesture: str
    motion: Motion
    without: Motion
    apex: float
    recording: str
    start: float


def checked_gestures(names: Sequence[str] | None) -> list[str]:
    """The gestures of the repertoire with these names (default: those that talk often calls for), each once; InputError
    for an unknown name."""
    if names is None:
        return [name for name, gesture in REPERTOIRE.items() if gesture.core]
    chosen = list(dict.fromkeys(ALIASES.get(name, name) for name in names))
    for name in chosen:
        if name not in REPERTOIRE:
            raise InputError(name, "is the name of no gesture", near_gestures(name))
    return chosen


def marked_gestures(system: Gesticulator, recordings: Sequence[Path], gestures: Sequence[str], seed: int = 0
                    ) -> Iterator[MarkedGesture]:
    """Each of `gestures`, in their order, performed in one of the recordings. seed: of the performances; a gesture that
    comes again is made in another way. InputError if no recording has room for a gesture."""
    speeches = [(path.stem, load_speech(path)) for path in recordings]
    rooms = [(name, speech, times) for name, speech in speeches if (times := _times(speech))]
    if not rooms:
        raise InputError("--speech", f"has no recording of {BEFORE + AFTER:g} s or more", "give longer ones")
    plain = [system(speech, seed=seed).motion for _, speech, _ in rooms]
    done = turn = 0
    while done < len(gestures):
        name, speech, times = rooms[turn % len(rooms)]
        now = list(zip(gestures[done:done + len(times)], times, strict=False))
        cues = tuple(GestureCue(gesture, time=time) for gesture, time in now)
        motion = system(speech, seed=seed + turn // len(rooms), cues=cues).motion
        for gesture, time in now:
            clip, start = _clip(motion, time)
            yield MarkedGesture(gesture, clip, _clip(plain[turn % len(rooms)], time)[0], time - start, name, start)
        done, turn = done + len(now), turn + 1


def _times(speech: Speech) -> list[float]:
    """Seconds at which there is room for a gesture."""
    room = speech.duration - BEFORE - AFTER
    return [BEFORE + _APART * number for number in range(int(room // _APART) + 1)] if room >= 0 else []


def _clip(motion: Motion, apex: float) -> tuple[Motion, float]:
    """A motion around an apex, and the second at which it starts."""
    first = round((apex - BEFORE) * motion.fps)
    return motion.crop(first, first + round((BEFORE + AFTER) * motion.fps)), first / motion.fps
