"""Gestures with a meaning in a corpus, counted: how often each was played, by split, and at how many words.

Counted from the truth, not measured on the motion: which label a stroke was chosen for and the word that asked for it.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence

from data_module.store import Recording
from data_module.truth import SCRIPTED
from eval.table import Cell, Column, Table

SPLITS = ("train", "val", "test")


def played(recording: Recording) -> tuple[tuple[str, str, str], ...]:
    """(label, word, source) of each stroke of a recording that has a meaning; the word is "" where words are not known,
    the source "script" or "clip"."""
    words = recording.speech.words or ()
    strokes = recording.truth.strokes if recording.truth else ()
    said = [word.text.lower().strip(".,?!") for word in words]
    return tuple((stroke.meaning, said[stroke.word] if 0 <= stroke.word < len(said) else "",
                  "script" if stroke.clip.startswith(SCRIPTED) else "clip")
                 for stroke in strokes if stroke.meaning)


def table(counted: Sequence[tuple[str, Sequence[tuple[str, str, str]]]]) -> Table:
    """Counts by label and split. counted: of each recording its split and what `played` tells."""
    strokes: dict[str, Counter[str]] = defaultdict(Counter)
    words: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for split, own in counted:
        for label, word, source in own:
            strokes[label][split] += 1
            strokes[label][source] += 1
            words[label][split].add(word)
    rows: dict[str, dict[str, Cell]] = {
        label: {**{split: strokes[label][split] for split in SPLITS}, "script": strokes[label]["script"],
                "words": len(set().union(*words[label].values())),
                "new": len(words[label]["test"] - words[label]["train"])} for label in sorted(strokes)}
    columns = {**{split: Column(split) for split in SPLITS}, "script": Column("of these from scripts"),
               "words": Column("words"),
               "new": Column("words of test alone")}
    return Table("Gestures with a meaning", columns, rows, "label",
                 ["Strokes that were chosen for the meaning of a word, counted from the truth; words: different ones "
                  "that they fall on."])
