"""Sound for the speech encoder's first stage: crops that keep to their recording, and folders that are told apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from data_module.store import Store
from gesticulator.training.stages.speech import Crops

RATE = 16000


def end_to_end(sizes: list[int], length: int) -> Crops:
    """Recordings of these sizes, each filled with its own number; the last sample says which it is in it."""
    sizes_array = np.array(sizes)
    samples = np.concatenate([np.full(size, number + 1.0) for number, size in enumerate(sizes)])
    return Crops(samples.astype(np.float16), np.cumsum(sizes_array) - sizes_array, sizes_array - length + 1, length)


@given(st.lists(st.integers(3, 40), min_size=1, max_size=6), st.integers(0, 2**31))
def test_a_crop_never_runs_over_two_recordings(sizes: list[int], seed: int) -> None:
    drawn = end_to_end(sizes, 3).sample(np.random.default_rng(seed), 200)
    assert drawn.shape == (200, 3) and drawn.dtype == np.float32
    assert (drawn == drawn[:, :1]).all() and set(drawn[:, 0]) <= set(range(1, len(sizes) + 1))


def test_of_a_store(tiny_store: Path) -> None:
    store = Store.open(tiny_store)
    crops = Crops.of_store(store, store.names[:2], RATE)
    sizes = [len(store.load(name).speech.samples) for name in store.names[:2]]
    assert crops.first.tolist() == [0, sizes[0]] and crops.room.tolist() == [size - RATE + 1 for size in sizes]
