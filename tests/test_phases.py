"""Units and phases of a hand, on paths whose phases are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.motion.phases import HandPhases, Phase, phases_of
from data_module.motion.skeletons import CHARACTER
from data_module.performer import talks, trunk
from data_module.performer.takes import WRISTS
from data_module.truth import Syllable
from data_module.types import Array

FPS = 60.0
LOW, MIDDLE, HIGH = np.array([0.2, -0.1, 0.0]), np.array([0.2, 0.2, 0.25]), np.array([0.25, 0.4, 0.2])


def path(*legs: tuple[Array, float]) -> Array:
    """Places [T, 3] of a hand that starts low and reaches each place by a minimum-jerk movement of so many seconds."""
    now, parts = LOW, []
    for place, seconds in legs:
        s = np.arange(round(seconds * FPS))[:, None] / (seconds * FPS)
        parts.append(now + (10 * s**3 - 15 * s**4 + 6 * s**5) * (place - now))
        now = place
    return np.concatenate(parts)


def phases_in_order(found: HandPhases) -> list[Phase]:
    changes = np.flatnonzero(np.diff(found.labels, prepend=-1))
    return [Phase(found.labels[at]) for at in changes]


ONE_BEAT = path((LOW, 1.5), (HIGH, 1.0), (MIDDLE, 0.3), (MIDDLE, 0.4), (LOW, 0.9), (LOW, 1.5))


def test_a_beat_is_prepared_struck_held_and_retracted() -> None:
    found = phases_of(ONE_BEAT, FPS)
    assert phases_in_order(found) == [Phase.REST, Phase.PREPARATION, Phase.STROKE, Phase.HOLD, Phase.RETRACTION,
                                      Phase.REST]
    assert len(found.units) == 1
    first, last = (frame / FPS for frame in found.units[0])
    assert first == pytest.approx(1.5, abs=0.2) and last == pytest.approx(4.1, abs=0.2)
    stroke, = found.strokes
    # A minimum-jerk movement decelerates hardest at 0.789 of its length.
    assert stroke.apex / FPS == pytest.approx(1.5 + 1.0 + 0.789 * 0.3, abs=0.05)
    assert stroke.size == pytest.approx(float(np.linalg.norm(HIGH - MIDDLE)), abs=0.03)


def test_strokes_that_follow_each_other_make_one_unit_and_a_rest_begins_another() -> None:
    two = path((LOW, 1.0), (MIDDLE, 0.6), (MIDDLE, 0.4), (HIGH, 0.6), (HIGH, 0.4), (LOW, 0.8), (LOW, 1.0))
    assert len(phases_of(two, FPS).units) == 1
    apart = path((LOW, 1.0), (MIDDLE, 0.6), (LOW, 0.8), (LOW, 1.0), (HIGH, 0.6), (LOW, 0.8), (LOW, 1.0))
    assert len(phases_of(apart, FPS).units) == 2


def test_a_raised_hand_that_is_still_for_long_rests_and_a_hanging_one_is_not_held() -> None:
    held = phases_of(path((LOW, 1.0), (HIGH, 0.6), (HIGH, 2.0), (MIDDLE, 0.6), (LOW, 0.8), (LOW, 1.0)), FPS)
    assert len(held.units) == 2 and Phase.REST in held.labels[110:180]
    lower = LOW + np.array([0.0, 0.05, 0.2])
    hanging = phases_of(path((LOW, 1.0), (lower, 0.5), (lower, 0.3), (LOW, 0.5), (LOW, 1.0)), FPS)
    assert Phase.HOLD not in hanging.labels


def test_a_still_hand_and_a_short_path_have_no_unit() -> None:
    assert phases_of(np.tile(HIGH, (300, 1)), FPS).units == ()
    assert phases_of(np.zeros((2, 3)), FPS).labels.tolist() == [Phase.REST] * 2


@given(st.lists(st.tuples(st.sampled_from([LOW, MIDDLE, HIGH]), st.floats(0.3, 1.5)), min_size=1, max_size=8),
       st.floats(0.0, 2 * np.pi))
def test_phases_cover_units_and_do_not_depend_on_heading(legs: list[tuple[Array, float]], turn: float) -> None:
    places = path((LOW, 1.0), *legs, (LOW, 1.0))
    found = phases_of(places, FPS)
    inside = np.zeros(len(places), dtype=bool)
    for first, last in found.units:
        inside[first:last] = True
    assert ((found.labels != Phase.REST) == inside).all()
    c, s = np.cos(turn), np.sin(turn)
    turned = phases_of(places @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]), FPS)
    np.testing.assert_array_equal(turned.labels, found.labels)


# ---------------------------------------------------------------------------------------------------- in the corpus

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


def test_the_chest_turns_with_high_accents_at_once_and_not_without_links() -> None:
    high = Syllable(2.0, 2.05, 2.25, 0, 3.0, 4.0, 1.0)
    low = Syllable(4.0, 4.05, 4.25, 1, 3.0, -4.0, 1.0)
    turned = trunk.pitch_accents([high, low], 400, 1.0, np.random.default_rng(1))
    size = np.linalg.norm(turned, axis=1)
    assert size.argmax() / FPS == pytest.approx(2.15, abs=0.03)
    speed = np.abs(np.diff(size))
    assert speed[:170].argmax() / FPS == pytest.approx(2.05, abs=0.1), "it moves while the pitch rises"
    assert size[200:].max() == 0.0, "a low syllable is no accent"
    assert not trunk.pitch_accents([high, low], 400, 0.0, np.random.default_rng(1)).any()
