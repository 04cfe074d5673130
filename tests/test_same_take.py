"""The same sound exported again is the same take, and two takes that parted come together again."""

from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest
from performances import example

from data_module.motion.kinematics import positions_of
from data_module.speech.audio import amplified
from data_module.types import Array
from gesticulator.gesticulator import Gesticulator
from gesticulator.performance import Performance


@lru_cache(maxsize=1)
def system() -> Gesticulator:
    return Gesticulator.from_pretrained()


@lru_cache(maxsize=2)
def take(seed: int) -> Performance:
    return system()(example(6.0), seed=seed)


def hands(made: Performance) -> Array:
    """[T, 2, 3] metres."""
    joints = [made.motion.skeleton.index(side + "Hand") for side in ("Left", "Right")]
    return positions_of(made.motion)[:, joints]


@pytest.mark.parametrize("decibels", [-0.1, -6.0])
def test_another_level_is_the_same_take(decibels: float) -> None:
    first, again = take(0), system()(amplified(example(6.0), decibels), seed=0)
    assert again.lexemes.tolist() == first.lexemes.tolist()
    assert np.array_equal(again.blocks.edges, first.blocks.edges)
    assert np.linalg.norm(hands(again) - hands(first), axis=-1).max() < 0.005


def test_short_recordings_give_takes_of_their_own_and_of_their_length() -> None:
    samples, made = example(6.0).samples, []
    pieces = ((0.0, 0.3, 60.0), (0.0, 1.4, 29.97), (1.4, 1.4, 30.0), (2.8, 1.4, 24.0), (4.2, 1.7, 120.0))
    for start, seconds, fps in pieces:
        piece = samples[round(start * 16000):round((start + seconds) * 16000)]
        performance = system()(piece, 16000, fps=fps, seed=0)
        assert abs((len(performance.motion) - 1) / fps - seconds) <= 1.0 / fps
        made.append(hands(performance))
    places = [one[np.linspace(0, len(one) - 1, 20).astype(int)] for one in made[1:]]
    assert all(np.linalg.norm(one - other, axis=-1).mean() > 0.02 for one, other in combinations(places, 2))


def test_another_seed_is_another_take() -> None:
    first, other = take(0), take(1)
    assert np.mean(first.lexemes != other.lexemes) > 0.7
    assert np.linalg.norm(hands(other) - hands(first), axis=-1).mean() > 0.1
