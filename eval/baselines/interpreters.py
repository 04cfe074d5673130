"""Interpreters that do not listen, which one that listens must beat: `Majority`, `Bigram`.

`RandomStyle` draws style codes. `ReplayInterpreter` gives lexemes that are known beforehand, so that they can be
played.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array

if TYPE_CHECKING:
    from gesticulator.bundle.bundle import Bundle
    from gesticulator.training.stages import Corpus
    from interpreters.base import BlockFeatures

IMPROBABLE = -1e3
"""A score so low that no temperature in use draws the lexeme."""
Lexemes = NDArray[np.int64]


def _only(lexeme: int, size: int) -> Array:
    """Scores [S] that leave one choice."""
    scores = np.full(size, IMPROBABLE)
    scores[lexeme] = 0.0
    return scores


class Bigram:
    """The most frequent successor of the previous lexeme for this speaker: what accuracy needs no sound for."""

    def __init__(self, successors: Lexemes) -> None:
        """successors: [speakers, S]."""
        self._successors = successors

    @classmethod
    def fitted(cls, corpus: Corpus, labels: Lexemes, size: int) -> Bigram:
        """Counted on the training split; labels: [N], size: S."""
        # Of each speaker by itself: styles differ in what follows what.
        counts = np.zeros((len(corpus.statistics.speakers), size, size))
        for recording in corpus.recordings("train"):
            sequence = labels[corpus.blocks_of(recording)]
            np.add.at(counts[corpus.speaker_of[recording]], (sequence[:-1], sequence[1:]), 1)
        return cls(counts.argmax(-1))

    def start(self, speaker: int, first_lexeme: int) -> int:
        """The state is the speaker."""
        return speaker

    def step(self, state: int, features: BlockFeatures, previous_lexeme: int) -> tuple[Array, int]:
        """One lexeme, by the table."""
        return _only(int(self._successors[state, previous_lexeme]), self._successors.shape[1]), state


class Majority(Bigram):
    """Always the lexeme that the speaker uses most, whatever came before it: the floor of every table."""

    def __init__(self, bundle: Bundle) -> None:
        best = np.array([frequencies.argmax() for frequencies in bundle.frequencies])
        super().__init__(np.repeat(best[:, None], len(bundle.vectors), axis=1))


class ReplayInterpreter:
    """Lexemes that are known beforehand, one sequence after the other: a `start` begins the next once the one before is
    played to its end. Before that it goes on, since a generator that forgets the past where the hands set out anew
    (`systems.movement.set_out`) starts its interpreter again there."""

    def __init__(self, sequences: Iterable[Lexemes], size: int) -> None:
        self._coming, self._size = iter(sequences), size
        self._left: deque[int] = deque()

    def start(self, speaker: int, first_lexeme: int) -> None:
        """Keep the lexemes that are still to be replayed."""
        # A restart within a sequence goes on with it.
        if not self._left:
            self._left = deque(next(self._coming).tolist())

    def step(self, state: None, features: BlockFeatures, previous_lexeme: int) -> tuple[Array, None]:
        """Scores [S] that leave one choice."""
        return _only(self._left.popleft(), self._size), None


class RandomStyle:
    """Style codes that know nothing: z from N(0, I) anew on each block, as L_z would have the learned (RG Table 2)."""

    def __init__(self, code_width: int, seed: int) -> None:
        self.code_width, self._seed = code_width, seed

    def start(self, speaker: int) -> np.random.Generator:
        """The state is the random generator, the same in each recording."""
        return np.random.default_rng([self._seed, speaker])

    def step(self, state: np.random.Generator, features: BlockFeatures, lexeme: int
             ) -> tuple[NDArray[np.float32], np.random.Generator]:
        """A code [d_z]."""
        return state.standard_normal(self.code_width).astype(np.float32), state
