"""The figures of motion over minutes: known answers of hands that stay, walk away, and tire."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import published_bvh
import pytest

from data_module.speech.audio import SAMPLE_RATE
from data_module.types import Speech
from eval.renderings import AcceptanceVoice
from tests.benchmark_files import benchmark

DRIFT = benchmark("drift")
RATE, WINDOW, apart, long_readings, slope, windows = (
    DRIFT.RATE, DRIFT.WINDOW, DRIFT.apart, DRIFT.long_readings, DRIFT.slope, DRIFT.windows)
FRAMES = round(RATE * WINDOW)


def waving(windows_: int, drift: float = 0.0, tires: float = 0.0) -> np.ndarray:
    """[T, 2, 3] both hands on a circle of 10 cm, once in 2 s, that moves by `drift` metres and slows by `tires` a
    window."""
    k = np.arange(windows_ * FRAMES) // FRAMES
    angle = np.cumsum(np.pi * (1 - tires * k)) / RATE
    circle = 0.1 * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    circle[:, 2] += drift * k
    return np.repeat(circle[:, None], 2, axis=1)


def test_hands_that_stay_do_not_drift() -> None:
    found = windows(waving(6))
    assert np.abs(found["drift"]).max() < 0.2 and abs(slope(found["drift"])) < 0.1
    assert len(windows(waving(6)[:-5])["drift"]) == 6, "a few frames less are still six windows"
    assert found["speed"] == pytest.approx(0.1 * np.pi, rel=0.01) and found["spread"] == pytest.approx(10.0, rel=0.01)


def test_hands_that_walk_away_drift_by_as_much() -> None:
    found = windows(waving(6, drift=0.02))
    assert found["drift"] == pytest.approx([0, 2, 4, 6, 8, 10], abs=0.1)
    assert slope(found["drift"]) == pytest.approx(4.0, rel=0.02), "2 cm in half a minute"


def test_hands_that_tire_slow_down() -> None:
    found = windows(waving(6, tires=0.1))
    assert slope(found["speed"]) == pytest.approx(-2 * 0.1 * 0.1 * np.pi, rel=0.05)


def test_two_recordings_of_one_speaker_lie_apart_and_others_are_not_compared() -> None:
    motion = published_bvh.moving(31.0, 20.0)
    moved = replace(motion, rotations=np.roll(motion.rotations, 100, axis=0))
    silence = Speech(np.zeros(16, np.float32), SAMPLE_RATE)
    same = [AcceptanceVoice("a", silence, "test", motion, "ann"), AcceptanceVoice("b", silence, "test", motion, "ann")]
    assert apart(same) == pytest.approx([0.0], abs=1e-6)
    assert apart([same[0], replace(same[1], own=moved)])[0] > 0.01
    assert apart([same[0], replace(same[1], performer="ben")]) == []


def test_readings_are_joined_until_the_minutes_are_full() -> None:
    voices = [AcceptanceVoice(str(k), Speech(np.full(2 * SAMPLE_RATE, k / 9, np.float32), SAMPLE_RATE), "test", None,
                              "ann", str(k)) for k in range(5)]
    made = list(long_readings(voices, 3.0))
    assert [len(speech.samples) for speech in made] == [3 * SAMPLE_RATE] * 2, "the fifth fills none"
    assert made[1].samples[0] == pytest.approx(2 / 9), "each voice once"
