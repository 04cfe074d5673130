"""Style editing judged: players whose features are known beforehand must be told as what they are."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from data_module.controls import FEATURES, LEVELS, Controls, Levels
from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from data_module.store import Recording, RecordingInfo, StoreWriter
from data_module.types import Motion, Speech, Word
from eval.ablate import style_editing
from eval.ablate.style_editing import FREE, REFERENCE, excerpts, figures, realised
from eval.clip.excerpts import excerpt

FPS, RATE = 60.0, 16000
SHOULDER_HEIGHT, ARM = 0.49, 0.53
"""Metres: the shoulder joint over the hips at rest, and from it to the wrist."""
LEVEL_TABLE = Levels(np.array([[0.1, 0.3, 0.6], [0.2, 0.5, 0.9], [0.3, 0.5, 0.7]]), np.array([0.3, 0.5, 0.5]),
                     np.array([0.2, 0.25, 0.2]))


def motion_of(height: float, speed: float, frames: int = 360) -> Motion:
    """The right hand at `height`, the left going round so that both together have `speed` (m/s on average)."""
    maps = np.zeros((frames, len(CHARACTER), 3))
    maps[:, CHARACTER.index("RightArm"), 2] = math.asin((SHOULDER_HEIGHT - height) / ARM)
    turn = 2 * math.asin(speed / FPS / ARM)  # a frame's chord is twice the speed, for one hand of two
    maps[:, CHARACTER.index("LeftArm"), 1] = turn * np.arange(frames)
    return Motion(CHARACTER, rotation.from_exponential_map(maps), np.zeros((frames, 3)), FPS)


def clips(count: int = 6) -> list[Recording]:
    """The number of a clip is its speaker's name."""
    speech = Speech(np.zeros(6 * RATE, np.float32), RATE)
    return [Recording(RecordingInfo(f"clip {i}", "test", str(i), "awb", "en"), speech, motion_of(0.2, 0.4))
            for i in range(count)]


def asked(controls: Controls, feature: str, otherwise: float) -> float:
    values, given = controls.at(np.zeros(1))
    index = FEATURES.index(feature)
    return float(values[0, index]) if given[index] else otherwise


def obedient(speech: Speech, *, speaker: str, controls: Controls, seed: int) -> Any:
    """Follows requests of height and speed, a centimetre or two off from clip to clip; ignores radius."""
    off = 0.01 * (int(speaker) - 2.5)
    return SimpleNamespace(motion=motion_of(asked(controls, "height", 0.2) + off, asked(controls, "speed", 0.4)))


def test_an_obedient_system_rises_and_an_ignored_feature_does_not() -> None:
    assert realised(motion_of(0.25, 0.6))[:2] == pytest.approx([0.25, 0.6])
    values = figures(obedient, clips(), LEVEL_TABLE)["values"]  # type: ignore[arg-type]
    means = {row: {feature: float(np.mean(of[feature])) for feature in FEATURES} for row, of in values.items()}
    for level, height, speed in zip(LEVELS, (0.1, 0.3, 0.6), (0.2, 0.5, 0.9), strict=True):
        assert means[f"height {level}"]["height"] == pytest.approx(height)
        assert np.ptp(values[f"height {level}"]["height"]) == pytest.approx(0.05)
        assert means[f"speed {level}"]["speed"] == pytest.approx(speed)
        assert means[f"radius {level}"]["radius"] == pytest.approx(means[FREE]["radius"], abs=1e-9)
    for row in (FREE, REFERENCE):
        assert (means[row]["height"], means[row]["speed"]) == pytest.approx((0.2, 0.4))


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


def test_clips_are_long_test_recordings_of_different_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recordings = [
        recording("a_short", 6), recording("b", 12, "one"), recording("c", 12, "one"), recording("d", 30, "two"),
        recording("e_tiny", 2), recording("f_train", 30, split="train"), recording("g", 11)]
    writer = StoreWriter(tmp_path / "store", "performer", {}, 0, "none")
    for one in recordings:
        writer.add(one)
    store = writer.finish([one.info.name for one in recordings])
    assert [clip.info.name for clip in excerpts(store)] == ["d", "b", "g", "a_short"]
    monkeypatch.setattr(style_editing, "SHORTEST", 60.0)
    with pytest.raises(InputError, match="no test recording"):
        excerpts(store)
