"""Gesture marks in the words of a speech, such as `[shrug]`: which gestures they name, and the cues that they become.

`data_module.text.marks` reads them from texts; a mark is resolved against `plan.GESTURES` when it is used, so that a
gesture that is added there has its marks at once.
"""

from __future__ import annotations

import difflib
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from data_module.text.marks import EMOJI, NONE, mark_name
from gesticulator.plan.gestures import EXPRESSIONS, GESTURES, REPERTOIRE, mark_of
from gesticulator.plan.plan import GestureCue

if TYPE_CHECKING:
    from data_module.types import Word
    from gesticulator.options import InferenceOptions

__all__ = ["SOURCE", "MarkWarning", "gesture_of_mark", "is_kept_free", "names_of_marks", "prompt"]

SOURCE = "mark"
"""The source of a cue in a plan that comes from a mark."""


class MarkWarning(UserWarning):
    """A mark that names no gesture."""


def gesture_of_mark(name: str) -> str | None:
    """The gesture of `plan.GESTURES` that a mark names, in any spelling (`mark_name`); None for an unknown one."""
    plain = mark_name(name)
    return plain if plain in GESTURES else next((one for one in GESTURES if mark_name(one) == plain), None)


def expression_of_mark(name: str) -> str | None:
    """The expression of `plan.gestures.EXPRESSIONS` that a mark names ("smile", "mood:happy", "raise brows"); None for
    another."""
    plain = mark_name(name)
    plain = plain.removeprefix("mood ").removeprefix("face ")
    return plain if plain in EXPRESSIONS else None


def names_of_marks() -> dict[str, tuple[str, ...]]:
    """Each gesture of `plan.GESTURES` with the ways to mark it in a text, the shortest first: brackets, SSML, and an
    emoji if it has one."""
    emoji = {gesture: sign for sign, gesture in EMOJI.items()}
    return {name: (mark_of(name), f'<mark name="gesture.{name.replace(" ", "_")}"/>',
                   *((emoji[name],) if name in emoji else ())) for name in GESTURES}


def prompt(gestures: Iterable[str] | None = None) -> str:
    """Instructions for a language model that writes what a character says: a hundred words, and the marks of these
    gestures (default: those that talk often calls for)."""
    gestures = [name for name, one in REPERTOIRE.items() if one.core] if gestures is None else gestures
    marks = " ".join(mark_of(name) for name in gestures)
    return ("Your words are spoken by a character with a body. You may mark a gesture by its name in square brackets, "
            "directly before the word it belongs to: \"[shrug] I have no idea.\" The marks are not spoken. Use one "
            "where a person would gesture: once in two or three sentences, never two in one, and none in lists or "
            "code. Do not announce or describe gestures in words. Where the character should keep still, write [none] "
            f"before the word. Use these marks and no others: {marks}")


def with_mark_cues(options: InferenceOptions, words: Sequence[Word]) -> InferenceOptions:
    """The options with a cue for each mark of the words. Warns (`MarkWarning`), once, of marks that name no gesture."""
    warn_of_unknown(name for word in words for name in word.marks)
    return replace(options, cues=(*options.cues, *mark_cues(words)))


def mark_cues(words: Sequence[Word]) -> tuple[GestureCue, ...]:
    """A cue at each marked word, of a gesture or of the face. Marks that name neither are left out."""
    from gesticulator.directing.directions import plain_word

    cues: list[GestureCue] = []
    spoken: Counter[str] = Counter()
    for word in words:
        plain = plain_word(word.text)
        spoken[plain] += 1
        for gesture in (*gestures_of(word), *expressions_of(word)):
            place = GestureCue(gesture, word.text, spoken[plain]) if plain else GestureCue(gesture, time=word.start)
            cues.append(replace(place, source=SOURCE))
    return tuple(cues)


def gestures_of(word: Word) -> tuple[str, ...]:
    """The gestures that are marked at a word."""
    found = (gesture_of_mark(name) for name in word.marks)
    return tuple(gesture for gesture in found if gesture is not None)


def expressions_of(word: Word) -> tuple[str, ...]:
    """The expressions of a face that are marked at a word."""
    found = (expression_of_mark(name) for name in word.marks)
    return tuple(expression for expression in found if expression is not None)


def is_kept_free(word: Word) -> bool:
    """Whether a word is marked with [none]: nothing but a cue places a gesture there."""
    return NONE in word.marks


def warn_of_unknown(names: Iterable[str], known: set[str] | None = None) -> None:
    """Warn of marks that name no gesture, once for each name. known: names that were warned of; new ones are added."""
    known = set() if known is None else known
    unknown = [name for name in dict.fromkeys(map(mark_name, names))
               if name not in known and name != NONE and gesture_of_mark(name) is None
               and expression_of_mark(name) is None]
    if not unknown:
        return
    known.update(unknown)
    near = difflib.get_close_matches(unknown[0], (*GESTURES, *EXPRESSIONS), 1)
    listed = ", ".join(f"[{name[:40]}]" for name in unknown[:8]) + (" ..." if len(unknown) > 8 else "")
    one = len(unknown) == 1
    warnings.warn(MarkWarning(f"{listed} {'names' if one else 'name'} no gesture and {'is' if one else 'are'} left out"
                              + (f"; did you mean {mark_of(near[0])}?" if near else "")), stacklevel=3)
