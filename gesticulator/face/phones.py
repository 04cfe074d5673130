"""The mouth by the words: the phones of words whose times are known, placed where the lips network hears them.

Each word is a chain of visemes, in every way that it may be said, with silence between words where there is any. The
best path through all chains (Viterbi) is found with the network's weights as probabilities; a word stays within its
times, give or take `SLACK`. A word that the sound contradicts is left to the sound.
"""

import itertools
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from data_module.text.alignment import aligner_installed, can_follow, dictionary_phones, spoken_words
from data_module.types import Array, Word
from gesticulator.face.visemes import CLOSED, RATE, SILENT, VISEMES, of_arpabet
from gesticulator.language import language_of

SLACK = 0.1
"""Seconds by which the times of a word may be wrong: recognisers round and miss by so much."""
_FLOOR = 0.01
"""Added to each probability: the network is never that sure."""
_FREE = 0.2
"""Probability of every frame in a word without a pronunciation."""
_PAUSE = 0.6
"""Seconds without a word at which one path ends and the next begins."""
_LONGEST = 15.0
"""Longest path, seconds: its memory grows with the square."""
_LEAST = -1.9
"""Mean logarithm of the probability of its visemes from which a word is heard where it should be."""
_MOST_UNHEARD = 0.4
"""Share of words that are not heard from which all are left to the sound: the text or its times are of other speech.
In readings with their text it is under 0.15, with the text of others over 0.5."""
_SHARE = 0.75
"""Share of the phones in the weights where they are known; the rest is the sound's, which says how clear a vowel is."""

Pronunciation: TypeAlias = tuple[int, ...]
"""The visemes of a word in order, no two neighbours equal."""


@dataclass(frozen=True)
class PhonedWord:
    """A word from `start` to `end` seconds, and the visemes of each way to say it; none if it is not known."""

    start: float
    end: float
    ways: tuple[Pronunciation, ...]


class _State(NamedTuple):
    """A state of a path: viseme, -1 for any; number of the word, -1 for silence; first and last frame, the last one
    excluded; and the states that may come before."""

    viseme: int
    word: int
    first: int
    last: int
    before: list[int]


class PhonesWarning(UserWarning):
    """The words of a recording do not help its lips."""


def with_phones(weights: Array, words: Sequence[PhonedWord]) -> Array | None:
    """[T, 15] the network's weights, 50 frames a second, drawn towards the phones of the words, which rise in time.
    Frames of words that are not heard keep theirs. None if too few of the words are heard."""
    # Each run of words has a path of its own, since memory grows with the square of its length.
    out, recognised = weights.copy(), 0
    for first, last in _runs(words):
        frames, visemes, count = _path(weights, words[first:last])
        recognised += count
        known = visemes >= 0
        out[frames[known]] = _mixed(weights[frames[known]], visemes[known])
    return out if recognised >= (1.0 - _MOST_UNHEARD) * len(words) else None


def _mixed(sound: Array, visemes: NDArray[np.int64]) -> Array:
    """[K, 15] the sound's weights and the phones'. Lips shut where a phone shuts them, for sure, and nowhere else."""
    # The sound alone shuts the mouth where no phone does, on noise above all: its share of closures is left out.
    open_ = np.where(np.arange(len(VISEMES)) == CLOSED, 0.0, sound)
    open_ /= np.maximum(open_.sum(axis=1, keepdims=True), 1e-9)
    # A closure and a silence are certain where the phones are known; of a vowel the sound says how clear it is.
    share = np.where(np.isin(visemes, (CLOSED, SILENT)), 1.0, _SHARE)[:, None]
    return np.asarray(share * np.eye(len(VISEMES))[visemes] + (1.0 - share) * open_)


def spoken_weights(weights: Array, words: Sequence[Word]) -> Array:
    """`with_phones` for words as they are written. Where their pronunciations are not known, or they are not heard, the
    weights stay, and a `PhonesWarning` says so."""
    # Recognisers send empty words, words without a duration, and some out of order.
    words = sorted((word for word in words if word.text.strip() and word.end > word.start),
                   key=lambda word: word.start)
    if not words:
        return weights
    ways = pronunciations([word.text for word in words])
    followed = None if ways is None else with_phones(weights, [
        PhonedWord(word.start, word.end, way) for word, way in zip(words, ways, strict=True)])
    if followed is None:
        reason = ("the words are not heard at their times" if ways is not None else
                  "no pronunciations for these words (English needs pocketsphinx, other languages have none)")
        warnings.warn(PhonesWarning(f"{reason}; the lips follow the sound alone"), stacklevel=1)
    return weights if followed is None else followed


def _runs(words: Sequence[PhonedWord]) -> Iterator[tuple[int, int]]:
    """First and last (excluded) of the words of each path."""
    first = 0
    for at in range(1, len(words) + 1):
        if at == len(words) or words[at].start - words[at - 1].end > _PAUSE \
                or words[at].end - words[first].start > _LONGEST:
            yield first, at
            first = at


def _path(weights: Array, words: Sequence[PhonedWord]) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Frames of these words, the viseme of each, -1 in a word that is not heard, and how many words are heard. No
    frames if there is no path."""
    # The window is as much longer than the words as their times may be wrong.
    begin = max(int((words[0].start - SLACK) * RATE), 0)
    end = min(int((words[-1].end + SLACK) * RATE) + 1, len(weights))
    states = _chained(words, begin, end)
    scores = np.log(np.concatenate([weights[begin:end] + _FLOOR, np.full((max(end - begin, 0), 1), _FREE)], axis=1))
    path = _best(states, scores, begin)
    visemes = np.array([state.viseme for state in states], np.int64)[path]
    owners = np.array([state.word for state in states], np.int64)[path]
    # A word of other speech gets a path, too, but an unlikely one: it is then left to the sound.
    likely = scores[np.arange(len(path)), visemes]  # -1 is the last column
    recognised = 0
    for word in np.unique(owners[owners >= 0]):
        inside = owners == word
        if likely[inside].mean() < _LEAST:
            visemes[inside] = -1
        else:
            recognised += 1
    return np.arange(begin, begin + len(path)), visemes, recognised


def _chained(words: Sequence[PhonedWord], begin: int, end: int) -> list[_State]:
    """The states of words and of the silences around them, in order, within frames `begin` to `end`."""
    states: list[_State] = []

    def add(viseme: int, word: int, start: float, stop: float, before: list[int]) -> int:
        """Add a state that may last from `start` to `stop` seconds; its number."""
        states.append(_State(viseme, word, max(int((start - SLACK) * RATE), begin),
                             min(int((stop + SLACK) * RATE) + 1, end), before))
        return len(states) - 1

    ends: list[int] = []
    edge = words[0].start
    for number, word in enumerate(words):
        # Words may follow each other with or without a silence, so the next word starts after either.
        silence = add(SILENT, -1, min(edge, word.start), word.start, list(ends))
        starts, ends = [*ends, silence], []
        for way in word.ways or ((-1,),):
            before = starts
            for viseme in way:
                for _ in range(2 if viseme == CLOSED else 1):  # lips stay shut for two frames at least
                    before = [add(viseme, number, word.start, word.end, before)]
            ends += before
        edge = word.end
    add(SILENT, -1, edge, edge, ends)
    return states


def _best(states: Sequence[_State], scores: Array, begin: int) -> NDArray[np.int64]:
    """[T] the state at each frame of `scores` [T, 16], on the best path (Viterbi); [0] if there is none."""
    # A row for each state: itself, since a state may last, and the states before it. -1 is no state, whose score stays
    # at minus infinity.
    count, most = len(states), max(len(state.before) for state in states)
    before = np.full((count, most + 1), -1)
    before[:, 0] = np.arange(count)
    for number, state in enumerate(states):
        before[number, 1:1 + len(state.before)] = state.before
    visemes, first, last = (np.array([getattr(state, name) for state in states]) for name in (
        "viseme", "first", "last"))
    # A path begins with the first silence or with the first phone of the first word.
    begins = [number for number, state in enumerate(states) if not state.before or state.before[0] == 0]
    now = np.full(count + 1, -np.inf)  # the last entry is of no state
    steps = []
    for frame, row in enumerate(scores):
        inside = np.flatnonzero((first <= begin + frame) & (begin + frame < last))
        if frame == 0:
            chosen = np.zeros(len(inside), np.int64)
            reached = np.where(np.isin(inside, begins), 0.0, -np.inf)
        else:
            options = now[before[inside]]
            chosen = options.argmax(axis=1)
            reached = options[np.arange(len(inside)), chosen]
        now = np.full(count + 1, -np.inf)
        now[inside] = reached + row[visemes[inside]]
        step = np.full(count, -1)
        step[inside] = before[inside, chosen]
        steps.append(step)
    # It ends with the last silence or with the last phone of a way to say the last word.
    ends = [count - 1, *states[-1].before]
    at = max(ends, key=lambda number: now[number])
    if not len(scores) or not np.isfinite(now[at]):
        return np.zeros(0, np.int64)
    path = np.zeros(len(scores), np.int64)
    for frame in range(len(scores) - 1, -1, -1):
        path[frame] = at
        at = int(steps[frame][at])
    return path


def pronunciations(words: Sequence[str]) -> list[tuple[Pronunciation, ...]] | None:
    """For each English word its pronunciations, () for a word without any; None for other languages, and without
    pocketsphinx, whose dictionary is used. words: as they are written."""
    if language_of(words) != "en" or not can_follow(" ".join(words)) or not aligner_installed():
        return None
    return [_in_dictionary(word) for word in words]


@lru_cache(maxsize=20000)
def _in_dictionary(word: str) -> tuple[Pronunciation, ...]:
    """All ways to say an English word; a word of several parts ("real-time") has the first way of each."""
    parts = [dictionary_phones(plain) for _, plain in spoken_words(word)]
    if not parts:
        return ()
    ways = parts[0] if len(parts) == 1 else [[phone for part in parts for phone in part[0]]]
    chains = (tuple(viseme for viseme, _ in itertools.groupby(viseme for phone in way for viseme in of_arpabet(phone)))
              for way in ways)
    return tuple(dict.fromkeys(chain for chain in chains if chain))
