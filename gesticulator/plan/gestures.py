"""The repertoire: the gestures that have a name and a meaning, and other names for some of them.

`gestures.csv` is the table: a name, its category, the hands that make it, whether talk often calls for it (`core`),
whether its picture alone says little (`weak`), whether it may offend, and what it means. How they move is in
`gesticulator.directing.named_gestures`.
"""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from data_module.files import read_table

_TABLE = Path(__file__).with_name("gestures.csv")
# Marks in texts are typed by people: the shortest word that is understood has to work.
ALIASES: Mapping[str, str] = {
    "wave": "wave hello", "me": "point self", "stop": "stop palm", "open palms": "palms question",
    "shake head": "head shake", "size big": "big spread", "size small": "small pinch",
    "count 1": "number one", "count 2": "number two", "count 3": "number three", "count 4": "number four",
    "count 5": "number five"}
"""Other names, which earlier plans use or which are shorter to write -> the name in the table."""


@dataclass(frozen=True)
class NamedGesture:
    """A gesture that has a name. category: its kinds, from the most general one on; hands: those that make it, "one",
    "two", "one or two", or "head" for head and trunk alone; core: talk often calls for it; weak: it is hard to tell
    from others without the words; offensive: it insults somewhere, so that only an explicit cue may ask for it;
    meaning: what it says, in one sentence."""

    name: str
    category: tuple[str, ...]
    hands: str
    core: bool
    weak: bool
    offensive: bool
    meaning: str


_ROWS = ({key: cell or "" for key, cell in row.items()} for _, row in read_table(_TABLE, "install the program again"))
REPERTOIRE: Mapping[str, NamedGesture] = {row["name"]: NamedGesture(
    row["name"], tuple(row["category"].split()), row["hands"], row["core"] == "yes", row["weak"] == "yes",
    row["offensive"] == "yes", row["meaning"]) for row in _ROWS}
"""Name -> gesture, without the other names."""
GESTURES: Mapping[str, str] = {
    **{name: gesture.meaning for name, gesture in REPERTOIRE.items()},
    **{alias: f"Another name of {name}: {REPERTOIRE[name].meaning}" for alias, name in ALIASES.items()}}
"""All names that cues can give besides the lexemes -> what they mean. The lexicon has movements without meanings, so
these are scripts, blended over the generated motion."""


EXPRESSIONS: Mapping[str, str] = {
    "smile": "A smile of about two seconds.", "frown": "Brows drawn together for a second.",
    "raise brows": "Brows raised for a moment.", "happy": "A smiling mood, until another mood.",
    "sad": "A sad mood, until another mood.", "neutral": "The end of a mood."}
"""What cues and marks can ask of a face (`gesticulator.face.track`) -> what it is. A body does nothing for them."""


def mark_of(name: str) -> str:
    """How a gesture is written into a text, such as "[shrug]" or "[count:3]"."""
    # Families are written with a colon, so that a language model learns the pattern from few examples.
    kind, _, which = name.partition(" ")
    return f"[{kind}:{which}]" if kind in ("count", "size", "point") else f"[{name}]"


def near_gestures(name: str, others: Iterable[str] = ()) -> str:
    """What to say of an unknown name: the nearest names, and how to list all. others: further names, as of lexemes."""
    near = difflib.get_close_matches(name, [*GESTURES, *others], 3, 0.55)
    return ((f"did you mean {' or '.join(near)}? " if near else "")
            + "choose a name of gesticulator gestures, or of the lexicon (gesticulator plan names)")
