"""Gesture marks in the words of a speech, such as `[shrug]`: the cues that they become, in a file and in a stream.

`data_module.text.marks` reads them from texts; a mark is resolved against `plan.GESTURES` when it is used, so that a
gesture that is added there has its marks at once.
"""

import difflib
import warnings
from bisect import bisect_left, bisect_right, insort
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from operator import attrgetter

from data_module.errors import InputError
from data_module.text.marks import NONE, mark_name, marked_words
from data_module.types import Word
from gesticulator.body.motion_path import LONGEST_HISTORY
from gesticulator.directing.cues import TimedCue, stroke_of_word
from gesticulator.directing.named_gestures import span_of_gesture
from gesticulator.options import InferenceOptions
from gesticulator.plan.checks import ALLOWED_CUES, CUES_PER_SECOND, plain_word
from gesticulator.plan.gestures import EXPRESSIONS, GESTURES, mark_of
from gesticulator.plan.plan import GestureCue

SOURCE = "mark"
"""The source of a cue in a plan that comes from a mark."""
LATEST = 0.6
"""Seconds that a stroke may come after its word, where the word came too late to prepare it; beyond, it is dropped."""
_TIME = attrgetter("time")


class MarkWarning(UserWarning):
    """A mark that names no gesture."""


def gesture_of_mark(name: str) -> str | None:
    """The gesture of `plan.GESTURES` that a mark names, in any spelling (`mark_name`); None for an unknown one."""
    plain = mark_name(name)
    return plain if plain in GESTURES else None


def expression_of_mark(name: str) -> str | None:
    """The expression of `plan.gestures.EXPRESSIONS` that a mark names ("smile", "mood:happy"); None for another."""
    plain = mark_name(name).removeprefix("mood ").removeprefix("face ")
    return plain if plain in EXPRESSIONS else None


def gestures_of(word: Word) -> tuple[str, ...]:
    """The gestures that are marked at a word."""
    return tuple(filter(None, map(gesture_of_mark, word.marks)))


def expressions_of(word: Word) -> tuple[str, ...]:
    """The expressions of a face that are marked at a word."""
    return tuple(filter(None, map(expression_of_mark, word.marks)))


def with_mark_cues(options: InferenceOptions, words: Sequence[Word], duration: float) -> InferenceOptions:
    """The options with a cue for each mark of the words, as many as a plan of these seconds may have. Warns, once, of
    marks that name no gesture, and if some are left out."""
    warn_of_unknown(name for word in words for name in word.marks)
    cues = (*options.cues, *mark_cues(words))
    most = max(ALLOWED_CUES, int(CUES_PER_SECOND * duration), len(options.cues))
    if len(cues) > most:
        warnings.warn(MarkWarning(f"{len(cues)} gestures are asked for, and the first {most} are made"), stacklevel=3)
    return replace(options, cues=cues[:most])


def mark_cues(words: Sequence[Word]) -> tuple[GestureCue, ...]:
    """A cue at each marked word, of a gesture or of the face. Marks that name neither are left out."""
    cues: list[GestureCue] = []
    spoken: Counter[str] = Counter()
    for word in words:
        plain = plain_word(word.text)
        spoken[plain] += 1
        for gesture in (*gestures_of(word), *expressions_of(word)):
            # A plan names the word, so that the cue moves with it; a lone punctuation mark has nothing but its time.
            place = GestureCue(gesture, word.text, spoken[plain]) if plain else GestureCue(gesture, time=word.start)
            cues.append(replace(place, source=SOURCE))
    return tuple(cues)


def warn_of_unknown(names: Iterable[str], known: set[str] | None = None) -> None:
    """Warn of marks that name no gesture, once for each name. known: names that were warned of; new ones are added."""
    known = set() if known is None else known
    unknown = [name for name in dict.fromkeys(map(mark_name, names)) if name not in known and name != NONE
               and gesture_of_mark(name) is None and expression_of_mark(name) is None]
    if not unknown:
        return
    known.update(unknown)
    # One warning for all: a text in which another program's marks stand may have hundreds.
    near = difflib.get_close_matches(unknown[0], (*GESTURES, *EXPRESSIONS), 1)
    listed = ", ".join(f"[{name[:40]}]" for name in unknown[:8]) + (" ..." if len(unknown) > 8 else "")
    warnings.warn(MarkWarning(f"no gesture is named {listed}, so nothing is shown for it"
                              + (f"; did you mean {mark_of(near[0])}?" if near else "")), stacklevel=3)


# ------------------------------------------------------------------------------------------------------- in a stream

class StreamMarks:
    """The marked gestures of a stream: `take` them from words, then ask for their `cues`."""

    def __init__(self, rotations: bool) -> None:
        """rotations: whether the bundle's poses are joint rotations, which gestures need."""
        self._rotations = rotations
        self._marked: list[TimedCue] = []
        self._late: tuple[str, ...] = ()
        self._known: set[str] = set()

    def take(self, words: Sequence[Word], final: float) -> tuple[Word, ...]:
        """The words as they are spoken, with their marks noted; a mark after the last one waits for the next call.
        final: seconds of motion that are final, so that a gesture can begin no earlier. `InputError` for a mark where
        the bundle's poses are no rotations, and for too many marks that wait."""
        parts, late = marked_words([word.text for word in words])
        out, waiting = [], self._late
        for word, (text, marks) in zip(words, parts, strict=True):
            if text.strip():
                out.append(replace(word, text=text, marks=tuple(dict.fromkeys((*word.marks, *waiting, *marks)))))
                waiting = ()
            elif not word.text.strip():
                out.append(word)
        self._late = (*waiting, *late)
        warn_of_unknown((name for word in out for name in word.marks), self._known)
        for word in out:
            for gesture in gestures_of(word):
                self._add(word, gesture, final)
        self._marked = [cue for cue in self._marked if cue.time >= final - LONGEST_HISTORY]
        return tuple(out)

    def _add(self, word: Word, gesture: str, final: float) -> None:
        if not self._rotations:
            raise InputError("gesture marks", "need a bundle of joint rotations, and this one has joint positions",
                             "leave them out")
        spoken = stroke_of_word(word)
        time = max(spoken, final + span_of_gesture(gesture)[0])
        # A recogniser sends a word again when it has understood it better, and what is marked again before its stroke
        # is the same gesture.
        within = max(span_of_gesture(gesture)[0], LATEST)
        first, last = (bisect_left(self._marked, time + apart, key=_TIME) for apart in (-1.0 - within, 1.0 + within))
        around = [cue for cue in self._marked[first:last] if cue.broken_off is None]
        again = any(cue.cue.gesture == gesture and abs(cue.time - time) < within for cue in around)
        # Each costs computing time in every block around it, which other streams would wait for.
        strokes = sorted([time, *(cue.time for cue in around)])
        crowded = any(after - before < 1.0 for before, after in zip(strokes, strokes[int(CUES_PER_SECOND):],
                                                                    strict=False))
        if time - spoken <= LATEST and not (again or crowded):
            if len(self._marked) - bisect_right(self._marked, final, key=_TIME) >= ALLOWED_CUES:
                raise InputError("gesture marks", f"more than {ALLOWED_CUES} wait", "send fewer")
            insort(self._marked, TimedCue(GestureCue(gesture, time=time, source=SOURCE), time), key=_TIME)

    def interrupt(self, at: float) -> None:
        """Forget what begins after `at` seconds, and break off what is being made."""
        self._late = ()
        # A gesture whose preparation has begun cannot be taken back at once; it ends as the hands come to rest.
        self._marked = [cue.ended(at) for cue in self._marked if cue.span[0] < at]

    def cues(self) -> list[TimedCue]:
        """The marked gestures, in order of their times."""
        return list(self._marked)
