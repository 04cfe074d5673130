"""Sentences of the corpus: topics with their words, and templates by meaning, read from `sentences/`.

A file of templates has the kind of the sentences that follow on a line of its own; a template begins with a space. Its
slots, {thing} {other} {things} {athing} {person} {someone} {place} {elsewhere} {adj} {do} {did} {doing}, are filled
from one topic; {n} is a small number and {time} a time of day. `|` ends a phrase, `...` is a hesitation, and a template
after "=" is held out for test. Topics and templates of the two splits share no entry, so no sentence of one split can
be spoken in the other. The phrasebooks of the other languages have slots of their own and attach no meaning to words:
the performer follows stress alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gesticulator_performer.tables import entries, table, templates


@dataclass(frozen=True)
class Topic:
    """The words of one everyday subject. Verbs are (base, past, -ing); each takes a thing as its object."""

    name: str
    things: tuple[str, ...]
    people: tuple[str, ...]
    places: tuple[str, ...]
    verbs: tuple[tuple[str, str, str], ...]
    adjectives: tuple[str, ...]


@dataclass(frozen=True)
class Phrasebook:
    """slots: name -> entries; templates: sentences with slots; openers: words a sentence may begin with."""

    slots: dict[str, tuple[str, ...]]
    templates: tuple[str, ...]
    openers: tuple[str, ...]


def _topic(row: dict[str, str]) -> Topic:
    split = [tuple(verb.split("/")) for verb in row["verbs"].split()]
    return Topic(row["name"], *(tuple(row[name].split()) for name in ("things", "people", "places")),
                 tuple((base, past, running) for base, past, running in split), tuple(row["adjectives"].split()))


def _phrasebook(book: dict[str, Any]) -> Phrasebook:
    return Phrasebook({name: entries(line, ",") for name, line in book["slots"].items()},
                      tuple(book["templates"].splitlines()), entries(book["openers"], "/"))


_WORDS = table("sentences/topics.toml")
_SPLITS = ("train", "test")
TOPICS = {split: tuple(map(_topic, _WORDS[split])) for split in _SPLITS}
NUMBERS, TIMES = tuple(_WORDS["shared"]["numbers"].split()), entries(_WORDS["shared"]["times"], ",")
OPENERS = {"train": entries(_WORDS["shared"]["openers"], "/"), "test": entries(_WORDS["shared"]["test_openers"], "/")}
PHRASEBOOKS = {(language, split): _phrasebook(table(f"sentences/{language}.toml")[split])
               for language in ("de", "es", "cmn") for split in _SPLITS}
"""(language, split) -> its phrasebook; English has topics and templates instead."""
TEMPLATES, MEANINGS, _CORE, _MORE, _FURTHER = (
    {split: templates(name, split == "test") for split in _SPLITS}
    for name in ("en", "meanings", "core", "more", "further"))
"""Split -> templates by kind; those of MEANINGS call for a gesture with captured strokes, by its label."""
REPERTOIRE = {split: _CORE[split] | _MORE[split] | {
    label: (*MEANINGS[split][label], *lines) for label, lines in _FURTHER[split].items()} for split in _SPLITS}
"""Templates for the gestures without captured strokes, and for those whose templates the detector seldom finds."""


def _repeated(times: dict[str, int]) -> tuple[str, ...]:
    """Each label as often as it says, to draw from."""
    return tuple(label for label, count in times.items() for _ in range(count))


_LABELS = {name: frozenset(words.split()) for name, words in table("words.toml")["labels"].items()}
# Labels whose cues other sentences contain anyway are written for twice; those whose cues hardly occur elsewhere, or
# weigh little, nine times; the others five times.
MEANING_KINDS = _repeated({label: 2 if label in _LABELS["often_elsewhere"] else
                           9 if label in _LABELS["seldom_elsewhere"] else 5 for label in MEANINGS["train"]})
"""The labels to draw a sentence's from, each as often as it needs to be."""
MEANING_SHARE = 0.75
"""Share of the English sentences that are written for a gesture with a meaning: with it each of the 32 gestures is
played at least 30 times in the training split of 4.4 hours."""
# With all named gestures: core gestures four times, the others three times, and three more for labels whose cue phrases
# often lose against others or seldom find an arm free.
REPERTOIRE_KINDS = _repeated({label: (4 if label in _CORE["train"] else 3) + 3 * (label in _LABELS["seldom_played"])
                              for label in REPERTOIRE["train"] | MEANINGS["train"]})
"""The same where every named gesture can be played."""
REPERTOIRE_SHARE = 0.9
"""Share of its sentences that are written for a gesture with a meaning: of a hundred gestures each is to come often."""
