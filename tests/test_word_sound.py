"""Where the stroke of a word falls by its sound, and how large its gesture is: made words with known answers."""

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.word_sound import WordSounds
from data_module.types import Speech, Word
from gesticulator.directing.cues import gesture_of_word, stroke_of_word

LASTS = 0.4
"""Seconds of a made word; words follow each other every half second, from .5 s on."""


def word(number: int) -> Word:
    return Word("word", 0.5 + 0.5 * number, 0.5 + 0.5 * number + LASTS)


def said(*words: tuple[float, float, float]) -> Speech:
    """A word for each (seconds from its start to its vowel, decibels, hertz): a hiss, a vowel of .15 s, and silence."""
    random = np.random.default_rng(0)
    sound = 1e-4 * random.standard_normal(round((1.0 + 0.5 * len(words)) * SAMPLE_RATE))
    for number, (vowel, level, pitch) in enumerate(words):
        begin = round(word(number).start * SAMPLE_RATE)
        at = begin + round(vowel * SAMPLE_RATE)
        sound[begin:at] += 0.01 * random.standard_normal(at - begin)
        seconds = np.arange(round(0.15 * SAMPLE_RATE)) / SAMPLE_RATE
        wave = sum(np.sin(2 * np.pi * pitch * k * seconds) / k for k in range(1, 12))
        edge = np.minimum(1.0, np.minimum(seconds, seconds[-1] - seconds) / 0.01)
        sound[at:at + len(wave)] += 0.1 * 10 ** (level / 20) * edge * wave
    return Speech(sound.astype(np.float32), SAMPLE_RATE)


def sounds(speech: Speech, count: int) -> WordSounds:
    return WordSounds(speech, [word(number) for number in range(count)])


@pytest.mark.parametrize("vowel", [0.03, 0.08, 0.15, 0.22])
@pytest.mark.parametrize("pitch", [90.0, 140.0, 230.0, 320.0])
def test_a_stroke_falls_just_before_the_vowel(vowel: float, pitch: float) -> None:
    begins = word(0).start + vowel
    assert sounds(said((vowel, 0.0, pitch)), 1).vowel(word(0)) == pytest.approx(begins, abs=0.035)
    assert -0.2 < gesture_of_word(word(0), sounds(said((vowel, 0.0, pitch)), 1))[0] - begins < 0.05


def test_of_two_vowels_the_louder_one_counts_unless_it_is_far() -> None:
    early, late = said((0.02, 0.0, 120.0)), said((0.22, 0.0, 120.0))

    def found(decibels: float) -> float:
        both = Speech((early.samples + 10 ** (decibels / 20) * late.samples).astype(np.float32), SAMPLE_RATE)
        return (sounds(both, 1).vowel(word(0)) or 0.0) - word(0).start

    assert found(0.0) < 0.1 and found(2.0) < 0.1 and found(15.0) > 0.15


@pytest.mark.parametrize("samples", [np.zeros(SAMPLE_RATE, np.float32),
                                     np.random.default_rng(1).normal(0, 0.1, SAMPLE_RATE).astype(np.float32),
                                     np.full(100, 0.5, np.float32)])
def test_without_a_voice_the_times_of_the_word_count(samples: np.ndarray) -> None:
    silent = WordSounds(Speech(samples, SAMPLE_RATE), [word(0)])
    assert silent.vowel(word(0)) is None
    assert gesture_of_word(word(0), silent) == gesture_of_word(word(0), None) == (stroke_of_word(word(0)), 1.0)


PLAIN = (0.08, 0.0, 120.0)


@pytest.mark.parametrize(("third", "size"), [
    ((0.08, 8.0, 160.0), 1.25), (PLAIN, 1.0), ((0.08, -8.0, 95.0), 0.8), ((0.08, 2.0, 120.0), 1.0),
])
def test_a_word_that_stands_out_gets_a_larger_gesture(third: tuple[float, float, float], size: float) -> None:
    speech = said(PLAIN, PLAIN, third, PLAIN, PLAIN)
    assert gesture_of_word(word(2), sounds(speech, 5))[1] == size


@lru_cache(maxsize=1)
def phrase() -> Speech:
    return said((0.05, 0.0, 120.0), (0.1, 6.0, 150.0), (0.15, -5.0, 100.0), (0.08, 3.0, 130.0), (0.2, 9.0, 180.0))


@settings(max_examples=15)
@given(st.floats(-50.0, 0.0))
def test_the_level_of_the_whole_recording_changes_nothing(decibels: float) -> None:
    quiet = Speech((phrase().samples * np.float32(10 ** (decibels / 20))).astype(np.float32), SAMPLE_RATE)
    for number in range(5):
        here, there = (sounds(one, 5) for one in (phrase(), quiet))
        assert gesture_of_word(word(number), here) == gesture_of_word(word(number), there)
