"""Units and phases of a hand, on paths whose phases are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.motion.phases import HandPhases, Phase, phases_of
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
