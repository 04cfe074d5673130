"""Unit selection: what it chooses for its own recordings, how it joins, and that it is the same again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bursts import recording

from data_module.blocks import BlockSettings, cut, normalise_motion
from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.bvh import write_bvh
from data_module.motion.skeletons import CHARACTER
from data_module.store import Store, StoreWriter
from eval.baselines import unit_selection
from eval.baselines.unit_selection import FADE, Sounds, UnitDatabase, UnitSelection, joined
from eval.commands import SCORE
from eval.metrics.eye import figures
from eval.stats import Interval
from eval.table import Marked, load


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Three recordings for training, one for test."""
    writer = StoreWriter(tmp_path_factory.mktemp("units") / "store", "folder", {}, 1, "free")
    names = ["one", "two", "three", "test"]
    for seed, name in enumerate(names):
        writer.add(recording(name, seed, split="test" if name == "test" else "train"))
    return writer.finish(names)


@pytest.fixture(scope="module")
def units(store: Store) -> UnitDatabase:
    """Their units."""
    return UnitDatabase.of(store)


def test_the_database_holds_the_training_split_alone(store: Store, units: UnitDatabase) -> None:
    counts = [len(cut(store.load(name).speech)) for name in ("one", "two", "three")]
    assert len(units) == sum(counts)
    ends = np.cumsum(counts) - 1
    assert (units.follower[ends] == -1).all()
    inner = np.delete(np.arange(len(units)), ends)
    np.testing.assert_array_equal(units.follower[inner], inner + 1)
    blocks = cut(store.load("two").speech)
    own = slice(counts[0], counts[0] + counts[1])
    np.testing.assert_allclose(units.poses[own], normalise_motion(store.load("two").motion, blocks), atol=1e-5)
    np.testing.assert_array_equal(units.sounds.silent[own], blocks.silent)


def test_a_recording_that_it_knows_gets_its_own_motion(store: Store, units: UnitDatabase,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unit_selection, "NOISE", 0.0)
    known = store.load("two")
    made = UnitSelection(units)(known.speech)
    first = len(cut(store.load("one").speech))
    np.testing.assert_array_equal(made.units, first + np.arange(len(made.blocks)))
    assert len(made.motion) == len(known.motion)
    # All but the smoothing and 20 knots a second: a hundredth of a radian.
    apart = rotation.angle_between(made.motion.rotations[60:-60], known.motion.rotations[60:-60])
    assert np.percentile(apart, 99) < 0.03


def test_same_seed_same_motion_and_another_seed_another_manner(store: Store, units: UnitDatabase) -> None:
    speech = store.load("test").speech
    first, again, other = (UnitSelection(units)(speech, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.motion.rotations, again.motion.rotations)
    assert (first.units != other.units).any()
    assert np.isfinite(first.motion.rotations).all()
    assert abs(first.motion.duration - speech.duration) < 0.02


def test_silent_blocks_get_silent_units_and_loud_ones_loud(store: Store, units: UnitDatabase) -> None:
    speech = store.load("test").speech
    heard = Sounds.of(speech, cut(speech))
    chosen = UnitSelection(units).select(heard)
    assert heard.silent.any() and (units.sounds.silent[chosen] == heard.silent).mean() > 0.9
    own, theirs = heard.contour[:, 1:5].mean(axis=1), units.sounds.contour[chosen, 1:5].mean(axis=1)
    late = UnitSelection(units).select(heard.rolled(len(chosen) // 2))
    behind = units.sounds.contour[late, 1:5].mean(axis=1)
    assert np.corrcoef(own, theirs)[0, 1] > 0.6 > np.corrcoef(own, behind)[0, 1] + 0.2
    np.testing.assert_array_equal(heard.rolled(3).durations, heard.durations)
    np.testing.assert_array_equal(heard.rolled(3).silent[3:], heard.silent[:-3])


def test_a_join_goes_on_from_where_the_pose_was_and_ends_on_the_new_piece() -> None:
    rng = np.random.default_rng(0)
    size = (6, 10, 3 * len(CHARACTER))
    pieces = (rng.normal(0, 0.3, (6, 1, size[2])) + 0.02 * np.arange(10)[:, None] * rng.normal(size=(6, 1, size[2]))
              ).astype(np.float32)
    np.testing.assert_allclose(joined(pieces, np.zeros(5, bool)), pieces, atol=1e-6)
    jumps = np.array([False, True, False, False, False])
    out = joined(pieces, jumps)
    np.testing.assert_allclose(out[:2], pieces[:2], atol=1e-6)
    step = np.abs(out[2, 0] - out[1, -1]).max()
    own, gap = np.abs(pieces[2, 1] - pieces[2, 0]).max(), np.abs(pieces[2, 0] - pieces[1, -1]).max()
    assert step < own + 0.1 * gap < gap
    faded = 2 * 10 + FADE
    np.testing.assert_allclose(out.reshape(60, -1)[faded:], pieces.reshape(60, -1)[faded:], atol=1e-6)


def test_the_kept_database_is_the_same(store: Store, units: UnitDatabase, tmp_path: Path) -> None:
    for _ in range(2):  # gathered, and read
        kept = UnitDatabase.of(store, work=tmp_path)
        for name in ("poses", "follower"):
            np.testing.assert_array_equal(getattr(kept, name), getattr(units, name))
        np.testing.assert_array_equal(kept.sounds.contour, units.sounds.contour)
    UnitDatabase.of(store, BlockSettings(fps=25.0), tmp_path)
    assert len(list(tmp_path.glob("units.*.npz"))) == 2


def test_the_score_has_a_row_of_it(store: Store, tmp_path: Path) -> None:
    test = store.load("test")
    (tmp_path / "same").mkdir()
    write_bvh(tmp_path / "same" / "test.bvh", test.motion)
    out = tmp_path / "score.json"
    assert SCORE.main("gesticulator score", ["--truth", str(store.path), "--system", f"same={tmp_path / 'same'}",
                                             "--units", str(store.path), "--seed", "3", "--out", str(out)]) == 0
    tables = {table.title: table for table in load(out)}
    row = tables["Perceptual figures: two hands"].rows
    expected = figures(UnitSelection(UnitDatabase.of(store))(test.speech, seed=3).motion)
    for name in ("eye_hand_speed_correlation", "eye_speed_95"):
        cell = row["unit selection"][name]
        assert isinstance(cell, Marked) and isinstance(cell.value, Interval)
        assert cell.value.mean == pytest.approx(expected[name], rel=0.02)


def test_a_store_without_training_split_is_refused(tmp_path: Path) -> None:
    writer = StoreWriter(tmp_path / "store", "folder", {}, 1, "free")
    writer.add(recording("only", 0, 4.0, "test"))
    with pytest.raises(InputError, match="training split"):
        UnitDatabase.of(writer.finish(["only"]))
