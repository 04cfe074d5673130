"""Readings with another effort: the pitch range, tilt and rate that were asked for at the same level, and who obeys."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.speech.audio import SAMPLE_RATE, load_speech, resample
from data_module.types import Array, Speech
from eval.acceptance.motion import effort
from eval.acceptance.motion.effort import LIVELY, SUBDUED, loudness, said_with, tilted
from eval.metrics.eye.pitch import pitch_track

SPEECH = Path(__file__).resolve().parent.parent / "examples" / "speech.flac"


@pytest.fixture(scope="module")
def speech() -> Speech:
    whole = resample(load_speech(SPEECH), SAMPLE_RATE)
    return Speech(whole.samples[:8 * SAMPLE_RATE], SAMPLE_RATE)


def tilt_of(samples: Array) -> float:
    """dB by which 2 to 4 kHz lie over 300 to 700 Hz."""
    power = np.abs(np.fft.rfft(samples)) ** 2
    hertz = np.fft.rfftfreq(len(samples), 1 / SAMPLE_RATE)
    high, low = (power[(hertz > a) & (hertz < b)].mean() for a, b in ((2000, 4000), (300, 700)))
    return float(10 * np.log10(high / low))


def test_another_effort_has_another_pitch_range_tilt_and_rate_and_the_same_level(speech: Speech) -> None:
    pytest.importorskip("parselmouth", reason="praat-parselmouth is not installed")
    lively, subdued = said_with(speech, LIVELY), said_with(speech, SUBDUED)
    for own, asked in ((lively, LIVELY), (subdued, SUBDUED)):
        assert own.duration == pytest.approx(speech.duration / asked.rate, rel=0.01)
        assert loudness(own.samples.astype(float), SAMPLE_RATE) == pytest.approx(
            loudness(speech.samples.astype(float), SAMPLE_RATE), rel=1e-3)
    wide, own, narrow = (float(np.subtract(*np.nanpercentile(pitch_track(sound), [90, 10])))
                         for sound in (lively, speech, subdued))
    assert wide > 1.3 * own and narrow < 0.7 * own
    assert tilt_of(lively.samples) > tilt_of(speech.samples) + 3.0 > tilt_of(subdued.samples) + 6.0


@given(st.floats(-6.0, 6.0))
def test_a_tilt_is_as_steep_as_it_is_called(decibels: float) -> None:
    white = np.random.default_rng(0).normal(size=SAMPLE_RATE)
    before, after = (np.abs(np.fft.rfft(own)) for own in (white, tilted(white, SAMPLE_RATE, decibels)))
    hertz = np.fft.rfftfreq(len(white), 1 / SAMPLE_RATE)
    for at, octaves in ((300, 0.0), (1000, 1.0), (4000, 3.0), (7000, 3.0)):
        place = int(np.argmin(np.abs(hertz - at)))
        assert 20 * np.log10(after[place] / before[place]) == pytest.approx(decibels * octaves, abs=1e-6)


def values(size: float, speed: float, wrong: int = 0) -> Array:
    """[2, 2, 10] of ten readings with these ratios; in so many of them the order of both is the other way round."""
    out = np.ones((2, 2, 10)) * np.linspace(0.5, 1.5, 10)
    out[:, 0] *= np.array([size, speed])[:, None]
    out[:, :, :wrong] = out[:, ::-1, :wrong]
    return out


@pytest.mark.parametrize(("size", "speed", "wrong", "holds"), [
    (1.3, 1.0, 0, [True, True]), (1.0, 1.25, 0, [True, True]), (1.1, 1.15, 0, [False, True]),
    (1.6, 1.0, 2, [True, True]), (2.0, 1.0, 3, [True, False]), (1.0, 1.0, 0, [False, False]),
    (0.5, 0.9, 0, [False, False])])
def test_one_of_both_must_differ_by_a_fifth_in_the_right_order(size: float, speed: float, wrong: int,
                                                               holds: list[bool]) -> None:
    assert [verdict.holds for verdict in effort.clauses(values(size, speed, wrong), [0.1] * 10)][:2] == holds


def test_level_alone_must_change_nothing() -> None:
    same, other = (effort.clauses(values(1.3, 1.3), [apart] * 10)[2] for apart in (0.3, 26.0))
    assert same.holds is True and other.holds is False
