"""Holds and accents that the corpus adds to real motion."""

from __future__ import annotations

import numpy as np
import pytest
from gesticulator_performer import talks, trunk
from gesticulator_performer.takes import WRISTS
from gesticulator_performer.types import Syllable
from test_phases import FPS, HIGH, LOW, MIDDLE, path

from data_module.motion.phases import Phase, phases_of
from data_module.motion.skeletons import CHARACTER


def test_holds_are_set_where_a_raised_hand_is_slow_and_nothing_is_lost() -> None:
    beats = [(HIGH, 0.6), (MIDDLE, 0.6)] * 12
    hand = path((LOW, 4.0), *beats)
    places = np.zeros((len(hand), len(CHARACTER), 3))
    for wrist in WRISTS:
        places[:, wrist] = hand
    shown = talks.hold_times(places, np.random.default_rng(0))
    assert len(shown) > len(hand) + 3 * 0.25 * FPS, "it lasts longer"
    pace = np.diff(shown)
    assert pace.min() > -1e-9 and pace.max() < 1.0 + 1e-9 and shown[0] == 0.0 and shown[-1] >= len(hand) - 3
    # As a path, every frame of the motion is passed: no step is larger than one.
    held = phases_of(np.stack([np.interp(shown, np.arange(len(hand)), column) for column in hand.T], axis=1), FPS)
    before = phases_of(hand, FPS)
    assert np.sum(held.labels == Phase.HOLD) > 3 * 0.25 * FPS > np.sum(before.labels == Phase.HOLD)
    low = places - [0.0, 1.0, 0.0]
    assert len(talks.hold_times(low, np.random.default_rng(0))) == len(hand) - 1, "hanging hands are not held"


def test_the_chest_turns_with_high_accents_at_once() -> None:
    high = Syllable(2.0, 2.05, 2.25, 0, 3.0, 4.0, 1.0)
    low = Syllable(4.0, 4.05, 4.25, 1, 3.0, -4.0, 1.0)
    turned = trunk.pitch_accents([high, low], 400, np.random.default_rng(1))
    size = np.linalg.norm(turned, axis=1)
    assert size.argmax() / FPS == pytest.approx(2.15, abs=0.03)
    speed = np.abs(np.diff(size))
    assert speed[:170].argmax() / FPS == pytest.approx(2.05, abs=0.1), "it moves while the pitch rises"
    assert size[200:].max() == 0.0, "a low syllable is no accent"
