"""One clip measured: speeds, silence, rhythm beside its chance, errors beside the truth."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER, from_vector
from data_module.store import Recording, RecordingInfo
from data_module.types import Speech, Word
from eval.clip.excerpts import excerpt
from eval.clip.measure import ClipMeasurement, measure


def test_speeds_in_speech_and_in_silence() -> None:
    speed, silent = np.array([[1.0, 3.0], [2.0, 2.0], [0.5, 0.1]]), np.array([False, False, True])
    beats = np.array([0.5, 1.0, 1.5])
    clip = ClipMeasurement(beats, beats, 3.0, speed, silent)
    assert clip.speech_speed == 2.0
    assert clip.rhythm()[2] == pytest.approx(100.0)
    assert math.isnan(dataclasses.replace(clip, silent=np.ones(3, bool)).speech_speed)


def test_speeds_are_metres_per_second_and_silence_is_told_apart() -> None:
    rate, fps = 16000, 60.0
    t = np.arange(round(8 * fps)) / fps
    pose = np.zeros((len(t), len(CHARACTER), 3))
    moving = t < 4
    pose[:, CHARACTER.index("RightForeArm"), 1] = np.where(moving, np.sin(2 * np.pi * t), 0.0)
    motion = from_vector(pose.reshape(len(t), -1), fps)
    rng = np.random.default_rng(0)
    sound = 1e-4 * rng.normal(size=8 * rate)
    at = np.arange(4 * rate) / rate
    syllables = np.clip(np.sin(2 * np.pi * 3 * at), 0, 1)  # a steady hum would be taken for the room
    sound[:4 * rate] += 0.2 * syllables * np.sign(np.sin(2 * np.pi * 120 * at))
    clip = measure(motion, Speech(sound.astype(np.float32), rate))
    hand = positions_of(motion)[:, CHARACTER.index("RightHand")]
    by_hand = np.linalg.norm(np.diff(hand, axis=0), axis=1) * fps
    np.testing.assert_allclose(clip.hand_speed[:, 0], by_hand, atol=1e-9)
    assert 0.25 * np.pi * 2 * 0.6 < by_hand.max() < 0.25 * np.pi * 2 * 1.01, "a 25 cm forearm, 1 rad at 1 Hz"
    silent = np.flatnonzero(clip.silent) / fps
    assert 4.75 < silent.min() < 5.1, "silence settles a second after the last syllable, which ends at 3.83 s"


def test_motion_in_time_is_above_chance_and_motion_at_random_is_not() -> None:
    onsets = np.cumsum(np.random.default_rng(0).uniform(0.2, 0.6, 100))
    none = np.zeros((1, 2)), np.zeros(1, bool)
    percent, _, above = ClipMeasurement(onsets, onsets + 0.02, 60.0, *none).rhythm()
    assert percent == 100.0 and above == pytest.approx(100.0)
    random = np.cumsum(np.random.default_rng(1).uniform(0.2, 0.6, 100))
    assert abs(ClipMeasurement(onsets, random, 60.0, *none).rhythm()[2]) < 15
    assert math.isnan(ClipMeasurement(onsets, np.zeros(0), 60.0, *none).rhythm()[2])


def test_an_excerpt_is_the_middle_with_sound_words_and_motion_together() -> None:
    def recording(seconds: float) -> Recording:
        words = tuple(Word(str(n), n + 0.1, n + 0.9) for n in range(int(seconds)))
        samples = np.linspace(0, 0.5, round(seconds * 16000)).astype(np.float32)
        motion = from_vector(np.zeros((round(20 * seconds), 3 * len(CHARACTER))), 20.0)
        place = np.outer(np.arange(len(motion)) / 20, [1.0, 0.0, 0.0])
        return Recording(RecordingInfo("one", "test", "brad", "awb", "en"), Speech(samples, 16000, words),
                         dataclasses.replace(motion, root_positions=place))

    cut = excerpt(recording(20.0), 10.0)
    assert cut.speech.duration == pytest.approx(10) and cut.motion.duration == pytest.approx(10)
    assert cut.speech.samples[0] == pytest.approx(0.5 * 5 / 20, abs=1e-5)
    assert cut.motion.root_positions[0, 0] == pytest.approx(5)
    assert cut.speech.words is not None and [w.text for w in cut.speech.words] == [str(n) for n in range(5, 15)]
    assert cut.speech.words[0].start == pytest.approx(0.1)
    narrow = excerpt(recording(20.0), 9.0)
    assert narrow.speech.words is not None and narrow.speech.words[0].text == "6", "a word that is cut is left out"
    whole = excerpt(recording(6.0), 10.0)
    assert whole.speech.duration == pytest.approx(6) and len(whole.motion) == 120
