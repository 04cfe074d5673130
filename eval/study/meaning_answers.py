"""What the answers of a study of meanings say: how often a gesture is named, against chance and controls.

The interval of all answers draws raters and clips anew (crossed, Owen 2007); that of one meaning is Wilson's, over
answers, and so too narrow where one rater gives several. Read a meaning's share beside what its answer gets in the
controls, and beside the catch trials of its raters.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_module.errors import InputError
from data_module.files import read_json
from data_module.types import Array
from eval.stats import Interval, crossed_means, limits, share
from eval.study.meaning import ANSWERS, CATCH, GESTURE, KIND, NONE, OTHER
from eval.table import Cell, Column, Table

CHANCE = 1.0 / ANSWERS
_ADVICE = "give the file that was saved"
_MOST_CONFUSED = 15
_MEANINGS = {"answers": Column("answers"), "right": Column("named"), "above": Column("above chance"),
             "taken": Column("most often taken for")}


@dataclass(frozen=True)
class Item:
    """A clip. kind: as in `eval.study.meaning`; meaning: the answer that is asked for; shown: the gesture in it."""

    kind: str
    meaning: str
    answers: tuple[str, ...]
    shown: str | None


@dataclass(frozen=True)
class MeaningKey:
    """What the page does not tell."""

    study: str
    items: Mapping[str, Item]


@dataclass(frozen=True)
class Choices:
    """chosen: (rater, item) -> the gesture whose saying was chosen; notes: what was odd."""

    key: MeaningKey
    raters: tuple[str, ...]
    chosen: Mapping[tuple[str, str], str]
    notes: tuple[str, ...]


def is_meaning_key(path: Path) -> bool:
    """Whether a key is of a study of meanings."""
    held = read_json(path, _ADVICE)
    return isinstance(held, dict) and held.get("kind") == KIND


def read_meaning_key(path: Path) -> MeaningKey:
    """The key that `study meaning` wrote; InputError for anything else."""
    held = read_json(path, _ADVICE)
    try:
        items = {str(name): Item(str(own["kind"]), str(own["meaning"]), tuple(map(str, own["answers"])), own["shown"])
                 for name, own in held["items"].items()}
        good = isinstance(held["study"], str) and items and all(
            own.kind in (GESTURE, NONE, OTHER, CATCH) and own.meaning in own.answers
            and len(set(own.answers)) == ANSWERS and isinstance(own.shown, str | None) for own in items.values())
    except (KeyError, TypeError, AttributeError):
        good = False
    if not good:
        raise InputError(path, "is not the key of a study of meanings", "give the key.json that `study meaning` wrote")
    return MeaningKey(held["study"], items)


def read_choices(paths: Sequence[Path], key: MeaningKey, without: Sequence[str] = ()) -> Choices:
    """The answers of all files, checked: InputError for those of another study, an item or answer that the key does not
    have, and two different answers of one rater to one clip. without: raters that are left out."""
    chosen: dict[tuple[str, str], str] = {}
    notes = [f"left out on demand: rater {name}" for name in without]
    for path in paths:
        for rater, item, answer in _rows(path, key):
            if chosen.setdefault((rater, item), answer) != answer:
                raise InputError(path, f"rater {rater} answers {item} twice and differently",
                                 "give each rater a number of their own, or one file")
    unknown = sorted(set(without) - {rater for rater, _ in chosen})
    if unknown:
        raise InputError("--without", f"rater {unknown[0]} gave no answer", "name raters that are in the files")
    chosen = {place: answer for place, answer in chosen.items() if place[0] not in without}
    if not chosen:
        raise InputError("answers", "hold no answer", "give what the raters saved")
    raters = tuple(sorted({rater for rater, _ in chosen}, key=lambda name: (len(name), name)))
    return Choices(key, raters, chosen, (*notes, *_notes(key, raters, chosen)))


def _rows(path: Path, key: MeaningKey) -> list[tuple[str, str, str]]:
    """(rater, item, chosen gesture) of each answer in a file."""
    held = read_json(path, _ADVICE)
    try:
        study, rater = held["study"], str(held["rater"]).strip()
        rows = [(own["item"], own["choice"]) for own in held["answers"]]
    except (KeyError, TypeError, AttributeError):
        raise InputError(path, "is not a file of answers", "give what the page saved") from None
    if study != key.study:
        raise InputError(path, f"belongs to study {study!r}, and the key to {key.study!r}",
                         "give answers and key of one study")
    if not rater:
        raise InputError(path, "has answers without a rater", "each file needs the rater's number")
    for item, choice in rows:
        if not isinstance(item, str) or item not in key.items or isinstance(choice, bool) \
                or not isinstance(choice, int) or not 0 <= choice < ANSWERS:
            raise InputError(path, f"answers {item!r} with {choice!r}, which the key does not know",
                             "give answers and key of one study")
    return [(rater, item, key.items[item].answers[choice]) for item, choice in rows]


def _notes(key: MeaningKey, raters: Sequence[str], chosen: Mapping[tuple[str, str], str]) -> list[str]:
    """Missing answers and missed catch trials, by rater."""
    notes = []
    catches = [name for name, item in key.items.items() if item.kind == CATCH]
    for rater in raters:
        missing = sum((rater, name) not in chosen for name in key.items)
        missed = sum((rater, name) in chosen and chosen[rater, name] != key.items[name].meaning for name in catches)
        if missing:
            notes.append(f"rater {rater}: {missing} of {len(key.items)} answers are missing")
        if missed:
            notes.append(f"rater {rater}: misses {missed} of {len(catches)} catch trials; consider --without {rater}")
    return notes


# ------------------------------------------------------------------------------------------------------- tables

def meaning_tables(choices: Choices, seed: int = 0) -> list[Table]:
    """How often meanings are named: all together with the controls, by meaning, and the most frequent confusions."""
    rows: dict[str, dict[str, Cell]] = {}
    for kind in (GESTURE, NONE, OTHER, CATCH):
        values = _hits(choices, kind)
        rows[kind] = {"answers": int(np.isfinite(values).sum()), "named": _interval(values, seed)}
    columns = {"answers": Column("answers"), "named": Column("named")}
    all_of = Table("Meanings named among five", columns, rows, "clips", [
        f"{len(choices.raters)} raters. Chance is {CHANCE:.1f}. Controls count the answer that is asked for, too: the "
        "same seconds without a gesture, and another gesture's clip. Intervals draw raters and clips anew.",
        *choices.notes])
    return [all_of, _by_meaning(choices), _confused(choices)]


def _hits(choices: Choices, kind: str) -> Array:
    """[R, C] whether each rater names the meaning of each clip of a kind; NaN without an answer."""
    items = [(name, item) for name, item in choices.key.items.items() if item.kind == kind]
    return np.array([[float(choices.chosen[rater, name] == item.meaning) if (rater, name) in choices.chosen else np.nan
                      for name, item in items] for rater in choices.raters]).reshape(len(choices.raters), len(items))


def _interval(values: Array, seed: int) -> Interval:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Interval.undefined()
    return limits(float(finite.mean()), crossed_means(values[:, :, None], seed)[:, 0], int(finite.size))


def _answers_to(choices: Choices) -> dict[str, Counter[str]]:
    """Gesture -> how often each answer was chosen for its clips."""
    out: dict[str, Counter[str]] = {}
    for (_, name), answer in choices.chosen.items():
        item = choices.key.items[name]
        if item.kind == GESTURE:
            out.setdefault(item.meaning, Counter())[answer] += 1
    return out


def _by_meaning(choices: Choices) -> Table:
    rows: dict[str, dict[str, Cell]] = {}
    answers = _answers_to(choices)
    for meaning in sorted(answers, key=lambda name: (answers[name][name] / answers[name].total(), name)):
        counts = answers[meaning]
        right = share(counts[meaning], counts.total())
        wrong = min(((-count, name) for name, count in counts.items() if name != meaning), default=None)
        rows[meaning] = {"answers": counts.total(), "right": right, "above": "yes" if right.above(CHANCE) else "no",
                         "taken": f"{wrong[1]} ({-wrong[0]})" if wrong else ""}
    return Table("By meaning, the least named first", _MEANINGS, rows, "gesture", [
        "Intervals are Wilson's, over answers."], {"chosen": {name: dict(sorted(counts.items()))
                                                             for name, counts in sorted(answers.items())}})


def _confused(choices: Choices) -> Table:
    """The pairs that were confused most often, with how often the wrong answer was offered."""
    offered: Counter[tuple[str, str]] = Counter()
    for (_, name) in choices.chosen:
        item = choices.key.items[name]
        offered.update((item.meaning, other) for other in item.answers if item.kind == GESTURE)
    taken = sorted(((count, shown, other) for shown, counts in _answers_to(choices).items()
                    for other, count in counts.items() if other != shown), key=lambda row: (-row[0], row[1:]))
    rows: dict[str, dict[str, Cell]] = {
        f"{shown} as {other}": {"times": count, "offered": offered[shown, other]}
        for count, shown, other in taken[:_MOST_CONFUSED]}
    return Table("Confusions", {"times": Column("times"), "offered": Column("of times offered")}, rows, "taken for")


def analysed(key: Path, answers: Sequence[Path], without: Sequence[str], seed: int) -> list[Table]:
    """The tables of a key and its answers; InputError for input that cannot be used."""
    return meaning_tables(read_choices(answers, read_meaning_key(key), without), seed)

