"""Sound for the speech encoder's first stage: crops that keep to their recording, and folders that are told apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.store import Store
from gesticulator.training.stages.speech import Crops, folder_digest, sound_files

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


def test_of_a_store_and_of_folders(tiny_store: Path, tmp_path: Path) -> None:
    store = Store.open(tiny_store)
    (tmp_path / "below").mkdir()
    soundfile.write(tmp_path / "below" / "half.wav", np.full(8000 * 2, 0.5, np.float32), 8000)
    soundfile.write(tmp_path / "short.flac", np.full(RATE // 2, 0.25, np.float32), RATE)
    (tmp_path / "notes.txt").write_text("not sound")
    length = RATE
    crops = Crops.of_store(store, store.names[:2], [tmp_path], length)
    sizes = [len(store.load(name).speech.samples) for name in store.names[:2]]
    assert crops.first.tolist()[:2] == [0, sizes[0]]
    assert crops.room[:2].tolist() == [size - length + 1 for size in sizes]
    assert len(crops.first) == 4, "two of the store, two of the folder and what lies below it"
    # In the order of their paths: 2 s brought to 16 kHz, then half a second filled up to one crop.
    assert crops.room[2:].tolist() == [RATE + 1, 1]
    half = crops.samples[crops.first[2]:crops.first[2] + 2 * RATE].astype(float)
    np.testing.assert_allclose(half[1000:-1000], 0.5, atol=0.01)
    short = crops.samples[crops.first[3]:]
    np.testing.assert_allclose(short[:RATE // 2].astype(float), 0.25, atol=1e-3)
    assert len(short) == length and (short[RATE // 2:] == 0).all()


def test_the_digest_is_that_of_names_and_contents_wherever_the_folder_lies(tmp_path: Path) -> None:
    def folder(name: str, files: dict[str, float]) -> Path:
        (tmp_path / name / "deep").mkdir(parents=True)
        for file, value in files.items():
            soundfile.write(tmp_path / name / file, np.full(200, value, np.float32), RATE, subtype="PCM_16")
        return tmp_path / name

    base = folder("a", {"one.wav": 0.1, "deep/two.flac": 0.2})
    digest = folder_digest(base)
    assert folder_digest(folder("b", {"one.wav": 0.1, "deep/two.flac": 0.2})) == digest
    others = [folder("c", {"one.wav": 0.1, "deep/two.flac": 0.3}), folder("d", {"one.wav": 0.2, "deep/two.flac": 0.1}),
              folder("e", {"one.wav": 0.1, "deep/too.flac": 0.2}), folder("f", {"one.wav": 0.1, "two.flac": 0.2}),
              folder("g", {"one.wav": 0.1}), folder("h", {"deep/one.wav": 0.1})]
    assert len({digest, *map(folder_digest, others)}) == 7
    (base / "notes.txt").write_text("what is not sound does not count")
    assert folder_digest(base) == digest


def test_folders_that_hold_no_sound_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "list.txt").write_text("a.wav")
    (tmp_path / "empty" / "folder.wav").mkdir()
    (tmp_path / "file.wav").write_bytes(b"x")
    for name, said in (("empty", "no sound file"), ("nowhere", "not a folder"), ("file.wav", "not a folder")):
        with pytest.raises(InputError, match=said) as error:
            sound_files(tmp_path / name)
        assert name in str(error.value)
