"""The cue phrases of the detector (`gesticulator.directing.meaning_cues`), as cues of the performer, within a budget.

The detector reads phrases with their guards: it does not fire on idioms, homonyms and negations. Labels that it does
not know keep the cues of the table of meanings, where it finds nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from data_module.text.language import LANGUAGES
from gesticulator.directing.meaning_cues import meaning_cues
from gesticulator_performer.cues import Asked, Cues

# Least score of a call: the texts are our own, and talk of meanings on purpose.
_LEAST = 0.55
# What the score of a call adds to the weight of its word: detected phrases are played in about four of five cases.
_SURER = 0.3


@dataclass(frozen=True)
class CalledCues:
    """What words ask for, of `labels`. others: cues for the labels that the detector does not know. apart: least
    seconds between two gestures with a meaning; again: seconds in which a label does not come again."""

    labels: frozenset[str]
    others: Cues
    apart: float = 3.0
    again: float = 20.0

    def asked(self, words: Sequence[str], language: str = "en", pauses: Sequence[float] = ()) -> dict[int, Asked]:
        """See `strokes.StrokeCues`. Surer calls weigh more."""
        if language not in LANGUAGES:
            return {}
        detector = meaning_cues(language)
        out: dict[int, Asked] = {}
        for word, asked in self.others.asked(words, language).items():
            new = {label: chance for label, chance in asked.labels.items()
                   if label in self.labels and label not in detector.gestures}
            if new:
                out[word] = Asked(new, asked.weight)
        for call in detector.called(words, pauses):
            if call.score >= _LEAST and call.label in self.labels:
                out[call.word] = Asked({call.label: 1.0}, 1.0 + _SURER * call.score)
        return out
