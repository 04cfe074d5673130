"""Sound for the speech encoder's first stage: crops that keep to their recording."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gesticulator.training.stages.speech import crops_of


@given(st.lists(st.integers(3, 40), min_size=1, max_size=6), st.integers(0, 2**31))
def test_a_crop_never_runs_over_two_recordings(sizes: list[int], seed: int) -> None:
    sounds = (np.full(size, number + 1.0, np.float32) for number, size in enumerate(sizes))
    drawn = crops_of(sounds, 3)(np.random.default_rng(seed), 200)
    assert drawn.shape == (200, 3) and drawn.dtype == np.float32
    assert (drawn == drawn[:, :1]).all() and set(drawn[:, 0]) <= set(range(1, len(sizes) + 1))
