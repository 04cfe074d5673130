"""The voices: times that the sound confirms, effort that is heard, the same bytes from the same seed."""

from __future__ import annotations

import re
import shutil
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import soundfile
from gesticulator_performer import flite, sound, syllables
from gesticulator_performer.syllables import Phrase, Spoken
from gesticulator_performer.text import Part, Utterance, compose
from gesticulator_performer.voices import nuclei_of, speak

from data_module.errors import InputError
from data_module.types import Speech

RATE = 16000
needs_flite = pytest.mark.skipif(not shutil.which("flite"), reason="flite is not installed")
needs_espeak = pytest.mark.skipif(not shutil.which("espeak-ng"), reason="libespeak-ng is not installed")
ENGLISH = pytest.mark.parametrize("voice", [
    *(pytest.param(voice, marks=needs_flite) for voice in ("rms", "slt_deep", "awb_high")),
    *(pytest.param(voice, marks=needs_espeak) for voice in ("us_f3", "rp_m7"))])


def _said(*phrases: tuple[str, float]) -> list[Utterance]:
    return [Utterance((Part(text, effort, 0.6),), "test") for text, effort in phrases]


@lru_cache
def _spoken(voice: str) -> Spoken:
    return speak(compose(np.random.default_rng(1), 25, "train"), voice, np.random.default_rng(2))


def _rise_errors(spoken: Spoken, late: float = 0.0) -> np.ndarray:
    """Per syllable: seconds from its vowel onset (and `late` more) to the steepest rise of the sound within 80 ms. The
    level is that of 20 ms every 10 ms by plain summing: an oracle apart from the module's own."""
    samples = spoken.speech.samples
    power = (samples[:len(samples) // 160 * 160].reshape(-1, 160).astype(float) ** 2).mean(axis=1)
    rise = np.gradient(10 * np.log10((power + np.concatenate((power[:1], power[:-1]))) / 2 + 1e-9))
    middles = [round((syllable.vowel + late) * 100) for syllable in spoken.syllables]
    firsts = [max(middle - 8, 0) for middle in middles]
    return np.array([(first + rise[first:middle + 9].argmax() - middle) / 100
                     for first, middle in zip(firsts, middles, strict=True)])


@ENGLISH
def test_vowels_lie_on_rises_of_the_sound(voice: str) -> None:
    spoken = _spoken(voice)
    errors = _rise_errors(spoken)
    assert abs(np.median(errors)) <= 0.01
    assert np.median(np.abs(errors)) <= 0.03
    # The same measure finds a clock that is 60 ms late.
    assert abs(np.median(_rise_errors(spoken, 0.06))) > 0.03


@ENGLISH
def test_effort_raises_loudness_range_and_rate_together(voice: str) -> None:
    line = "the banker carried a wonderful yellow melon over the long wall."
    made = speak(_said((line, -0.8), (line, 0.8)), voice, np.random.default_rng(0))
    calm, lively = made.phrases
    assert (calm.effort, lively.effort) == (-0.8, 0.8)

    def part(phrase: Phrase) -> np.ndarray:
        return made.speech.samples[round(phrase.start * RATE):round(phrase.end * RATE)]

    gain = 20 * np.log10(np.std(part(lively)) / np.std(part(calm)))
    assert 10 < gain < 19  # 9 dB either way at full effort: 14.4 dB between these two
    assert lively.end - lively.start < 0.93 * (calm.end - calm.start)

    def spread(phrase: Phrase) -> float:
        track = syllables.pitch_track(part(phrase), RATE)
        return float(np.ptp(np.percentile(np.log(track[track > 0]), [10, 90])))

    assert spread(lively) > 1.15 * spread(calm)


@ENGLISH
def test_the_same_seed_gives_the_same_bytes(voice: str) -> None:
    text = compose(np.random.default_rng(6), 8, "test")
    first, second, other = (speak(text, voice, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first.speech.samples.tobytes() == second.speech.samples.tobytes()
    assert first.syllables == second.syllables and first.phrases == second.phrases
    assert first.speech.samples.tobytes() != other.speech.samples.tobytes()


def test_phones_find_their_words_through_changes() -> None:
    """The word "don't" loses its t, "the" changes its vowel, "and" its d: each phone still lies in its word."""
    words = [("ay",), ("d", "ow", "n", "t"), ("n", "ow"), ("dh", "ax"), ("ae", "p", "ax", "l")]
    spoken = ["ay", "d", "ow", "n", "n", "ow", "dh", "iy", "ae", "p", "ax", "l"]
    assert flite.assigned(spoken, words) == [0, 1, 1, 1, 2, 2, 3, 3, 4, 4, 4, 4]
    assert flite.assigned(["ae", "n", "s", "ow"], [("ae", "n", "d"), ("s", "ow")]) == [0, 0, 1, 1]


def test_syllables_of_phones() -> None:
    names = [("b", 0), ("a", 0), ("n", 0), ("d", 0), ("a", 0), ("h", 1), ("m", 1)]
    phones = [sound.Phone(n, i / 10, (i + 1) / 10, n == "a", w) for i, (n, w) in enumerate(names)]
    assert [(n.start, n.vowel, n.end, n.word) for n in nuclei_of(phones)] == \
        [(0.0, 0.1, 0.3, 0), (0.3, 0.4, 0.5, 0), (0.5, 0.5, 0.7, 1)]


def test_a_missing_program_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="flite: is not installed; on Debian: apt install flite"):
        speak(_said(("hello there", 0.0)), "slt", np.random.default_rng(0))


@pytest.mark.parametrize(("name", "language"), [("es_prose_1", "es"), ("de_prose_1", "de"), ("en_sonnet_1", "en")])
def test_real_readings_are_heard(outside_data: Path, name: str, language: str) -> None:
    """As many syllables as the text has runs of vowel letters, within a fifth."""
    samples, rate = soundfile.read(outside_data / "speech" / f"{name}.flac", dtype="float32")
    text = (outside_data / "speech" / f"{name}.txt").read_text(encoding="utf-8").lower()
    heard = syllables.find_syllables(Speech(samples, rate), language)
    written = re.sub(r"\b(\w+[^aeiouy\W])es?\b", r"\1", text) if language == "en" else text
    assert len(heard.syllables) == pytest.approx(len(re.findall("[aeiouyäöüáéíóú]+", written)), rel=0.2)
    assert all(b.start - a.end >= 0.25 - 1e-9 for a, b in zip(heard.phrases, heard.phrases[1:], strict=False))


def test_an_utterance_without_its_text_is_heard(outside_data: Path) -> None:
    """It says "Chapter one" and its title, and begins "Anne of Green Gables", up to "a brook": 49 syllables."""
    sound = outside_data / "voices" / "train_clean" / "103-1240-0000.flac"
    if not sound.is_file():
        pytest.skip("the outside data has no voices")
    samples, rate = soundfile.read(sound, dtype="float32")
    heard = syllables.find_syllables(Speech(samples, rate), "en")
    assert len(heard.syllables) == pytest.approx(49, rel=0.12) and {one.word for one in heard.syllables} == {-1}
    assert 3 <= len(heard.phrases) <= 9
    prominence = np.array([one.prominence for one in heard.syllables])
    assert abs(prominence.mean()) < 0.1 and 0.05 < (prominence > 1).mean() < 0.3
