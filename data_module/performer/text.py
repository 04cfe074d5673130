"""Text to perform: sentences of our own grammar, broken in phrases, with an effort and a pause for each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_module.errors import InputError
from data_module.performer import grammar
from data_module.performer.grammar import Topic

SPLITS = ("train", "test")
CHARACTERS_PER_SECOND = 14.0
# The longest pause, and what share of sentence ends gets one of a second or more.
LONG_PAUSE, LONG_SHARE = 6.0, 0.24
_VOWELS = "aeiou"


@dataclass(frozen=True)
class Part:
    """A phrase to speak: its text, the effort (-1 to 1) to speak it with, and the seconds of silence after it."""

    text: str
    effort: float
    pause: float


@dataclass(frozen=True)
class Utterance:
    """A sentence as its phrases, in order, and what kind of sentence it is (a key of the grammar)."""

    parts: tuple[Part, ...]
    kind: str

    @property
    def text(self) -> str:
        """The sentence in one line."""
        return " ".join(part.text for part in self.parts)


def compose(rng: np.random.Generator, seconds: float, split: str, used: set[str] | None = None,
            language: str = "en") -> list[Utterance]:
    """Write about `seconds` of speech, pauses included, without saying a sentence twice.

    split: "train" or "test"; the two share neither topics nor templates. used: sentences not to be said again; the new
    ones are added, so that one set kept over many calls makes hours without repetition. Effort wanders from sentence to
    sentence (AR(1), 0.7) and varies from phrase to phrase. Same generator state, same text.
    """
    if split not in SPLITS:
        raise InputError(f"split {split!r}", "is not known", f"choose one of {', '.join(SPLITS)}")
    said = set() if used is None else used
    topics, templates, openers = _material(split, language)
    kinds = list(templates)
    utterances: list[Utterance] = []
    mood = float(rng.normal(0, 0.5))
    topic, left = topics[int(rng.integers(len(topics)))], 0
    total = 0.0
    while total < seconds:
        if left == 0:
            topic, left = topics[int(rng.integers(len(topics)))], int(rng.integers(3, 9))
        kind = kinds[int(rng.integers(len(kinds)))]
        lines = _new_sentence(rng, topic, templates[kind], openers, said)
        left -= 1
        mood = 0.7 * mood + float(rng.normal(0, 0.38))
        utterance = Utterance(_paced(rng, lines, mood), kind)
        utterances.append(utterance)
        total += sum(len(part.text) / CHARACTERS_PER_SECOND + part.pause for part in utterance.parts)
    return utterances


def sentence_key(utterance: Utterance) -> str:
    """A sentence without its pauses, capitals and punctuation: two utterances that say the same share it."""
    return " ".join(re.findall(r"[^\W\d_]+(?:'[^\W\d_]+)*", utterance.text.lower()))


def _material(split: str, language: str) -> tuple[Sequence[Topic], dict[str, tuple[str, ...]], Sequence[str]]:
    if language != "en":
        raise InputError(f"language {language!r}", "has no grammar here", "choose en")
    if split == "train":
        return grammar.TRAIN_TOPICS, grammar.TRAIN_TEMPLATES, grammar.OPENERS
    return grammar.TEST_TOPICS, grammar.TEST_TEMPLATES, grammar.TEST_OPENERS


def _new_sentence(rng: np.random.Generator, topic: Topic, templates: Sequence[str], openers: Sequence[str],
                  said: set[str]) -> list[str]:
    """A sentence not in `said`, as its phrases; it is added there without its opener."""
    for _ in range(1000):
        sentence = _fill(rng, topic, templates[int(rng.integers(len(templates)))])
        if sentence not in said:
            break
    else:
        raise InputError("text", f"has no new sentence left for the topic {topic.name}", "ask for fewer seconds")
    said.add(sentence)
    if rng.random() < 0.22:
        opener = openers[int(rng.integers(len(openers)))]
        sentence = f"{opener} | {sentence}" if opener[-1] in ",." else f"{opener} {sentence}"
    return [phrase.strip() for phrase in sentence.split("|")]


def _fill(rng: np.random.Generator, topic: Topic, template: str) -> str:
    """The template with words of the topic in its slots; no word stands twice."""
    things = [topic.things[i] for i in rng.permutation(len(topic.things))[:4]]
    people = [topic.people[i] for i in rng.permutation(len(topic.people))[:2]]
    places = [topic.places[i] for i in rng.permutation(len(topic.places))[:2]]
    base, past, running = topic.verbs[int(rng.integers(len(topic.verbs)))]
    numbers = [grammar.NUMBERS[i] for i in rng.permutation(len(grammar.NUMBERS))[:2]]
    return template.format(
        thing=things[0], other=things[1], things=plural(things[2]), things2=plural(things[3]),
        athing=with_article(things[2]), athing2=with_article(things[3]), person=people[0], someone=people[1],
        place=places[0], elsewhere=places[1], adj=topic.adjectives[int(rng.integers(len(topic.adjectives)))],
        do=base, did=past, done=past, doing=running, n=numbers[0], n2=numbers[1],
        time=grammar.TIMES[int(rng.integers(len(grammar.TIMES)))])


def plural(noun: str) -> str:
    """The regular English plural."""
    irregular = {"wolf": "wolves", "shelf": "shelves", "goose": "geese"}
    if noun in irregular:
        return irregular[noun]
    if noun.endswith("y") and noun[-2] not in _VOWELS:
        return noun[:-1] + "ies"
    return noun + ("es" if noun.endswith(("s", "x", "sh", "ch")) else "s")


def with_article(noun: str) -> str:
    """The noun after a or an."""
    return f"{'an' if noun[0] in _VOWELS and not noun.startswith('uni') else 'a'} {noun}"


def _paced(rng: np.random.Generator, phrases: Sequence[str], mood: float) -> tuple[Part, ...]:
    """Phrases with an effort around the mood of the sentence and a pause after each."""
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
    """Seconds between two sentences: mostly short, sometimes 1 to 6 s."""
    if rng.random() < LONG_SHARE:
        return float(1 + (LONG_PAUSE - 1) * rng.beta(1.0, 2.0))
    return float(rng.uniform(0.3, 1.0) if rng.random() < 0.75 else rng.uniform(0.12, 0.3))
