"""The sentences of the grammar when every named gesture can be played, and how often each label is written for."""

from __future__ import annotations

from data_module.performer.grammar import TRAIN_MEANINGS, templates
from data_module.performer.repertoire_sentences import CORE_SENTENCES, MORE_SENTENCES

TRAIN_REPERTOIRE = templates(CORE_SENTENCES.rstrip() + MORE_SENTENCES, held_out=False)
TEST_REPERTOIRE = templates(CORE_SENTENCES.rstrip() + MORE_SENTENCES, held_out=True)
"""Templates for the gestures without captured strokes, by label."""
_CORE, _CAPTURED, _MORE = 4, 4, 2
"""How often a label comes: core gestures without captured strokes, labels with some, and the others."""
REPERTOIRE_KINDS = tuple(
    label for labels, times in ((TRAIN_MEANINGS, _CAPTURED), (templates(CORE_SENTENCES, held_out=False), _CORE),
                                (templates(MORE_SENTENCES, held_out=False), _MORE))
    for label in labels for _ in range(times))
"""The labels to draw a sentence's from."""
