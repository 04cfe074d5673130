"""Smaller gestures are no faster at any moment than those they are made of, whoever performs."""

from dataclasses import replace

import numpy as np
import pytest
from performances import example

from data_module.types import Array, Speech
from gesticulator import Gesticulator
from gesticulator.directing.strokes import LARGE, StrokeMemory
from gesticulator.performance import Performance

SEED = 2
NO_FASTER = 1.15
"""Joints are slowed, and a hand's speed depends on which of them move: up to a seventh more is left at a peak, where
one arm follows the other."""


@pytest.fixture(scope="module")
def system() -> Gesticulator:
    system = Gesticulator.from_pretrained()
    system.keeps_generations = True
    return system


@pytest.fixture(scope="module")
def speech() -> Speech:
    return example()


def peaks(performance: Performance) -> Array:
    """[2] greatest speed of the left and the right hand, m/s."""
    places = performance.positions()[:, [performance.joints.index(f"{side}Hand") for side in ("Left", "Right")]]
    speeds: Array = np.linalg.norm(np.diff(places, axis=0), axis=-1) * 60.0
    return speeds.max(axis=0)


def halved(system: Gesticulator, first: Performance, intensity: float = 0.5) -> Performance:
    plan = first.plan()
    return system(first.speech, plan=replace(plan, knobs=replace(plan.knobs, intensity=intensity)))


@pytest.mark.parametrize("speaker", ["brad", "brad2", "connor", "conversation", "garza", "lesson", "presenter", "story",
                                     "traffic"])
def test_no_hand_of_a_performer_is_faster_at_half_the_intensity(system: Gesticulator, speech: Speech, speaker: str
                                                                ) -> None:
    first = system(speech, seed=SEED, speaker=speaker)
    assert (peaks(halved(system, first)) <= NO_FASTER * peaks(first)).all()


def test_the_mean_of_a_value_is_that_of_the_span_before_for_any_pieces() -> None:
    rng = np.random.default_rng(3)
    times, poses = np.cumsum(rng.uniform(0.03, 0.08, 200)), rng.normal(size=(200, 6))
    whole, pieces = (StrokeMemory(np.arange(4), LARGE) for _ in range(2))
    whole.push(times, poses)

    def value(arm: Array) -> Array:
        return arm.sum(axis=1)

    at_once = whole.averaged(times, 0.8, value)
    parts = []
    for part in np.split(np.arange(200), [5, 6, 50, 120]):
        pieces.push(times[part], poses[part])
        parts.append(pieces.averaged(times[part], 0.8, value))
    np.testing.assert_array_equal(np.concatenate(parts), at_once)
    # What was before the span does not count, nor what comes after; a constant is its mean.
    other = poses.copy()
    other[times < times[100] - 0.8] += 5.0
    other[times > times[100]] -= 5.0
    anew = StrokeMemory(np.arange(4), LARGE)
    anew.push(times, other)
    assert anew.averaged(times[100:101], 0.8, value)[0] == at_once[100]
    np.testing.assert_allclose(whole.averaged(times, 0.8, lambda arm: np.full(len(arm), 2.5)), 2.5, rtol=1e-12)
    # Its greatest change is that of its window: a step by 1 takes the whole span.
    step = whole.averaged(times, 0.8, lambda arm: (np.arange(len(arm)) >= len(arm) - 100).astype(float))
    assert np.abs(np.diff(step) / np.diff(times)).max() < 2.6 / 0.8
