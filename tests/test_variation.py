"""The same beats and lexemes in another manner: `--variation`."""

import numpy as np
import pytest

from data_module.errors import InputError
from data_module.types import Speech
from gesticulator.gesticulator import Gesticulator
from tests.untrained import MOVING, PLAIN, untrained

RATE = 16000


@pytest.fixture(scope="module")
def system() -> Gesticulator:
    return Gesticulator(untrained(*PLAIN, *MOVING, "selection.temperature=1.0"))


@pytest.fixture(scope="module")
def speech() -> Speech:
    """Five seconds of syllables."""
    time = np.arange(5 * RATE) / RATE
    noise = np.random.default_rng(0).normal(size=len(time))
    return Speech((0.2 * noise * np.maximum(np.sin(2 * np.pi * 2.3 * time), 0.02)).astype(np.float32), RATE)


def test_a_variation_keeps_blocks_and_lexemes_and_moves_otherwise(system: Gesticulator, speech: Speech) -> None:
    first, again = (system(speech, seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.rotations, again.rotations)
    others = [system(speech, seed=3, variation=number) for number in (1, 2)]
    for other in others:
        np.testing.assert_array_equal(other.lexemes, first.lexemes)
        np.testing.assert_array_equal(other.blocks.edges, first.blocks.edges)
        assert other.plan().variation > 0
    drawn = [first, *others]
    for one in range(3):
        for two in range(one):
            assert np.abs(drawn[one].rotations - drawn[two].rotations).max() > 1e-3
    assert len(set(first.lexemes.tolist())) > 3, "there is nothing to keep"


def test_who_does_not_sample_refuses_it(speech: Speech) -> None:
    with pytest.raises(InputError, match="variation 1: needs a generator that samples"):
        Gesticulator(untrained(*PLAIN))(speech, variation=1)
