"""Text to perform: sentences of the grammar in phrases, each with an effort and a pause.

Topics with their words, and templates by meaning, are read from `sentences/`. A file of templates has the kind of the
sentences that follow on a line of its own; a template begins with a space. Its slots, {thing} {other} {things} {athing}
{person} {someone} {place} {elsewhere} {adj} {do} {did} {doing}, are filled from one topic; {n} is a small number and
{time} a time of day. `|` ends a phrase, `...` is a hesitation, and a template after "=" is held out for test. Topics
and templates of the two splits share no entry, so no sentence of one split can be spoken in the other. The phrasebooks
of the other languages have slots of their own and attach no meaning to words: the performer follows stress alone.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from data_module.errors import InputError
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


SPLITS = ("train", "test")
CHARACTERS_PER_SECOND = {"cmn": 7.5}
"""Characters a second that the voices speak, for languages other than those with 17 letters and spaces a second."""
_LETTERS_PER_SECOND = 17.0
# The longest pause in seconds, and the share of sentence ends with a pause of a second or more.
LONG_PAUSE, LONG_SHARE = 6.0, 0.21
_VOWELS = "aeiou"
_PLURALS = {"wolf": "wolves", "shelf": "shelves", "goose": "geese"}
_PARTICIPLES = {"threw": "thrown", "drew": "drawn", "stole": "stolen", "hid": "hidden"}
_T = TypeVar("_T")


def _topic(row: dict[str, str]) -> Topic:
    split = [tuple(verb.split("/")) for verb in row["verbs"].split()]
    return Topic(row["name"], *(tuple(row[name].split()) for name in ("things", "people", "places")),
                 tuple((base, past, running) for base, past, running in split), tuple(row["adjectives"].split()))


_WORDS = table("sentences/topics.toml")
TOPICS = {split: tuple(map(_topic, _WORDS[split])) for split in SPLITS}
NUMBERS, TIMES = tuple(_WORDS["shared"]["numbers"].split()), entries(_WORDS["shared"]["times"], ",")
OPENERS = {"train": entries(_WORDS["shared"]["openers"], "/"), "test": entries(_WORDS["shared"]["test_openers"], "/")}
TEMPLATES, MEANINGS, _CORE, _MORE, _FURTHER = (
    {split: templates(name, split == "test") for split in SPLITS}
    for name in ("en", "meanings", "core", "more", "further"))
"""Split -> templates by kind; those of MEANINGS call for a gesture with captured strokes, by its label."""
REPERTOIRE = {split: _CORE[split] | _MORE[split] | {
    label: (*MEANINGS[split][label], *lines) for label, lines in _FURTHER[split].items()} for split in SPLITS}
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


@dataclass(frozen=True)
class Part:
    """A phrase to speak: its text, its effort (-1 to 1), and the silence after it in seconds."""

    text: str
    effort: float
    pause: float


@dataclass(frozen=True)
class Utterance:
    """A sentence as its phrases, in order, and its kind (a key of the grammar)."""

    parts: tuple[Part, ...]
    kind: str

    @property
    def text(self) -> str:
        return " ".join(part.text for part in self.parts)


def compose(rng: np.random.Generator, seconds: float, split: str, used: set[str] | None = None,
            language: str = "en", repertoire: bool = False) -> list[Utterance]:
    """Write about `seconds` of speech, pauses included, without repeating a sentence.

    split: "train" or "test"; the two share neither topics nor templates. used: sentences not to be repeated; the new
    ones are added, so that one set over many calls gives hours without repetition. repertoire: English sentences for
    all named gestures, not only for those with captured strokes. Effort drifts from sentence to
    sentence (AR(1), 0.7) and varies from phrase to phrase. Same generator state, same text.
    """
    used = set() if used is None else used
    source = _English(split, repertoire) if language == "en" else _Phrases(split, language)
    pace = CHARACTERS_PER_SECOND.get(language, _LETTERS_PER_SECOND)
    utterances: list[Utterance] = []
    mood = float(rng.normal(0, 0.5))
    total = 0.0
    while total < seconds:
        kind, lines = _new_sentence(rng, source, used)
        mood = 0.7 * mood + float(rng.normal(0, 0.38))
        utterance = Utterance(_paced(rng, lines, mood), kind)
        utterances.append(utterance)
        total += sum(len(part.text) / pace + part.pause for part in utterance.parts)
    return utterances


def sentence_key(utterance: Utterance) -> str:
    """A sentence without pauses, capitals and punctuation, for the comparison of utterances."""
    return " ".join(re.findall(r"[^\W\d_]+(?:'[^\W\d_]+)*", utterance.text.lower()))


class _English:
    """Draws English sentences; consecutive ones share a topic."""

    def __init__(self, split: str, repertoire: bool) -> None:
        self.topics, self.templates = TOPICS[split], TEMPLATES[split]
        self.meanings, self.openers = MEANINGS[split], OPENERS[split]
        self.kinds, self.share = MEANING_KINDS, MEANING_SHARE
        if repertoire:
            self.meanings = self.meanings | REPERTOIRE[split]
            self.kinds, self.share = REPERTOIRE_KINDS, REPERTOIRE_SHARE
        self._topic, self._left = self.topics[0], 0

    def draw(self, rng: np.random.Generator) -> tuple[str, str]:
        if self._left == 0:
            self._topic, self._left = _one(rng, self.topics), int(rng.integers(3, 9))
        self._left -= 1
        if rng.random() < self.share:
            kind = _one(rng, self.kinds)
            return kind, _fill(rng, self._topic, _one(rng, self.meanings[kind]))
        kind = _one(rng, tuple(self.templates))
        return kind, _fill(rng, self._topic, _one(rng, self.templates[kind]))


class _Phrases:
    """Draws sentences of the phrasebook of another language than English."""

    def __init__(self, split: str, language: str) -> None:
        book = table(f"sentences/{language}.toml")[split]
        self.slots = {name: entries(line, ",") for name, line in book["slots"].items()}
        self.templates, self.openers = tuple(book["templates"].splitlines()), entries(book["openers"], "/")

    def draw(self, rng: np.random.Generator) -> tuple[str, str]:
        slots: dict[str, str] = {}
        for name, words in self.slots.items():
            order = rng.permutation(len(words))
            slots |= {f"{name}{rank + 1 if rank else ''}": words[i] for rank, i in enumerate(order[:3])}
        return "phrase", _one(rng, self.templates).format(**slots)


def _one(rng: np.random.Generator, entries: Sequence[_T]) -> _T:
    return entries[int(rng.integers(len(entries)))]


def _new_sentence(rng: np.random.Generator, source: _English | _Phrases, used: set[str]) -> tuple[str, list[str]]:
    """(kind, phrases) of a sentence not in `used`, to which it is added without its opener."""
    for _ in range(2000):
        kind, sentence = source.draw(rng)
        if sentence not in used:
            break
    else:
        raise InputError("text", "has no new sentence left", "ask for fewer seconds, or for another split or language")
    used.add(sentence)
    if rng.random() < 0.22:
        opener = _one(rng, source.openers).strip()
        sentence = f"{opener} | {sentence}" if opener[-1] in ",.，" else f"{opener} {sentence}"
    return kind, [phrase.strip() for phrase in sentence.split("|")]


def _fill(rng: np.random.Generator, topic: Topic, template: str) -> str:
    """The template with words of the topic in its slots; no word occurs twice."""
    things, people, places, numbers = ([words[i] for i in rng.permutation(len(words))[:4]] for words in (
        topic.things, topic.people, topic.places, NUMBERS))
    base, past, running = _one(rng, topic.verbs)
    return template.format(
        thing=things[0], other=things[1], things=plural(things[2]), things2=plural(things[3]),
        athing=with_article(things[2]), athing2=with_article(things[3]), person=people[0], someone=people[1],
        place=places[0], elsewhere=places[1], adj=_one(rng, topic.adjectives), do=base, did=past,
        done=_PARTICIPLES.get(past, past), doing=running, n=numbers[0], n2=numbers[1], time=_one(rng, TIMES))


def plural(noun: str) -> str:
    if noun in _PLURALS:
        return _PLURALS[noun]
    if noun.endswith("y") and noun[-2] not in _VOWELS:
        return noun[:-1] + "ies"
    return noun + ("es" if noun.endswith(("s", "x", "sh", "ch")) else "s")


def with_article(noun: str) -> str:
    return f"{'an' if noun[0] in _VOWELS and not noun.startswith('uni') else 'a'} {noun}"


def _paced(rng: np.random.Generator, phrases: Sequence[str], mood: float) -> tuple[Part, ...]:
    parts = []
    for position, phrase in enumerate(phrases):
        effort = float(np.tanh(1.1 * (mood + rng.normal(0, 0.33))))
        if position == len(phrases) - 1:
            pause = _pause_between(rng)
        elif phrase.endswith("..."):
            pause = float(rng.uniform(0.4, 1.3))
        else:
            pause = float(rng.uniform(0.08, 0.32) if rng.random() < 0.7 else rng.uniform(0.3, 0.8))
        parts.append(Part(phrase.removesuffix("...").strip(), effort, round(pause, 4)))
    return tuple(parts)


def _pause_between(rng: np.random.Generator) -> float:
    if rng.random() < LONG_SHARE:
        return float(1 + (LONG_PAUSE - 1) * rng.beta(1.0, 2.0))
    return float(rng.uniform(0.3, 1.0) if rng.random() < 0.75 else rng.uniform(0.12, 0.3))
