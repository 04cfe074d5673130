"""Sentences of the corpus: topics with their words, and templates by meaning, read from `sentences/`.

A file of templates has the kind of the sentences that follow on a line of its own; a template begins with a space. Its
slots, {thing} {other} {things} {athing} {person} {someone} {place} {elsewhere} {adj} {do} {did} {doing}, are filled
from one topic; {n} is a small number and {time} a time of day. `|` ends a phrase, `...` is a hesitation, and a template
after "=" is held out for test. Topics and templates of the two splits share no entry, so no sentence of one split can
be spoken in the other.
"""

from __future__ import annotations

from dataclasses import dataclass

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


def _topic(row: dict[str, str]) -> Topic:
    split = [tuple(verb.split("/")) for verb in row["verbs"].split()]
    return Topic(row["name"], *(tuple(row[name].split()) for name in ("things", "people", "places")),
                 tuple((base, past, running) for base, past, running in split), tuple(row["adjectives"].split()))


_WORDS = table("sentences/topics.toml")
TRAIN_TOPICS, TEST_TOPICS = (tuple(map(_topic, _WORDS[split])) for split in ("train", "test"))
NUMBERS, TIMES = tuple(_WORDS["shared"]["numbers"].split()), entries(_WORDS["shared"]["times"], ",")
OPENERS, TEST_OPENERS = (entries(_WORDS["shared"][name], "/") for name in ("openers", "test_openers"))
TRAIN_TEMPLATES, TEST_TEMPLATES = (templates("en", held_out) for held_out in (False, True))
TRAIN_MEANINGS, TEST_MEANINGS = (templates("meanings", held_out) for held_out in (False, True))
"""Templates whose words call for a gesture with captured strokes, by its label."""
_CORE = templates("core", held_out=False)
TRAIN_REPERTOIRE, TEST_REPERTOIRE = (
    templates("core", held_out) | templates("more", held_out)
    | {label: (*known[label], *lines) for label, lines in templates("further", held_out).items()}
    for held_out, known in ((False, TRAIN_MEANINGS), (True, TEST_MEANINGS)))
"""Templates for the gestures without captured strokes, and for those whose templates the detector seldom finds."""


def _repeated(times: dict[str, int]) -> tuple[str, ...]:
    """Each label as often as it says, to draw from."""
    return tuple(label for label, count in times.items() for _ in range(count))


_LABELS = {name: frozenset(words.split()) for name, words in table("words.toml")["labels"].items()}
# Labels whose cues other sentences contain anyway are written for twice; those whose cues hardly occur elsewhere, or
# weigh little, nine times; the others five times.
MEANING_KINDS = _repeated({label: 2 if label in _LABELS["often_elsewhere"] else
                           9 if label in _LABELS["seldom_elsewhere"] else 5 for label in TRAIN_MEANINGS})
"""The labels to draw a sentence's from, each as often as it needs to be."""
# With all named gestures: core gestures four times, the others three times, and three more for labels whose cue phrases
# often lose against others or seldom find an arm free.
REPERTOIRE_KINDS = _repeated({label: (4 if label in _CORE else 3) + 3 * (label in _LABELS["seldom_played"])
                              for label in {**TRAIN_REPERTOIRE, **TRAIN_MEANINGS}})
"""The same where every named gesture can be played."""
REPERTOIRE_SHARE = 0.9
"""Share of its sentences that are written for a gesture with a meaning: of a hundred gestures each is to come often."""
