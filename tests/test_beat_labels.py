"""Labelled beats: every layout that they may come in, the figures against mir_eval, and real labels."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import mir_eval
import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.store import Store
from data_module.types import Speech
from eval.commands import PROBE
from eval.foreign import read_motion
from eval.label_files import LabelChoice, Labels, find_labels, read_labels, read_recordings
from eval.metrics import pmb
from eval.probes import beat_labels
from eval.probes.beat_labels import Found, LabelledRecording, f_measure, judge, offset, scores
from eval.table import load

TIMES = [0.5, 1.25, 2.0]
_LONG_GRID = """File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 3
tiers? <exists>
size = 2
item []:
    item [1]:
        class = "IntervalTier"
        name = "words"
        xmin = 0
        xmax = 3
        intervals: size = 1
        intervals [1]:
            xmin = 0
            xmax = 3
            text = "say ""this"" now"
    item [2]:
        class = "TextTier"
        name = "gesture beats"
        xmin = 0
        xmax = 3
        points: size = 3
        points [1]:
            number = 0.5
            mark = "b"
        points [2]:
            number = 1.25
            mark = "b"
        points [3]:
            number = 2.0
            mark = "b"
"""
_SHORT_GRID = ('File type = "ooTextFile"\nObject class = "TextGrid"\n\n0\n3\n<exists>\n1\n"IntervalTier"\n"any"\n'
               '0\n3\n6\n0\n0.5\n""\n0.5\n0.8\n"x"\n0.8\n1.25\n""\n1.25\n1.5\n"x"\n1.5\n2\n"sil"\n2\n3\n"x"\n')
LAYOUTS = {
    "seconds": ("0.5\n1.25\n2.0\n", "seconds, one a line"),
    "out of order, twice": ("# beats\n2.0\n0.5\n\n1.25\n2\n", "seconds, one a line"),
    "with labels": ("0.5 beat, strong\n1.25\tbeat\n2.0,weak\n", "seconds, one a line"),
    "audacity points": ("0.500000\t0.500000\tb\n1.25\t1.25\tb\n2.0\t2.0\t\n", "Audacity label track"),
    "audacity regions": ("0.5\t0.7\tb\n\\\t100.0\t200.0\n1.25\t1.5\n2.0\t2.5\t3\n", "Audacity label track"),
    "table": ("label;Time\nb;0.5\nb;1.25\nnone;\nb;2.0\n", "table"),
    "table of marks that last": ("start,end,label\n0.5,0.7,b\n1.25,1.5,\n2,2.5,b\n", "table"),
    "json numbers": ("[0.5, 1.25, 2]", "JSON"),
    "json pairs": ('[[0.5, "b"], [1.25, "b"], [2.0, "b"]]', "JSON"),
    "json objects": ('{"speaker": 1, "beats": [{"time": 0.5}, {"start": 1.25, "end": 1.5}, {"time": 2}]}', "JSON"),
    "textgrid, long": (_LONG_GRID, "TextGrid"),
    "textgrid, short": (_SHORT_GRID, "TextGrid"),
}


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_every_layout_gives_the_same_moments(name: str, encoding: str, tmp_path: Path) -> None:
    text, layout = LAYOUTS[name]
    file = tmp_path / "any.thing"
    file.write_bytes(text.replace("\n", "\r\n").encode(encoding))
    told = read_labels(file)
    assert told.times == pytest.approx(TIMES) and told.layout == layout


@pytest.mark.parametrize(("text", "wrong"), [
    ("", "holds no labels"), ("# nothing\n", "holds no labels"), ("[]", "no labels"), ("{\"a\": 1}", "no list"),
    ("[1, true]", r"\[1\].*no time"), ("[1,", "is none"), ("0.5 0.7\n1 2\n", "second number"),
    ("1,0.5\n2,0.7\n", "head"), ("0.5\t0.7\tb\n1.0\n", "one number and lines with two"), ("0.5\nhello\n", "line 2"),
    ("2\t1\tb\n", "before it starts"),
    ("-1\n2\n", "before the recording"), ("who,what\na,b\n", "no column of times"), ("time\nsoon\n", "line 2.*no time"),
    ("1\n00:00:01,000 --> 00:00:02,000\nhello\n", "subtitles"), ("file,time\na,1\nb,2\n", "several recordings"),
    (_LONG_GRID[:-40], "cut off"), (_LONG_GRID.replace("gesture beats", "hands"), "--tier"),
    (_LONG_GRID.replace("number = 1.25", 'number = "x"'), "a number was expected"),
    (_LONG_GRID.replace('mark = "b"', 'mark = ""'), "no entry with a text"), ("a\0b", "not text"),
    ("file,time\na,1\n,2\n", "line 3: names no recording"),
])
def test_what_is_no_label_file_is_refused_in_one_line(text: str, wrong: str, tmp_path: Path) -> None:
    file = tmp_path / "labels.txt"
    file.write_text(text)
    with pytest.raises(InputError, match=wrong) as caught:
        read_labels(file)
    assert "\n" not in str(caught.value) and str(file) in str(caught.value)


@pytest.mark.parametrize(("text", "wrong"), [
    ("1" * 16_000 + "x\n", "column"), ("time\n" + "1" * 130_000 + "x\n", "no time"),
    (_LONG_GRID.replace("number = 1.25", "number = " + "1" * 16_000 + "x"), "expected"),
    (_LONG_GRID + '"' * 20_001, None), ('[' * 900 + ']' * 900, "no time"),
    ("time\n" + "1" * 140_000 + "\n", "field larger"), ("[1" + "0" * 400 + "]", "no time"),
    ("[1e999]", "no time"), ("1e999\n", "at inf s"), ("1e200\t1e300\n", "1e"),
    (_LONG_GRID.replace("number = 1.25", "number = 1e999"), "number was expected"),
    (_LONG_GRID.replace("points: size = 3", "points: size = 1e999"), "number was expected"),
])
def test_huge_numbers_and_long_lines_cost_no_time(text: str, wrong: str | None, tmp_path: Path) -> None:
    file = tmp_path / "labels"
    file.write_text(text)
    begun = time.monotonic()
    if wrong is None:
        assert read_labels(file).times == pytest.approx(TIMES)
    else:
        with pytest.raises(InputError, match=wrong) as caught:
            read_labels(file)
        assert len(str(caught.value)) < 500
    assert time.monotonic() - begun < 0.5  # 16,000 digits took 8 s


def test_choices(tmp_path: Path) -> None:
    file = tmp_path / "marks"
    file.write_text("10\t20\tb\n30\t30\tb\n")
    assert read_labels(file, LabelChoice("middle", rate=20)).times == pytest.approx([0.75, 1.5])
    assert read_labels(file, LabelChoice("end", rate=1000)).times == pytest.approx([0.02, 0.03])
    file.write_text(_LONG_GRID)
    assert read_labels(file, LabelChoice(tier="words", at="end")).times == pytest.approx([3.0])
    file.write_text("file,ready,emphasis\na/one.bvh,0.1,0.5\ntwo,0.2,0.7\na/one.bvh,0.3,\n")
    told = read_recordings(file, LabelChoice(column="emphasis"))
    assert {name: own.times.tolist() for name, own in told.items()} == {"a/one.bvh": [0.5], "two": [0.7]}
    for wrong in ({"at": "apex"}, {"rate": 0.0}):
        with pytest.raises(InputError):
            LabelChoice(**wrong)


def test_the_label_file_of_a_recording(tmp_path: Path) -> None:
    (tmp_path / "Beats").mkdir()
    for name in ("speaker01_clip01.wav", "speaker01_clip01.srt", "Beats/speaker01_clip01_beats.txt",
                 "Beats/speaker01_clip011.txt", "speaker01_clip02.csv", "Beats/speaker01_clip02.json"):
        (tmp_path / name).write_text("1\n")
    assert find_labels(tmp_path, "speaker01_clip01") == tmp_path / "Beats" / "speaker01_clip01_beats.txt"
    assert find_labels(tmp_path, "speaker01_clip03") is None
    with pytest.raises(InputError, match="several files"):
        find_labels(tmp_path, "speaker01_clip02")


# ---------------------------------------------------------------------------------------------------- the figures

_moments = st.lists(st.integers(0, 29999), min_size=1, max_size=60, unique=True).map(
    lambda own: np.sort(np.array(own) / 1000.0 + 0.00037 * (np.array(own) % 3)))


@given(_moments, _moments, st.sampled_from([0.0501, 0.1003, 0.2007]))
def test_precision_recall_and_f_are_those_of_mir_eval(found: np.ndarray, labels: np.ndarray, tolerance: float) -> None:
    f, precision, recall = mir_eval.onset.f_measure(labels, found, window=tolerance)
    clip = Found(found, labels, 30.1)
    hits = np.count_nonzero(pmb.matched(found, labels, tolerance + 1e-9) >= 0)
    assert (hits / len(found), hits / len(labels)) == pytest.approx((precision, recall))
    assert f_measure([clip], tolerance) == pytest.approx(f)


def test_scores_of_a_case_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beat_labels, "SHIFTS", 20)
    labels = np.array([1.0, 5.0, 9.95, 15.0])
    clip = Found(np.array([1.05, 1.08, 10.01, 15.25]), labels, 20.0)  # a pair may lie across the edge of two pieces
    told: Any = scores([clip, Found(np.zeros(0), np.array([2.0]), 4.0)], 0.1)
    assert told["precision"].mean == pytest.approx(0.5)
    assert told["recall"].mean == pytest.approx(0.4)
    assert told["f"].mean == pytest.approx(f_measure([clip, Found(np.zeros(0), np.array([2.0]), 4.0)], 0.1)) \
        == pytest.approx(4 / 9)
    assert told["f"].low <= told["f"].mean <= told["f"].high and told["f"].n == 3
    assert offset([clip]) == pytest.approx(60.0)  # 50, 60, 250; nothing lies within half a second of the label at 5
    nothing: Any = scores([Found(np.zeros(0), labels, 20.0)], 0.1)
    assert np.isnan(nothing["precision"].mean) and nothing["recall"].mean == 0.0
    assert nothing["reached by"] == "nothing was found"
    assert np.isnan(offset([Found(np.zeros(0), labels, 20.0)]))


def test_many_beats_match_anything_and_the_controls_say_so() -> None:
    rng = np.random.default_rng(3)
    labels = np.sort(rng.uniform(0, 60, 60))
    dense: Any = scores([Found(np.arange(0.1, 60, 0.2), labels, 60.0)], 0.2)
    assert dense["recall"].mean > 0.95 and dense["reached by"] and dense["p_value"] > 0.05
    right: Any = scores([Found(np.sort(labels + rng.normal(0, 0.02, 60)) % 60, labels, 60.0)], 0.1)
    assert right["f"].mean > 0.95 and not right["reached by"] and right["p_value"] < 0.01


# ---------------------------------------------------------------------------------------------------- whole recordings

def _clicks(path: Path, times: list[float], seconds: float) -> None:
    rng = np.random.default_rng(0)
    samples = 1e-4 * rng.standard_normal(round(16000 * seconds))
    for at in times:
        first = round(at * 16000)
        samples[first:first + 800] += 0.3 * rng.standard_normal(800) * np.exp(-np.arange(800) / 200)
    soundfile.write(path, samples.clip(-1, 1), 16000)


def test_the_onsets_of_a_click_train_are_its_labels(tmp_path: Path) -> None:
    times = [0.6 + 0.7 * n + 0.05 * (n % 3) for n in range(18)]
    _clicks(tmp_path / "train.wav", times, 14.0)
    (tmp_path / "train.txt").write_text("\n".join(f"{20 * time:.3f}" for time in times))
    out = tmp_path / "new" / "figures.json"
    assert PROBE.main("gesticulator probe", [
        "beat-labels", "--labels", str(tmp_path), "--sound", str(tmp_path / "train.wav"), "--label-fps", "20",
        "--tolerance", "0.05", "--out", str(out)]) == 0
    (table,) = load(out)
    rows: Any = table.rows
    assert list(rows) == ["onsets", "beats", "beats: onset", "beats: loud pseudo", "beats: even pseudo"]
    onsets = rows["onsets"]
    assert table.facts["labels"] == 18 == onsets["per_second"] * 14 and abs(onsets["offset_ms"]) < 20
    assert onsets["f"].mean == 1.0 and onsets["p_value"] < 0.01 and onsets["reached by"] == ""
    assert rows["beats: onset"]["recall"].mean == 1.0
    assert rows["beats"]["precision"].mean < 0.7  # pseudo-beats lie between


def test_frames_taken_for_seconds_are_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _clicks(tmp_path / "train.wav", TIMES, 3.0)
    (tmp_path / "train.txt").write_text("10\n25\n40\n")
    for arguments, wrong in (((), "--label-fps"), (("--label-fps", "20", "--tolerance", "0"), "not positive"),
                             (("--store", str(tmp_path)), "leave --sound"),
                             (("--leave-out", "(a"), "no regular expression")):
        with pytest.raises(SystemExit) as caught:
            PROBE.main("gesticulator probe", ["beat-labels", "--labels", str(tmp_path / "train.txt"), "--sound",
                                              str(tmp_path / "train.wav"),
                              *arguments])
        told = capsys.readouterr().err
        assert caught.value.code == 2 and wrong in told and told.count("\n") == 1


def test_the_recordings_of_a_store_that_have_labels(tiny_store: Path, tmp_path: Path,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beat_labels, "SHIFTS", 10)
    store = Store.open(tiny_store)
    name = store.names[0]
    truth = store.load(name).truth
    assert truth is not None
    beats = [stroke.beat for stroke in truth.strokes]
    (tmp_path / f"{name}_beats.json").write_text(json.dumps(beats))
    clips = beat_labels.from_store(store, beat_labels.labels_by_name(tmp_path, LabelChoice()))
    assert [clip.name for clip in clips] == [name]
    row: Any = judge(clips, [0.1])[0].rows["motion beats A"]
    assert row["recall"].mean > 0.7 and "nearby" not in row["reached by"]
    with pytest.raises(InputError, match="fit none"):
        judge(beat_labels.from_store(store, lambda name: None))


# ---------------------------------------------------------------------------------------------------- real labels

def test_real_stroke_times_are_where_the_arms_come_to_rest(outside_data: Path, tmp_path: Path,
                                                            monkeypatch: pytest.MonkeyPatch) -> None:
    """SmartBody's sync times are labels that an author set by hand; motion beats find their "emphasis"."""
    monkeypatch.setattr(beat_labels, "SHIFTS", 40)
    strokes = outside_data / "strokes"
    rows = (strokes / "manifest.csv").read_text().splitlines()
    table = tmp_path / "some.csv"
    table.write_text("\n".join([rows[0], *(row for row in rows[1:] if "brad_Idle01" in row)]))
    labels_of = beat_labels.labels_by_name(table, LabelChoice(column="emphasis"))
    clips = beat_labels.from_files(None, strokes, labels_of, leave_out="ToIdle|ScratchHead|WeightShift")
    assert len(clips) > 10 and all(len(clip.labels.times) == 1 for clip in clips)
    told: Any = judge(clips, [0.2])[0].rows["motion beats B"]
    assert told["reached by"] == "" and told["p_value"] < 0.05
    assert abs(told["offset_ms"]) < 250


def test_a_real_take_marked_at_its_own_motion_beats(outside_data: Path, tmp_path: Path) -> None:
    take = outside_data / "takes" / "beat_scott"
    motion, sound = next(take.glob("*.npz")), next(take.glob("*.wav"))
    marks = Labels(np.array([1.0]), "none yet")
    beats = beat_labels.detections(LabelledRecording("own", marks, motion=read_motion(motion)))["motion beats A"]
    (tmp_path / "own.txt").write_text("\n".join(f"{time:.6f}" for time in beats))
    near, far = judge(beat_labels.from_files(sound, motion,
                                             beat_labels.labels_by_name(tmp_path / "own.txt", LabelChoice())))
    assert near.rows["motion beats A"]["f"].mean == 1.0  # type: ignore[union-attr]
    for name in ("onsets", "beats"):  # real speech: far from 1, and chance beside it
        row: Any = far.rows[name]
        assert 0.2 < row["f"].mean < 0.9 and 0.2 < row["shifted"] < 0.9


def test_a_label_beyond_the_recording_is_refused() -> None:
    with pytest.raises(InputError, match="has a label at"):
        LabelledRecording("x", Labels(np.array([40.0]), "seconds"), Speech(np.zeros(48000, np.float32), 16000))
