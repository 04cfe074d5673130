"""The sentences of the grammar when every named gesture can be played, and how often each label is written for."""

from __future__ import annotations

from gesticulator_performer.grammar import TEST_MEANINGS, TRAIN_MEANINGS, templates
from gesticulator_performer.repertoire_sentences import CORE_SENTENCES, FURTHER_SENTENCES, MORE_SENTENCES

_NEW = CORE_SENTENCES.rstrip() + MORE_SENTENCES
_FURTHER = [templates(FURTHER_SENTENCES, held_out) for held_out in (False, True)]
TRAIN_REPERTOIRE, TEST_REPERTOIRE = (
    templates(_NEW, held_out) | {label: (*known[label], *lines) for label, lines in further.items()}
    for held_out, known, further in zip((False, True), (TRAIN_MEANINGS, TEST_MEANINGS), _FURTHER, strict=True))
"""Templates for the gestures without captured strokes, and for those whose own templates the detector seldom finds."""
_CORE, _CAPTURED, _MORE = 4, 3, 3
"""How often a label comes: core gestures without captured strokes, labels with some, and the others."""
_OFTENER = 3
"""Added for labels whose cue phrases often lose against others, or seldom find an arm free."""
_SELDOM = """
arms_crossed beckon box_frame cheer_arms chop_point clap decrease facepalm fist_pump fist_resolve flat_surface flex_arm
hands_on_hips idea_finger increase interlock long_stretch low_hand point_there point_up point_you prayer_hands
precision_pinch quick_snap receive they_over_there thumbs_down thumbs_up turn_back usher zip_lips
"""
_TIMES = {**dict.fromkeys(TRAIN_REPERTOIRE, _MORE), **dict.fromkeys(TRAIN_MEANINGS, _CAPTURED),
          **dict.fromkeys(templates(CORE_SENTENCES, held_out=False), _CORE)}
REPERTOIRE_SHARE = 0.9
"""Share of the sentences that are written for a gesture with a meaning: of a hundred gestures each is to come often."""
REPERTOIRE_KINDS = tuple(label for label, times in _TIMES.items()
                         for _ in range(times + (_OFTENER if label in _SELDOM.split() else 0)))
"""The labels to draw a sentence's from, each as often as it comes."""
