"""The stability probe: variants of a sound are what they are called, and the table tells how far the take moved."""

from __future__ import annotations

import argparse
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile

from data_module.errors import InputError
from data_module.speech.audio import SAMPLE_RATE, load_speech, resample
from data_module.types import Array, Motion, Speech, Word
from eval.metrics.eye.body import common_body
from eval.probes import stability
from gesticulator.performance import Performance
from tests.test_eye import elbow, posed

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
    options = argparse.Namespace(speech=[tmp_path / "talk.wav"], text=[], bundle=None, speaker=None, seeds=1)
    table, verdicts = stability.run(options)
    assert len(verdicts.rows) == 2 * len(stability.VARIANTS) + len(stability.VARIANTS) - len(stability.LEVELS)
    assert {str(row["bound"]) for name, row in verdicts.rows.items() if name.startswith("hands")} == {
        "at most 2.00", "at most 5.00"}
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
        stability.run(argparse.Namespace(speech=[], text=[], bundle=None, speaker=None, seeds=0))
    with pytest.raises(InputError, match="--text"):
        stability.run(argparse.Namespace(speech=[], text=[SPEECH], bundle=None, speaker=None, seeds=1))


def said(*texts: str) -> Speech:
    words = tuple(Word(text, float(at), at + 0.8) for at, text in enumerate(texts))
    return Speech(np.zeros(len(texts) * SAMPLE_RATE, np.float32), SAMPLE_RATE, words)


def test_one_word_in_the_middle_is_changed_and_no_other() -> None:
    speech = said("a", "wonderful", "cat", "sat", "there", "was", "no", "b")
    changed, time = stability.word_changed(speech)
    assert [word.text for word in changed.words or ()] == [
        "a", "wonderful", "cat", "sat", "wonderful", "was", "no", "b"]
    assert time == 4.0 and [word.start for word in changed.words or ()] == [word.start for word in speech.words or ()]
    for few in (said("one"), said("same", "Same")):
        with pytest.raises(InputError, match="two words"):
            stability.word_changed(few)


def swinging(*strokes: float) -> Motion:
    """30 s in which the right hand goes out and back at these seconds."""
    def move(time: Array) -> dict[str, Array]:
        swings = [np.where(np.abs(time - at - 0.5) < 0.5, 0.6 * (1 - np.cos(2 * np.pi * (time - at))), 0.0)
                  for at in strokes]
        return {"RightForeArm": elbow("Right", np.sum(swings, axis=0))}

    return posed(30.0, move)


def test_what_a_word_changes_is_told_before_its_unit_and_from_the_second_after_it() -> None:
    edges, lexemes = np.arange(31.0), np.zeros(30, int)

    def made(motion: Motion, own: np.ndarray) -> Performance:
        return SimpleNamespace(motion=motion, lexemes=own, blocks=SimpleNamespace(edges=edges))  # type: ignore[return-value]

    first = made(swinging(4.0, 10.0, 16.0, 22.0), lexemes)
    units = stability.units_of(common_body(first.motion))
    assert [round(begin) for begin, _ in units] == [4, 10, 16, 22]
    other = lexemes.copy()
    other[10:16] = 1  # its own unit, and until the second after it
    quiet = stability.moved_by_word(first, made(swinging(4.0, 10.4, 16.0, 22.0), other), 10.5)
    assert quiet["before"] < 0.01 and quiet["after"] == 0.0
    other[25:] = 1
    loud = stability.moved_by_word(first, made(swinging(4.6, 10.4, 16.0, 22.0), other), 10.5)
    assert loud["before"] > 1.0 and loud["after"] > 50.0
    assert np.isnan(stability.moved_by_word(first, first, 17.0)["after"]), "no second unit after it"
    # The new word's gesture is prepared before the word and before the old one's unit; what moves before that counts.
    prepared = stability.moved_by_word(first, made(swinging(4.0, 9.5, 16.0, 22.0), other), 9.9)
    assert prepared["before"] < 0.01
    assert stability.moved_by_word(first, made(swinging(4.6, 9.5, 16.0, 22.0), other), 9.9)["before"] > 1.0
