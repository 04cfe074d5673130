"""Reading recordings: every format, and everything that can be wrong with one."""

from __future__ import annotations

import io
import subprocess
import sys
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
import soundfile

from data_module.errors import InputError
from data_module.speech.audio import SAMPLE_RATE, AudioWarning, load_speech, write_flac
from data_module.types import Samples, Speech

FORMATS = [("wav", "WAV", "PCM_16"), ("flac", "FLAC", "PCM_16"), ("ogg", "OGG", "VORBIS"), ("mp3", "MP3", None)]


def tone(rate: int, seconds: float = 2.0, hertz: float = 440.0) -> Samples:
    return (0.3 * np.sin(2 * np.pi * hertz * np.arange(round(rate * seconds)) / rate)).astype(np.float32)


def encoded(samples: np.ndarray, rate: int, kind: str = "WAV", subtype: str | None = "PCM_16") -> bytes:
    memory = io.BytesIO()
    soundfile.write(memory, samples, rate, format=kind, subtype=subtype)
    return memory.getvalue()


def put(folder: Path, name: str, data: bytes) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def refused(path: Path, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_speech(path)
    line = str(caught.value)
    assert "\n" not in line
    assert path.name in line
    for word in words:
        assert word in line


@pytest.mark.parametrize(("suffix", "kind", "subtype"), FORMATS)
@pytest.mark.parametrize("rate", [8000, 16000, 44100, 48000])
@pytest.mark.parametrize("channels", [1, 2])
def test_a_tone_keeps_its_pitch_length_and_level_in_every_format(
        tmp_path: Path, suffix: str, kind: str, subtype: str | None, rate: int, channels: int) -> None:
    sound = np.repeat(tone(rate)[:, None], channels, axis=1)
    path = put(tmp_path, f"a.{suffix}", encoded(sound, rate, kind, subtype))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        speech = load_speech(path)
    assert speech.sample_rate == SAMPLE_RATE
    assert speech.words is None
    assert abs(speech.duration - 2.0) < 0.002
    middle = speech.samples[4000:28000].astype(np.float64)
    spectrum = np.abs(np.fft.rfft(middle * np.hanning(len(middle))))
    assert abs(np.argmax(spectrum) * SAMPLE_RATE / len(middle) - 440.0) < 1.0
    assert np.sqrt(np.mean(middle ** 2)) == pytest.approx(0.3 / np.sqrt(2), rel=0.03)


def test_channels_are_averaged(tmp_path: Path) -> None:
    sound = np.stack([tone(16000), np.zeros(32000, np.float32)], axis=1)
    speech = load_speech(put(tmp_path, "a.wav", encoded(sound, 16000)))
    assert np.allclose(speech.samples, tone(16000) / 2, atol=1e-4)


def test_flac_round_trip_is_exact_to_16_bits(tmp_path: Path) -> None:
    noise = (0.2 * np.random.default_rng(0).standard_normal(16000)).astype(np.float32)
    write_flac(tmp_path / "a.flac", Speech(noise, SAMPLE_RATE))
    assert np.abs(load_speech(tmp_path / "a.flac").samples - noise).max() <= 1.0 / 32768
    assert [path.name for path in tmp_path.iterdir()] == ["a.flac"]


def test_what_is_no_sound_is_refused_in_one_line(tmp_path: Path) -> None:
    random = np.random.default_rng(0).bytes(80000)
    refused(tmp_path / "missing.wav", "does not exist")
    refused(tmp_path, "directory")
    refused(put(tmp_path, "empty.wav", b""), "empty")
    refused(put(tmp_path, "text.wav", b"not a sound at all\n" * 100), "decoded")
    refused(put(tmp_path, "text.mp3", b"not a sound at all\n" * 100), "decoded")
    refused(put(tmp_path, "random.mp3", b"\xff\xfb" + random), "decoded")
    refused(put(tmp_path, "a.raw", random), "decoded")
    refused(put(tmp_path, "header.wav", encoded(tone(16000), 16000)[:30]), "header")


def test_samples_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    refused(put(tmp_path, "none.wav", encoded(tone(16000)[:0], 16000)), "no samples")
    refused(put(tmp_path, "short.wav", encoded(tone(16000, 0.29), 16000)), "0.29 s", "0.3 s")
    load_speech(put(tmp_path, "enough.wav", encoded(tone(16000, 0.3), 16000)))
    for value in (np.nan, np.inf):
        sound = tone(48000)
        sound[500] = value
        refused(put(tmp_path, "nan.wav", encoded(sound, 48000, subtype="FLOAT")), "not numbers")
    refused(put(tmp_path, "big.wav", encoded(tone(16000) * 30000, 16000, subtype="FLOAT")), "full scale")
    refused(put(tmp_path, "slow.wav", encoded(tone(500, 9.0), 500)), "500 samples per second")


@pytest.mark.parametrize(("suffix", "kind", "subtype"), [row for row in FORMATS if row[0] != "ogg"])
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_a_file_shorter_than_its_header_promises_is_refused(
        tmp_path: Path, suffix: str, kind: str, subtype: str | None, share: float) -> None:
    noise = (0.1 * np.random.default_rng(0).standard_normal(44100 * 4)).astype(np.float32)
    whole = encoded(noise, 44100, kind, subtype)
    assert load_speech(put(tmp_path, f"whole.{suffix}", whole)).duration == pytest.approx(4.0, abs=0.01)
    refused(put(tmp_path, f"cut.{suffix}", whole[:int(len(whole) * share)]), "copy it again")


def open_ended(kind: str) -> bytes:
    """A sound of 2 s as a recorder writes it that cannot go back to fill in the length."""
    if kind == "flac":
        data = bytearray(encoded(tone(16000), 16000, "FLAC"))
        data[21] &= 0xF0
        data[22:26] = bytes(4)
    elif kind == "ogg":
        noise = (0.1 * np.random.default_rng(0).standard_normal(96000)).astype(np.float32)
        whole = encoded(noise, 16000, "OGG", "VORBIS")
        data = bytearray(whole[:len(whole) * 2 // 3])
    else:
        data = bytearray(encoded(tone(16000), 16000))
        place = data.find(b"data") + 4
        data[place:place + 4] = {"zero": bytes(4), "ones": b"\xff" * 4, "sox": b"\xdb\xff\xff\x7f"}[kind]
    return bytes(data)


@pytest.mark.parametrize("kind", ["zero", "ones", "sox", "flac", "ogg"])
def test_a_length_left_open_is_one_warning(tmp_path: Path, kind: str) -> None:
    path = put(tmp_path, f"a.{kind if kind in ('flac', 'ogg') else 'wav'}", open_ended(kind))
    with pytest.warns(AudioWarning) as caught:
        speech = load_speech(path)
    assert len(caught) == 1
    if kind != "ogg":
        assert np.allclose(speech.samples, tone(16000), atol=1e-4)


def test_the_decoders_keep_quiet(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    noise = (0.1 * np.random.default_rng(0).standard_normal(48000)).astype(np.float32)
    whole = encoded(noise, 16000, "MP3", None)
    for data in (whole, whole[:len(whole) // 2], b"\xff\xfb" + np.random.default_rng(1).bytes(90000)):
        path = put(tmp_path, "a.mp3", data)
        if data is whole:
            load_speech(path)
        else:
            refused(path)
    assert capfd.readouterr() == ("", "")


def test_a_long_recording_is_never_held_at_its_own_rate(tmp_path: Path) -> None:
    noise = (0.1 * np.random.default_rng(0).standard_normal((48000 * 90, 2))).astype(np.float32)
    path = put(tmp_path, "a.wav", encoded(noise, 48000))
    held = noise.nbytes
    load_speech(path)  # what is imported on first use does not count
    tracemalloc.start()
    speech = load_speech(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert speech.duration == pytest.approx(90.0, abs=0.001)
    assert peak < 2.2 * speech.samples.nbytes + 10e6 < held


def test_importing_the_reader_imports_no_decoder() -> None:
    code = ("import sys, data_module.speech.audio;"
            "print([m for m in ('soundfile', 'soxr', 'librosa') if m in sys.modules])")
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
