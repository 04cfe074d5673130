"""The stability probe: variants of a sound are what they are called, and the table tells how far the take moved."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest
import soundfile

from data_module.errors import InputError
from data_module.speech.audio import SAMPLE_RATE, load_speech, resample
from data_module.types import Speech
from eval.probes import stability

SPEECH = Path(__file__).resolve().parent.parent / "examples" / "speech.flac"


@pytest.fixture(scope="module")
def speech() -> Speech:
    whole = resample(load_speech(SPEECH), SAMPLE_RATE)
    return Speech(whole.samples[:5 * SAMPLE_RATE], SAMPLE_RATE)


@pytest.mark.parametrize(("name", "decibels"), [("0.1 dB quieter", 0.1), ("1 dB quieter", 1.0), ("6 dB quieter", 6.0)])
def test_levels_fall_by_what_they_are_called(name: str, decibels: float, speech: Speech) -> None:
    changed = stability.VARIANTS[name](speech).samples
    loud = np.abs(speech.samples) > 0.01
    np.testing.assert_allclose(20 * np.log10(np.abs(speech.samples[loud]) / np.abs(changed[loud])), decibels, atol=1e-3)


@pytest.mark.parametrize("name", ["resampled from 48 kHz", "MP3, 192 kbit/s", "noise at -60 dB"])
def test_other_exports_are_the_same_sound_in_time(name: str, speech: Speech) -> None:
    if name.startswith("MP3"):
        pytest.importorskip("av", reason="av is not installed")
    changed = stability.VARIANTS[name](speech).samples
    assert len(changed) == len(speech.samples) and changed.dtype == np.float32
    difference = changed - speech.samples
    assert 0 < np.sqrt((difference ** 2).mean()) < 0.0015
    if name.startswith("noise"):
        assert 20 * np.log10(np.sqrt((difference ** 2).mean())) == pytest.approx(-60.0, abs=0.2)


def test_the_table_has_every_variant_and_another_seed(speech: Speech, tmp_path: Path) -> None:
    pytest.importorskip("av", reason="av is not installed")
    soundfile.write(tmp_path / "talk.wav", speech.samples, SAMPLE_RATE)
    options = argparse.Namespace(speech=[tmp_path / "talk.wav"], bundle=None, speaker=None, seeds=1)
    [table] = stability.run(options)
    assert list(table.rows) == [*stability.VARIANTS, "another seed"]
    seeds = table.rows["another seed"]
    assert seeds["hands"].mean > 2.0 and seeds["lexemes"].mean > 20.0  # type: ignore[union-attr]
    for row in table.rows.values():
        assert 0 <= row["apart"].mean <= 100 and row["joints"].mean <= row["hands"].mean  # type: ignore[union-attr]


def test_a_rendering_against_itself_has_not_moved(speech: Speech) -> None:
    from gesticulator.pipeline import Gesticulator

    first = Gesticulator.from_pretrained().perform(speech)
    same = stability.moved(first, first)
    assert same["hands"] == same["joints"] == same["lexemes"] == same["apart"] == 0.0


def test_bad_options_are_refused() -> None:
    with pytest.raises(InputError, match="--seeds"):
        stability.run(argparse.Namespace(speech=[], bundle=None, speaker=None, seeds=0))
