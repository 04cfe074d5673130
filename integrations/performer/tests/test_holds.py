"""Holds and accents that the corpus adds to real motion."""

from __future__ import annotations

import numpy as np
from gesticulator_performer import talks
from gesticulator_performer.takes import WRISTS
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
