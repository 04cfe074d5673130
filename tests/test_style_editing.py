"""Style editing judged: players whose features are known beforehand must be told as what they are."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_module.controls import FEATURES, LEVELS, Controls, Levels
from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from data_module.store import Recording, RecordingInfo, Store, StoreWriter
from data_module.types import Motion, Speech, Word
from eval.ablate.style_editing import FREE, REFERENCE, SHOWN, excerpts, figures, realised
from eval.clip.excerpts import excerpt
from eval.pictures import plots

FPS, RATE = 60.0, 16000
SHOULDER_HEIGHT, ARM = 0.49, 0.53
"""Metres: the shoulder joint over the hips at rest, and from it to the wrist."""
LEVEL_TABLE = Levels(np.array([[0.1, 0.3, 0.6], [0.2, 0.5, 0.9], [0.3, 0.5, 0.7]]), np.array([0.3, 0.5, 0.5]),
                     np.array([0.2, 0.25, 0.2]))


def motion_of(height: float, speed: float, frames: int = 360, tremor: float = 0.0) -> Motion:
    """The right hand at `height`, the left going round so that both together have `speed` (m/s on average).

    tremor: m/s of mean speed that the right hand has on top, to and fro from frame to frame.
    """
    maps = np.zeros((frames, len(CHARACTER), 3))
    maps[:, CHARACTER.index("RightArm"), 2] = math.asin((SHOULDER_HEIGHT - height) / ARM)
    maps[:, CHARACTER.index("RightArm"), 2] += (np.arange(frames) % 2) * 2 * math.asin(tremor / FPS / ARM)
    turn = 2 * math.asin(speed / FPS / ARM)  # a frame's chord is twice the speed, for one hand of two
    maps[:, CHARACTER.index("LeftArm"), 1] = turn * np.arange(frames)
    return Motion(CHARACTER, rotation.from_exponential_map(maps), np.zeros((frames, 3)), FPS)


def clips(count: int = 6) -> list[Recording]:
    speech = Speech(np.zeros(6 * RATE, np.float32), RATE)
    return [Recording(RecordingInfo(f"clip {i}", "test", "anyone", "awb", "en"), speech, motion_of(0.2, 0.4))
            for i in range(count)]


def number(clip: Recording) -> int:
    return int(clip.info.name.split()[1])


def asked(controls: Controls, feature: str, otherwise: float) -> float:
    values, given = controls.at(np.zeros(1))
    index = FEATURES.index(feature)
    return float(values[0, index]) if given[index] else otherwise


def obedient(clip: Recording, controls: Controls) -> Motion:
    """Does as told in height and speed, a centimetre or two off from clip to clip; deaf to radius."""
    off = 0.01 * (number(clip) - 2.5)
    return motion_of(asked(controls, "height", 0.2) + off, asked(controls, "speed", 0.4))


def test_realised_is_what_the_motion_does() -> None:
    got = dict(zip(SHOWN, realised(motion_of(0.25, 0.6)), strict=True))
    assert got["height"] == pytest.approx(0.25) and got["speed"] == pytest.approx(0.6)
    assert got["steady_speed"] == pytest.approx(0.6, rel=0.02)
    shaking = dict(zip(SHOWN, realised(motion_of(0.25, 0.1, tremor=0.8)), strict=True))
    assert shaking["speed"] == pytest.approx(0.9, rel=0.01)
    assert shaking["steady_speed"] < 0.15, "what the tremor adds is not a movement"


def test_an_obedient_player_rises_and_a_deaf_feature_does_not() -> None:
    found = figures(obedient, clips(), LEVEL_TABLE)
    for level, value in zip(LEVELS, (0.1, 0.3, 0.6), strict=True):
        height = found["rows"][f"height {level}"]["height"]
        assert height.mean == pytest.approx(value)
        assert value - 0.025 <= height.low < value < height.high <= value + 0.025
        assert found["rows"][f"speed {level}"]["speed"].mean == pytest.approx(found["asked"]["speed"][level])
    radius = [found["rows"][f"radius {level}"]["radius"].mean for level in LEVELS]
    assert radius == pytest.approx([radius[0]] * 3, abs=1e-9)
    assert found["rows"][FREE]["height"].mean == pytest.approx(0.2)
    assert found["rows"][FREE]["speed"].mean == pytest.approx(0.4)
    assert found["rows"][REFERENCE]["height"].to_dict() == pytest.approx({"mean": 0.2, "low": 0.2, "high": 0.2, "n": 6})


# ----------------------------------------------------------------------------------------------------- clips

def recording(name: str, seconds: float, group: str = "", split: Any = "test") -> Recording:
    frames = round(seconds * 20)
    samples = np.linspace(0, 0.5, round(seconds * RATE)).astype(np.float32)
    rotations = np.zeros((frames, len(CHARACTER), 4))
    rotations[..., 0] = 1
    place = np.outer(np.arange(frames) / 20, [1.0, 0.0, 0.0])
    words = tuple(Word(str(n), n + 0.1, n + 0.9) for n in range(int(seconds)))
    return Recording(RecordingInfo(name, split, "brad", "awb", "en", group=group), Speech(samples, RATE, words),
                     Motion(CHARACTER, rotations, place, 20.0))


def test_an_excerpt_is_the_middle_with_sound_words_and_motion_together() -> None:
    cut = excerpt(recording("long", 20.0), 10.0)
    assert cut.speech.duration == pytest.approx(10) and cut.motion.duration == pytest.approx(10)
    assert cut.speech.samples[0] == pytest.approx(0.5 * 5 / 20, abs=1e-5)
    assert cut.motion.root_positions[0, 0] == pytest.approx(5)
    assert cut.speech.words is not None
    assert [w.text for w in cut.speech.words] == [str(n) for n in range(5, 15)]
    assert cut.speech.words[0].start == pytest.approx(0.1)
    narrow = excerpt(recording("long", 20.0), 9.0)
    assert narrow.speech.words is not None and narrow.speech.words[0].text == "6", "a word that is cut is left out"
    whole = excerpt(recording("short", 6.0), 10.0)
    assert whole.speech.duration == pytest.approx(6) and len(whole.motion) == 120


def store_of(folder: Path, recordings: list[Recording]) -> Store:
    writer = StoreWriter(folder, "performer", {}, 0, "none")
    for one in recordings:
        writer.add(one)
    return writer.finish([one.info.name for one in recordings])


def test_clips_are_long_test_recordings_of_different_groups(tmp_path: Path) -> None:
    store = store_of(tmp_path / "store", [
        recording("a_short", 6), recording("b", 12, "one"), recording("c", 12, "one"), recording("d", 30, "two"),
        recording("e_tiny", 2), recording("f_train", 30, split="train"), recording("g", 11)])
    assert [clip.info.name for clip in excerpts(store, 8, 10.0)] == ["b", "d", "g", "a_short"]
    assert [clip.info.name for clip in excerpts(store, 2, 20.0)] == ["d", "b"]
    for count, seconds in ((1, 10.0), (8, 0.0), (8, math.nan), (8, math.inf)):
        with pytest.raises(InputError, match=r"--clips|--seconds"):
            excerpts(store, count, seconds)


def test_a_store_without_test_recordings_is_refused(tmp_path: Path) -> None:
    store = store_of(tmp_path / "store", [recording("a", 6, split="train"), recording("b", 6)])
    with pytest.raises(InputError, match="1 test recordings"):
        excerpts(store)


# --------------------------------------------------------------------------------------------------- reports

def test_the_picture_shows_what_was_asked_and_what_came() -> None:
    told = figures(obedient, clips(), LEVEL_TABLE)
    axes = plots.style_editing(told).axes
    over_time, boxes = axes[0], axes[1]
    levels = {round(float(line.get_ydata()[0]), 6) for line in over_time.lines if line.get_linestyle() == "--"}
    assert levels == {0.1, 0.3, 0.6}
    curves = [np.asarray(line.get_ydata()) for line in over_time.lines if line.get_linestyle() == "-"]
    assert [round(float(c.mean()), 3) for c in curves] == [0.075, 0.275, 0.575], "the first clip is 2.5 cm low"
    medians = sorted(float(np.mean(line.get_ydata())) for line in boxes.lines
                     if len(line.get_ydata()) == 2 and np.isclose(np.ptp(line.get_xdata()), 0.5))
    assert any(np.isclose(m, 0.6, atol=1e-6) for m in medians) and any(np.isclose(m, 0.1, atol=1e-6) for m in medians)
