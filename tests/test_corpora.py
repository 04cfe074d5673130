"""Every reader keeps the same contract; readers of files give what the files hold."""

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import published
import published_bvh
import pytest
from bursts import waving

from data_module.corpora.base import DroppedError, Options, Reader, load, spread
from data_module.corpora.folder import FolderOptions
from data_module.corpora.table import CORPORA, SEPARATE, open_corpus
from data_module.errors import InputError
from data_module.motion import kinematics, skeletons
from data_module.motion.bvh import write_bvh
from data_module.speech.audio import write_flac
from data_module.store import SPLITS
from data_module.types import Speech, Word

RATE = 16000


def _speech(seconds: float, words: tuple[Word, ...] | None = None) -> Speech:
    samples = 0.1 * np.sin(np.arange(round(seconds * RATE)) / 20).astype(np.float32)
    return Speech(samples.astype(np.float32), RATE, words)


def _pairs(root: Path, *names: str) -> Path:
    source = root / "recordings"
    source.mkdir()
    for number, name in enumerate(names or ("ann_1", "ann_2", "bob_1")):
        write_bvh(source / f"{name}.bvh", waving(frames=150 + 30 * number, fps=60.0, seed=number))
        write_flac(source / f"{name}.flac", _speech(2.6))
    return source


def _beat(root: Path) -> Path:
    published.write_beat(root / "5", "5_stewart_0_65_65")
    return root


def _ted(root: Path) -> Path:
    published.write_ted(root)
    return root


SAMPLES: dict[str, Callable[[Path], Reader]] = {
    "folder": lambda root: open_corpus("folder", _pairs(root), Options()),
    "trinity": lambda root: open_corpus("trinity", published_bvh.trinity(root), Options()),
    "zeroeggs": lambda root: open_corpus("zeroeggs", published_bvh.zeroeggs(root), Options()),
    "mocca": lambda root: open_corpus("mocca", published_bvh.mocca(root), Options()),
    "genea": lambda root: open_corpus("genea", published_bvh.genea(root), Options()),
    "beat": lambda root: open_corpus("beat", _beat(root), Options()),
    "beat2": lambda root: open_corpus("beat2", published.listed_beat2(root).parent, Options()),
    "ted": lambda root: open_corpus("ted", _ted(root), Options()),
}
"""A small instance of every reader; a new reader brings its own."""


def test_every_reader_has_a_sample() -> None:
    assert set(SAMPLES) == set(CORPORA) - set(SEPARATE)


@pytest.mark.parametrize("name", list(SAMPLES))
def test_contract(name: str, tmp_path: Path) -> None:
    reader = SAMPLES[name](tmp_path)
    assert reader.licence
    json.dumps(dict(reader.settings()))
    items = reader.items()
    names = [item.info.name for item in items]
    assert len(set(names)) == len(names) > 0
    assert [pickle.loads(pickle.dumps(item)) for item in items] == list(reader.items())
    recording = load(reader, items[-1])
    assert recording.info.name == names[-1] and recording.info.split in ("train", "val", "test")
    assert abs(recording.motion.duration - recording.speech.duration) < 1e-3
    for word in recording.speech.words or ():
        assert 0 <= word.start <= word.end <= recording.speech.duration + 1e-6
    # Metres: hips to head of a person, and the motion can be brought onto the character.
    character = skeletons.to_character(recording.motion)
    places = kinematics.positions_of(recording.motion)
    table = skeletons.find_table(recording.motion.skeleton.names)
    tall = np.linalg.norm(places[:, table["Head"]] - places[:, table["Hips"]], axis=-1)
    assert 0.4 < np.median(tall) < 0.8
    again = load(reader, items[-1])
    assert np.array_equal(again.motion.rotations, recording.motion.rotations)
    assert np.array_equal(again.speech.samples, recording.speech.samples) and len(character) == len(again.motion)
    assert all(isinstance(line, str) for line in reader.notes())


def test_folder_pairs_by_name_and_reports_the_rest(tmp_path: Path) -> None:
    source = _pairs(tmp_path)
    write_bvh(source / "lonely.bvh", waving(frames=100, fps=60.0))
    (source / "ann_2.json").write_text(json.dumps({"words": [{"text": "hello", "start": 0.5, "end": 0.9}],
                                                   "performer": "ann", "language": "en", "split": "test"}))
    (source / "bob_1.bvh").write_text("HIERARCHY\n broken")
    reader = open_corpus("folder", source, Options())
    items = {item.info.name: item for item in reader.items()}
    assert list(items) == ["ann_1", "ann_2", "bob_1"]
    assert "lonely" in " ".join(reader.notes())
    with pytest.raises(DroppedError, match=r"bob_1\.bvh"):
        reader.read(items["bob_1"])
    assert items["ann_2"].info.split == "test" and items["ann_1"].info.language == "und"
    recording = load(reader, items["ann_2"])
    assert recording.speech.words == (Word("hello", 0.5, 0.9),) and recording.info.speaker == "ann"
    # 180 frames are 3 s, the sound is 2.6 s: the shorter counts.
    assert len(recording.motion) == 156
    assert load(reader, items["ann_1"]).speech.words is None


@pytest.mark.parametrize(("count", "counts"), [
    (1, (1, 0, 0)), (2, (1, 0, 1)), (3, (1, 1, 1)), (4, (2, 1, 1)), (10, (8, 1, 1)), (40, (32, 4, 4)),
    (200, (160, 20, 20)),
])
def test_shares_give_every_split_a_recording_where_they_can(count: int, counts: tuple[int, ...]) -> None:
    splits = spread(count, (80, 10, 10))
    assert tuple(splits.count(split) for split in SPLITS) == counts
    # Spread, not at one end: every half of a long list has its part.
    if count >= 40:
        assert 0.4 < splits[:count // 2].count("test") / counts[2] < 0.6


def test_splits_and_speakers_of_a_folder_as_the_user_says(tmp_path: Path) -> None:
    source = _pairs(tmp_path, "s1-a", "s1-b", "s2-a")
    listed = tmp_path / "splits.csv"
    listed.write_text("name,split\ns1-a,test\n s1-b , train\ns2-a,val\nother,train\n")
    options = FolderOptions(split=str(listed), speaker="^(s.)-")
    infos = [item.info for item in open_corpus("folder", source, options).items()]
    assert [info.split for info in infos] == ["test", "train", "val"]
    assert [info.speaker for info in infos] == ["s1", "s1", "s2"]
    infos = [item.info for item in open_corpus("folder", source, FolderOptions(split="0/0/100", speaker="Ann")).items()]
    assert {(info.split, info.speaker, info.voice) for info in infos} == {("test", "Ann", "Ann")}
    infos = [item.info for item in open_corpus("folder", source, FolderOptions(split="100/0/0")).items()]
    assert {info.split for info in infos} == {"train"}


@pytest.mark.parametrize(("split", "speaker", "says"), [
    ("80/10", "", "neither three shares nor a file"), ("0/0/0", "", "neither"), ("a/b/c", "", "neither"),
    ("-80/10/10", "", "neither"), ("FILE", "", "does not name s1-b"), ("BROKEN", "", "line 2"),
    ("", "(", "not a regular expression"), ("", "^(x)", "matches no speaker in s1-a"),
    ("", "^(?:s1)", "matches no speaker"),
])
def test_splits_and_speakers_that_cannot_be(split: str, speaker: str, says: str, tmp_path: Path) -> None:
    source = _pairs(tmp_path, "s1-a", "s1-b")
    (tmp_path / "FILE").write_text("s1-a,train\n")
    (tmp_path / "BROKEN").write_text("s1-a,train\ns1-b,perhaps\n")
    split = str(tmp_path / split) if split in ("FILE", "BROKEN") else split
    with pytest.raises(InputError, match=says):
        open_corpus("folder", source, FolderOptions(split=split, speaker=speaker))
