"""Stores: the round trip, and every way a store can be wrong."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from data_module.motion.skeletons import CHARACTER, CHARACTERS, FINGER_JOINTS, FINGERED, WHOLE_BODY, resized
from data_module.store import Recording, RecordingInfo, Split, Store, StoreWriter
from data_module.types import Motion, Speech, Word

SETTINGS = {"preset": "test", "hours": 1.0}


def _recording(name: str, split: Split = "train", seed: int = 0, words: bool = True) -> Recording:
    rng = np.random.default_rng(seed)
    frames, fps = 90, 60.0
    rotations = Rotation.random(frames * 16, random_state=seed).as_quat(scalar_first=True).reshape(frames, 16, 4)
    motion = Motion(CHARACTER, rotations, rng.normal(size=(frames, 3)), fps, ("Spine3",))
    spoken = (Word("où", 0.1, 0.4), Word("l'été", 0.4, 0.9)) if words else None
    speech = Speech(rng.uniform(-0.9, 0.9, 24000).astype(np.float32), 16000, spoken, "brad")
    return Recording(RecordingInfo(name, split, "brad", "slt", "fr", group="g"), speech, motion)


def _store(folder: Path, *recordings: Recording) -> Store:
    writer = StoreWriter(folder, "test", SETTINGS, 3, "none")
    for recording in recordings:
        writer.add(recording)
    return writer.finish([recording.info.name for recording in recordings])


def test_round_trip(tmp_path: Path) -> None:
    first, second = _recording("a", "train", 1), _recording("b", "test", 2, words=False)
    _store(tmp_path / "s", first, second)
    store = Store.open(tmp_path / "s")
    assert store.names == ("a", "b") and store.settings == SETTINGS and (store.seed, store.corpus) == (3, "test")
    assert [info.name for info in store.of_split("test")] == ["b"]
    for before in (first, second):
        after = store.load(before.info.name)
        # 16-bit sound, 32-bit motion: what the two formats keep.
        assert np.abs(after.speech.samples - before.speech.samples).max() <= 1.01 / 32768
        turned = np.abs(np.sum(after.motion.rotations * before.motion.rotations, axis=-1))
        assert turned.min() > 1 - 1e-12 and np.abs(np.linalg.norm(after.motion.rotations, axis=-1) - 1).max() < 1e-12
        assert np.abs(after.motion.root_positions - before.motion.root_positions).max() < 1e-6
        assert after.motion.fps == 60 and after.motion.absent == ("Spine3",)
        assert after.speech.words == before.speech.words
        assert after.info == replace(before.info, seconds=1.5, frames=90, fps=60.0, absent=("Spine3",))


def test_the_whole_body_is_kept_and_read_in_any_size(tmp_path: Path) -> None:
    small = _recording("a")
    motion = resized(small.motion, WHOLE_BODY)
    turns = Rotation.random(90 * 54, random_state=4).as_quat(scalar_first=True).reshape(90, 54, 4)
    motion = replace(motion, rotations=turns, absent=("Spine3", "LeftToeBase"), filled=FINGER_JOINTS)
    store = _store(tmp_path / "s", replace(small, motion=motion))
    assert store.recordings[0].absent == motion.absent and store.recordings[0].filled == FINGER_JOINTS
    for joints, absent, filled in ((54, motion.absent, FINGER_JOINTS), (46, ("Spine3",), FINGER_JOINTS),
                                   (16, ("Spine3",), ())):
        read = store.load("a", joints).motion
        assert read.skeleton is CHARACTERS[joints] and (read.absent, read.filled) == (absent, filled)
        assert np.abs(np.sum(read.rotations * turns[:, :joints], axis=-1)).min() > 1 - 1e-12
    assert len(store.load("a").motion.skeleton) == 16
    # What a store of the papers' joints has not is at rest and absent.
    grown = _store(tmp_path / "old", small).load("a", 46).motion
    assert grown.absent == ("Spine3", *FINGERED.names[16:]) and (grown.rotations[:, 16:, 0] == 1).all()


def test_bytes_and_fingerprint_depend_on_the_content_alone(tmp_path: Path) -> None:
    one = _store(tmp_path / "one", _recording("a", seed=1), _recording("b", seed=2))
    writer = StoreWriter(tmp_path / "two", "test", SETTINGS, 3, "none")
    writer.add(_recording("b", seed=2))
    writer.add(_recording("a", seed=1))
    two = writer.finish(["a", "b"])
    for file in sorted((tmp_path / "one").rglob("*")):
        if file.is_file():
            assert file.read_bytes() == (tmp_path / "two" / file.relative_to(tmp_path / "one")).read_bytes()
    other = _store(tmp_path / "three", _recording("a", seed=1), _recording("b", seed=4))
    assert one.fingerprint == two.fingerprint != other.fingerprint


def _edited(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], object]:
    """Change the listing of a store."""
    def edit(store: Path) -> None:
        content = json.loads((store / "store.json").read_text())
        change(content)
        (store / "store.json").write_text(json.dumps(content))

    return edit


@pytest.mark.parametrize(("damage", "wrong"), [
    (shutil.rmtree, "does not exist"),
    (lambda store: (store / "store.json").unlink(), "not a store"),
    (lambda store: (store / "store.json").write_text("{"), "is not valid JSON"),
    (lambda store: (store / "store.json").write_text("[]"), "not the listing"),
    (lambda store: (store / "recordings" / "a.npz").unlink(), "is missing from its store"),
    (_edited(lambda content: content.update(format=99)), "format 99, and this version reads format 3"),
    (_edited(lambda content: content["recordings"][0].update(split="test")), "fingerprint"),
    (_edited(lambda content: content.pop("licence")), "invalid entries"),
])
def test_broken_stores_are_refused_in_one_line(damage: Callable[[Path], object], wrong: str, tmp_path: Path) -> None:
    _store(tmp_path / "s", _recording("a"))
    damage(tmp_path / "s")
    with pytest.raises(InputError, match=wrong) as caught:
        Store.open(tmp_path / "s")
    assert "\n" not in str(caught.value) and str(tmp_path / "s") in str(caught.value)


@pytest.mark.parametrize("suffix", ["npz", "flac"])
def test_a_changed_file_is_refused(tmp_path: Path, suffix: str) -> None:
    store = _store(tmp_path / "s", _recording("a"))
    file = tmp_path / "s" / "recordings" / f"a.{suffix}"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(bytes(content))
    with pytest.raises(InputError, match="was changed"):
        store.load("a")
    with pytest.raises(InputError, match="not in the store"):
        store.load("nobody")
