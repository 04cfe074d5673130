"""Recordings are read in pieces, and are what they are as a whole."""

from pathlib import Path

import numpy as np
import pytest
import soundfile
from performances import example

from data_module.speech import sound_files
from data_module.speech.audio import load_speech


def test_sound_is_read_in_pieces_and_is_the_whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    samples = example(2.0).samples
    soundfile.write(tmp_path / "a.wav", np.stack([samples, samples / 2], 1), 44100)
    whole = load_speech(tmp_path / "a.wav").samples
    monkeypatch.setattr(sound_files, "PIECE", 6000)
    assert np.array_equal(load_speech(tmp_path / "a.wav").samples, whole)
