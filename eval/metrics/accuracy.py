"""Lexeme accuracy: does an interpreter choose the lexeme that the speaker performed? (RG 7.4.6, Table 6)

Theory: the percentage of blocks whose chosen lexeme is the speaker's own, which is the lexeme nearest to the latent of
the real motion (RG Eq. 4), on silent blocks with the silent hint where the interpreter was taught it:

    accuracy = 100 / n sum_i [chosen_i = own_i],        chance = 100 sum_k p_k q_k,

with p and q the shares of lexeme k in the two sequences: what two sequences with these shares would agree by if neither
knew of the other. Cohen's kappa (1960), (accuracy - chance) / (100 - chance), is the share of what chance leaves: 0 at
chance, 1 for equal sequences, below 0 for less than chance.

Unit: percent of blocks (kappa has none). Good: high; 100 only for the speaker's own lexemes. The paper prints one
figure and does not say which of two it is:

- Teacher-forced: before each block the interpreter is told the speaker's lexeme of the block before. This is how it is
  trained, and errors cannot add up; but most of the figure may be due to the hint, because lexemes come in runs.
- Free-running: it is told its own choice, as in use. One early difference sends the two sequences apart for good,
  though both may suit the speech. Print both, and name them.

What fools it:
- The commonest lexeme for every block: accuracy is then that lexeme's share, and kappa 0. With many silent blocks and a
  silent mask it is high without any ear; take spoken blocks alone as well (pass `chosen[~silent]`,
  `reference[~silent]`).
- The order of lexemes: kappa takes the shares of lexemes into account and not their order. Under teacher forcing the
  commonest successor of the speaker's last lexeme, which hears nothing, reaches 35.9 % on the shipped store, the
  network 33.9 % (free-running: 9.9 and 14.6 %). Print such a deaf rule beside the figure.
- Many lexemes look alike, and many gestures suit a sentence: a wrong lexeme may make the same motion, or a better one.
  So low accuracy does not mean bad gestures, and a draw from the true distribution scores below its arg max.
- The lexicon: with fewer lexemes all figures rise. Compare over one lexicon only.

    >>> agreement_by_chance([0, 0, 1, 1], [0, 0, 1, 0])
    Agreement(percent=75.0, chance=50.0, kappa=0.5, blocks=4, reason='')
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from eval.metrics.diversity import Labels, checked_labels
from eval.metrics.pmb import above_chance

__all__ = ["Accuracy", "lexeme_accuracy"]

_NO_BLOCK = "there is no block"


@dataclass(frozen=True)
class Accuracy:
    """percent: of `blocks` whose lexeme is the speaker's, 0 to 100; NaN where there is no block, and reason says so."""

    percent: float
    blocks: int
    reason: str = ""


@dataclass(frozen=True)
class Agreement:
    """Accuracy beside chance. percent: the accuracy; chance: percent that sequences with these shares of lexemes agree
    by when neither knows of the other; kappa: (percent - chance) / (100 - chance), at most 1.

    NaN where there is no block; kappa also where chance is 100 %, with both sequences of one and the same lexeme.
    """

    percent: float
    chance: float
    kappa: float
    blocks: int
    reason: str = ""


def lexeme_accuracy(chosen: ArrayLike, reference: ArrayLike) -> Accuracy:
    """Percent of blocks [n] whose chosen lexeme is the speaker's own (RG Table 6).

    Leave out block 0 where the interpreter was given it. To pool clips, weigh each by its `blocks`. ValueError for
    unequal shapes, another shape than [n], and labels that are negative or no whole numbers.
    """
    first, second = _pair(chosen, reference)
    if len(first) == 0:
        return Accuracy(float("nan"), 0, _NO_BLOCK)
    return Accuracy(100.0 * float(np.mean(first == second)), len(first))


def agreement_by_chance(reference: ArrayLike, chosen: ArrayLike) -> Agreement:
    """Agreement of sequences of lexemes [n] with these shares by chance, and the share of agreement above it.

    The mean accuracy over all orders of `chosen` is this chance level, exactly. ValueError as in `lexeme_accuracy`.
    """
    first, second = _pair(reference, chosen)
    nan, blocks = float("nan"), len(second)
    if blocks == 0:
        return Agreement(nan, nan, nan, 0, _NO_BLOCK)
    size = 1 + int(max(second.max(), first.max()))
    # In whole numbers, so that chance is 100 % when it is and not a hair below.
    by_chance = int(np.bincount(first, minlength=size) @ np.bincount(second, minlength=size))
    percent, chance = 100.0 * float(np.mean(second == first)), 100.0 * by_chance / blocks ** 2
    if by_chance == blocks ** 2:
        return Agreement(percent, chance, nan, blocks, "one lexeme is all that there is: chance leaves no room")
    return Agreement(percent, chance, above_chance(percent, chance), blocks)


def _pair(first: ArrayLike, second: ArrayLike) -> tuple[Labels, Labels]:
    """Both sequences [n], checked."""
    a, b = checked_labels(first), checked_labels(second)
    if a.shape != b.shape:
        raise ValueError(f"{len(a)} lexemes cannot be compared with {len(b)}")
    return a, b
