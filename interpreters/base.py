"""The protocol of lexeme interpreters, and the one place where a lexeme is chosen from scores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

__all__ = ["BlockFeatures", "LexemeInterpreter", "Scores", "select"]

Scores = NDArray[np.float64]


@dataclass(frozen=True)
class BlockFeatures:
    """What an interpreter hears of one block.

    low, high: [3K, d] the two levels of audio on the window of the block before, the block and the block after.
    silent: the block is a silence. text: [3K, d_t + 1] word vectors and the flag of the empty word on the same window,
    or None in the audio-only path. control: [K, 2 F] what is asked of F features of style and whether it is asked, or
    None when nothing is. past: [K, D_m] the block before as it was drawn, normalised, or None where nobody says.
    durations: seconds of the block before and of this one, or None.
    """

    low: Tensor
    high: Tensor
    silent: bool = False
    text: Tensor | None = None
    control: Tensor | None = None
    past: Tensor | None = None
    durations: tuple[float, float] | None = None


@runtime_checkable
class LexemeInterpreter(Protocol):
    """Scores for the next lexeme, block by block. Scores are natural logarithms of probabilities (or Q values)."""

    def start(self, speaker: int, first_lexeme: int) -> Any:
        """The state before the first block, for a speaker (index) whose resting lexeme is `first_lexeme`."""
        ...

    def step(self, state: Any, features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, Any]:
        """Scores [S] for this block's lexeme given what went before, and the state after it."""
        ...


def select(scores: Scores, *, allowed: NDArray[np.int64] | None = None, temperature: float = 0.0,
           top: int | None = None, rng: np.random.Generator | None = None) -> int:
    """One lexeme from scores [S]: the best (temperature 0), or one drawn from softmax(scores / temperature).

    allowed: indices to choose among (the silent mask); None or empty allows all. top: draw among the best `top` only.
    """
    if temperature < 0 or (top is not None and top < 1):
        raise ValueError("temperature must not be negative and top must be positive")
    masked = np.array(scores, dtype=np.float64)
    if allowed is not None and len(allowed):
        blocked = np.ones(len(masked), dtype=bool)
        blocked[allowed] = False
        masked[blocked] = -np.inf
    if temperature == 0 or rng is None:
        return int(np.argmax(masked))
    if top is not None and top < len(masked):
        masked[masked < np.sort(masked)[-top]] = -np.inf
    weights = np.exp((masked - masked.max()) / temperature)
    return int(rng.choice(len(weights), p=weights / weights.sum()))
