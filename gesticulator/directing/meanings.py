"""Gestures that the words call for: which of them are shown, and at which moment.

The rules are the same for a recording and for a stream: from the first word on, each gesture depends on the words
before it and on those of the next seconds (`Level.apart`). A stream whose words come that far ahead decides as a file
does; one whose words come later leaves out what no longer fits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from data_module.text.language import language_of
from data_module.types import Speech, Word
from gesticulator.directing.directions import MeantCue, cues_at, stroke_of_word
from gesticulator.directing.marks import gestures_of
from gesticulator.directing.meaning_cues import CalledGesture, meaning_cues
from gesticulator.directing.named_gestures import span_of_gesture
from gesticulator.options import MEANING_LEVELS, InferenceOptions
from gesticulator.plan.gestures import GESTURES
from gesticulator.plan.plan import GestureCue, PlanMeaning

__all__ = ["LEVELS", "Level", "MeaningTrack", "chosen", "played_meanings", "track_of"]

AGAIN = 20.0
"""Seconds in which a meaning is not shown again."""
_KEPT = 60.0
"""Seconds of past words that a stream keeps: enough for the beginning of the sentence that is spoken."""
_REMEMBERED = 660.0
"""Seconds of past gestures that a stream keeps, more than it can go back."""

@dataclass(frozen=True)
class Level:
    """How many gestures are shown. score: least score of a call; apart: least seconds between two of them."""

    score: float
    apart: float


LEVELS = dict(zip(MEANING_LEVELS, (Level(math.inf, 3.0), Level(0.8, 8.0), Level(0.7, 3.0), Level(0.6, 3.0)),
                  strict=True))


@dataclass(frozen=True)
class Called:
    """A call with the spoken word and the second of its stroke. size: a factor on its intensity; broken_off: when an
    interruption ended it, seconds."""

    gesture: CalledGesture
    word: Word
    time: float
    size: float = 1.0
    broken_off: float | None = None


def chosen(calls: Sequence[Called], level: Level, begun: Sequence[Called] = (), taken: Sequence[float] = (),
           begin: float = 0.0, preparation: Callable[[str], float] = lambda gesture: 0.0) -> list[Called]:
    """The calls that are shown, in order of time.

    Left out are: a call under the level's score; one within the level's distance of a shown one or of `taken` (seconds
    of cues, which outrank it); a meaning that was shown within `AGAIN` seconds; one with a better one within that
    distance after it; and one whose preparation would begin before `begin`. begun: those shown before.
    """
    good = [call for call in sorted(calls, key=lambda call: call.time)
            if call.gesture.score >= level.score and call.time - preparation(call.gesture.gesture) >= begin
            and all(abs(call.time - other) >= level.apart for other in taken)]
    out = list(begun)

    def barred(call: Called) -> bool:
        return any(call.time - before.time < level.apart
                   or (call.time - before.time < AGAIN and before.gesture.label == call.gesture.label)
                   for before in reversed(out[-8:]))

    for number, call in enumerate(good):
        if barred(call):
            continue
        after = (other for other in good[number + 1:number + 20] if other.time - call.time < level.apart)
        if not any(other.gesture.score > call.gesture.score and not barred(other) for other in after):
            out.append(call)
    return out[len(begun):]


class MeaningTrack:
    """The gestures that a growing list of words calls for."""

    def __init__(self, level: str, taken: Sequence[float] = (), still: Sequence[tuple[float, float]] = (),
                 intensity: float = 1.0, speech: Speech | None = None) -> None:
        """level: a name of `LEVELS`; taken: seconds of cues that outrank what is found; still: ranges of seconds in
        which the hands rest; intensity: of the gestures; speech: the sound, if it is there before the gestures."""
        self._speech = speech
        self._level, self._taken, self._still, self._intensity = LEVELS[level], tuple(taken), tuple(still), intensity
        self._words: list[tuple[Word, bool]] = []
        self._begun: list[Called] = []
        self._next: list[Called] | None = None
        self._until = 0.0

    def add(self, words: Sequence[Word], forbidden: Collection[int] = ()) -> None:
        """Add words with their times, seconds. forbidden: the numbers of those (in `words`) that must show no meaning,
        besides those with a mark; the gesture of a mark outranks what is found."""
        spoken = [(word, number in forbidden or bool(word.marks)) for number, word in enumerate(words)
                  if word.text.strip()]
        self._taken += tuple(stroke_of_word(word) for word in words if gestures_of(word))
        self._words = sorted([*self._words, *spoken], key=lambda one: one[0].start)
        self._next = None

    def forget(self, time: float) -> None:
        """Forget the words from a time on, and the gestures that have not begun by then; others are broken off."""
        self._words = [one for one in self._words if one[0].start < time]
        self._begun = [replace(call, broken_off=min(call.broken_off or time, time)) if _end(call) > time else call
                       for call in self._begun if _start(call) < time]
        self._until, self._next = min(self._until, time), None

    def cues(self, until: float) -> list[MeantCue]:
        """The gestures that begin up to a time; what was given once stays."""
        if self._next is None:
            self._next = self._chosen()
        if until > self._until:
            self._begun += [call for call in self._next if _start(call) <= until]
            self._next = [call for call in self._next if _start(call) > until]
            self._until = until
            self._begun = [call for call in self._begun if call.time > until - _REMEMBERED]
            self._words = [one for one in self._words if one[0].end > until - _KEPT]
        return [self._cue(call) for call in self._begun]

    def meanings(self) -> tuple[PlanMeaning, ...]:
        """All gestures of the words, as a plan stores them."""
        calls = [*self._begun, *(self._chosen() if self._next is None else self._next)]
        return tuple(PlanMeaning(
            call.word.start, call.word.end, call.gesture.label, f"cue phrase: {call.gesture.source}",
            call.gesture.score, "words", call.word.text, call.gesture.gesture, round(call.time, 6), self._size(call))
            for call in calls)

    def _cue(self, call: Called) -> MeantCue:
        time = round(call.time, 6)
        return MeantCue(GestureCue(call.gesture.gesture, time=time, intensity=self._size(call)), time, call.broken_off)

    def _size(self, call: Called) -> float:
        return round(self._intensity * call.size, 6)

    def _chosen(self) -> list[Called]:
        words = [word for word, _ in self._words]
        texts = [word.text for word in words]
        pauses = [max(after.start - word.end, 0.0) for word, after in zip(words, words[1:], strict=False)]
        called = meaning_cues(language_of(texts)).called(texts, pauses)
        place = self._places(words)
        calls = [Called(one, words[one.word], *place(words[one.word])) for one in called
                 if one.gesture in GESTURES and not any(barred for _, barred in self._words[one.first:one.last + 1])]
        calls = [call for call in calls if not any(start < _end(call) and _start(call) < end
                                                   for start, end in self._still)]
        return chosen(calls, self._level, self._begun, self._taken, self._until,
                      lambda gesture: span_of_gesture(gesture)[0])

    def _places(self, words: Sequence[Word]) -> Callable[[Word], tuple[float, float]]:
        """Gives the second of a word's stroke, and the factor on the size of its gesture: by the sound, if it is there.
        """
        if self._speech is None:
            return lambda word: (stroke_of_word(word), 1.0)
        from gesticulator.directing.word_sound import WordSounds

        sounds = WordSounds(self._speech, words)
        return lambda word: (sounds.stroke(word), sounds.size(word))


def _start(call: Called) -> float:
    return call.time - span_of_gesture(call.gesture.gesture)[0]


def _end(call: Called) -> float:
    return call.time + span_of_gesture(call.gesture.gesture)[1]


def track_of(options: InferenceOptions, speech: Speech | None = None) -> MeaningTrack | None:
    """The track for these options; None where no meaning is to be shown. speech: the whole sound with its words, if it
    is there."""
    words, duration = ((), math.inf) if speech is None else (speech.words or (), speech.duration)
    knobs = options.knobs
    if options.meaning == "off" or options.plan is not None or knobs.share == 0.0 or knobs.size == 0.0:
        return None
    named = [cue for cue in options.cues if cue.gesture in GESTURES]
    taken = [cue.time for cue in cues_at(named, words, duration, lambda: ())]
    return MeaningTrack(options.meaning, taken, knobs.hold_still, min(knobs.size, 1.0), speech)


def played_meanings(meanings: Sequence[PlanMeaning]) -> list[MeantCue]:
    """The gestures of a plan's meanings."""
    return [MeantCue(GestureCue(one.gesture, time=one.time, intensity=one.intensity, mirror=one.mirror), one.time)
            for one in meanings if one.gesture is not None and one.time is not None]
