"""Options that a recording cannot satisfy: stillness after its end, cues at words that are not spoken."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

from data_module.types import Word
from gesticulator.directing.directions import plain_word
from gesticulator.options import InferenceOptions


class OptionWarning(UserWarning):
    """An option that has no effect on this recording."""


def without_mismatches(options: InferenceOptions, words: Sequence[Word], duration: float) -> InferenceOptions:
    """The options without cues at words that are not among `words`. Warns (`OptionWarning`) about each such cue, and
    about each range of stillness that ends after `duration` seconds.

    Without any words the cues stay: they raise an `InputError` later.
    """
    for begin, end in options.hold_still:
        if end > duration:
            effect = "has no effect" if begin >= duration else "is cut there"
            _warn(f"hold_still {begin:g}-{end:g} goes beyond the end of the recording ({duration:.2f} s) and {effect}")
    if not any(word.text.strip() for word in words):
        return options
    spoken = [plain_word(word.text) for word in words]
    cues = []
    for cue in options.cues:
        count = 0 if cue.word is None else spoken.count(plain_word(cue.word))
        if cue.word is None or count >= cue.occurrence:
            cues.append(cue)
            continue
        reason = ("the word is never spoken" if not count else f"the word is spoken {count} times, and occurrence "
                  f"{cue.occurrence} is asked for")
        _warn(f"the cue {cue.word}={cue.gesture} is left out: {reason}")
    return replace(options, cues=tuple(cues))


def warn_of_losses(lines: Sequence[str]) -> None:
    """Warn (`OptionWarning`) of what a plan lost when it was moved onto another sound."""
    for line in lines:
        _warn(line)


def _warn(line: str) -> None:
    warnings.warn(OptionWarning(line), stacklevel=4)
