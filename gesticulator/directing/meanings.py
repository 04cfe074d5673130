"""Gestures that the words call for: which of them are shown, and at which moment.

The rules are the same for a recording and for a stream: from the first word on, each gesture depends on the words
before it and on those of the next seconds (`Level.apart`). A stream whose words come that far ahead decides as a file
does; one whose words come later leaves out what no longer fits.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import NamedTuple

from data_module.speech.word_sound import WordSounds
from data_module.types import Speech, Word
from gesticulator.directing.cues import TimedCue, cues_at, gesture_of_word, stroke_of_word
from gesticulator.directing.marks import gestures_of
from gesticulator.directing.meaning_cues import CalledGesture, meaning_cues
from gesticulator.language import language_of
from gesticulator.options import InferenceOptions
from gesticulator.plan.gestures import GESTURES
from gesticulator.plan.plan import GestureCue, PlanMeaning

AGAIN = 20.0
"""Seconds in which a meaning is not shown again."""
_WORDS, _GESTURES = 60.0, 660.0
"""Seconds of the past that a stream keeps: of words, enough for the beginning of the sentence that is spoken; of
gestures, more than it can go back."""

_TEXT = 4000
"""Characters that a stream reads at a time, from the words that it keeps on: five minutes of speech. More would take
longer to read than a block does."""


class Level(NamedTuple):
    """How many gestures are shown. score: least score of a call; apart: least seconds between two of them."""

    score: float
    apart: float


LEVELS = {"off": Level(math.inf, 3.0), "few": Level(0.8, 8.0), "normal": Level(0.7, 3.0), "rich": Level(0.6, 3.0)}


@dataclass(frozen=True)
class Called:
    """A call with the spoken word, and the cue that shows it."""

    gesture: CalledGesture
    word: Word
    cue: TimedCue


def chosen(calls: Sequence[Called], level: Level, begun: Sequence[Called] = (), taken: Sequence[float] = (),
           begin: float = 0.0) -> list[Called]:
    """The calls that are shown, in order of time. Left out are: a call under the level's score; one within the level's
    distance of a shown one or of `taken` (seconds of cues, which outrank it); a meaning that was shown within
    `AGAIN` seconds; one with a better one so near after it; one that would begin before `begin`. begun: those shown
    before."""
    # Cues of the user, marks and stillness come first; words fill what is left.
    taken = sorted(taken)
    good = [call for call in sorted(calls, key=lambda call: call.cue.time)
            if call.gesture.score >= level.score and call.cue.span[0] >= begin
            and bisect_right(taken, call.cue.time - level.apart) == bisect_left(taken, call.cue.time + level.apart)]
    out = list(begun)

    def barred(call: Called) -> bool:
        # The last eight reach further back than `AGAIN`, at three seconds from one to the next.
        return any(call.cue.time - before.cue.time < level.apart
                   or (call.cue.time - before.cue.time < AGAIN and before.gesture.label == call.gesture.label)
                   for before in reversed(out[-8:]))

    for number, call in enumerate(good):
        if barred(call):
            continue
        # A better one that is itself barred would leave a gap.
        after = (other for other in good[number + 1:number + 20] if other.cue.time - call.cue.time < level.apart)
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
        self._words: list[Word] = []
        self._begun: list[Called] = []
        self._next: list[Called] | None = None
        self._until, self._known = 0.0, 0.0

    def add(self, words: Sequence[Word]) -> None:
        """Add words with their times, seconds. Words with a mark show no meaning, and their gesture outranks others."""
        self._taken += tuple(stroke_of_word(word) for word in words if gestures_of(word))
        self._words = sorted([*self._words, *(word for word in words if word.text.strip())],
                             key=lambda word: word.start)
        self._next = None

    def forget(self, time: float) -> None:
        """Forget the words from a time on, and the gestures that have not begun by then; others are broken off."""
        self._words = [word for word in self._words if word.start < time]
        self._begun = [replace(call, cue=call.cue.ended(time)) for call in self._begun if call.cue.span[0] < time]
        # What was shown up to then stays, so that a stream never contradicts frames that were sent.
        self._until, self._next = min(self._until, time), None

    def cues(self, until: float) -> list[TimedCue]:
        """The gestures that begin up to a time; what was given once stays."""
        if self._next is None or until > self._known:
            self._next = self._chosen()
        if until > self._until:
            self._begun += [call for call in self._next if call.cue.span[0] <= until]
            self._next = [call for call in self._next if call.cue.span[0] > until]
            self._until = until
            self._begun = [call for call in self._begun if call.cue.time > until - _GESTURES]
            self._words = [word for word in self._words if word.start > until - _WORDS]
        return [call.cue for call in self._begun]

    def meanings(self) -> tuple[PlanMeaning, ...]:
        """All gestures of the words, as a plan stores them."""
        calls = [*self._begun, *(self._chosen() if self._next is None else self._next)]
        return tuple(PlanMeaning(
            call.word.start, call.word.end, call.gesture.label, f"cue phrase: {call.gesture.source}",
            call.gesture.score, "words", call.word.text, call.gesture.gesture, call.cue.time, call.cue.cue.intensity)
            for call in calls)

    def _chosen(self) -> list[Called]:
        words, self._known = self._words, math.inf
        if self._speech is None:
            words = words[:bisect_right(list(accumulate(len(word.text) for word in words)), _TEXT)]
            if len(words) < len(self._words):
                self._known = words[-1].start - AGAIN if words else -math.inf
        texts = [word.text for word in words]
        pauses = [max(after.start - word.end, 0.0) for word, after in zip(words, words[1:], strict=False)]
        sounds = None if self._speech is None else WordSounds(self._speech, words)
        calls = []
        for called in meaning_cues(language_of(texts)).called(texts, pauses):
            word = words[called.word]
            if called.gesture not in GESTURES or any(near.marks for near in words[called.first:called.last + 1]):
                continue
            stroke, size = gesture_of_word(word, sounds)
            # Rounded as a plan stores them, so that a plan replays the same motion.
            time, intensity = round(stroke, 6), round(self._intensity * size, 6)
            cue = TimedCue(GestureCue(called.gesture, time=time, intensity=intensity), time)
            # Hands that rest do not gesture.
            if not any(start < cue.span[1] and cue.span[0] < end for start, end in self._still):
                calls.append(Called(called, word, cue))
        return chosen(calls, self._level, self._begun, self._taken, self._until)


def track_of(options: InferenceOptions, speech: Speech | None = None) -> MeaningTrack | None:
    """The track for these options; None where no meaning is shown. speech: the whole sound with its words, if known."""
    knobs = options.knobs
    if options.meaning == "off" or options.plan is not None or knobs.share == 0.0 or knobs.size == 0.0:
        return None
    words, duration = ((), math.inf) if speech is None else (speech.words or (), speech.duration)
    named = [cue for cue in options.cues if cue.gesture in GESTURES]
    taken = [cue.time for cue in cues_at(named, words, duration, lambda: ())]
    return MeaningTrack(options.meaning, taken, knobs.hold_still, min(knobs.size, 1.0), speech)


def played_meanings(meanings: Sequence[PlanMeaning]) -> list[TimedCue]:
    """The gestures of a plan's meanings."""
    return [TimedCue(GestureCue(one.gesture, time=one.time, intensity=one.intensity, mirror=one.mirror), one.time)
            for one in meanings if one.gesture is not None and one.time is not None]
