"""Lexeme accuracy: does an interpreter choose the lexeme that the speaker performed? (RG 7.4.6, Table 6)

Theory: the percentage of blocks whose chosen lexeme is the speaker's own, which is the lexeme nearest to the latent of
the real motion (RG Eq. 4), on silent blocks with the silent hint where the interpreter was taught it:

    accuracy = 100 / n sum_i [chosen_i = own_i].

Unit: percent of blocks. Good: high; 100 only for the speaker's own lexemes. The paper prints one figure and does not
say which of two it is:

- Teacher-forced: before each block the interpreter is told the speaker's lexeme of the block before. This is how it is
  trained, and errors cannot add up; but most of the figure may be due to the hint, because lexemes come in runs.
- Free-running: it is told its own choice, as in use. One early difference sends the two sequences apart for good.

What fools it:
- The commonest lexeme for every block: accuracy is then that lexeme's share. With many silent blocks and a silent mask
  it is high without any ear; take spoken blocks alone as well (pass `chosen[~silent]`, `reference[~silent]`).
- The order of lexemes. Under teacher forcing the commonest successor of the speaker's last lexeme, which hears nothing,
  reaches 35.9 % on the shipped store, the network 33.9 % (free-running: 9.9 and 14.6 %). Print such a deaf rule beside
  the figure (`eval.baselines.interpreters`).
- Many lexemes look alike, and many gestures suit a sentence: a wrong lexeme may make the same motion, or a better one.
  So low accuracy does not mean bad gestures, and a draw from the true distribution scores below its arg max.
- The lexicon: with fewer lexemes all figures rise. Compare over one lexicon only.

    >>> lexeme_accuracy([0, 0, 1, 1], [0, 0, 1, 0])
    75.0
"""

import numpy as np
from numpy.typing import ArrayLike

from eval.metrics.diversity import checked_labels

__all__ = ["lexeme_accuracy"]


def lexeme_accuracy(chosen: ArrayLike, reference: ArrayLike) -> float:
    """Percent of blocks [n] whose chosen lexeme is the speaker's own (RG Table 6), 0 to 100; NaN for no block.

    Leave out block 0 where the interpreter was given it. ValueError for unequal shapes, another shape than [n], and
    labels that are negative or no whole numbers.
    """
    first, second = checked_labels(chosen), checked_labels(reference)
    # Equality would broadcast one label over all blocks.
    if first.shape != second.shape:
        raise ValueError(f"{len(first)} lexemes cannot be compared with {len(second)}")
    return 100.0 * float(np.mean(first == second)) if len(first) else float("nan")
