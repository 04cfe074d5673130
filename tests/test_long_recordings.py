"""Recordings done in pieces: the bytes of the whole, in bounded memory, and nothing left behind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
from example_speech import example_speech

from data_module.speech import sound_files
from data_module.speech.audio import load_speech
from gesticulator import infer


def test_sound_is_read_in_pieces_and_is_the_whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    samples = example_speech(2.0).samples
    soundfile.write(tmp_path / "a.wav", np.stack([samples, samples / 2], 1), 44100)
    whole = load_speech(tmp_path / "a.wav").samples
    monkeypatch.setattr(sound_files, "PIECE", 6000)
    assert np.array_equal(load_speech(tmp_path / "a.wav").samples, whole)


def test_what_breaks_off_leaves_nothing_behind(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    speech = example_speech(6.0)
    samples, rate = speech.samples, speech.sample_rate
    samples[-rate // 2:] = np.nan
    soundfile.write(tmp_path / "a.wav", samples, rate, subtype="FLOAT")
    with pytest.raises(SystemExit) as stop:
        infer.main([str(tmp_path / "a.wav"), "-o", str(tmp_path / "out.bvh"), "-o", str(tmp_path / "out.glb")])
    assert stop.value.code == 2 and "not numbers" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.wav"]
