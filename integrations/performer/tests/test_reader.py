"""The reader of the synthetic corpus: its plan, its splits and its licence."""

from __future__ import annotations

import argparse
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import soundfile
from gesticulator_performer.reader import TEST_READINGS, Performer, PerformerOptions
from gesticulator_performer.text import sentence_key

from data_module.corpora.base import load
from data_module.motion import kinematics


@pytest.fixture(scope="module")
def source(free_motion: Path) -> Path:
    pytest.importorskip("pocketsphinx")
    return free_motion.parent


@pytest.fixture
def reader(source: Path) -> Performer:
    return Performer(source, PerformerOptions(hours=4.0))


def test_the_command_line_sets_the_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GESTICULATOR_DATA", str(tmp_path))
    arguments = argparse.Namespace(fps=30.0, unit=0.01, seed=7, hours=0.5, repertoire=tmp_path / "takes")
    assert Performer.options(arguments) == PerformerOptions(
        fps=30.0, unit=0.01, seed=7, joints=None, data=tmp_path, hours=0.5, repertoire=tmp_path / "takes")


def test_plan_of_the_default_performer(source: Path, reader: Performer) -> None:
    """Shares, leaks and kept readings of the real plan; nothing is spoken or played."""
    items = reader.items()
    infos = [item.info for item in items]
    assert {info.part for info in infos} == {"motion", "talk", "style", "reading"}
    assert len({info.name for info in infos}) == len(infos)
    made = [info for info in infos if info.part != "reading"]
    share = Counter(info.split for info in made)
    assert share["val"] >= 20 and sum(info.split == "test" for info in infos) >= 60
    seconds = Counter[str]()
    for item in items:
        seconds[item.info.split] += item.info.seconds
    assert seconds["train"] > 0.7 * seconds.total(), "recordings for test are short"
    train = [info for info in infos if info.split != "test"]
    test = [info for info in infos if info.split == "test"]
    assert not {info.group for info in train} & {info.group for info in test}
    assert not {i.voice for i in train} & {i.voice for i in test}
    assert {i.speaker for i in test} <= {i.speaker for i in train}
    assert {"brad", "brad2", "connor", "garza", "story", "conversation"} <= {i.speaker for i in test}
    # Each reading by three performers at most; those held out, whole, by one.
    readings = Counter((info.group, info.split) for info in infos if info.part == "reading" and "-" not in info.voice)
    assert {group for group, split in readings if split == "test"} == set(TEST_READINGS)
    assert all(count == (1 if split == "test" else 3) for (_, split), count in readings.items())
    again = Performer(source, PerformerOptions(hours=4.0)).items()
    assert [(item.info, item.content) for item in items] == [(item.info, item.content) for item in again]
    assert [item.content for item in reader.items()] == [item.content for item in items], "asked twice, the same"
    longer = Performer(source, PerformerOptions(hours=4.4)).items()
    assert longer[0] == items[0] and longer[-1] == items[-1]
    other = Performer(source, PerformerOptions(hours=4.0, seed=2)).items()
    assert other[0].info != items[0].info
    credit = ("The data used in this project was obtained from mocap.cs.cmu.edu. "
              "The database was created with funding from NSF EIA-0196217.")
    assert all(named in reader.licence for named in (credit, "Rocketbox", "MIT", "LGPL 2.1", "LibriVox", "PNGestures"))


def test_each_utterance_is_performed_once_and_no_reader_is_in_two_splits(outside_data: Path, reader: Performer) -> None:
    """The table of LibriSpeech says who may be heard in training."""
    if not (outside_data / "voices").is_dir():
        pytest.skip("the outside data has no voices")
    assert all(part in reader.licence for part in ("LibriSpeech", "Panayotov", "CC BY 4.0"))
    rows = [line.split("|") for line in (outside_data / "voices" / "SPEAKERS.TXT").read_text().splitlines()]
    subset = {row[0].strip(): row[2].strip() for row in rows if len(row) > 2}
    items = reader._utterances()
    files = {file.stem: file for file in (outside_data / "voices").rglob("*.flac")}
    for split, of, count in (("train", "train-clean-100", 227), ("val", "test-other", 10), ("test", "test-other", 10)):
        infos = [item.info for item in items if item.info.split == split]
        assert len({info.voice for info in infos}) == len(infos) == count
        assert {subset[info.group] for info in infos} == {of} and all(i.voice.startswith(i.group) for i in infos)
        players = Counter(info.speaker for info in infos)
        assert len(players) == 4 and max(players.values()) - min(players.values()) <= 1
    groups = Counter(group for group, _ in {(item.info.group, item.info.split) for item in items})
    assert set(groups.values()) == {1} and len({item.index for item in items}) == len(items)
    item = max(items, key=lambda one: one.info.seconds)
    made = load(reader, item)
    assert made.speech.words is None and len(made.info.sources) >= 2
    written = soundfile.read(files[item.info.voice], dtype="float32")[0][:len(made.speech.samples)]
    assert np.corrcoef(made.speech.samples, written)[0, 1] > 0.999
    assert made.motion.duration == pytest.approx(soundfile.info(files[item.info.voice]).duration, abs=1 / 60)


@pytest.mark.parametrize(("folder", "credit"), [("voices", "LibriSpeech"), ("idle", "ReActIdle")])
def test_a_folder_that_may_be_missing_is_credited_where_it_is(tmp_path: Path, folder: str, credit: str) -> None:
    for needed in ("strokes", "speech", "free_motion", "meaning"):
        (tmp_path / needed).mkdir()
        (tmp_path / needed / "manifest.csv").touch()
    bare = Performer(tmp_path, PerformerOptions())
    assert not bare._utterances() and credit not in bare.licence
    before = bare.settings()["source"]
    (tmp_path / folder).mkdir()
    (tmp_path / folder / "one").write_bytes(b"x")
    assert credit in Performer(tmp_path, PerformerOptions()).licence
    assert bare.settings()["source"] != before, "a changed file makes another store"


def test_no_sentence_and_no_take_crosses_a_split(reader: Performer) -> None:
    said: dict[str, list[str]] = {"train": [], "val": [], "test": []}
    for item in reader.items():
        if item.info.part in ("talk", "style"):
            said[item.info.split] += [sentence_key(utterance) for utterance in item.content]
    everything = [one for sentences in said.values() for one in sentences]
    assert len(everything) > 2000 and len(set(everything)) > 0.99 * len(everything)
    pools: dict[str, set[str]] = {"train": set(), "val": set(), "test": set()}
    for (_, split), texts in reader._phrases[0].items():
        pools[split] |= set(texts)
    for one, other in (("train", "test"), ("val", "test"), ("train", "val")):
        assert not set(said[one]) & set(said[other])
        assert not {phrase for phrase in pools[one] if len(phrase) > 20} & pools[other]
    takes = reader._take_splits
    assert set(takes.values()) == {"train", "val", "test"} and len(takes) > 90


def test_a_talk_made_for_motion_uses_takes_of_its_split_alone(reader: Performer) -> None:
    if not shutil.which("espeak-ng"):
        pytest.skip("espeak-ng is not installed")
    item = next(i for i in reader.items() if i.info.part == "motion" and i.info.voice == "us_f3")
    reader._phrases[0][item.info.voice, item.info.split] = reader._phrases[0][item.info.voice, item.info.split][:220]
    recording = load(reader, item)
    assert recording.info.sources and all(reader._take_splits[name] == "train" for name in recording.info.sources)
    assert recording.motion.duration == pytest.approx(recording.speech.duration, abs=1 / 60)
    assert recording.speech.words
    hands = kinematics.positions_of(recording.motion)[:, [11, 15]]
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=-1) * recording.motion.fps
    assert 0.2 < speed.mean() < 1.0
