"""A corpus that stays on the disk is the corpus in memory, row by row, and trains the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.store import Store
from gesticulator.training import command as train
from gesticulator.training import presets
from gesticulator.training.stages.corpus import Corpus, prepare
from gesticulator.training.stages.rows import RowsWriter, StoredRows, evenly, stretches
from tests import ranks

VALUES = np.random.default_rng(0).normal(size=(23, 4, 3)).astype(np.float16)


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> StoredRows:
    """VALUES in a file, written in three parts."""
    path = tmp_path_factory.mktemp("rows") / "values.npy"
    writer = RowsWriter(path, VALUES.shape, VALUES.dtype)
    for part in (VALUES[:5], VALUES[5:5], VALUES[5:].astype(np.float32)):
        writer.add(part)
    writer.close()
    np.testing.assert_array_equal(np.load(path), VALUES)
    return StoredRows(path)


KEYS: list[Any] = [
    3, -1, slice(None), slice(4, 20, 3), slice(5, 5), np.array([7, 7, 2]), torch.tensor([[1, 2], [22, 0]]),
    torch.arange(5, 12), np.arange(23) % 4 == 0, (slice(None), slice(1, 3)), (np.array([4, 3]), slice(-2, None)),
    (torch.tensor([[5, 6]]), slice(None), 1), np.zeros(0, np.int64)]


@pytest.mark.parametrize("key", KEYS, ids=str)
def test_rows_are_those_of_the_array(rows: StoredRows, key: Any) -> None:
    wanted = torch.from_numpy(VALUES)[key]
    assert torch.equal(rows[key], wanted) and rows[key].dtype == wanted.dtype == rows.dtype
    assert rows.shape == VALUES.shape and len(rows) == 23


@given(st.lists(st.integers(-23, 22), max_size=40))
def test_any_rows_in_any_order(tmp_path_factory: pytest.TempPathFactory, numbers: list[int]) -> None:
    path = tmp_path_factory.getbasetemp() / "any.npy"
    if not path.exists():
        np.save(path, VALUES)
    np.testing.assert_array_equal(StoredRows(path)[np.array(numbers, np.int64)].numpy(), VALUES[numbers])


def test_rows_lie_in_an_archive_too_and_what_is_not_there_is_told(tmp_path: Path, rows: StoredRows) -> None:
    np.savez(tmp_path / "a.npz", first=np.arange(3), values=VALUES)
    np.testing.assert_array_equal(StoredRows(tmp_path / "a.npz", "values")[2:9].numpy(), VALUES[2:9])
    np.savez_compressed(tmp_path / "b.npz", values=VALUES)
    with pytest.raises(ValueError, match="compressed"):
        StoredRows(tmp_path / "b.npz", "values")
    for wrong in (23, -24):
        with pytest.raises(IndexError):
            rows[wrong]
    data = rows.path.read_bytes()
    cut = tmp_path / "cut.npy"
    cut.write_bytes(data[:-1])
    with pytest.raises(InputError, match="ends early"):
        StoredRows(cut)[22]


def test_an_array_that_lacks_rows_gets_no_name(tmp_path: Path) -> None:
    writer = RowsWriter(tmp_path / "a.npy", (3, 2), np.float32)
    writer.add(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="2 rows of 3"):
        writer.close()
    with pytest.raises(ValueError, match="shape"):
        RowsWriter(tmp_path / "b.npy", (3, 2), np.float32).add(np.zeros((3, 5)))
    assert not list(tmp_path.glob("*.npy"))


@given(st.lists(st.tuples(st.integers(1, 300), st.integers(0, 3)), min_size=1, max_size=30), st.integers(1, 2000))
def test_stretches_are_spread_over_all_and_bounded(recordings: list[tuple[int, int]], most: int) -> None:
    counts, speakers = [c for c, _ in recordings], [s for _, s in recordings]
    taken = stretches(counts, speakers, most, length=10)
    for parts, count in zip(taken, counts, strict=True):
        assert all(0 <= part.start < part.stop <= count for part in parts)
    total = sum(part.stop - part.start for parts in taken for part in parts)
    if sum(counts) <= most:
        assert total == sum(counts)
    # A speaker has one stretch too many at most, and a stretch may be shorter where a recording ends.
    stretches_in_all = sum(-(-count // 10) for count in counts)
    assert total <= 10 * (stretches_in_all / -(-sum(counts) // most) + len(set(speakers)))
    for speaker in set(speakers):
        assert any(parts for parts, own in zip(taken, speakers, strict=True) if own == speaker)


def test_numbers_evenly_taken() -> None:
    assert evenly(np.arange(10), 10).tolist() == list(range(10)) and evenly(np.arange(10), 4).tolist() == [0, 3, 6, 9]


@pytest.fixture(scope="module")
def both(tiny_store: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Corpus, Corpus]:
    """The tiny corpus in memory and on the disk, before it is heard."""
    store, config, work = Store.open(tiny_store), presets.preset("tiny"), tmp_path_factory.mktemp("work")
    here = prepare(store, config, work, progress=False)
    prepare(store, config, work, progress=False, memory=0.0)  # the second opening reads what the first wrote
    return here, prepare(store, config, work, progress=False, memory=0.0)


def test_the_corpus_on_the_disk_is_the_one_in_memory(both: tuple[Corpus, Corpus]) -> None:
    here, there = both
    assert there.stored and not here.stored
    for name in ("motion", "low", "control", "word_at", "words", "first", "mask", "silent", "durations", "has_text",
                 "recording", "speaker_of"):
        one, other = (np.asarray(getattr(corpus, name)[:]) for corpus in both)
        np.testing.assert_array_equal(one, other, err_msg=name)
        assert one.dtype == other.dtype, name
    assert there.high is there.low and there.names == here.names and there.text_width == here.text_width
    one, other = here.statistics, there.statistics
    for name in ("mean_pose", "rest_pose", "deviation", "bounds", "quiet_low", "quiet_high"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert one.levels is not None and other.levels is not None
    for fitted, again in ((one.low, other.low), (one.high, other.high), (one.levels, other.levels)):
        for name, value in fitted.to_dict().items():
            np.testing.assert_array_equal(value, again.to_dict()[name], err_msg=name)
    for key in (slice(None), torch.tensor([[0, 1], [5, 0]])):
        assert torch.equal(here.pasts[key].frames, there.pasts[key].frames)
        assert torch.equal(here.pasts.ratio[key], there.pasts.ratio[key])
    for recording in (0, 3):
        np.testing.assert_array_equal(here.sound(recording), np.asarray(there.sound(recording)[:]))


def test_every_stage_learns_the_same_from_the_disk(tiny_store: Path, tiny_bundle: Path, tiny_movement_bundle: Path,
                                                   tmp_path: Path) -> None:
    for number, bundle in enumerate((tiny_bundle, tiny_movement_bundle)):
        out = tmp_path / str(number)
        ranks.first_steps(tiny_store, bundle, out, steps=3, memory=0.0)
        logs = sorted(out.glob("*/*.jsonl"))
        assert len(logs) >= 7
        for file in logs:
            alone = ranks.first_trained(bundle, file.stem) / file.name
            assert file.read_text().splitlines() == alone.read_text().splitlines()[:3], file.stem


def test_little_memory_is_a_flag(tiny_store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        train.main(["--data", str(tiny_store), "--out", str(tmp_path / "b"), "--corpus-memory", "-1"])
    assert "--corpus-memory -1.0: is out of range" in capsys.readouterr().err
