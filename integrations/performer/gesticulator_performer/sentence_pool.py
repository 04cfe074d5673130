"""The pool of phrases of a voice, with the time of every vowel, from which speech for a given motion is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.types import Array, Samples, Speech, Word
from gesticulator_performer import meaning, text, voices
from gesticulator_performer.sound import RATE
from gesticulator_performer.syllables import Nucleus, listen
from gesticulator_performer.types import Phrase

_LEAST_LETTERS, _LONGEST_LETTERS = 6, 70
# Probability that a phrase is joined with the next of its sentence, because motion has phrases of up to 6 s.
_JOINED = 0.55
# Silence between the phrases while their prominence is measured, seconds.
_PAUSE = 0.3
NO_VOWEL = np.inf


@dataclass(frozen=True)
class Pool:
    """The phrases of a voice. texts: [B]; durations: [B] seconds; vowels: [B, I] seconds of vowel onsets from each
    phrase's first sample, infinite beyond the last; prominence: [B, I]; asks: [B, I] index in `meaning.MOVEMENTS` of
    the movement that the vowel's word asks for, -1 for none; level: the RMS over all phrases."""

    voice: str
    texts: tuple[str, ...]
    durations: Array
    vowels: Array
    prominence: Array
    asks: Array
    level: float

    def __len__(self) -> int:
        return len(self.texts)


def phrase_texts(rng: np.random.Generator, count: int, split: str, used: set[str]) -> tuple[str, ...]:
    """`count` new phrases of the grammar, some of them joined; none is in `used`, to which they are added."""
    phrases: list[str] = []
    while len(phrases) < count:
        for utterance in text.compose(rng, 60.0, split, used):
            waiting = ""
            for place, part in enumerate(utterance.parts):
                waiting = f"{waiting} {part.text}".strip()
                goes_on = len(waiting) < _LONGEST_LETTERS and rng.random() < _JOINED
                if goes_on and place < len(utterance.parts) - 1:
                    continue
                if len(waiting) >= _LEAST_LETTERS and waiting not in used:
                    phrases.append(waiting)
                    used.add(waiting)
                waiting = ""
    return tuple(phrases[:count])


def make_pool(voice: str, texts: Sequence[str]) -> Pool:
    spoken = voices.sound_all([text.Part(one, 0.0, _PAUSE) for one in texts], voices.VOICES[voice])
    gap = np.zeros(round(_PAUSE * RATE), dtype=np.float32)
    offset, pieces = 0, []
    nuclei: list[Nucleus] = []
    phrases: list[Phrase] = []
    words: list[Word] = []
    for one in spoken:
        at = offset / RATE
        nuclei += [replace(n, start=n.start + at, vowel=n.vowel + at, end=n.end + at, word=n.word + len(words))
                   for n in voices.nuclei_of(one.phones)]
        words += [replace(w, start=w.start + at, end=w.end + at) for w in one.words]
        phrases.append(Phrase(at, at + len(one.samples) / RATE, 0.0))
        pieces += [one.samples, gap]
        offset += len(one.samples) + len(gap)
    speech = Speech(np.concatenate(pieces), RATE, tuple(words))
    syllables = listen(speech, phrases, nuclei, "en")
    counts = [len(voices.nuclei_of(one.phones)) for one in spoken]
    starts = np.cumsum([0, *counts])
    first_words = np.cumsum([0, *(len(one.words) for one in spoken)])
    shape = (len(spoken), max(counts))
    vowels, prominence, asks = np.full(shape, NO_VOWEL), np.zeros(shape), np.full(shape, -1)
    for k, (one, phrase) in enumerate(zip(spoken, phrases, strict=True)):
        inside = syllables[starts[k]:starts[k + 1]]
        vowels[k, :len(inside)] = [s.vowel - phrase.start for s in inside]
        prominence[k, :len(inside)] = [s.prominence for s in inside]
        wanted = meaning.movements_of([w.text for w in one.words])
        for place, syllable in enumerate(inside):
            best = max(s.prominence for s in inside if s.word == syllable.word)
            if syllable.prominence == best:
                asks[k, place] = wanted[syllable.word - first_words[k]]
    level = float(np.sqrt(np.mean(np.concatenate([one.samples for one in spoken]) ** 2))) + 1e-9
    return Pool(voice, tuple(texts), np.array([len(one.samples) / RATE for one in spoken]), vowels, prominence,
                asks, level)


def stretched(samples: Samples, anchors: Array) -> Samples:
    """Time-stretch samples at 16 kHz with the pitch unchanged: WSOLA with windows of 40 ms. anchors: [K, 2] seconds in
    and out, rising in both columns, the first (0, 0), the last at the end of the samples."""
    import pytsmod

    marks = np.round(anchors.T * RATE).astype(int)
    marks[0, -1] = min(marks[0, -1], len(samples) - 1)
    keep = np.concatenate([[True], (np.diff(marks) > 0).all(axis=0)])
    out = pytsmod.wsola(samples.astype(np.float64), marks[:, keep], win_size=640, syn_hop_size=320, tolerance=200)
    return np.asarray(out, dtype=np.float32).ravel()[:marks[1, -1]]
