"""Cues in time: when the stroke of a gesture at a word falls, and cues that a recording cannot satisfy."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from data_module.errors import InputError, shown
from data_module.types import Word
from gesticulator.options import InferenceOptions
from gesticulator.plan.checks import plain_word
from gesticulator.plan.gestures import EXPRESSIONS, GESTURES, near_gestures
from gesticulator.plan.plan import GestureCue, LexemeName

if TYPE_CHECKING:
    from data_module.speech.word_sound import WordSounds

_VOWEL_SHARE, _EARLY = 0.3, 0.11
"""A stroke falls at this share of its word, less this many seconds. Measured on two read sonnets: the vowel of the
loudest syllable begins there, and a beat of the hand leads the voice by .075 s in the median."""
_LEAD = 0.08
"""Seconds by which a stroke comes before a vowel that was found in the sound, for the same reason."""
_STANDS_OUT = 0.45
"""Emphasis from which on a gesture is larger; from its negative on it is smaller."""
_SMALLER, _LARGER = 0.8, 1.25


class OptionWarning(UserWarning):
    """An option that has no effect on this recording."""


@dataclass(frozen=True)
class TimedCue:
    """A cue and the time of its stroke, seconds. lexeme: the one it names, or None for a gesture of `GESTURES`;
    broken_off: when an interruption ended it, seconds."""

    cue: GestureCue
    time: float
    lexeme: int | None = None
    broken_off: float | None = None

    @property
    def span(self) -> tuple[float, float]:
        """Seconds at which the gesture begins and ends."""
        from gesticulator.directing.named_gestures import span_of_gesture

        before, after = span_of_gesture(self.cue.gesture)
        return self.time - before, self.time + after

    def ended(self, at: float) -> TimedCue:
        """The cue after an interruption at a time, seconds."""
        return self if self.span[1] <= at else replace(self, broken_off=min(self.broken_off or at, at))


def stroke_of_word(word: Word) -> float:
    """Seconds at which the stroke of a word's gesture falls: just before its stressed vowel, as far as the times of the
    word tell. `gesture_of_word` knows it better where the sound is there."""
    return max(word.start + _VOWEL_SHARE * (word.end - word.start) - _EARLY, 0.0)


def gesture_of_word(word: Word, sounds: WordSounds | None) -> tuple[float, float]:
    """Seconds at which the stroke of a word's gesture falls, and the factor on the gesture's size: larger for a word
    that stands out from those around it, smaller for one that recedes, and 1 without sound or where little is known."""
    if sounds is None:
        return stroke_of_word(word), 1.0
    vowel, emphasis = sounds.vowel(word), sounds.emphasis(word)
    stroke = stroke_of_word(word) if vowel is None else max(vowel - _LEAD, 0.0)
    return stroke, _LARGER if emphasis >= _STANDS_OUT else _SMALLER if emphasis <= -_STANDS_OUT else 1.0


def cues_at(cues: Sequence[GestureCue], words: Sequence[Word], duration: float,
            names: Callable[[], Sequence[LexemeName]]) -> list[TimedCue]:
    """The cues of the body with the times of their strokes. names: returns the lexicon's names; called only for
    gestures that are not in `GESTURES`. `InputError` for what is not spoken, known or within the sound."""
    out, spoken = [], _spoken(words if cues else ())
    lexemes: dict[str, int] | None = None
    for cue in cues:
        if cue.gesture in EXPRESSIONS:
            continue
        lexeme = None
        if cue.gesture not in GESTURES:
            # Naming the lexemes decodes all of them: only where a cue needs it.
            lexemes = {entry.name: entry.lexeme for entry in names()} if lexemes is None else lexemes
            lexeme = lexemes.get(cue.gesture)
            if lexeme is None:
                raise InputError(f"gesture {shown(cue.gesture)}", "is unknown", near_gestures(cue.gesture, lexemes))
        out.append(TimedCue(cue, _time_of(cue, spoken, duration), lexeme))
    return out


def expressions_at(cues: Sequence[GestureCue], words: Sequence[Word], duration: float) -> list[tuple[float, str]]:
    """(time, name) of the cues of the face, seconds; raises as `cues_at`."""
    spoken = _spoken(words)
    return [(_time_of(cue, spoken, duration), cue.gesture) for cue in cues if cue.gesture in EXPRESSIONS]


def _spoken(words: Sequence[Word]) -> Mapping[str, Sequence[Word]]:
    # Plain word -> where it is spoken.
    spoken = dict[str, list[Word]]()
    for word in words:
        spoken.setdefault(plain_word(word.text), []).append(word)
    return spoken


def _time_of(cue: GestureCue, spoken: Mapping[str, Sequence[Word]], duration: float) -> float:
    if cue.time is not None:
        # In a stream the duration is infinite, so that any time may come.
        if not 0 <= cue.time <= duration:
            raise InputError(f"cue at {cue.time:g} s", f"is not within the {duration:.2f} s of the sound",
                             "choose an earlier time")
        return float(cue.time)
    if not spoken:
        raise InputError(f"cue at the word {shown(cue.word)}", "needs the words of the recording",
                         "give them with --text, or a time instead of the word")
    # Without case and punctuation, as people do not type them in a cue.
    matches = spoken.get(plain_word(cue.word or ""), ())
    if len(matches) < cue.occurrence:
        near = [word for word in spoken if word]
        raise InputError(f"cue at the word {shown(cue.word)}, occurrence {cue.occurrence}",
                         f"is impossible: the word is spoken {len(matches)} times",
                         "choose among " + ", ".join(near[:30]) + (" ..." if len(near) > 30 else ""))
    return stroke_of_word(matches[cue.occurrence - 1])


def without_mismatches(options: InferenceOptions, words: Sequence[Word]) -> InferenceOptions:
    """The options without cues at words that are not among `words`. Warns (`OptionWarning`) about each such cue.
    Without any words the cues stay: they raise an `InputError` later."""
    spoken = _spoken([word for word in words if word.text.strip()])
    if not spoken:
        return options
    # A folder of recordings gets the same cues: one that a recording cannot satisfy must not stop the others.
    cues = []
    for cue in options.cues:
        count = cue.occurrence if cue.word is None else len(spoken.get(plain_word(cue.word), ()))
        if count >= cue.occurrence:
            cues.append(cue)
        else:
            warnings.warn(OptionWarning(f"the cue {cue.word}={cue.gesture}, occurrence {cue.occurrence}, is left out: "
                                        f"the word is spoken {count} times"), stacklevel=3)
    return replace(options, cues=tuple(cues))
