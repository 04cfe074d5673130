"""Alignment of a transcript: order, bounds, a second way to align as the oracle, and what if it fails."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from data_module.speech.audio import load_speech
from data_module.text import alignment as text
from data_module.types import Speech, Word

RATE = 16000


def _bursts(starts: list[float], seconds: float, length: float = 0.6) -> Speech:
    rng = np.random.default_rng(0)
    samples = 0.001 * rng.standard_normal(round(seconds * RATE))
    for start in starts:
        at = round(start * RATE)
        samples[at:at + round(length * RATE)] += 0.2 * rng.standard_normal(round(length * RATE))
    return Speech(samples.astype(np.float32), RATE)


@pytest.mark.parametrize(("word", "sounds"), [
    ("cat", "K AE T"), ("ship", "SH IH P"), ("mate", "M EY T"), ("light", "L AY T"), ("racing", "R AE S IH NG"),
    ("glutton", "G L AH T AA N"), ("", "AH"), ("''", "AH"),
])
def test_letters_to_sounds_on_known_words(word: str, sounds: str) -> None:
    assert text.letters_to_sounds(word) == sounds


def test_spoken_words_keep_apostrophes_and_part_hyphens() -> None:
    words = text.spoken_words("Feed’st thy light's flame — with self-substantial 42 fuel, ‘so’!")
    assert [plain for _, plain in words] == ["feed'st", "thy", "light's", "flame", "with", "self", "substantial",
                                             "fuel", "so"]
    assert words[0][0] == "Feed'st" and words[7][0] == "fuel"


def test_written_words_in_other_scripts() -> None:
    assert text.written_words("«L'été» — 3,5 % don’t _x_ !") == ["L'été", "3,5", "don’t", "x"]
    assert text.written_words("今天 天气很好，真的吗？ OK") == ["今天", *"天气很好真的吗", "OK"]


@pytest.mark.parametrize(("transcript", "follows"), [
    ("The café is naïve.", True), ("Das ist für Größe.", False), ("今天天气很好", False), ("42 !", False), ("", False),
    ("A Señor " + "spoke " * 30, True), ("¿Señor?", False),
])
def test_the_aligner_reads_english_letters(transcript: str, follows: bool) -> None:
    assert text.can_follow(transcript) is follows


def _read(outside_data: Path) -> tuple[Speech, str, tuple[Word, ...]]:
    pytest.importorskip("pocketsphinx")
    speech = load_speech(outside_data / "speech" / "en_austen_0870.flac")
    transcript = (outside_data / "speech" / "en_austen_0870.txt").read_text(encoding="utf-8")
    return speech, transcript, text.alignment(speech, transcript)[0]


def _apart(found: Sequence[Word], wanted: Sequence[Word]) -> NDArray[np.float64]:
    return np.abs([a.start - b.start for a, b in zip(found, wanted, strict=True)])


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8])
def test_a_text_that_stops_early_keeps_its_times_and_says_where_it_stops(outside_data: Path, share: float) -> None:
    speech, _, whole = _read(outside_data)
    count = round(share * len(whole))
    part, doubt, missing = text.alignment(speech, " ".join(word.text for word in whole[:count]))
    assert not doubt and np.quantile(_apart(part, whole[:count]), 0.95) < 0.1
    assert f"goes on after the last word, {whole[count - 1].text!r}" in missing


@pytest.mark.parametrize("share", [0.4, 0.7, 0.95])
def test_a_text_that_goes_on_keeps_the_times_of_what_is_there(outside_data: Path, share: float) -> None:
    speech, transcript, whole = _read(outside_data)
    count = round(share * len(whole))
    end = (whole[count - 1].end + whole[count].start) / 2
    part, doubt, missing = text.alignment(replace(speech, samples=speech.samples[:round(end * RATE)]), transcript)
    assert not doubt and abs(len(part) - count) <= 3
    same = min(len(part), count)
    assert np.quantile(_apart(part[:same], whole[:same]), 0.95) < 0.1
    assert f"word {len(part) + 1} on, {whole[len(part)].text!r}" in missing
    more, doubt, missing = text.alignment(speech, f"{transcript} And then the whole family left for the sea.")
    assert not doubt and len(more) == len(whole) and "'And'" in missing


@pytest.mark.parametrize(("other", "words"), [("en_sonnet_1", 200), ("en_austen_0890", 200), ("en_austen_0920", 200),
                                              ("en_sonnet_2", 8)])
@pytest.mark.parametrize("share", [0.6, 1.0])
def test_another_text_does_not_follow(outside_data: Path, other: str, words: int, share: float) -> None:
    speech, *_ = _read(outside_data)
    said = (outside_data / "speech" / f"{other}.txt").read_text(encoding="utf-8").split()[:words]
    part = speech.samples[:round(share * len(speech.samples))]
    assert text.alignment(replace(speech, samples=part), " ".join(said))[1]


def test_pieces_tile_the_recording_and_are_cut_in_pauses() -> None:
    starts = [0.5 + 1.0 * k for k in range(32)]
    samples = text._aligner_samples(_bursts(starts, 33.0))
    cut = text.pieces(samples)
    assert cut[0][0] == 0 and cut[-1][1] == len(samples)
    assert all(a[1] == b[0] for a, b in zip(cut, cut[1:], strict=False))
    for start, stop in cut:
        assert (stop - start) / RATE <= text.LONGEST_PIECE + 0.02
    for start, _ in cut[1:]:
        assert not any(s <= start / RATE <= s + 0.6 for s in starts)


def test_shared_out_words_keep_to_the_loud_parts() -> None:
    speech = _bursts([1.0, 3.0], 5.0, length=1.0)
    found = text.shared_out(speech, ["aaaa", "bbbb", "cccc", "dddd"])
    starts = [word.start for word in found]
    assert starts[0] == pytest.approx(1.0, abs=0.05) and starts[2] == pytest.approx(3.0, abs=0.1)
    assert found[-1].end == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("name", ["en_austen_0870", "en_austen_0920", "en_sonnet_3"])
def test_real_readings(outside_data: Path, name: str) -> None:
    """Words in order and within the speech; onsets agree with one pass over the whole file with a wide beam."""
    pytest.importorskip("pocketsphinx")
    speech = load_speech(outside_data / "speech" / f"{name}.flac")
    transcript = (outside_data / "speech" / f"{name}.txt").read_text(encoding="utf-8")
    found, doubt, missing = text.alignment(speech, transcript)
    assert not doubt and not missing
    assert [w.text.lower() for w in found][-1] == text.spoken_words(transcript)[-1][1]
    starts, ends = np.array([[w.start, w.end] for w in found]).T
    assert (np.diff(starts) > 0).all() and (starts[1:] >= ends[:-1] - 1e-9).all()
    assert starts[0] >= 0 and ends[-1] <= speech.duration
    if "austen" in name:  # a wide pass over a sonnet takes eight seconds; the next test watches for drift there
        whole = text._whole(text._aligner_samples(speech), [plain for _, plain in text.spoken_words(transcript)])
        apart = np.abs(starts - np.array([a for a, *_ in whole]))
        assert np.median(apart) <= 0.01 and (apart < 0.05).mean() > 0.95
