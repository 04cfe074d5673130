"""The readers of Trinity, ZeroEGGS, MOCCA and of any folder: files of just the published layout, and broken ones."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import published_bvh as published
import pytest

from data_module.corpora.base import DroppedError, Imported, Item, Options, Reader, load
from data_module.corpora.table import open_corpus
from data_module.corpora.takes import read_motion
from data_module.errors import InputError
from data_module.motion import kinematics
from data_module.motion.skeletons import FINGER_JOINTS, WHOLE_BODY, to_character
from data_module.types import Motion, Word

LAYOUTS: dict[str, Callable[[Path], Path]] = {"trinity": published.trinity, "zeroeggs": published.zeroeggs,
                                              "mocca": published.mocca, "genea": published.genea}


def _named(reader: Reader) -> dict[str, Item]:
    return {item.info.name: item for item in reader.items()}


def _same(found: Motion, made: Motion) -> None:
    """Both take the joints to the same places, in metres."""
    assert set(found.skeleton.names) == set(made.skeleton.names)
    order = [found.skeleton.index(name) for name in made.skeleton.names]
    apart = kinematics.positions_of(found)[:, order] - kinematics.positions_of(made)[:len(found)]
    assert np.abs(apart).max() < 1e-5


# ---------------------------------------------------------------------------------------------------- Trinity


def test_trinity_as_published(tmp_path: Path) -> None:
    reader = open_corpus("trinity", published.trinity(tmp_path), Options())
    items = _named(reader)
    assert {name: item.info.split for name, item in items.items()} == {
        "Recording_001": "train", "Recording_008": "val", "TestSeq001": "test"}
    assert {(item.info.speaker, item.info.language) for item in items.values()} == {("trinity", "en")}
    recording = load(reader, items["Recording_008"])
    assert isinstance(recording, Imported) and recording.unit == "0.01 m, as published" and recording.words == "given"
    _same(recording.motion, published.moving(2.0, 60.0, seed=1))
    # 2 s of motion, 2.5 s of sound.
    assert (recording.motion.fps, len(recording.motion), recording.speech.duration) == (60.0, 120, 2.0)
    assert recording.speech.words == (Word("So", 0.2, 0.5), Word("we", 0.5, 0.7), Word("went.", 1.0, 1.4))
    assert to_character(recording.motion).absent == ()


def test_trinity_says_what_is_missing_by_file(tmp_path: Path) -> None:
    release = published.trinity(tmp_path, train=(1, 2, 3, 8, 24))
    train = release / "Training_data"
    (train / "Audio" / "Recording_002.wav").unlink()
    (train / "Motion" / "Recording_003.bvh").unlink()
    (train / "Transcripts" / "Recording_001.json").unlink()
    reader = open_corpus("trinity", tmp_path, Options())  # the folder above will do
    assert list(_named(reader)) == ["Recording_001", "Recording_008", "TestSeq001"]
    notes = "\n".join(reader.notes())
    assert "left out Recording_002: Recording_002.wav is missing" in notes
    assert "left out Recording_003: Recording_003.bvh is missing" in notes
    assert "Recording_001.json is missing, so its words are unknown" in notes
    assert f"left out {train / 'Motion' / 'Recording_024.bvh'}: it is not a recording of the published split" in notes
    assert load(reader, reader.items()[0]).speech.words is None


# ---------------------------------------------------------------------------------------------------- ZeroEGGS


def test_zeroeggs_as_published(tmp_path: Path) -> None:
    data = published.zeroeggs(tmp_path)
    clean = data / "clean"
    for copy in ("001_Neutral_0_mirror_x_1_0", "001_Neutral_0_x_0_9"):
        shutil.copy(clean / "001_Neutral_0_x_1_0.bvh", clean / f"{copy}.bvh")
    reader = open_corpus("zeroeggs", data, Options())
    items = _named(reader)
    assert {name: item.info.split for name, item in items.items()} == {
        "001_Neutral_0_x_1_0": "train", "005_Neutral_4_x_1_0": "test", "010_Sad_4_x_1_0": "val",
        "067_Speech_2_x_1_0": "test"}
    recording = load(reader, items["005_Neutral_4_x_1_0"])
    _same(recording.motion, published.moving(2.0, 60.0, seed=5))
    assert recording.motion.fps == 60.0  # of a frame time of 0.016667
    assert recording.speech.words is None and isinstance(recording, Imported) and recording.words == ""
    notes = "\n".join(reader.notes())
    assert "words are unknown" in notes and "divided between val and test" in notes


# ---------------------------------------------------------------------------------------------------- MOCCA


def test_mocca_as_published(tmp_path: Path) -> None:
    source = published.mocca(tmp_path)
    (source / "speaker01_clip01_beats.txt").write_text("0.5\n1.0\n")
    reader = open_corpus("mocca", source, Options())
    items = _named(reader)
    assert {name: (item.info.split, item.info.speaker) for name, item in items.items()} == {
        "speaker01_clip01": ("train", "speaker01"), "speaker01_clip04": ("test", "speaker01"),
        "speaker05_clip02": ("train", "speaker05")}
    recording = load(reader, items["speaker05_clip02"])
    _same(recording.motion, published.moving(2.0, 60.0, seed=2))
    assert isinstance(recording, Imported) and recording.words == "guessed"
    assert recording.unit == "0.01 m, guessed by the length of the spine"
    words = recording.speech.words or ()
    assert "".join(word.text for word in words) == "大家好我是老师"
    for first, last, said in ((0.2, 1.0, "大家好"), (1.2, 1.9, "我是老师")):
        inside = [word for word in words if first - 1e-6 <= word.start and word.end <= last + 1e-6]
        assert "".join(word.text for word in inside) == said
    notes = "\n".join(reader.notes())
    assert "not published: here speaker01_clip04" in notes


# ---------------------------------------------------------------------------------------------------- GENEA


def test_talking_with_hands_as_genea_gave_it(tmp_path: Path) -> None:
    reader = open_corpus("genea", published.genea(tmp_path, 2022), Options())
    items = _named(reader)
    assert {name: (item.info.split, item.info.speaker, item.info.group) for name, item in items.items()} == {
        "trn_2022_v1_000": ("train", "speaker1", "trn_2022_v1_000"),
        "trn_2022_v1_001": ("train", "speaker2", "trn_2022_v1_001"),
        "val_2022_v1_000": ("val", "unknown", "val_2022_v1_000")}
    assert "1 recordings are in no metadata.csv" in "\n".join(reader.notes())
    recording = load(reader, items["trn_2022_v1_001"])
    _same(recording.motion, published.moving(4.0, 30.0, seed=1, skeleton=published.hands_rig()))
    assert isinstance(recording, Imported) and recording.unit == "0.01 m, as published" and recording.words == "given"
    assert (recording.motion.fps, len(recording.motion)) == (30.0, 120)
    assert recording.speech.words == (Word("So", 0.3, 0.55), Word("we", 0.55, 0.9), Word("", 0.9, 1.5),
                                      Word("went.", 2.0, 3.0))
    # Only fingers that were measured count; the rig has neither a second neck joint nor toes.
    lacking = {"Neck1", "LeftToeBase", "RightToeBase"}
    whole = load(reader, items["trn_2022_v1_000"])
    assert set(to_character(whole.motion, skeleton=WHOLE_BODY).absent) == lacking
    assert set(to_character(recording.motion, skeleton=WHOLE_BODY).absent) == lacking | set(FINGER_JOINTS)


def test_both_people_of_a_genea_2023_conversation(tmp_path: Path) -> None:
    source = published.genea(tmp_path, 2023)
    # The main agent's motion of the test is withheld.
    published.write_clicks(source / "tst" / "main-agent" / "wav" / "tst_2023_v0_000_main-agent.wav", 4.0)
    reader = open_corpus("genea", source, Options())
    items = _named(reader)
    assert {name: (item.info.split, item.info.speaker, item.info.group) for name, item in items.items()} == {
        "trn_2023_v0_000_interloctr": ("train", "speaker3", "trn_2023_v0_000"),
        "trn_2023_v0_000_main-agent": ("train", "speaker17", "trn_2023_v0_000"),
        "tst_2023_v0_000_interloctr": ("test", "speaker3", "tst_2023_v0_000")}
    assert "left out tst_2023_v0_000_main-agent: tst_2023_v0_000_main-agent.bvh is missing" in reader.notes()
    assert [set(published.hands_rig().names) & set(reader.read(item).motion.absent) != set()
            for item in items.values()] == [True, False, True]
    (source / "trn" / "metadata.csv").write_text("trn_2023_v0_000,17,finger_incl\n")
    assert _named(open_corpus("genea", source, Options()))["trn_2023_v0_000_interloctr"].info.speaker == "unknown"
    (source / "trn" / "metadata.csv").write_text("prefix\ntrn_2023_v0_000,17,finger_incl,3\n")
    with pytest.raises(InputError, match=r"metadata\.csv: line 2: trn_2023_v0_000,17,finger_incl,3 is not a name"):
        open_corpus("genea", source, Options())


@pytest.mark.parametrize("row", ["0.2\tabc\tword", "0.2\t0.4 word", "word", "start\tend\tword"])
def test_a_bad_row_of_words_is_named_by_its_line(row: str, tmp_path: Path) -> None:
    source = published.genea(tmp_path)
    file = source / "trn" / "tsv" / "trn_2022_v1_000.tsv"
    file.write_text(f"0.0\t0.2\n{row}\n")
    reader = open_corpus("genea", source, Options())
    with pytest.raises(DroppedError, match=r"trn_2022_v1_000\.tsv: line 2: is not a start, an end and a text"):
        reader.read(reader.items()[0])


# ---------------------------------------------------------------------------------------------------- any folder


def _pair(folder: Path, name: str = "talk", seconds: float = 2.0) -> Motion:
    return published.write_take(folder / f"{name}.bvh", folder / f"{name}.wav", seconds)


_TEXTGRID = ('File type = "ooTextFile"\nObject class = "TextGrid"\n\n0\n2\n<exists>\n1\n"IntervalTier"\n"words"\n'
             '0\n2\n2\n0\n0.4\n""\n0.4\n1.0\n"hello"\n')


@pytest.mark.parametrize(("kind", "text", "words", "how"), [
    (".TextGrid", _TEXTGRID, [("", 0.0, 0.4), ("hello", 0.4, 1.0)], "given"),
    (".json", json.dumps({"words": [{"word": "hello", "start": 0.4, "end": 1.0}]}), [("hello", 0.4, 1.0)], "given"),
    (".json", json.dumps([{"word": "hello", "start": 0.4, "end": 1.0}]), [("hello", 0.4, 1.0)], "given"),
    (".json", json.dumps({"words": [{"text": "hello", "start": 0.4, "end": 1.0}]}), [("hello", 0.4, 1.0)], "given"),
    (".json", json.dumps({"segments": [{"start": 0.4, "end": 1.0, "text": "привет"}]}), [("привет", None, None)],
     "guessed"),
    (".srt", "1\n00:00:00,400 --> 00:00:01,000\nпривет\n", [("привет", None, None)], "guessed"),
    (".vtt", "WEBVTT\n\n00:00.400 --> 00:01.000\nпривет\n", [("привет", None, None)], "guessed"),
    (".txt", "привет", [("привет", None, None)], "guessed"),
])
def test_a_folder_with_what_is_said(kind: str, text: str, words: list[tuple[str, float | None, float | None]], how: str,
                                    tmp_path: Path) -> None:
    made = _pair(tmp_path)
    (tmp_path / f"talk{kind}").write_text(text, encoding="utf-8")
    reader = open_corpus("folder", tmp_path, Options())
    recording = load(reader, reader.items()[0])
    _same(recording.motion, made)
    assert isinstance(recording, Imported) and recording.words == how
    found = recording.speech.words or ()
    assert [word.text for word in found] == [word for word, _, _ in words]
    for word, (_, start, end) in zip(found, words, strict=True):
        if start is not None:
            assert (word.start, word.end) == (start, end)
        elif kind != ".txt":
            assert 0.4 <= word.start < word.end <= 1.0


# ---------------------------------------------------------------------------------------------------- units


def test_the_unit_is_told_or_published_or_guessed(tmp_path: Path) -> None:
    made = published.moving(1.0, 60.0)
    file = tmp_path / "a.bvh"
    for unit in (1.0, 0.01, 0.001):
        file.write_text(published.bvh_in(made, unit=unit))
        motion, said = read_motion(file, Options())
        _same(motion, made)
        assert said == f"{unit:g} m, guessed by the length of the spine"
    file.write_text(published.bvh_in(made, unit=0.0254))
    motion, said = read_motion(file, Options(unit=0.0254), published=0.01)
    _same(motion, made)
    assert said == "0.0254 m, given by --unit"
    assert read_motion(file, Options(), published=0.01)[1] == "0.01 m, as published"


# ---------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_folder_without_the_data_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--source: is missing"):
        open_corpus(name, None, Options())
    with pytest.raises(InputError, match=r"nowhere: does not exist"):
        open_corpus(name, tmp_path / "nowhere", Options())
    _pair(tmp_path / "other", "unheard_of")
    with pytest.raises(InputError, match=r"other: holds no .*\.wav of the same name; name "):
        open_corpus(name, tmp_path / "other", Options())


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize(("kind", "content", "message"), [
    (".bvh", b"HIERARCHY\nROOT Hips\n{\nMOTION\nFrame Time: 0.1\n", "is not a BVH file"),
    (".bvh", b"\xff\xfe\x00", "is not text"),
    (".bvh", None, r"its header says 120 frames at \d0 fps but 119 rows follow"),
    (".wav", b"RIFF", ""),
])
def test_a_broken_file_is_named_and_the_rest_is_read(name: str, kind: str, content: bytes | None, message: str,
                                                     tmp_path: Path) -> None:
    source = LAYOUTS[name](tmp_path)
    reader = open_corpus(name, source, Options())
    first, last = reader.items()[0], reader.items()[-1]
    [file] = source.rglob(first.info.name + kind)
    file.write_bytes(content if content is not None else b"\n".join(file.read_bytes().rstrip().split(b"\n")[:-1]))
    with pytest.raises(DroppedError, match=rf"{file.name}: .*{message}"):
        load(reader, first)
    assert len(load(reader, last).motion) == 120


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_file_that_is_there_twice_is_refused(name: str, tmp_path: Path) -> None:
    source = LAYOUTS[name](tmp_path)
    file = next(source.rglob("*.bvh"))
    (file.parent / "again").mkdir()
    shutil.copy(file, file.parent / "again")
    with pytest.raises(InputError, match=rf"{file.name}: is there twice"):
        open_corpus(name, source, Options())
